#!/usr/bin/env python3
"""Scores trackers of unknown objects on the sequences of render.py by the protocol of YCBInEOAT.

    score.py DATA OUT METHOD=FOLDER ...     reads FOLDER/NAME/poses/*.txt and FOLDER/NAME/mesh.obj; writes OUT/summary.json and prints tables

FOLDER/NAME is an output folder of `mambavitact run --log DATA/NAME --modality vi --out FOLDER/NAME`, or of peer.py: 4 x 4 poses, camera from model,
OpenCV axes, of the certified frames only, and the final mesh in the model's coordinates, metres.

The estimated motion since frame 0 is applied to the true pose of frame 0. A frame without a pose holds the last one. If frame 0 has no pose, the
first certified frame ties the model to the object (`first_frame`), and the frames before it hold the true pose of frame 0.

  add_auc, add_s_auc   area under the curve of the share of frames below an error, 0 to 10 cm, percent; all frames, also those that hide the object
  chamfer_mm           mean of both mean distances between the meshes
  f5                   F-score of the mesh at 5 mm
  wrong                share of all frames, percent, that are certified although ADD is above 20 mm or the rotation off by more than 20 degrees;
                       of symmetric objects although ADD-S is above 20 mm
  abstained            share of all frames, percent, that are not certified; abstained_seen: of the frames that show at least a tenth of the object
  found                of a sequence that hides the object fully: 100 if a pose is certified, and right, within 2 s after the object comes back
  within_two           share of the certified frames, percent, whose surface is off by at most two stated deviations
  iou                  of a run that carried the mask of the first frame: median over the other frames, percent; where both masks are empty, 100
"""

import argparse
import csv
import json
from functools import cache
from pathlib import Path

import numpy as np
import open3d as o3d
from PIL import Image
from scipy.spatial import cKDTree
from suite import SEQUENCES, SUITE, Recorded, load_mesh

AUC_M = 0.10
WRONG_M = 0.020
WRONG_DEG = 20.0
F_SCORE_M = 0.005
# Points of the mesh for ADD, and for the distances between meshes.
ADD_POINTS = 1000
MESH_POINTS = 20_000
SEEN = 0.1
FOUND_FRAMES = 60
SHOWN = {
    "add_auc": "ADD",
    "add_s_auc": "ADD-S",
    "chamfer_mm": "CD mm",
    "f5": "F@5",
    "wrong": "wrong",
    "abstained": "abst.",
    "abstained_seen": "a.seen",
    "found": "found",
    "within_two": "in 2 s.d.",
    "iou": "IoU",
    "s_per_frame": "s/fr",
}


def sampled(mesh, count):
    """Returns points on a mesh, spread evenly by area."""
    o3d.utility.random.seed(0)
    return np.asarray(mesh.sample_points_uniformly(count).points)


@cache
def truth(name):
    """Returns points of the true mesh for ADD, their tree, and those for distances between meshes."""
    mesh = load_mesh(name)
    add = sampled(mesh, ADD_POINTS)
    return add, cKDTree(add), sampled(mesh, MESH_POINTS)


def read_poses(folder):
    """Reads the certified poses of a run by the names of frames."""
    return {path.stem: np.loadtxt(path) for path in sorted((Path(folder) / "poses").glob("*.txt"))}


def held(sequence, poses, frames=None):
    """Returns the estimated pose of every frame in the camera, the first certified frame, and which frames are certified."""
    names = sequence.names[:frames]
    certified = np.array([name in poses for name in names])
    first = int(np.argmax(certified)) if certified.any() else None
    result, last = [], sequence.poses[0]
    for name, known in zip(names, certified, strict=True):
        if known:
            last = poses[name] @ np.linalg.inv(poses[names[first]]) @ sequence.poses[first]
        result.append(last)
    return np.array(result), first, certified


def tracking(sequence, poses, frames=None):
    """Returns the scores of the poses, percent, and the frame that ties the model to the object."""
    estimated, first, certified = held(sequence, poses, frames)
    points, tree, _ = truth(sequence.object)
    add, add_s, turned = [], [], []
    for found, true in zip(estimated, sequence.poses, strict=False):
        # In the object's coordinates.
        off = np.linalg.inv(true) @ found
        moved = points @ off[:3, :3].T + off[:3, 3]
        add.append(np.linalg.norm(moved - points, axis=1).mean())
        # From the true points to the nearest estimated one, as the YCB toolbox does: the same as to the moved tree.
        back = np.linalg.inv(off)
        add_s.append(tree.query(points @ back[:3, :3].T + back[:3, 3])[0].mean())
        turned.append(np.degrees(np.arccos(np.clip((np.trace(off[:3, :3]) - 1.0) / 2.0, -1.0, 1.0))))
    add, add_s, turned = np.array(add), np.array(add_s), np.array(turned)
    off = add_s > WRONG_M if sequence.object in SUITE["symmetric"] else (add > WRONG_M) | (turned > WRONG_DEG)
    path = sequence.folder / "seen.txt"
    seen = np.loadtxt(path)[: len(add)] > SEEN if path.exists() else np.ones(len(add), bool)
    # The object comes back: after a frame that does not show it at all.
    back = [k for k in range(1, len(seen)) if seen[k] and not seen[k - 1] and not seen[max(k - FOUND_FRAMES // 2, 0) : k].any()]
    found = [bool((certified & ~off)[k : k + FOUND_FRAMES].any()) for k in back]
    return {
        "found": 100.0 * float(np.mean(found)) if found else None,
        "add_auc": 100.0 * float(np.clip(1.0 - add / AUC_M, 0.0, None).mean()),
        "add_s_auc": 100.0 * float(np.clip(1.0 - add_s / AUC_M, 0.0, None).mean()),
        "wrong": 100.0 * float((certified & off).mean()),
        "abstained": 100.0 * float((~certified).mean()),
        "abstained_seen": 100.0 * float((~certified)[seen].mean()),
        "first_frame": first,
    }


def meshes(sequence, poses, path, first):
    """Returns the distances between the estimated mesh, tied to the object by the first certified frame, and the true one."""
    if first is None or not path.exists():
        return {"chamfer_mm": None, "f5": 0.0}
    mesh = o3d.io.read_triangle_mesh(str(path))
    if len(mesh.triangles) == 0:
        return {"chamfer_mm": None, "f5": 0.0}
    mesh.transform(np.linalg.inv(sequence.poses[first]) @ poses[sequence.names[first]])
    found, true = sampled(mesh, MESH_POINTS), truth(sequence.object)[2]
    to_true, to_found = cKDTree(true).query(found)[0], cKDTree(found).query(true)[0]
    precision, recall = (to_true < F_SCORE_M).mean(), (to_found < F_SCORE_M).mean()
    return {"chamfer_mm": 500.0 * float(to_true.mean() + to_found.mean()), "f5": float(2.0 * precision * recall / max(precision + recall, 1e-9))}


def within_two(folder, poses):
    """Returns the share of certified frames that are off by at most two stated deviations, percent, from trajectory.csv; `None` without one."""
    if not (folder / "trajectory.csv").exists() or not poses:
        return None
    with open(folder / "trajectory.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["deviation_mm"] and row["add_s_mm"] and f"{int(row['frame']):06}" in poses]
    return 100.0 * float(np.mean([float(row["add_s_mm"]) <= 2.0 * float(row["deviation_mm"]) for row in rows])) if rows else None


def iou(sequence, folder):
    """Returns the median agreement of carried masks with the given ones, percent; `None` of a run that carried none."""
    if not (folder / "masks" / "carried.csv").exists():
        return None
    shares = []
    for name in sequence.names[1:]:
        true = np.asarray(Image.open(sequence.folder / "masks" / f"{name}.png")) > 0
        path = folder / "masks" / f"{name}.png"
        found = np.asarray(Image.open(path)) > 0 if path.exists() else np.zeros_like(true)
        shares.append((true & found).sum() / max((true | found).sum(), 1) if (true | found).any() else 1.0)
    return 100.0 * float(np.median(shares))


def seconds(folder):
    """Returns the seconds of a frame, from the peer's time.txt or from our summary.json."""
    if (folder / "time.txt").exists():
        return float((folder / "time.txt").read_text())
    try:
        summary = json.loads((folder / "summary.json").read_text())
        return float(summary["wall_s"]) / float(summary["frames"])
    except (OSError, KeyError, TypeError, ValueError, ZeroDivisionError):
        return None


def score(sequence, folder):
    """Returns all scores of a run."""
    poses = read_poses(folder)
    result = tracking(sequence, poses)
    result |= {"within_two": within_two(folder, poses), "iou": iou(sequence, folder)}
    return {**result, **meshes(sequence, poses, folder / "mesh.obj", result["first_frame"]), "s_per_frame": seconds(folder)}


def row(title, scores):
    cells = [f"{scores[key]:8.2f}" if scores.get(key) is not None else "       -" for key in SHOWN]
    return f"{title:32}" + "".join(cells)


def summarised(lines, methods):
    """Returns medians and means of each method over a half, and the paired differences between methods with standard errors."""
    result = {}
    for half in ("tuning", "held_out"):
        chosen = [line for line in lines if line["half"] == half]
        part = {"sequences": len({line["sequence"] for line in chosen}), "median": {}, "mean": {}, "differences": {}}
        values = {
            m: {k: {line["sequence"]: line[k] for line in chosen if line["method"] == m and line[k] is not None} for k in SHOWN} for m in methods
        }
        for method in methods:
            for kind, function in (("median", np.median), ("mean", np.mean)):
                part[kind][method] = {key: float(function(list(of.values()))) for key, of in values[method].items() if of}
            for other in methods[methods.index(method) + 1 :]:
                part["differences"][f"{method} - {other}"] = difference = {}
                for key in SHOWN:
                    both = values[method][key].keys() & values[other][key].keys()
                    gaps = np.array([values[method][key][name] - values[other][key][name] for name in both])
                    if len(gaps) > 1:
                        difference[key] = {"mean": float(gaps.mean()), "standard_error": float(gaps.std(ddof=1) / np.sqrt(len(gaps)))}
        result[half] = part
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the rendered sequences")
    parser.add_argument("out", type=Path, help="folder for summary.json")
    parser.add_argument("runs", nargs="+", metavar="METHOD=FOLDER", help="name of a method, and the folder of its results")
    arguments = parser.parse_args()
    if any("=" not in run for run in arguments.runs):
        parser.error("give every method as METHOD=FOLDER")
    runs = {method: Path(folder) for method, folder in (run.split("=", 1) for run in arguments.runs)}
    lines = []
    print(f"{'':32}" + "".join(f"{title:>8}" for title in SHOWN.values()))
    for name, entry in SEQUENCES.items():
        for method, folder in runs.items():
            if (arguments.data / name).exists() and (folder / name).exists():
                found = score(Recorded(arguments.data / name), folder / name)
                lines.append({"sequence": name, "method": method, "kind": entry["kind"], "half": entry["half"], **found})
                print(row(f"{name} {method} ({entry['half']})", found), flush=True)
    summary = summarised(lines, list(runs))
    for half, part in summary.items():
        for method in runs:
            if part["median"].get(method):
                print(row(f"median {method} ({half})", part["median"][method]))
        for pair, difference in part["differences"].items():
            cells = [f"{difference[key]['mean']:+.2f}({difference[key]['standard_error']:.2f})" if key in difference else "-" for key in SHOWN]
            print(f"{pair} ({half}): " + ", ".join(f"{title} {cell}" for title, cell in zip(SHOWN.values(), cells, strict=True)))
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "summary.json").write_text(json.dumps({"halves": summary, "sequences": lines}, indent=2) + "\n")


if __name__ == "__main__":
    main()
