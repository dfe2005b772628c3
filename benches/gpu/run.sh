#!/usr/bin/env bash
# Measures the GPU of this machine. Use: run.sh OUT [speed] [paper]
# On a bare machine, run pack.sh here, carry its folder there, and run speed.sh and paper.sh of that folder; table.py makes the tables.
set -euo pipefail
out=$1
shift
cd "$(dirname "$0")/../.."
cargo build --release --features cuda
cargo build --release -p mvt-cuda --features nvidia --example gpu_bench
target=${CARGO_TARGET_DIR:-target}/release
benches/gpu/pack.sh "$target/mambavitact" "$target/examples/gpu_bench" "$out/packed"
for part in "${@:-speed}"; do
    case $part in
    speed) "$out/packed/speed.sh" "$out/packed" "$out" ;;
    paper)
        export UNPACKED=$out/unpacked REAL_TOUCH=$PWD/results/real_touch.py
        "$out/packed/paper.sh" "$out/packed" "$out/paper" "$out/packed/paper/long.txt"
        "$out/packed/pipeline.sh" "$out/packed" "$out/paper"
        TOGETHER=3 TEST_IMAGES=0 "$out/packed/paper.sh" "$out/packed" "$out/paper" "$out/packed/paper/short.txt"
        ;;
    *) echo "$part: choose speed or paper" >&2 && exit 2 ;;
    esac
done
python3 benches/gpu/table.py "$out"
