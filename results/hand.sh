#!/usr/bin/env bash
# Scores the controllers that tumble and roll objects on starts that no search has seen.
#
#   results/hand.sh PROGRAM OUT [STARTS]
#
# Writes a line per controller, object and step to OUT/hand.jsonl: share alive after 20 s, median net rate about the axis (rad/s), net turn
# about the other axes relative to it, and touching pads. 60 starts by default. `steps` 24 halves the integration step; only cubes are scored with it.
set -euo pipefail
program=${1:?usage: results/hand.sh PROGRAM OUT [STARTS]}
out=$(mkdir -p "${2:?usage: results/hand.sh PROGRAM OUT [STARTS]}" && cd "$2" && pwd)
starts=${3:-60}
rm -f "$out/hand.jsonl"
"$(dirname "$0")/air.py" "$out" --meshes

# Scores controller $1 with objects $2 at $3 steps per command.
score() {
    "$program" hand score --controller "$1" --object "$2" --steps "$3" --scored-starts "$starts" --json |
        sed "s/^{/{\"steps\":$3,/" >>"$out/hand.jsonl"
}

score tumble_back cube70,077_rubiks_cube 12
score tumble_brick 061_foam_brick 12
score tumble_can 005_tomato_soup_can,010_potted_meat_can 12
score tumble_ball 055_baseball,056_tennis_ball 12
score roll_ball 055_baseball,056_tennis_ball,017_orange 12
score tumble_ball_forth 055_baseball,056_tennis_ball,017_orange 12
score roll_ball_back 055_baseball,056_tennis_ball,017_orange 12
score roll_cube rubiks_cube_small,large_dice,"$out/cube48.obj","$out/cube51.obj","$out/cube54.obj" 12
score tumble_back cube70,077_rubiks_cube 24
