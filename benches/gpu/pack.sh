#!/usr/bin/env bash
# Packs what a bare machine with a GPU needs into a folder: the program, libmujoco, the meshes that the networks of the paper are trained
# and tested on, and the scripts. Use: pack.sh PROGRAM BENCH DIR
set -euo pipefail
program=$1 bench=$2 out=$3
here=$(cd "$(dirname "$0")" && pwd)
cache=${XDG_CACHE_HOME:-$HOME/.cache}/mambavitact
mkdir -p "$out"
cp "$here"/*.sh "$here"/*.py "$here"/*.json "$out"
cp -r "$here/paper" "$out"
cp "$here/../../perception/touch/weights/default.safetensors" "$out/shipped.safetensors"
for binary in "$program" "$bench"; do
    strip -o "$out/stripped" "$binary"
    xz -9 -T0 -c "$out/stripped" >"$out/$(basename "$binary").xz"
    rm "$out/stripped"
done
xz -9 -T0 -c "$(ldd "$program" | awk '/libmujoco/ { print $3 }')" >"$out/$(ldd "$program" | awk '/libmujoco/ { print $1 }').xz"
# The meshes that the configurations name, those of validation and those of test.
names=$(grep -oh '"0[0-9][^"]*"' "$here/paper/vit.toml" | tr -d '"' | sort -u)
names="$names 010_potted_meat_can 014_lemon 022_windex_bottle 038_padlock 051_large_clamp 065-e_cups 073-c_lego_duplo"
names="$names 004_sugar_box 005_tomato_soup_can 006_mustard_bottle 021_bleach_cleanser 025_mug 035_power_drill 037_scissors"
names="$names 042_adjustable_wrench 048_hammer 055_baseball"
for name in $names; do printf '%s.stl\n' "$name"; done | tar -C "$cache/ycb" -c -T - | xz -9 -T0 >"$out/ycb.tar.xz"
du -sh "$out"
