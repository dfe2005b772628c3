#!/usr/bin/env bash
# Measures `run --ros` beside a real node of ROS 2 and a simulated robot, and `view --foxglove`:
#
#   benches/ros/run.sh OUT
#
# Writes OUT/replay.jsonl, OUT/loop.json, OUT/kills.json and OUT/soak.json; about 35 minutes. Needs Python 3 with pip, and Node
# with npm.
set -euo pipefail
out=$(mkdir -p "${1:?usage: benches/ros/run.sh OUT}" && cd "$1" && pwd)
cd "$(dirname "$0")/../.."
if [ ! -e "$out/venv/ready" ]; then
    python3 -m venv --clear "$out/venv"
    "$out/venv/bin/pip" install --quiet --disable-pip-version-check numpy pillow mcap websockets -r tests/ros/requirements.txt
    touch "$out/venv/ready"
fi
if [ ! -e "$out/client/ready" ]; then
    npm install --silent --no-fund --no-audit --prefix "$out/client" @foxglove/ws-protocol@0.8.0 ws@8.23.0
    touch "$out/client/ready"
fi
cp benches/ros/official_client.mjs "$out/client/"
export ROS_PYTHON="$out/venv/bin/python"
cargo build --release --quiet --features ros,foxglove --bin mambavitact
program="${CARGO_TARGET_DIR:-target}/release/mambavitact"
"$ROS_PYTHON" benches/ros/replay.py --program "$program" >"$out/replay.jsonl"
"$ROS_PYTHON" benches/ros/loop.py --program "$program" --starts 5 --speed 0.3 --json "$out/loop.json"
"$ROS_PYTHON" benches/ros/loop.py --program "$program" --starts 0 --kills 100 --speed 0.3 --json "$out/kills.json"
"$ROS_PYTHON" benches/ros/soak.py --program "$program" --client "$out/client" >"$out/soak.json"
