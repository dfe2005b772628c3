#!/bin/sh
# Times our ray caster beside Embree 3 on the same triangles and rays, one thread each, and prints rates and ratios.
#
#   benches/embree/run.sh [ROUNDS]      (default 5)
#
# Scenes: a procedural object, and, if $YCB_DIR or the asset cache has it, the YCB banana. Views: a 240 x 320 DIGIT
# close-up, 22 mm from the surface, and a 640 x 480 camera that sees object and hand. The programs take turns, so that a
# change of the machine's load meets both; figures are medians over the rounds of the CPU time of the fastest frame of a
# round.
set -eu
cd "$(dirname "$0")/../.."
rounds=${1:-5}

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

if ! [ -e /usr/include/embree3/rtcore.h ]; then
    echo "Embree 3 is missing: installing the package libembree-dev"
    if [ "$(id -u)" = 0 ]; then as_root=""; else as_root="sudo"; fi
    $as_root apt-get install -y --no-install-recommends libembree-dev >"$work/apt.log" 2>&1 || {
        tail -n 3 "$work/apt.log" >&2
        echo "Could not install Embree. Install libembree-dev (Embree 3) yourself, then run this again." >&2
        exit 1
    }
fi
"${CXX:-c++}" -O3 -march=native -std=c++17 benches/embree/embree.cpp -lembree3 -o "$work/embree"
cargo build --release --quiet -p mvt-render --example ray_bench
ours="${CARGO_TARGET_DIR:-target}/release/examples/ray_bench"

cache="${XDG_CACHE_HOME:-$HOME/.cache}/mambavitact"
banana=$(find "${YCB_DIR:-/nonexistent}" "$cache" -name 011_banana.stl 2>/dev/null | head -n 1)
for object in procedural ${banana:+banana}; do
    mesh=""
    [ "$object" = procedural ] || mesh="--mesh $banana"
    for round in $(seq "$rounds"); do
        # shellcheck disable=SC2086 # two words on purpose
        "$ours" --dump $mesh "$work" | sed "s/^/ours $object /"
        for view in close-up camera; do
            "$work/embree" "$view" "$work/$view.bin" | sed "s/^/embree $object /"
        done
    done
done >"$work/times"

awk '
    function median(key,    n, k, j, t, list) {
        n = split(times[key], list, " ")
        for (k = 2; k <= n; ++k)
            for (j = k; j > 1 && list[j] + 0 < list[j - 1] + 0; --j) { t = list[j]; list[j] = list[j - 1]; list[j - 1] = t }
        return (list[int((n + 1) / 2)] + list[int(n / 2) + 1]) / 2
    }
    {
        scene = $2 " " $3
        if (!(scene in rays)) order[++scenes] = scene
        rays[scene] = $4
    }
    $1 == "ours" { times[scene "/ours"] = times[scene "/ours"] " " $6; hits[scene] = $5 }
    $1 == "embree" {
        times[scene "/one"] = times[scene "/one"] " " $6
        times[scene "/eight"] = times[scene "/eight"] " " $7
        their_hits[scene] = $5
        if ($8 > worst[scene]) worst[scene] = $8
    }
    END {
        printf "%-20s %22s %22s %22s %12s %12s %14s %14s\n", "scene and view", "ours", "Embree, 1 ray", "Embree, 8 rays",
            "ours / x1", "ours / x8", "hits", "depth, 99.9 %"
        for (k = 1; k <= scenes; ++k) {
            s = order[k]
            ours = median(s "/ours"); one = median(s "/one"); eight = median(s "/eight")
            printf "%-20s %8.2f ms %4.0f Mray/s %8.2f ms %4.0f Mray/s %8.2f ms %4.0f Mray/s %12.2f %12.2f %6d/%-7d %11.5f mm\n", s,
                ours * 1e3, rays[s] / ours / 1e6, one * 1e3, rays[s] / one / 1e6, eight * 1e3, rays[s] / eight / 1e6,
                ours / one, ours / eight, hits[s], their_hits[s], worst[s]
            if (ours >= one || ours > 1.5 * eight) missed = 1
        }
        bars = "faster than single rays, at most 1.5 times packets of 8"
        print missed ? "MISSED: " bars : "met: " bars
        exit missed
    }' "$work/times"
