#!/bin/bash
# Installs the newest versions of all Python packages that zygos needs into an empty environment, and writes them to
# constraints.txt, which `make` obeys: a build of next year then has the packages of today. Usage: tools/lock.sh PYTHON
set -euo pipefail
cd "$(dirname "$0")/.."
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"$1" -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check '.[test,lint]'
{
    echo "# Versions of the Python packages that zygos is built and tested with. \`make lock\` writes this file."
    "$folder/venv/bin/pip" freeze --exclude zygos
} >"$folder/constraints.txt"
mv "$folder/constraints.txt" constraints.txt
