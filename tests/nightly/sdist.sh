#!/usr/bin/env bash
# Makes the source distribution of the Python package, installs it into an empty environment, and uses it outside the clone. Its build takes
# ten minutes of two cores.
set -euo pipefail
cd "$(dirname "$0")/../.."
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/build"
"$folder/build/bin/pip" install --quiet 'maturin>=1.8.1,<2'
"$folder/build/bin/maturin" sdist --manifest-path python/Cargo.toml --out "$folder"
python3 -m venv "$folder/empty"
CARGO_TARGET_DIR="$folder/target" "$folder/empty/bin/pip" install --quiet "$folder"/mambavitact-*.tar.gz
cd "$folder"
empty/bin/python -m mambavitact run --object rubiks_cube_small --duration 0.5 --quiet --out run
empty/bin/python -c 'import mambavitact; assert len(mambavitact.Recording("run").poses) == 15'
echo "the source distribution works"
