#!/bin/sh
# Install what the tests of the viewer need: a Chromium of the system's packages, and Playwright in .venv to drive it.
# Installs only what is missing, and only on Debian and Ubuntu as root or with sudo that asks no password; elsewhere it
# says in one line what to install and exits with 1.
set -eu
cd "$(dirname "$0")/.."

if ! command -v chromium >/dev/null && ! command -v chromium-browser >/dev/null && ! command -v google-chrome >/dev/null
then
    if [ "$(id -u)" -eq 0 ]; then
        as_root=env
    elif sudo -n true 2>/dev/null; then
        as_root="sudo env"
    else
        as_root=""
    fi
    if [ -z "$as_root" ] || ! command -v apt-get >/dev/null; then
        echo "test-browser: install this system package first (name as in Debian): chromium" >&2
        exit 1
    fi
    echo "test-browser: installing chromium"
    $as_root DEBIAN_FRONTEND=noninteractive apt-get -qq update
    $as_root DEBIAN_FRONTEND=noninteractive apt-get -qq install --yes --no-install-recommends chromium >/dev/null
fi
.venv/bin/python -c "import playwright" 2>/dev/null || .venv/bin/python -m pip install --quiet --editable ".[browser]"
