#!/usr/bin/env bash
# The wheel, installed in an empty environment, has what it needs: package data, the command, a solve
# with its proof. Outside the checkout: in it the source tree would shadow what is installed. What the
# code computes is tested in the checkout. Called by `make test-wheel`.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
# From a copy, so that neither build folders of the checkout get in nor new ones are left there.
mkdir "$folder/source"
(cd "$root" && tar -cf - pyproject.toml README.md LICENSE hamsym templates examples) | tar -xf - -C "$folder/source"
"$VENV_BIN/python" -m build --wheel --outdir "$folder" "$folder/source" >"$folder/build.log" 2>&1 ||
    { cat "$folder/build.log"; exit 1; }
"$PYTHON" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check "$TORCH" \
    "$(echo "$folder"/*.whl)" pytest
mkdir "$folder/tests"
cp "$root/tests/test_packaging.py" "$folder/tests/"
cp "$root/pyproject.toml" "$folder/"
rm -rf "$folder/source"
cd "$folder"
export HAMSYM_CACHE_DIR="$folder/cache"
venv/bin/python -c "import hamsym; assert hamsym.__file__.startswith('$folder/venv'), hamsym.__file__"
venv/bin/python -m pytest tests/test_packaging.py
venv/bin/hamsym --help >/dev/null
for backend in torch numpy numba jax c julia javascript; do
    venv/bin/hamsym source "p**2/2 + x**2/2 + x**4/4" --backend "$backend" >/dev/null
done
venv/bin/hamsym solve "p**2/2 + x**2/2 + x**4/4" --z0 x=1.3,p=1 --t-end 6 -o orbit.hamsym
venv/bin/hamsym certify orbit.hamsym
venv/bin/hamsym verify orbit.hamsym
