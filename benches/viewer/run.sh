#!/usr/bin/env bash
# Measures how much an open window slows a run: the same closed-loop episode with and without --view, in turns on the
# same cores. Prints frames per second of both and the loss.
#
#   benches/viewer/run.sh [ROUNDS [SECONDS]]
#
# Each side runs ROUNDS episodes (default: 3) of SECONDS (default: 30). Without a display the script starts Xvfb, so
# that the CPU draws the window. Needs Rust and Python 3.
set -euo pipefail
cd "$(dirname "$0")/../.."
rounds=${1:-3}
seconds=${2:-30}
cargo build --release --quiet --bin mambavitact
program="${CARGO_TARGET_DIR:-target}/release/mambavitact"
work=$(mktemp -d)
server=
trap 'pkill -f "view --run $work" || true; kill $server 2>/dev/null || true; rm -rf "$work"' EXIT
if [ -z "${DISPLAY:-}${WAYLAND_DISPLAY:-}" ]; then
    export DISPLAY=":$((90 + RANDOM % 900))" XDG_RUNTIME_DIR="$work"
    Xvfb "$DISPLAY" -screen 0 1280x800x24 >"$work/xvfb.log" 2>&1 &
    server=$!
    sleep 1
fi

# Prints the frames per second of a run with these options.
speed() {
    "$program" run --quiet --duration "$seconds" --out "$work/$1" "${@:2}" >"$work/$1.log" 2>&1 ||
        { cat "$work/$1.log" >&2; exit 1; }
    pkill -f "view --run $work" || true
    python3 -c 'import json, sys; print(json.load(open(sys.argv[1]))["frames_per_second"])' "$work/$1/summary.json"
}

speed warm-up >/dev/null
for round in $(seq "$rounds"); do
    alone=$(speed "alone-$round")
    watched=$(speed "watched-$round" --view)
    echo "$alone $watched" | tee -a "$work/speeds"
done
python3 - "$work/speeds" <<'PYTHON'
import sys

alone, watched = (list(map(float, column)) for column in zip(*(line.split() for line in open(sys.argv[1]))))
cost = 100 * (1 - sum(watched) / sum(alone))
print(f"without window {sum(alone) / len(alone):.2f} frames/s, with it {sum(watched) / len(watched):.2f}: {cost:.1f} % lost")
PYTHON
