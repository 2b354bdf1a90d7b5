#!/bin/sh
# Install what the tests of the viewer need: a Chromium of the system's packages, and Playwright in .venv to drive it.
# Installs only what is missing, and only on Debian and Ubuntu as root or with sudo that asks no password; elsewhere it
# says in one line what to install and exits with 1.
set -eu
cd "$(dirname "$0")/../.."

if ! command -v chromium >/dev/null && ! command -v chromium-browser >/dev/null && ! command -v google-chrome >/dev/null
then
    . tools/install/system_packages.sh
    if ! may_install; then
        echo "test-browser: install this system package first (name as in Debian): chromium" >&2
        exit 1
    fi
    echo "test-browser: installing chromium"
    install_packages chromium
fi
if ! .venv/bin/python -c "import playwright" 2>/dev/null; then
    . tools/install/python_packages.sh
    install_with browser
fi
