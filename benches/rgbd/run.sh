#!/usr/bin/env bash
# Renders 23 RGB-D sequences of unknown objects with Open3D's rays, tracks them with our program and with Open3D's ICP and TSDF volume, and scores both
# by the protocol of YCBInEOAT.
#
#   benches/rgbd/run.sh OUT [--only NAME ...]           renders into OUT/sequences; finished ones are skipped; some 25 minutes on one core, 5 GB
#   benches/rgbd/run.sh OUT track [--only NAME ...]     renders the held-out half alone, tracks it into OUT/ours, with the first mask alone into
#                                                       OUT/carried, and by Open3D into OUT/open3d_plane, unless that is done, and writes OUT/summary.json
#   benches/rgbd/run.sh OUT tune                        chooses Open3D's settings on the tuning half, and writes OUT/tuned/settings.json
#
# Needs Rust and Python 3.11 to 3.13; installs Open3D 0.20 into a virtual environment in OUT. sequences.toml describes the sequences and names the half
# on which settings may be chosen.
set -euo pipefail
out=$(realpath -m "${1:?name a folder}")
shift
step=render
case ${1:-} in
track | tune) step=$1 && shift ;;
esac
cd "$(dirname "$0")/../.."
here=benches/rgbd
python=$out/venv/bin/python
if [ ! -e "$out/venv/ready" ]; then
    python3 -m venv "$out/venv"
    "$python" -m pip install --quiet --disable-pip-version-check open3d==0.20.0 numpy pillow scipy
    touch "$out/venv/ready"
fi
cargo build --release --quiet --bin mambavitact
ours="${CARGO_TARGET_DIR:-target}/release/mambavitact"
"$ours" assets fetch
if [ $step = track ] && [ $# = 0 ]; then
    held_out=$("$python" -c 'import tomllib; print(*(name for name, of in tomllib.load(open("benches/rgbd/sequences.toml", "rb")).items() if isinstance(of, dict) and of.get("half") == "held_out"))')
    # shellcheck disable=SC2086
    set -- --only $held_out
fi
"$python" $here/render.py "$out/sequences" "$@"
case $step in
tune) "$python" $here/peer.py "$out/sequences" "$out/tuned" --tune ;;
track)
    "$python" $here/peer.py "$out/sequences" "$out/open3d_plane" --variant plane "$@"
    for name in "${@:2}"; do
        # The same with the mask of the first frame alone.
        first=$out/first_mask/$name
        mkdir -p "$first/masks"
        for part in rgb depth annotated_poses cam_K.txt object.txt masks/000000.png; do
            ln -sfn "$out/sequences/$name/$part" "$first/$part"
        done
        for pair in "sequences ours" "first_mask carried"; do
            read -r data results <<<"$pair"
            [ -e "$out/$results/$name/mesh.obj" ] ||
                "$ours" run --log "$out/$data/$name" --modality vi --object "$(cat "$out/sequences/$name/object.txt")" --out "$out/$results/$name" --quiet
        done
    done
    "$python" $here/score.py "$out/sequences" "$out" ours="$out/ours" carried="$out/carried" open3d_plane="$out/open3d_plane"
    ;;
esac
