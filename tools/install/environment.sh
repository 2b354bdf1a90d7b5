#!/bin/sh
# Make the virtual environment .venv, if there is none, and install nerf-rl with its development tools into it.
# uv does it several times faster than pip; where uv cannot be had or fails (say, behind a private index), pip does it.
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
python=.venv/bin/python
export PIP_DISABLE_PIP_VERSION_CHECK=1

index=${PIP_INDEX_URL:-$($python -m pip config get global.index-url 2>/dev/null || true)}
if [ -n "$index" ]; then
    export UV_DEFAULT_INDEX="${UV_DEFAULT_INDEX:-$index}"
fi
# Bytecode is compiled here, because processes that may not write it would otherwise compile torch at every start.
echo "setup: installing nerf-rl and its dependencies (a few GB, mostly torch)"
if ! { $python -m pip install --quiet uv &&
    $python -m uv pip install --quiet --python $python --system-certs --compile-bytecode --editable ".[dev]"; }; then
    echo "setup: uv did not manage, so pip takes over (a few minutes)"
    $python -m pip install --quiet --editable ".[dev]"
fi
