#!/usr/bin/env bash
# Compares the release build of this commit with that of a reference commit: wall time from an empty target folder, size of the stripped
# program, and lines of code.
#
#   results/build.sh OUT [REFERENCE [ROUNDS]]
#
# Writes OUT/build.json. Both commits are cloned into OUT and built ROUNDS times (2 by default) in turns, each from an empty target folder of
# its own; the fastest build counts. What a build downloads is downloaded before the first round. REFERENCE is c39846d by default. Changes
# that are not committed are not built.
set -euo pipefail
out=$(mkdir -p "${1:?usage: results/build.sh OUT [REFERENCE [ROUNDS]]}" && cd "$1" && pwd)
reference=${2:-c39846d}
rounds=${3:-2}
cd "$(dirname "$0")/.."
unset RUSTC_WRAPPER CARGO_BUILD_RUSTC_WRAPPER CARGO_INCREMENTAL

rm -rf "$out/reference" "$out/present" "$out"/*.seconds
git clone --quiet --shared . "$out/reference"
git -C "$out/reference" checkout --quiet --detach "$reference"
git clone --quiet --shared . "$out/present"
git -C "$out/present" checkout --quiet --detach "$(git rev-parse HEAD)"

# Builds $1; appends the wall time to $1.seconds.
build() {
    rm -rf "$out/target-$1"
    local begun=$EPOCHREALTIME
    (cd "$out/$1" && CARGO_TARGET_DIR="$out/target-$1" cargo build --release --locked --quiet)
    awk -v a="$begun" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.1f\n", b - a }' >>"$out/$1.seconds"
    echo "$1: $(tail -n 1 "$out/$1.seconds") s"
}

for name in reference present; do
    (cd "$out/$name" && cargo fetch --locked --quiet)
done
# MuJoCo's library is downloaded by a build script, into the cache that both commits share.
(cd "$out/reference" && CARGO_TARGET_DIR="$out/target-reference" cargo build --release --locked --quiet -p mujoco-lib)
for _ in $(seq "$rounds"); do
    build reference
    build present
done

fastest() { sort -n "$out/$1.seconds" | head -n 1; }
strip -o "$out/mambavitact" "$out/target-present/release/mambavitact"
megabytes=$(awk -v bytes="$(wc -c <"$out/mambavitact")" 'BEGIN { printf "%.2f", bytes / 1e6 }')

cd "$out/present"
# Lines of the tracked Rust files that match the patterns.
lines() { git ls-files -z -- "$@" | xargs -0 --no-run-if-empty cat | wc -l; }
largest_crate=0
crate=
while read -r manifest; do
    folder=$(dirname "$manifest")
    count=$(lines ":(glob)$folder/src/**/*.rs")
    if [ "$count" -gt "$largest_crate" ]; then
        largest_crate=$count
        crate=$folder
    fi
done < <(git ls-files -- Cargo.toml '*/Cargo.toml')
read -r largest_file file < <(git ls-files -z -- '*.rs' | xargs -0 -n 1 wc -l | sort -rn | head -n 1 || true)

printf '{"reference_s": %s, "present_s": %s, "program_mb": %s, "source_lines": %s, "largest_crate": "%s", "largest_crate_lines": %s, "largest_file": "%s", "largest_file_lines": %s}\n' \
    "$(fastest reference)" "$(fastest present)" "$megabytes" "$(lines ':(glob)src/**/*.rs')" \
    "$crate" "$largest_crate" "$file" "$largest_file" >"$out/build.json"
cat "$out/build.json"
rm -rf "$out/target-reference" "$out/target-present"
