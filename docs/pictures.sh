#!/usr/bin/env bash
# Makes the pictures and films of README.md, and the example of the window, anew: docs/pictures.sh [PROGRAM]. Needs Xvfb and xdotool for the window, Chromium
# for the report, NumPy and SciPy for the real sequence; about 4 minutes.
set -euo pipefail
cd "$(dirname "$0")/.."
program=${1:-}
if [ -z "$program" ]; then
    cargo build --release --locked
    program=target/release/mambavitact
fi
program=$(realpath "$program")
docs=$PWD/docs
work=$(mktemp -d)
display=$((90 + RANDOM % 900))
viewer= server=
trap 'kill $viewer $server 2>/dev/null || true; rm -rf "$work"' EXIT
# The settings of this machine's user are neither read nor changed.
mkdir -m 700 "$work/runtime"
export XDG_RUNTIME_DIR="$work/runtime" XDG_CONFIG_HOME="$work/config"
unset WAYLAND_DISPLAY WAYLAND_SOCKET
cd "$work"

"$program" run --out run
cp run/mesh.gif "$docs/rubiks_cube.gif"
"$program" view --run run --record "$docs/view.gif" --overwrite --every 18 --rate 10 --size 800x450
# The recording that the window carries.
"$program" run --object rubiks_cube_small --duration 5 --set mesh_cell_mm=3 --out example
rm example/recording/running
python3 - "$docs/../app/window/assets/example.zip" <<'PYTHON'
import pathlib, sys, zipfile
with zipfile.ZipFile(sys.argv[1], "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
    for file in sorted(pathlib.Path("example/recording").iterdir()):
        archive.write(file)
PYTHON
"$program" run --object 077_rubiks_cube --controller tumble_back --duration 6 --seed 1 --out tumble
"$program" view --run tumble --record "$docs/tumble.gif" --overwrite --layout scene --colour true --show mesh,truth,hand --every 4 --rate 12 \
    --size 600x400
"$program" run --object ball --controller air_ball --duration 8 --seed 9705 --out air
"$program" view --run air --record "$docs/air.gif" --overwrite --layout scene --colour true --show mesh,truth,hand --every 4 --rate 12 \
    --size 600x400
"$program" generate --object 077_rubiks_cube --logs 1 --duration 12 --noise none --out logs
"$program" inspect logs/077_rubiks_cube/00 --sheet "$docs/contact_sheet.png" --overwrite

python3 "$docs/../benches/rgbd/real.py" "$docs/../../shared/real_rgbd" real --program "$program"
"$program" view --run real/025_mug_out --record "$docs/real_mug.gif" --overwrite --every 1 --rate 3 --size 800x450 --colour true

images=$docs/../../shared/real_digit/dd
"$program" touch predict --images "$images/003_img.png" --untouched "$images/untouched.png" --out ball
cp ball/003_picture.png "$docs/real_digit.png"
mini=$docs/../../shared/real_gelsight_mini
mkdir -p mini && cp "$mini/9.500mm/12/gelsight.png" mini/12_img.png
"$program" touch predict --profile gelsight_mini --images mini --untouched "$mini/background.png" --out mini_read
cp mini_read/12_picture.png "$docs/real_gelsight_mini.png"

for object in random:0 random:2 random:4; do
    for camera in side front-left; do
        "$program" run --quiet --object "$object" --cameras "$camera" --duration 6 --out "runs/$object-$camera"
    done
done
"$program" report runs --out report.html
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH="$docs/../benches/report" python3 - "$docs/report.png" <<'PYTHON'
import os, sys
import browser
page = browser.Browser()
page.resize((1000, 1100))
page.theme("light")
page.open(os.path.abspath("report.html"))
page.run("document.querySelector('#shapes').scrollIntoView()")
page.frames(60)
top = page.run("document.querySelector('#shapes').getBoundingClientRect().bottom + scrollY")
open(sys.argv[1], "wb").write(page.picture(clip=(0, 0, 1000, top + 16)))
page.close()
PYTHON

Xvfb ":$display" -screen 0 1280x800x24 >xvfb.log 2>&1 &
server=$!
sleep 2 # until the display is ready
export DISPLAY=":$display"
"$program" view --run run >view.log 2>&1 &
viewer=$!
sleep 10 # until the run is loaded
window=$(xdotool search --pid "$viewer" --name MambaViTact | tail -1)
# Xvfb has no window manager to give the window the keyboard.
xdotool windowfocus "$window"
sleep 2
# To the middle of the time line; the window then needs a moment to paint without jagged edges.
xdotool mousemove 800 729 click 1 sleep 3 key --window "$window" s
for _ in $(seq 60); do
    picture=$(ls ./*.png 2>/dev/null | head -1) && [ -n "$picture" ] && break
    sleep 0.5
done
sleep 1 # until the file is complete
mv "$picture" "$docs/window.png"
