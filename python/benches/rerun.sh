#!/usr/bin/env bash
# Opens an export with the official MCAP reader and with rerun's converter. Usage: rerun.sh DIR
# Installs both into a virtual environment in DIR. Prints one JSON line.
set -euo pipefail
out=$(realpath -m "${1:?name a folder}")
cd "$(dirname "$0")/../.."
if [ ! -e "$out/venv/ready" ]; then
    python3 -m venv "$out/venv"
    "$out/venv/bin/pip" install --quiet --disable-pip-version-check rerun-sdk==0.41.0 mcap==1.6.0 mcap-protobuf-support ./python
    touch "$out/venv/ready"
fi
"$out/venv/bin/python" -P python/benches/rerun.py "$out"
