#!/bin/sh
# Make the virtual environment .venv, or complete it, and install nerf-rl with its development tools into it.
set -eu
cd "$(dirname "$0")/../.."

# Python is there before pip: an environment whose making was interrupted has the one and not the other.
can_install() {
    .venv/bin/python -m pip --version >/dev/null 2>&1 || .venv/bin/python -m uv --version >/dev/null 2>&1
}

if ! can_install; then
    python=$(sh tools/install/find_python.sh) || {
        echo "setup: no Python 3.11, 3.12 or 3.13 with the venv module found; install one or set PYTHON=/path/to/python" >&2
        exit 1
    }
    echo "setup: making .venv with $("$python" --version)"
    "$python" -m venv .venv  # what is in one that is there already stays
fi
echo "setup: installing nerf-rl and its dependencies (a few GB, mostly torch)"
. tools/install/python_packages.sh
install_with dev
