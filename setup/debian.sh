# Sourced by the scripts here: installs Debian packages where that needs no question.

say() { printf 'setup: %s\n' "$*"; }

debian_install() { # PACKAGE… ; says what to do where it cannot
    if command -v apt-get >/dev/null && [ "$(id -u)" = 0 ]; then
        root=env
    elif command -v apt-get >/dev/null && sudo -n true 2>/dev/null; then
        root="sudo -n env"
    else
        say "system packages are missing; install them: sudo apt-get install -y $*"
        return
    fi
    say "installing Debian packages: $*"
    apt="$root DEBIAN_FRONTEND=noninteractive apt-get -qq -o Dpkg::Use-Pty=0"
    # The lists may be absent or old (a fresh container), in which case the first try fails.
    $apt install -y --no-install-recommends "$@" >/dev/null 2>&1 ||
        { $apt update >/dev/null && $apt install -y --no-install-recommends "$@" >/dev/null; } ||
        say "apt-get failed; install by hand: $*"
}
