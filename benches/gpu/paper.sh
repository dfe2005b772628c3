#!/usr/bin/env bash
# Trains the networks of the paper one after the other and scores them on the test objects. Use: paper.sh DIR OUT [DEVICE [STEPS]]
# DIR is what pack.sh made; OUT receives curves and scores. Each network has the same images and as many steps.
set -uo pipefail
packed=$1 out=$2 device=${3:-cuda} steps=${4:-}
source "$packed/unpack.sh" "$packed"
run() { LD_LIBRARY_PATH=$unpacked:$cuda "$unpacked/mambavitact" "$@"; }
mkdir -p "$out" "$unpacked/trained"
sampler=
if [ "$device" = cuda ]; then
    nvidia-smi --query-gpu=timestamp,power.draw,utilization.gpu --format=csv,noheader,nounits -lms 500 >"$out/busy.csv" &
    sampler=$!
fi
run touch data --images 200 --out "$unpacked/test" >"$out/data.log" 2>&1
for network in ${NETWORKS:-vit mamba robust_mamba default}; do
    config=$unpacked/$network.toml
    sed -E "${steps:+s/steps = [0-9]+/steps = $steps/; s/validate_every = .*/validate_every = $steps/; s/validation_images = .*/validation_images = 4/; s/batch = 32/batch = 1/}" \
        "$packed/paper/$network.toml" >"$config"
    begun=$SECONDS
    MAMBAVITACT_LOG=info run touch train --network "$network" --config "$config" --device "$device" \
        --out "$unpacked/trained/$network" >"$out/$network.log" 2>&1
    echo "$network: rc $?, $((SECONDS - begun)) s"
    cp "$unpacked/trained/$network/curve.csv" "$out/$network.csv"
    cp "$unpacked/trained/$network/panels.png" "$out/$network.png"
    run touch evaluate --weights "$unpacked/trained/$network/last.safetensors" --data "$unpacked/test" --device "$device" \
        --json >"$out/$network.json" 2>>"$out/$network.log"
done
[ -z "$sampler" ] || kill "$sampler"
