#!/usr/bin/env bash
# Touch rendering beside TACTO 0.0.3: CPU time per 240x320 frame on one thread each, in one run, with an object in contact and with
# shading, blur and noise on both sides; also how far the two agree.
#
#   benches/tacto/run.sh [ROUNDS [TACTO_FRAMES [OUR_FRAMES]]]
#
# Needs Rust, Python 3.8 to 3.11 (TACTO's pins have no wheels for later ones) and OSMesa; installs TACTO into a virtual
# environment in the user's cache folder. Set PYTHON to name the interpreter, MESH and POSE to add a mesh of your own.
set -euo pipefail
cd "$(dirname "$0")/../.."

cache=${XDG_CACHE_HOME:-$HOME/.cache}/mambavitact/tacto-bench
python=${PYTHON:-}
if [ -z "$python" ]; then
    for candidate in python3.11 python3.10 python3.9 python3.8 python3; do
        if "$candidate" -c 'import sys; sys.exit(not (3, 8) <= sys.version_info[:2] <= (3, 11))' 2>/dev/null; then
            python=$candidate
            break
        fi
    done
fi
[ -n "$python" ] || { echo "No Python 3.8 to 3.11 found: TACTO's versions of NumPy and SciPy need one. Set PYTHON." >&2; exit 1; }

if ! ldconfig -p | grep -q libOSMesa; then
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        apt-get install -y libosmesa6 libegl1 libgl1
    else
        echo "TACTO renders through OSMesa, which is missing. As root: apt-get install libosmesa6 libegl1 libgl1" >&2
        exit 1
    fi
fi

if [ ! -e "$cache/ready" ]; then
    mkdir -p "$cache"
    "$python" -m venv "$cache/venv"
    pip() { "$cache/venv/bin/python" -m pip install --quiet --disable-pip-version-check "$@"; }
    pip "setuptools<70" wheel numpy==1.23.5 scipy==1.10.1 opencv-python-headless==4.8.1.78 "trimesh==3.23.5" "pyglet<2" \
        omegaconf==2.3.0 pycollada lxml six freetype-py imageio pybullet
    # Their own pins (PyOpenGL 3.1.0, networkx 2.2) do not work on these Pythons.
    pip --no-deps tacto==0.0.3 pyrender==0.1.45 urdfpy==0.0.22 PyOpenGL==3.1.7 networkx==2.8.8
    touch "$cache/ready"
fi

cargo build --release --quiet -p mvt-render --example touch_bench
target=$(cargo metadata --format-version 1 --no-deps | "$python" -c 'import json, sys; print(json.load(sys.stdin)["target_directory"])')
# One thread each: llvmpipe takes its number of rasteriser threads from LP_NUM_THREADS, where 0 means the calling one.
PYOPENGL_PLATFORM=osmesa LP_NUM_THREADS=0 OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
    "$cache/venv/bin/python" benches/tacto/compare.py "$target/release/examples/touch_bench" "${@}"
