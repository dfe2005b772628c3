#!/usr/bin/env bash
# Measures how much of a core a window takes that shows a finished run and that nobody touches; the CPU draws the window.
# Prints JSON.
#
#   benches/viewer/idle.sh [SECONDS [PROGRAM]]
#
# Measures for SECONDS (default: 20), after the window has come to rest. Without PROGRAM a release build is made. Needs
# Rust, Python 3 and Xvfb on Linux.
set -euo pipefail
cd "$(dirname "$0")/../.."
seconds=${1:-20}
program=${2:-}
if [ -z "$program" ]; then
    cargo build --release --quiet --bin mambavitact
    program="${CARGO_TARGET_DIR:-target}/release/mambavitact"
fi
work=$(mktemp -d)
server=
viewer=
trap 'kill $viewer $server 2>/dev/null || true; rm -rf "$work"' EXIT
export DISPLAY=":$((90 + RANDOM % 900))" XDG_RUNTIME_DIR="$work" XDG_CONFIG_HOME="$work/config"
unset WAYLAND_DISPLAY WAYLAND_SOCKET
Xvfb "$DISPLAY" -screen 0 1280x800x24 >"$work/xvfb.log" 2>&1 &
server=$!
"$program" run --quiet --duration 4 --out "$work/run"
MAMBAVITACT_LOG=mvt_viewer=trace "$program" view --run "$work/run" >"$work/view.log" 2>&1 &
viewer=$!
until grep -q "painted in" "$work/view.log"; do
    kill -0 "$viewer" || { cat "$work/view.log" >&2; exit 1; }
    sleep 0.5
done
# Until the fine picture and the images of the sensors are shown.
sleep 5
# Time in user and system mode, in ticks of the clock.
ticks() {
    cut -d ")" -f 2 "/proc/$viewer/stat" | awk '{ print $12 + $13 }'
}
painted=$(grep -c "painted in" "$work/view.log")
before=$(ticks)
begun=$EPOCHREALTIME
sleep "$seconds"
after=$(ticks)
python3 - "$before" "$after" "$begun" "$EPOCHREALTIME" "$(getconf CLK_TCK)" \
    "$(($(grep -c "painted in" "$work/view.log") - painted))" <<'PYTHON'
import json, sys

before, after, begun, ended, ticks, painted = map(float, sys.argv[1:])
seconds = ended - begun
core_share = (after - before) / ticks / seconds
print(json.dumps({"core_share": round(core_share, 5), "seconds": round(seconds, 1), "painted": int(painted)}))
PYTHON
