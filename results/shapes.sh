#!/usr/bin/env bash
# Scores the controllers that `auto` chooses for single kinds of shapes, on starts that no search has seen, with the integration step of episodes and
# with half of it, so that no fault of the solver turns an object.
#
#   results/shapes.sh PROGRAM OUT [STARTS]
#
# Writes a line per controller, object and step to OUT/shapes.jsonl: share alive after 20 s, median net rate about the axis (rad/s). 40 starts by default.
set -euo pipefail
program=${1:?usage: results/shapes.sh PROGRAM OUT [STARTS]}
out=$(mkdir -p "${2:?usage: results/shapes.sh PROGRAM OUT [STARTS]}" && cd "$2" && pwd)
starts=${3:-40}
rm -f "$out/shapes.jsonl"

for steps in 12 24; do
    while read -r controller objects; do
        "$program" hand score --controller "$controller" --object "$objects" --steps "$steps" --scored-starts "$starts" --json |
            sed "s/^{/{\"steps\":$steps,/" >>"$out/shapes.jsonl"
    done <<'OBJECTS'
turn_large_ball 053_mini_soccer_ball
turn_small_cup 065-a_cups
turn_cup 065-b_cups,065-c_cups
turn_brick 061_foam_brick
turn_pepper bell_pepper
turn_post 036_wood_block
turn_slender pepper_grinder
turn_duck duck
turn_elephant elephant
turn_wide_cup 065-j_cups
turn_bottle 006_mustard_bottle
turn_berry 012_strawberry
turn_bowl 024_bowl
turn_stick 072-d_toy_airplane,072-e_toy_airplane
tumble_pear 016_pear,pear
tumble_block 073-b_lego_duplo,073-d_lego_duplo,073-f_lego_duplo
tumble_small_block 070-b_colored_wood_blocks
OBJECTS
done
