#!/bin/sh
# Makes the virtual environment that every target of the Makefile works in:
#   system packages (Debian and its kin, only those missing) -> environment -> Python packages -> native kernel.
# Asks nothing. Safe to run again: what is there already is left alone.
set -eu
venv=${1:?usage: setup/environment.sh FOLDER}
cd "$(dirname "$0")/.."

. setup/debian.sh
stop() {
    printf 'setup: %s\n' "$*" >&2
    exit 1
}

find_python() { # the newest rule is Open3D's: it has wheels for these
    for name in "${PYTHON:-python3}" python3.13 python3.12 python3.11 python3.14; do
        if "$name" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' 2>/dev/null; then
            printf '%s' "$name"
            return
        fi
    done
}

python=$(find_python)
[ -n "$python" ] || stop "no Python 3.11 to 3.14 on PATH; install one (apt-get install python3), or name it: make PYTHON=…"
version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')

# Without these there is nothing to build with; Debian splits them off Python.
needed=
command -v c++ >/dev/null || command -v g++ >/dev/null || command -v clang++ >/dev/null || needed="g++"
"$python" -c 'import ensurepip' 2>/dev/null || needed="$needed python$version-venv"
header=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include") + "/Python.h")')
[ -e "$header" ] || needed="$needed python$version-dev"

# Open3D's wheel links against these but does not bring them.
libraries=
cache=$(PATH="$PATH:/sbin:/usr/sbin" ldconfig -p 2>/dev/null || true)
for pair in libusb-1.0.so.0=libusb-1.0-0 libGL.so.1=libgl1 libEGL.so.1=libegl1 libgomp.so.1=libgomp1 \
    libX11.so.6=libx11-6; do
    case $cache in *"${pair%=*} "*) ;; *) libraries="$libraries ${pair#*=}" ;; esac
done
libraries=${libraries# }
needed=${needed# }

if [ -n "$needed$libraries" ]; then
    debian_install $needed $libraries
    "$python" -c 'import ensurepip' 2>/dev/null || stop "Python $version cannot make an environment without python$version-venv"
    [ -e "$header" ] || stop "the kernel cannot be built without Python's headers (python$version-dev)"
fi

if ! "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
    say "making $venv with Python $version"
    rm -rf build/dev build/sanitize # configured for the interpreter of an older environment
    "$python" -m venv --clear "$venv"
fi

say "installing Python packages into $venv (the first time about 450 MB, most of it Open3D)"
pip() { "$venv/bin/python" -m pip --quiet --disable-pip-version-check "$@"; }
# No build isolation: the build folder then outlives the installation, and `make kernel` compiles only what changed.
pip install cmake ninja $("$venv/bin/python" -c '
import tomllib
print(*tomllib.load(open("pyproject.toml", "rb"))["build-system"]["requires"])')
pip install --no-build-isolation --config-settings=build-dir=build/dev --editable '.[test,lint]'

"$venv/bin/python" -c 'import open3d' 2>"$venv/open3d.log" ||
    stop "Open3D does not start ($(tail -n 1 "$venv/open3d.log")); it needs the packages: libusb-1.0-0 libgl1 libegl1 libgomp1 libx11-6"
say "ready"
