#!/usr/bin/env bash
# Compares our SLAM with Open3D's frame-to-model ICP and TSDF integration, and our tracker with Open3D's ICP on known shapes, on ten logs of 8 s.
#
#   benches/open3d/run.sh OUT [--duration S]          writes OUT/results.jsonl and OUT/summary.json; some 30 minutes on 2 cores
#   benches/open3d/run.sh OUT --tune --duration 4     chooses Open3D's settings on three other logs, and writes OUT/settings.json
#
# Needs Rust and Python 3.10 to 3.13; installs Open3D 0.20 and the package of this repository into a virtual environment in OUT.
set -euo pipefail
out=$(realpath -m "${1:?name a folder}")
shift
cd "$(dirname "$0")/../.."
if [ ! -e "$out/venv/ready" ]; then
    python3 -m venv "$out/venv"
    "$out/venv/bin/python" -m pip install --quiet --disable-pip-version-check open3d==0.20.0 ./python
    touch "$out/venv/ready"
fi
"$out/venv/bin/python" benches/open3d/compare.py "$out" "$@"
