#!/usr/bin/env bash
# Compares the paper's three networks and the two that it proposes at equal cost (2.3 to 2.4 GMAC per touch image), and
# `default` (0.8 GMAC), after the same short training on small images: accuracy on held-out objects by input size and
# over the training; then `mamba` with other hooks and fewer fusions.
#
#   benches/networks/run.sh [DIR]
#
# DIR (default: out_networks) receives the trainings, the tables (table.md) and the curves (NAME/curve.csv,
# NAME/curve.svg). After an interruption the same command continues. It takes one to three hours on two cores with AMX.
# Needs Rust and Python 3.
set -euo pipefail
cd "$(dirname "$0")/../.."
out=${1:-out_networks}
configurations=perception/touch/training/comparison
cargo build --release --quiet --features train --bin mambavitact
program="${CARGO_TARGET_DIR:-target}/release/mambavitact"
mkdir -p "$out"
[ -e "$out/test" ] || "$program" touch data --objects test --images 400 --seed 1 --out "$out/test"

# Trains network $1 with configuration $2 into $out/$3, unless that training is complete.
train() {
    local arguments=(touch train --network "$1" --config "$2" --out "$out/$3")
    [ -e "$out/$3/done" ] && return
    [ ! -e "$out/$3/checkpoint.safetensors" ] || arguments+=(--resume)
    "$program" "${arguments[@]}"
    touch "$out/$3/done"
}

# Scores the weights in $out/$1 at the given input sizes.
score() {
    for size in "${@:2}"; do
        "$program" touch evaluate --weights "$out/$1/last.safetensors" --data "$out/test" --input "$size" --json \
            >"$out/$1/$size.json"
    done
}

for network in vit mamba robust_mamba swin convnext default; do
    train "$network" "$configurations/$network.toml" "$network"
    score "$network" 64x80 128x160 192x240 240x320
done
# Hooks at the end instead of spread out (2, 5, 8, 11), and one, two or three fusions instead of four.
for hooks in 8-9-10-11 5-8-11 5-11 11; do
    python3 - "$configurations/mamba.toml" "$hooks" >"$out/hooks-$hooks.toml" <<'PYTHON'
import re, sys

print(re.sub(r"hooks = .*", f"hooks = [{sys.argv[2].replace('-', ', ')}]", open(sys.argv[1]).read()), end="")
PYTHON
    train mamba "$out/hooks-$hooks.toml" "hooks-$hooks"
    score "hooks-$hooks" 128x160
done

python3 - "$out" <<'PYTHON' | tee "$out/table.md"
import json, pathlib, sys

out = pathlib.Path(sys.argv[1])
print("| training | input | contact MAE, mm | contact RMSE, mm | RMSE, mm | MAE, mm | IoU |\n|---|---|---|---|---|---|---|")
for path in sorted(out.glob("*/*x*.json")):
    s = json.loads(path.read_text())
    cells = [s[key] for key in ("contact_mae_mm", "contact_rmse_mm", "rmse_mm", "mae_mm", "iou")]
    print(f"| {path.parent.name} | {path.stem} | " + " | ".join(f"{cell:.4f}" for cell in cells) + " |")
PYTHON
