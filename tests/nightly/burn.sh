#!/usr/bin/env bash
# Gradients of whole networks, by the tape and by the kernels of the GPU, beside those of burn: a package of its own, since burn brings
# some 200 packages that CI needs for nothing else. CI compares each operation with finite differences, and the kernels with the tape.
set -euo pipefail
cd "$(dirname "$0")/../.."
cargo clippy --manifest-path tests/burn/Cargo.toml --all-targets --locked -- -D warnings
cargo test --manifest-path tests/burn/Cargo.toml --locked
