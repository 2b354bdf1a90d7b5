# Sourced by the install scripts: may_install tells whether system packages can be installed here (Debian or Ubuntu, as
# root or with sudo that asks no password), install_packages installs them.

if [ "$(id -u)" -eq 0 ]; then
    as_root=env
elif sudo -n true 2>/dev/null; then
    as_root="sudo env"
else
    as_root=""
fi

may_install() {
    [ -n "$as_root" ] && command -v apt-get >/dev/null
}

install_packages() {
    $as_root DEBIAN_FRONTEND=noninteractive apt-get -qq update &&
        $as_root DEBIAN_FRONTEND=noninteractive apt-get -qq install --yes --no-install-recommends "$@" >/dev/null
}
