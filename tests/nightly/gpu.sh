#!/usr/bin/env bash
# The package in gpu/: its lints, and gradients of whole networks beside those of burn. It compiles 400 packages that CI needs for nothing
# else; CI compares each operation with finite differences.
set -euo pipefail
cd "$(dirname "$0")/../.."
cargo clippy --manifest-path gpu/Cargo.toml --all-targets --locked -- -D warnings
cargo test --manifest-path gpu/Cargo.toml --no-default-features --locked --release
