#!/usr/bin/env bash
# Runs the main job with this commit and with a reference commit in turns, and compares their speed.
#
#   results/speed.sh OUT [REFERENCE [RUNS [SECONDS]]]
#
# Writes a line per run to OUT/speed.jsonl: seed, and frames per second of both. Run k has seed k. REFERENCE is e960bac by default; 5 runs of
# 5 s. Both commits are cloned into OUT and built there. Changes that are not committed are not built.
set -euo pipefail
out=$(mkdir -p "${1:?usage: results/speed.sh OUT [REFERENCE [RUNS [SECONDS]]]}" && cd "$1" && pwd)
reference=${2:-e960bac}
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

# Prints the frames per second of a run.
run() {
    rm -rf "$out/run-$1-$2"
    "$out/target-$1/release/mambavitact" run --quiet --duration "$seconds" --seed "$2" --out "$out/run-$1-$2"
    sed -n 's/.*"frames_per_second": *\([0-9.eE+-]*\).*/\1/p' "$out/run-$1-$2/summary.json" | head -n 1
}

# The first run of each reads files that later runs find in memory.
run reference 0 >"$out/first.txt"
run present 0 >>"$out/first.txt"
: >"$out/speed.jsonl"
for ((seed = 0; seed < runs; ++seed)); do
    reference_fps=$(run reference "$seed")
    printf '{"seed": %s, "reference_fps": %s, "present_fps": %s}\n' "$seed" "$reference_fps" "$(run present "$seed")" |
        tee -a "$out/speed.jsonl"
done
