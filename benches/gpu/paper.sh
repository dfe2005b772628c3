#!/usr/bin/env bash
# Trains the networks of the paper one after the other and scores them on the test objects. Use: paper.sh DIR OUT [DEVICE [STEPS]]
# DIR is what pack.sh made; OUT receives curves and scores. Each network has the same images and as many steps.
set -uo pipefail
packed=$1 out=$2 device=${3:-cuda} steps=${4:-}
source "$packed/unpack.sh" "$packed"
run() { LD_LIBRARY_PATH=/tmp/gpu:$cuda /tmp/gpu/mambavitact "$@"; }
mkdir -p "$out" /tmp/gpu/trained
sampler=
if [ "$device" = cuda ]; then
    nvidia-smi --query-gpu=timestamp,power.draw,utilization.gpu --format=csv,noheader,nounits -lms 500 >"$out/busy.csv" &
    sampler=$!
fi
run touch data --images 200 --out /tmp/gpu/test >"$out/data.log" 2>&1
for network in ${NETWORKS:-vit mamba robust_mamba default}; do
    config=/tmp/gpu/$network.toml
    sed -E "${steps:+s/steps = [0-9]+/steps = $steps/; s/validate_every = .*/validate_every = $steps/; s/validation_images = .*/validation_images = 4/; s/batch = 32/batch = 1/}" \
        "$packed/paper/$network.toml" >"$config"
    begun=$(date +%s.%N)
    MAMBAVITACT_LOG=info run touch train --network "$network" --config "$config" --device "$device" \
        --out "/tmp/gpu/trained/$network" >"$out/$network.log" 2>&1
    echo "$network: rc $?, $(echo "$(date +%s.%N) - $begun" | bc) s"
    cp "/tmp/gpu/trained/$network/curve.csv" "$out/$network.csv"
    cp "/tmp/gpu/trained/$network/panels.png" "$out/$network.png"
    run touch evaluate --weights "/tmp/gpu/trained/$network/last.safetensors" --data /tmp/gpu/test --device "$device" \
        --json >"$out/$network.json" 2>>"$out/$network.log"
done
[ -z "$sampler" ] || kill "$sampler"
