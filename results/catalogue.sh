#!/usr/bin/env bash
# Plays the controller that `auto` chooses, or every controller, on the whole catalogue.
#
#   results/catalogue.sh PROGRAM OUT [all]
#
# Writes OUT/catalogue.jsonl: a line per object and controller, with the net angle about each axis in three starts of 20 s (seeds 8101 to 8103),
# as `hand survey --help` describes. With `all`, OUT/survey.jsonl has every controller on three starts of the search instead. The same command
# continues after an interruption.
set -euo pipefail
program=${1:?usage: results/catalogue.sh PROGRAM OUT [all]}
out=${2:?usage: results/catalogue.sh PROGRAM OUT [all]}
mkdir -p "$out"
if [ "${3:-}" = all ]; then
    "$program" hand survey --out "$out/survey.jsonl"
else
    "$program" hand survey --controller auto --seed 8101 --out "$out/catalogue.jsonl"
fi
