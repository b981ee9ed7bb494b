#!/usr/bin/env bash
# The wheel, installed in an empty environment, passes the tests, outside the checkout: in it the
# source tree would shadow what is installed. Called by `make test-wheel`.
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
    "$(echo "$folder"/*.whl)[dev]"
cp -r "$root/tests" "$root/examples" "$root/README.md" "$folder/"
cp "$root/pyproject.toml" "$folder/"
rm -rf "$folder/source"
cd "$folder"
venv/bin/python -c "import hamsym; assert hamsym.__file__.startswith('$folder/venv'), hamsym.__file__"
venv/bin/python -m pytest -n 2 -m "not slow"
