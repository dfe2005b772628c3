#!/usr/bin/env bash
# Licences, origins and advisories of the packages of all platforms, by cargo-deny, whose build takes minutes: CI checks licences and origins
# of its own platform with .ci/licences.
set -euo pipefail
cd "$(dirname "$0")/../.."
command -v cargo-deny >/dev/null || cargo install --quiet --locked --debug cargo-deny@0.20.2
cargo deny check bans licenses sources
cargo deny fetch db && cargo deny check advisories
