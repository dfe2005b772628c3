#!/usr/bin/env bash
# Runs the whole pipeline with trained networks. Use: pipeline.sh DIR OUT
# DIR is what pack.sh made; the networks are those that paper.sh left in the folder UNPACKED, and the one that is shipped. OUT receives
# pipeline.jsonl: a line per network, object and device. In the environment: OBJECTS, SECONDS_EACH (4).
set -uo pipefail
packed=$1 out=$2
source "$packed/unpack.sh" "$packed"
mkdir -p "$out"
measure() {
    local name=$1 object=$2 device=$3
    shift 3
    LD_LIBRARY_PATH=$unpacked:$cuda "$unpacked/mambavitact" run --quiet --object "$object" --duration "${SECONDS_EACH:-4}" --device "$device" \
        --out "$unpacked/run" --overwrite "$@" >"$out/$name-$object-$device.log" 2>&1
    python3 - "$unpacked/run/summary.json" "$name" "$object" "$device" >>"$out/pipeline.jsonl" <<'PYTHON'
import json, sys
summary = json.load(open(sys.argv[1]))
print(json.dumps({"network": sys.argv[2], "object": sys.argv[3], "device": sys.argv[4], "summary": summary}))
PYTHON
}
for object in ${OBJECTS:-010_potted_meat_can 025_mug}; do
    for device in cuda cpu; do
        measure default "$object" "$device"
        for weights in "$unpacked"/trained/*/last.safetensors; do
            measure "$(basename "$(dirname "$weights")")" "$object" "$device" --weights "$weights"
        done
    done
done
