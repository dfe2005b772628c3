#!/usr/bin/env bash
# Our engine running `default` on 240x320 touch images beside ONNX Runtime running ViT-S/16 with a DPT decoder of 64 channels at
# 224x224, in turns in one run on the same cores with the same number of threads: images per second, and their ratio.
#
#   benches/onnxruntime/run.sh [ROUNDS [SECONDS]]
#
# ROUNDS, 5 by default, of SECONDS, 4 by default, for each side. Set THREADS for other than 2 threads, WEIGHTS for trained weights
# of our network; speed does not depend on them. Needs Rust and Python 3.11 or later; installs PyTorch, with which the peer's network is
# made, and ONNX Runtime into a virtual environment in the user's cache folder. PYTHON names the interpreter.
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
