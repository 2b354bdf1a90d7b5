#!/bin/sh
# Make the virtual environment .venv, if there is none, and install nerf-rl with its development tools into it.
set -eu
cd "$(dirname "$0")/../.."

if [ ! -x .venv/bin/python ]; then
    python=$(sh tools/install/find_python.sh) || {
        echo "setup: no Python 3.11, 3.12 or 3.13 with the venv module found; install one or set PYTHON=/path/to/python" >&2
        exit 1
    }
    echo "setup: making .venv with $("$python" --version)"
    "$python" -m venv .venv
fi
echo "setup: installing nerf-rl and its dependencies (a few GB, mostly torch)"
. tools/install/python_packages.sh
install_with dev
