#!/bin/sh
# A simulated robot and a run that drives it, two processes over the loopback, beside the same starts as `run` alone.
# usage: benches/ros/loop.sh [--starts 10] [--duration 30] [--speed 0.15] [--object cube70] [--kills 0]
# ROS_PYTHON names a Python with rclpy, which then records the commands as a third process.
set -eu
cd "$(dirname "$0")/../.."
cargo build --release --features ros --bin mambavitact
exec python3 benches/ros/loop.py --program "${CARGO_TARGET_DIR:-target}/release/mambavitact" "$@"
