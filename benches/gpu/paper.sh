#!/usr/bin/env bash
# Trains networks of the paper and scores them on the test objects. Use: paper.sh DIR OUT PLAN [DEVICE]
# DIR is what pack.sh made. Each line of PLAN is a training: network, seed, learning rate, steps, steps between validations. OUT receives
# curves, panels and scores, named after them. In the environment: TOGETHER trainings at a time (1), ARITHMETIC of the GPU (bf16),
# TEST_IMAGES to score with (200; 0: none), BATCH (32).
set -uo pipefail
packed=$1 out=$2 plan=$3 device=${4:-cuda}
source "$packed/unpack.sh" "$packed"
run() { LD_LIBRARY_PATH=$unpacked:$cuda "$unpacked/mambavitact" "$@"; }
mkdir -p "$out" "$unpacked/trained"
sampler=
if [ "$device" = cuda ]; then
    nvidia-smi --query-gpu=timestamp,power.draw,utilization.gpu --format=csv,noheader,nounits -lms 500 >"$out/busy.csv" &
    sampler=$!
    # No job of this shell, so that "wait" does not wait for it.
    disown
fi
images=${TEST_IMAGES:-200}
[ "$images" = 0 ] || run touch data --images "$images" --out "$unpacked/test" >"$out/data.txt" 2>&1
train() {
    local network=$1 seed=$2 rate=$3 steps=$4 every=$5 begun=$SECONDS
    local name=$network-$seed-$rate-$steps
    sed -E "s/^seed = .*/seed = $seed/; s/learning_rate = .*/learning_rate = $rate/; s/steps = [0-9]+/steps = $steps/
        s/batch = [0-9]+/batch = ${BATCH:-32}/; s/validate_every = .*/validate_every = $every/
        s/^resizes = .*/&\ngpu_arithmetic = \"${ARITHMETIC:-bf16}\"/" "$packed/paper/$network.toml" >"$unpacked/$name.toml"
    MAMBAVITACT_LOG=info run touch train --network "$network" --config "$unpacked/$name.toml" --device "$device" \
        --out "$unpacked/trained/$name" >"$out/$name.log" 2>&1
    echo "$name: rc $?, $((SECONDS - begun)) s"
    cp "$unpacked/trained/$name/curve.csv" "$out/$name.csv"
    cp "$unpacked/trained/$name/panels.png" "$out/$name.png"
    [ "$images" = 0 ] || run touch evaluate --weights "$unpacked/trained/$name/last.safetensors" --data "$unpacked/test" \
        --device "$device" --json >"$out/$name.json" 2>>"$out/$name.log"
}
while read -r network seed rate steps every; do
    [ "${network:0:1}" != "#" ] || continue
    train "$network" "$seed" "$rate" "$steps" "$every" </dev/null &
    while [ "$(jobs -rp | wc -l)" -ge "${TOGETHER:-1}" ]; do wait -n; done
done <"$plan"
wait
[ -z "$sampler" ] || kill "$sampler"
