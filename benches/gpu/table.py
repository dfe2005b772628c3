"""Makes tables of what speed.sh and paper.sh measured: speed.json with all rows, ratios.json with our speed over that of PyTorch, and
paper.json with the errors of the networks on the validation objects over the steps, tested.json with those on the test objects, busy.json
with the share of time in which the GPU computed during the trainings, pipeline.json with runs of the whole program.

Use: table.py DIR
"""

import csv
import datetime
import json
import re
import sys
from pathlib import Path

folder = Path(sys.argv[1])


def lines(name):
    path = folder / name
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def rows(name):
    """Returns the rows of a table, without one that was cut off while it was written."""
    path = folder / name
    table = list(csv.reader(path.open())) if path.exists() else []
    return [row for row in table if len(row) == len(table[0])]


def seconds(stamp):
    """Returns a time of `nvidia-smi` or `date` in seconds."""
    date, _, fraction = stamp.strip().partition(".")
    return datetime.datetime.strptime(date, "%Y/%m/%d %H:%M:%S").timestamp() + float(f"0.{fraction or 0}")


def power_w(span_s):
    """Returns the mean power between two times, watts; None without samples."""
    samples = [float(row[1]) for row in rows("power.csv") if span_s[0] <= seconds(row[0]) <= span_s[1]]
    return sum(samples) / len(samples) if samples else None


speed, profiles, errors = [], [], []
for row in lines("ours.jsonl"):
    if "error" in row:
        sys.exit(f"a measurement failed: {row}")
    if row["mode"] == "Check":
        errors.append(row["gradient_error"])
    elif row["mode"].startswith("Profile"):
        scan = sum(call[2] for call in row["calls"] if call[0].startswith("scan"))
        profiles.append({"network": row["network"], "mode": row["mode"], "scan_share": scan / row["calls_ms"]})
    else:
        watts = power_w(row["span_s"])
        speed.append({
            "program": "ours",
            "network": row["network"],
            "mode": row["mode"].lower(),
            "size": row["size"][0],
            "batch": row["batch"],
            "arithmetic": row["arithmetic"].lower(),
            "images_per_s": row["images_per_s"],
            "memory_mb": row["peak_memory_mb"],
            "energy_j": watts and watts / row["images_per_s"],
        })
for row in lines("peer.jsonl"):
    if "error" in row:
        sys.exit(f"a measurement failed: {row}")
    speed.append({
        "program": "PyTorch, channels last" if row["channels_last"] else "PyTorch",
        "network": row["network"],
        "mode": row["mode"],
        "size": row["size"],
        "batch": row["batch"],
        "arithmetic": row["precision"],
        "images_per_s": row["images_per_s"],
        "memory_mb": row["peak_memory_mb"],
        "energy_j": None,
    })
(folder / "speed.json").write_text(json.dumps(speed, indent=1))

ratios = {}
what = ("network", "mode", "size", "batch", "arithmetic")
for ours in (row for row in speed if row["program"] == "ours"):
    # The faster of PyTorch's two layouts.
    peers = [row["images_per_s"] for row in speed if row["program"] != "ours" and all(row[k] == ours[k] for k in what)]
    if peers:
        name = "_".join(str(ours[k]) for k in ("network", "mode", "size", "arithmetic"))
        ratios[name] = ours["images_per_s"] / max(peers)
of = {tuple(row[k] for k in what): row for row in speed if row["program"] == "ours"}
for mode in ("train", "infer"):
    for arithmetic in ("tf32", "bf16"):
        mamba, vit = (of.get((network, mode, 384, 32, arithmetic)) for network in ("mamba", "vit"))
        if mamba and vit:
            ratios[f"mamba_over_vit_{mode}_{arithmetic}"] = mamba["images_per_s"] / vit["images_per_s"]
            ratios[f"mamba_over_vit_memory_{mode}_{arithmetic}"] = mamba["memory_mb"] / vit["memory_mb"]
for profile in profiles:
    if profile["network"] == "mamba":
        ratios[f"scan_share_{profile['mode'].lower()}"] = profile["scan_share"]
ratios["gradient_error"] = max(errors, default=None)
(folder / "ratios.json").write_text(json.dumps(ratios, indent=1))

paper, tested = [], []
for curve in sorted((folder / "paper").glob("*-*-*-*.csv")):
    network, seed, rate, steps = re.fullmatch(r"(\w+)-(\d+)-(.+)-(\d+)", curve.stem).groups()
    training = {"network": network, "seed": int(seed), "learning_rate": float(rate), "steps": int(steps)}
    figures = ("images_per_s", "loss", "contact_mae_mm", "rmse_mm", "iou", "training_contact_mae_mm", "training_iou")
    paper += [
        {**training, "step": int(row["step"]), **{name: float(row[name]) for name in figures}}
        for row in csv.DictReader(curve.open())
    ]
    scores = curve.with_suffix(".json")
    if scores.exists():
        tested.append({**training, **json.loads(scores.read_text())})
if tested:
    (folder / "tested.json").write_text(json.dumps(tested, indent=1))
if paper:
    (folder / "paper.json").write_text(json.dumps(paper, indent=1))
spans = [tuple(map(seconds, row)) for row in rows("paper/spans.csv")]
busy = [float(row[2]) for row in rows("paper/busy.csv") if any(begin <= seconds(row[0]) <= end for begin, end in spans)]
if busy:
    (folder / "busy.json").write_text(json.dumps({"busy_percent": sum(busy) / len(busy)}))
pipeline = [
    {
        **{name: row[name] for name in ("network", "device", "object")},
        "frames_per_second": row["summary"]["frames_per_second"],
        "f_score_5mm": row["summary"]["f_score"]["5"],
        "add_s_mm": row["summary"]["add_s_mm"]["mean"],
    }
    for row in lines("paper/pipeline.jsonl")
]
if pipeline:
    (folder / "pipeline.json").write_text(json.dumps(pipeline, indent=1))
