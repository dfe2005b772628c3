#!/usr/bin/env bash
# Trains networks of the paper and scores them on the test objects. Use: paper.sh DIR OUT PLAN [DEVICE]
# DIR is what pack.sh made. Each line of PLAN is a training: network, seed, learning rate, steps, steps between validations. OUT receives
# curves, panels and scores, named after them. In the environment: TOGETHER trainings at a time (1), ARITHMETIC of the GPU (bf16),
# TEST_IMAGES to score with (200; 0: none), BATCH (32), REAL_TOUCH: the path of results/real_touch.py, to score on real sensors, too.
set -uo pipefail
packed=$1 out=$2 plan=$3 device=${4:-cuda}
source "$packed/unpack.sh" "$packed"
run() { LD_LIBRARY_PATH=$unpacked:$cuda "$unpacked/mambavitact" "$@"; }
mkdir -p "$out" "$unpacked/trained"
sampler=
if [ "$device" = cuda ]; then
    nvidia-smi --query-gpu=timestamp,power.draw,utilization.gpu --format=csv,noheader,nounits -lms 500 >>"$out/busy.csv" &
    sampler=$!
    # No job of this shell, so that "wait" does not wait for it.
    disown
fi
images=${TEST_IMAGES:-200}
if [ "$images" != 0 ]; then
    run touch data --images "$images" --out "$unpacked/test" --overwrite >"$out/data.txt" 2>&1
    run touch evaluate --weights "$packed/shipped.safetensors" --data "$unpacked/test" --json >"$out/shipped.json" 2>>"$out/data.txt"
fi
train() {
    local network=$1 seed=$2 rate=$3 steps=$4 every=$5 begun=$SECONDS at
    at=$(date "+%Y/%m/%d %H:%M:%S")
    local name=$network-$seed-$rate-$steps
    sed -E "s/^seed = .*/seed = $seed/; s/learning_rate = .*/learning_rate = $rate/; s/steps = [0-9]+/steps = $steps/
        s/batch = [0-9]+/batch = ${BATCH:-32}/; s/validate_every = .*/validate_every = $every/
        s/^resizes = .*/&\ngpu_arithmetic = \"${ARITHMETIC:-bf16}\"/" "$packed/paper/$network.toml" >"$unpacked/$name.toml"
    MAMBAVITACT_LOG=info run touch train --network "$network" --config "$unpacked/$name.toml" --device "$device" \
        --out "$unpacked/trained/$name" >"$out/$name.log" 2>&1
    echo "$name: rc $?, $((SECONDS - begun)) s"
    echo "$at,$(date "+%Y/%m/%d %H:%M:%S")" >>"$out/spans.csv"
    cp "$unpacked/trained/$name/curve.csv" "$out/$name.csv"
    cp "$unpacked/trained/$name/panels.png" "$out/$name.png"
    [ "$images" = 0 ] || run touch evaluate --weights "$unpacked/trained/$name/last.safetensors" --data "$unpacked/test" \
        --device "$device" --json >"$out/$name.json" 2>>"$out/$name.log"
    [ -z "${REAL_TOUCH:-}" ] || LD_LIBRARY_PATH=$unpacked:$cuda python3 "$REAL_TOUCH" "$unpacked/real/$name" --program "$unpacked/mambavitact" \
        --only digit --weights "$unpacked/trained/$name/last.safetensors" >"$out/$name.real.txt" 2>&1
}
# What a training that is cut off had learnt until then counts, too.
trap 'for curve in "$unpacked"/trained/*/curve.csv; do cp "$curve" "$out/$(basename "$(dirname "$curve")").csv"; done; exit 1' TERM
while read -r network seed rate steps every; do
    [ "${network:0:1}" != "#" ] || continue
    train "$network" "$seed" "$rate" "$steps" "$every" </dev/null &
    while [ "$(jobs -rp | wc -l)" -ge "${TOGETHER:-1}" ]; do wait -n; done
done <"$plan"
wait
[ -z "$sampler" ] || kill "$sampler"
