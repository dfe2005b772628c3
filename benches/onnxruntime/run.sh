#!/usr/bin/env bash
# Compares the speed of our engine with `default` on touch images of 240x320 and of ONNX Runtime with ViT-S/16 and a DPT
# decoder of 64 channels at 224x224. Both take turns on the same cores with the same number of threads. Prints images
# per second and their ratio.
#
#   benches/onnxruntime/run.sh [ROUNDS [SECONDS]]
#
# Each side runs ROUNDS times (default: 5) for SECONDS (default: 4). THREADS sets the number of threads (default: 2),
# WEIGHTS trained weights of our network, which do not change the speed, and PYTHON the interpreter. Needs Rust and
# Python 3.11 or later; installs PyTorch, which makes the network of the other side, and ONNX Runtime into a virtual
# environment in the user's cache folder.
set -euo pipefail
cd "$(dirname "$0")/../.."

cache=${XDG_CACHE_HOME:-$HOME/.cache}/mambavitact/onnxruntime-bench
python=${PYTHON:-python3}
if [ ! -e "$cache/ready" ]; then
    mkdir -p "$cache"
    "$python" -m venv "$cache/venv"
    "$cache/venv/bin/python" -m pip install --quiet --disable-pip-version-check torch==2.15.0 onnx==1.23.2 onnxruntime==1.31.1 numpy
    touch "$cache/ready"
fi
[ -e "$cache/vit_dpt.onnx" ] || "$cache/venv/bin/python" benches/onnxruntime/model.py "$cache/vit_dpt.onnx"

cargo build --release --quiet --bin mambavitact
ours="${CARGO_TARGET_DIR:-target}/release/mambavitact"
"$cache/venv/bin/python" benches/onnxruntime/compare.py "$ours" "$cache/vit_dpt.onnx" "$@"
