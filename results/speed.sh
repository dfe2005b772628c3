#!/usr/bin/env bash
# Runs the main job, and the estimator on a log of it, with this commit and with a reference commit in turns, and compares their speed.
#
#   results/speed.sh OUT [REFERENCE [RUNS [SECONDS]]]
#
# Writes a line per run to OUT/speed.jsonl: seed, and frames per second of both, in the loop and on the log. Run k has seed k; the log is that of
# the reference, which both commits can read. REFERENCE is e960bac by default; 5 runs of 5 s. Both commits are cloned into OUT and built there.
# Changes that are not committed are not built.
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

program() { echo "$out/target-$1/release/mambavitact"; }

# Prints the frames per second of a run: of a commit, with a seed, in the loop or on the log.
run() {
    local words=(--duration "$seconds")
    [ "$3" = loop ] || words=(--log "$log")
    rm -rf "$out/run-$1-$2"
    "$(program "$1")" run --quiet "${words[@]}" --seed "$2" --out "$out/run-$1-$2"
    sed -n 's/.*"frames_per_second": *\([0-9.eE+-]*\).*/\1/p' "$out/run-$1-$2/summary.json" | head -n 1
}

rm -rf "$out/log"
"$(program reference)" generate --object 077_rubiks_cube --logs 1 --duration "$seconds" --seed 0 --cameras front-left --out "$out/log" >"$out/log.txt"
log=$out/log/077_rubiks_cube/00

# The first run of each reads files that later runs find in memory.
run reference 0 loop >"$out/first.txt"
run present 0 loop >>"$out/first.txt"
: >"$out/speed.jsonl"
for ((seed = 0; seed < runs; ++seed)); do
    reference_fps=$(run reference "$seed" loop) present_fps=$(run present "$seed" loop)
    reference_log_fps=$(run reference "$seed" log) present_log_fps=$(run present "$seed" log)
    printf '{"seed": %s, "reference_fps": %s, "present_fps": %s, "reference_log_fps": %s, "present_log_fps": %s}\n' \
        "$seed" "$reference_fps" "$present_fps" "$reference_log_fps" "$present_log_fps" | tee -a "$out/speed.jsonl"
done
