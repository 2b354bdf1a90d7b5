# To be sourced from the checkout's root, where .venv is. One way to install for all: pip, which some machines configure
# otherwise than uv, would exchange a PyTorch that uv has installed for another one.

export PIP_DISABLE_PIP_VERSION_CHECK=1

# install_with EXTRA: install nerf-rl and what one of its extras asks for; what fits already stays as it is.
# uv does it several times faster than pip; where uv cannot be had or fails (say, behind a private index), pip does it.
install_with() {
    python=.venv/bin/python
    index=${PIP_INDEX_URL:-$($python -m pip config get global.index-url 2>/dev/null || true)}
    if [ -n "$index" ]; then
        export UV_DEFAULT_INDEX="${UV_DEFAULT_INDEX:-$index}"
    fi
    # Bytecode is compiled here, because processes that may not write it would otherwise compile torch at every start.
    if ! { { $python -m uv --version >/dev/null 2>&1 || $python -m pip install --quiet uv; } &&
        $python -m uv pip install --quiet --python $python --system-certs --compile-bytecode --editable ".[$1]"; }; then
        echo "uv did not manage, so pip takes over (a few minutes)"
        $python -m pip install --quiet --editable ".[$1]"
    fi
}
