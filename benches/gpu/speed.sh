#!/usr/bin/env bash
# Measures speed, memory and power of our networks and of PyTorch's on this machine's GPU. Use: speed.sh DIR OUT
# DIR is what pack.sh made; OUT receives ours.jsonl, peer.jsonl and power.csv, of which table.py makes tables.
set -uo pipefail
packed=$1 out=$2
source "$packed/unpack.sh" "$packed"
nvidia-smi --query-gpu=name --format=csv,noheader | sed "s/$/, $(nproc) cores/" >"$out/machine.txt"
nvidia-smi --query-gpu=timestamp,power.draw,utilization.gpu --format=csv,noheader,nounits -lms 100 >"$out/power.csv" &
sampler=$!
LD_LIBRARY_PATH=$cuda timeout 200 "$unpacked/gpu_bench" "$packed/ours.json" >"$out/ours.jsonl" 2>"$out/ours.err"
timeout 120 python3 "$packed/peer.py" --list "$packed/peer.json" >"$out/peer.jsonl" 2>"$out/peer.err"
kill "$sampler"
