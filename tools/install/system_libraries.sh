#!/bin/sh
# Install what pip cannot: EGL with a driver, for MuJoCo's headless rendering, and Python if there is none that fits.
# Installs only what is missing, and only on Debian and Ubuntu as root or with sudo that asks no password; elsewhere it
# says in one line what to install and exits with 1. A MUJOCO_GL set by the user is taken as the user's own arrangement.
# What only one export needs is installed where that is possible and otherwise done without.
set -eu

[ "$(uname -s)" = Linux ] || exit 0

has_library() {
    PATH="$PATH:/sbin:/usr/sbin" ldconfig -p 2>/dev/null | grep -q "[[:space:]]$1[[:space:]]"
}

has_egl() {
    has_library libEGL.so.1 && has_library libOpenGL.so.0 &&
        ls /usr/share/glvnd/egl_vendor.d/*.json /etc/glvnd/egl_vendor.d/*.json 2>/dev/null | grep -q .
}

packages=""
if [ -z "${MUJOCO_GL:-}" ] && ! has_egl && ! has_library libOSMesa.so.8; then
    packages="libegl1 libopengl0 libgl1-mesa-dri"
fi
if ! sh "$(dirname "$0")/find_python.sh" >/dev/null; then
    packages="$packages python3 python3-venv"
fi
optional=""
if ! has_library libusb-1.0.so.0; then
    optional="libusb-1.0-0" # for Open3D
fi
[ -n "$packages$optional" ] || exit 0

. "$(dirname "$0")/system_packages.sh"

install() {
    echo "setup: installing system packages:" "$@"
    install_packages "$@"
}

if [ -z "$packages" ]; then
    if ! may_install || ! install $optional; then
        echo "setup: going on without $optional, so 'nerf-rl export --format mesh' will not run"
    fi
    exit 0
fi
if ! may_install; then
    echo "setup: install these system packages first (names as in Debian; Python 3.11 to 3.13):" $packages >&2
    exit 1
fi
install $packages $optional
