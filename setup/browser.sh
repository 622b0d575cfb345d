#!/bin/sh
# Chromium and its driver, for the tests that open a report in a browser. Without them these tests are skipped.
set -eu
cd "$(dirname "$0")"
. ./debian.sh

if ! command -v chromium >/dev/null || ! command -v chromedriver >/dev/null; then
    debian_install chromium chromium-driver
    command -v chromedriver >/dev/null || say "no browser; its tests are skipped"
fi
