#!/bin/sh
# Check the wheel in dist/ in a clean virtual environment: it holds every module, it starts, every command's recipe prints.
# The wheel alone is installed; its dependencies are borrowed from .venv (a fresh torch would take minutes), so this says
# nothing about the dependency list. The checkout itself is out of reach: a file that the wheel lacks is a failure.
set -eu
cd "$(dirname "$0")/../.."

wheel=$(ls "$PWD"/dist/*.whl)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
.venv/bin/python -m venv --without-pip "$scratch/venv"
python=$scratch/venv/bin/python
.venv/bin/python -m pip --python "$python" install --quiet --disable-pip-version-check --no-deps "$wheel"
site_packages() {
    "$1" -c 'import sysconfig; print(sysconfig.get_path("purelib"))'
}
site_packages .venv/bin/python >"$(site_packages "$python")/borrowed.pth"

find nerf_rl -type f -not -name '*.pyc' | sort >"$scratch/checkout"
"$python" -m zipfile --list "$wheel" | awk '/^nerf_rl\// { print $1 }' | sort >"$scratch/wheel"
diff "$scratch/checkout" "$scratch/wheel" >&2 || {
    echo "build: files of nerf_rl/ (<) and files in the wheel (>) differ" >&2
    exit 1
}

cp tools/install/import_all_modules.py "$scratch"
cd "$scratch"
"$python" import_all_modules.py >imported
grep "$scratch/venv" imported
venv/bin/nerf-rl --version
venv/bin/nerf-rl --help >/dev/null
for command in $("$python" -c 'from nerf_rl.cli import COMMANDS; print(*COMMANDS)'); do
    venv/bin/nerf-rl "$command" --help >/dev/null
    venv/bin/nerf-rl "$command" --print_config >/dev/null
done
echo "build: $(basename "$wheel") works in a clean environment"
