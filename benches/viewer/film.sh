#!/usr/bin/env bash
# Measures how long a film of 60 pictures at 1280 x 720 takes: MP4 if ffmpeg is installed, otherwise GIF. Prints JSON:
# the time, and the time of all cores together.
#
#   benches/viewer/film.sh [PROGRAM]
#
# Without PROGRAM a release build is made. Needs Rust and Python 3.
set -euo pipefail
cd "$(dirname "$0")/../.."
program=${1:-}
if [ -z "$program" ]; then
    cargo build --release --quiet --bin mambavitact
    program="${CARGO_TARGET_DIR:-target}/release/mambavitact"
fi
format=$(command -v ffmpeg >/dev/null && echo mp4 || echo gif)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# 180 frames, of which every third is recorded.
"$program" run --quiet --duration 6 --out "$work/run"
python3 - "$format" "$program" view --run "$work/run" --record "$work/film.$format" --size 1280x720 --every 3 <<'PYTHON'
import json, resource, subprocess, sys, time

begun = time.monotonic()
done = subprocess.run(sys.argv[2:], capture_output=True, text=True)
seconds = time.monotonic() - begun
if done.returncode:
    sys.exit(done.stderr)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
figures = {"seconds": seconds, "core_seconds": used.ru_utime + used.ru_stime}
print(json.dumps({**{name: round(value, 2) for name, value in figures.items()}, "pictures": 60, "format": sys.argv[1]}))
PYTHON
