#!/usr/bin/env bash
# Runs the main job with this commit and with a reference commit in turns, and compares poses and fields to the byte, and speed.
#
#   results/same.sh OUT [REFERENCE [RUNS [SECONDS]]]
#
# Writes a line per run to OUT/same.jsonl: seed, whether all poses are equal, whether the fields are equal, and both speeds. Run k has seed k.
# REFERENCE is c39846d by default; 5 runs of 5 s. Both commits are cloned into OUT and built there. Changes that are not committed are not
# built. Of trajectory.csv, columns with times and the column `coordinates`, which the reference lacks, are left out of the comparison; of
# the fields, the header, in which the reference has no checksum.
set -euo pipefail
out=$(mkdir -p "${1:?usage: results/same.sh OUT [REFERENCE [RUNS [SECONDS]]]}" && cd "$1" && pwd)
reference=${2:-c39846d}
runs=${3:-5}
seconds=${4:-5}
cd "$(dirname "$0")/.."

# Clones commit $2 into $1 and builds it; an unchanged clone is not built again.
prepare() {
    [ -d "$out/$1" ] || git clone --quiet --shared . "$out/$1"
    git -C "$out/$1" fetch --quiet origin
    git -C "$out/$1" checkout --quiet --detach "$2"
    (cd "$out/$1" && CARGO_TARGET_DIR="$out/target-$1" cargo build --release --locked --quiet --bin mambavitact)
}
prepare reference "$(git rev-parse "$reference")"
prepare present "$(git rev-parse HEAD)"

run() {
    "$out/target-$1/release/mambavitact" run --quiet --duration "$seconds" --seed "$2" --out "$out/run-$1-$2" --overwrite
}
# trajectory.csv without the columns whose names end in _ms, and without coordinates.
poses() {
    awk -F, 'NR == 1 { for (k = 1; k <= NF; ++k) kept[k] = $k !~ /_ms$|^coordinates$/ }
        { for (k = 1; k <= NF; ++k) if (kept[k]) printf "%s,", $k; print "" }' "$out/run-$1-$2/trajectory.csv"
}
# The tensors of field.safetensors: what follows the header, whose length is the first number.
tensors() {
    local file=$out/run-$1-$2/field.safetensors
    tail -c +"$((9 + $(od -An -t u8 -N 8 "$file")))" "$file"
}
speed() { sed -n 's/.*"frames_per_second": *\([0-9.eE+-]*\).*/\1/p' "$out/run-$1-$2/summary.json" | head -n 1; }
answer() { if "$@"; then echo true; else echo false; fi; }

# The first run of each reads files that later runs find in memory.
run reference 0
run present 0
: >"$out/same.jsonl"
for ((seed = 0; seed < runs; ++seed)); do
    run reference "$seed"
    run present "$seed"
    poses reference "$seed" >"$out/reference.csv"
    poses present "$seed" >"$out/present.csv"
    printf '{"seed": %s, "poses_equal": %s, "field_equal": %s, "reference_fps": %s, "present_fps": %s}\n' "$seed" \
        "$(answer cmp -s "$out/reference.csv" "$out/present.csv")" \
        "$(answer cmp -s <(tensors reference "$seed") <(tensors present "$seed"))" \
        "$(speed reference "$seed")" "$(speed present "$seed")" | tee -a "$out/same.jsonl"
done
