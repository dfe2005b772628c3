#!/usr/bin/env bash
# Compares the first command of this commit with that of a reference commit: `cargo run --release` with an empty cargo home and an empty target
# folder, which downloads and builds all packages and plays an episode of 30 s: seconds of wall, and of all cores together, which hardly depend on what
# else runs. Also states the size of the program, the packages of
# the lock file, lines of code, and the packages that take longest to build.
#
#   results/build.sh OUT [REFERENCE [ROUNDS]]
#
# Writes OUT/build.json and OUT/build.md. Both commits are cloned into OUT and run ROUNDS times (1 by default) in turns; the fastest counts.
# libmujoco and the meshes are downloaded before the first round. REFERENCE is e960bac by default. Changes that are not committed are not
# built.
set -euo pipefail
out=$(mkdir -p "${1:?usage: results/build.sh OUT [REFERENCE [ROUNDS]]}" && cd "$1" && pwd)
reference=${2:-e960bac}
rounds=${3:-1}
cd "$(dirname "$0")/.."
unset RUSTC_WRAPPER CARGO_BUILD_RUSTC_WRAPPER CARGO_INCREMENTAL CARGO_TARGET_DIR
settings=${CARGO_HOME:-$HOME/.cargo}/config.toml

rm -rf "$out/reference" "$out/present" "$out"/*.seconds
git clone --quiet --shared . "$out/reference"
git -C "$out/reference" checkout --quiet --detach "$reference"
git clone --quiet --shared . "$out/present"
git -C "$out/present" checkout --quiet --detach "$(git rev-parse HEAD)"

# Runs the first command of $1; appends its seconds of wall and of all cores together to $1.seconds.
first_command() {
    rm -rf "$out/target-$1" "$out/home"
    mkdir "$out/home"
    # The user's registry, if there are settings for one.
    if [ -e "$settings" ]; then cp "$settings" "$out/home/"; fi
    local TIMEFORMAT='%R %U %S'
    {
        time (cd "$out/$1" && CARGO_HOME="$out/home" CARGO_TARGET_DIR="$out/target-$1" cargo run --release --locked --quiet --timings \
            >"$out/$1.log" 2>&1)
    } 2>"$out/$1.time"
    awk '{ print $1, $2 + $3 }' "$out/$1.time" >>"$out/$1.seconds"
    echo "$1: $(tail -n 1 "$out/$1.seconds") s (wall, all cores)"
}

# MuJoCo's library and the meshes are in the cache that both commits share before the first round.
if [ ! -d "${XDG_CACHE_HOME:-$HOME/.cache}/mambavitact/ycb" ]; then
    (cd "$out/present" && cargo run --release --locked --quiet -- assets fetch)
fi
for _ in $(seq "$rounds"); do
    first_command reference
    first_command present
done

# Where the time of the build goes.
python3 - "$out/target-present/cargo-timings/cargo-timing.html" >"$out/build.md" <<'PYTHON'
import json, re, sys

units = json.loads(re.search(r"UNIT_DATA = (\[.*?\]);\n", open(sys.argv[1]).read(), re.S).group(1))
seconds = {}
for unit in units:
    seconds[unit["name"]] = seconds.get(unit["name"], 0.0) + unit["duration"]
total = sum(seconds.values())
print(f"Packages that take longest in a release build, of {total:.0f} s for {len(units)} units on all cores together.\n")
print("| package | time (s) |\n|---|---|")
for name, duration in sorted(seconds.items(), key=lambda item: -item[1])[:10]:
    print(f"| {name} | {duration:.1f} |")
PYTHON
cat "$out/build.md"

# The least of column $2 over the rounds of $1.
fastest() { cut -d " " -f "$2" "$out/$1.seconds" | sort -n | head -n 1; }
megabytes=$(awk -v bytes="$(wc -c <"$out/target-present/release/mambavitact")" 'BEGIN { printf "%.2f", bytes / 1e6 }')

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

printf '{"reference_s": %s, "present_s": %s, "reference_cpu_s": %s, "present_cpu_s": %s, "program_mb": %s, "packages": %s, "source_lines": %s, "largest_crate": "%s", "largest_crate_lines": %s, "largest_file": "%s", "largest_file_lines": %s}\n' \
    "$(fastest reference 1)" "$(fastest present 1)" "$(fastest reference 2)" "$(fastest present 2)" "$megabytes" "$(grep -c '^name = ' Cargo.lock)" "$(lines ':(glob)src/**/*.rs')" \
    "$crate" "$largest_crate" "$file" "$largest_file" >"$out/build.json"
cat "$out/build.json"
rm -rf "$out/target-reference" "$out/target-present" "$out/home"
