#!/usr/bin/env bash
# Trains a policy to turn a ball, and plays it and the stroke from starts that no training has, with the true place of the object
# and its errors, and with our own estimate.
#
#   results/policy.sh OUT [STEPS]
#
# Writes OUT/training.json (steps, minutes), OUT/scores.jsonl (a line per object and controller), and OUT/policy and OUT/stroke, runs with SLAM.
# 2 million steps by default. An interrupted training begins anew, so that its minutes are those of all steps.
set -euo pipefail
out=$(mkdir -p "${1:?usage: results/policy.sh OUT [STEPS]}" && cd "$1" && pwd)
steps=${2:-2000000}
cd "$(dirname "$0")/.."
cargo build --release --quiet --features train --bin mambavitact
program="$PWD/${CARGO_TARGET_DIR:-target}/release/mambavitact"
cd "$out"
if [ ! -e training.json ]; then
    rm -f turn_ball.safetensors.state
    begun=$(date +%s)
    "$program" hand train --object ball --steps "$steps" --scored-starts 1 --json --overwrite --out turn_ball.safetensors >trained.json
    minutes=$(awk -v s="$(($(date +%s) - begun))" 'BEGIN { printf "%.2f", s / 60 }')
    echo "{\"steps\": $steps, \"minutes\": $minutes}" >training.json
fi
rm -rf scores.jsonl policy stroke
for controller in turn_ball.safetensors ball; do
    "$program" hand score --object ball --controller "$controller" --scored-starts 200 --json >>scores.jsonl
done
for object in 055_baseball 056_tennis_ball 017_orange; do
    "$program" hand score --object "$object" --controller turn_ball.safetensors --scored-starts 60 --json >>scores.jsonl
done
slam() { # CONTROLLER OUT
    "$program" evaluate --objects ball --seeds 5 --duration 20 --modes slam --modalities vitac --cameras side --controller "$1" --out "$2"
}
slam turn_ball.safetensors policy
slam ball stroke
