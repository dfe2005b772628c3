#!/usr/bin/env bash
# Loads an export of three logs with LeRobot 0.4.4 and compares it with the logs. Usage: lerobot.sh DIR
# Installs lerobot, which brings torch (6 GB), into a virtual environment in DIR. Prints one JSON line.
set -euo pipefail
out=$(realpath -m "${1:?name a folder}")
cd "$(dirname "$0")/../.."
if [ ! -e "$out/venv/ready" ]; then
    python3 -m venv "$out/venv"
    "$out/venv/bin/pip" install --quiet --disable-pip-version-check lerobot==0.4.4 ./python
    touch "$out/venv/ready"
fi
"$out/venv/bin/python" -P python/benches/lerobot.py "$out"
