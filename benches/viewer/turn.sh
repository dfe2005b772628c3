#!/usr/bin/env bash
# Measures how many pictures per second a window shows while the pointer turns the fine mesh of a finished run; the CPU
# draws the window.
#
#   benches/viewer/turn.sh [SECONDS [PROGRAM]]
#
# The mesh turns for SECONDS (default: 10). Without PROGRAM a release build is made. Needs Rust, Python 3, Xvfb and xdotool.
set -euo pipefail
cd "$(dirname "$0")/../.."
seconds=${1:-10}
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

# Cells of 0.75 mm make 100,000 triangles of a Rubik's cube.
"$program" run --quiet --duration 8 --set mesh_cell_mm=0.75 --out "$work/run"
MAMBAVITACT_LOG=mvt_viewer=trace "$program" view --run "$work/run" >"$work/view.log" 2>&1 &
viewer=$!
until grep -q "painted in" "$work/view.log"; do
    kill -0 "$viewer" || { cat "$work/view.log" >&2; exit 1; }
    sleep 0.5
done
sleep 5
shown=$(wc -l <"$work/view.log")
xdotool mousemove 500 300 mousedown 1
begun=$EPOCHREALTIME
until=$((SECONDS + seconds))
# 100 movements a second, to and fro.
while ((SECONDS < until)); do
    # shellcheck disable=SC2046
    xdotool $(for x in 3 -3; do for _ in $(seq 25); do echo "mousemove_relative -- $x 0 sleep 0.01"; done; done)
done
ended=$EPOCHREALTIME
xdotool mouseup 1
tail -n +"$((shown + 1))" "$work/view.log" >"$work/turned.log"
python3 - "$work/turned.log" "$work/run/mesh.ply" "$begun" "$ended" <<'PYTHON'
import re, sys

log, mesh = open(sys.argv[1]).read(), open(sys.argv[2], "rb").read(2000)
faces = re.search(rb"element face (\d+)", mesh).group(1).decode()
pictures = re.findall(r"at \[(\d+), (\d+)\] painted in ([\d.]+)(ms|µs|s)", log)
times = sorted(float(value) * {"ms": 1, "µs": 1e-3, "s": 1e3}[unit] for *_, value, unit in pictures)
sizes = [f"{width} x {height}" for width, height, *_ in pictures]
counts = ", ".join(f"{sizes.count(size)} of {size}" for size in sorted(set(sizes)))
rate = len(times) / (float(sys.argv[4]) - float(sys.argv[3]))
print(f"{faces} triangles, {counts}: {rate:.1f} pictures/s, "
      f"painted in {times[len(times) // 2]:.1f} ms, worst {times[-1]:.1f} ms")
PYTHON
