"""Writes metrics_oracle.json: scores computed with NumPy alone, all distances by brute force.

Run `python3 metrics_oracle.py` with NumPy >= 2 in this folder. The points lie on a bumpy, lopsided surface, so that no symmetry
hides an exchange of directions.
"""

import json

import numpy as np

rng = np.random.default_rng(7)


def surface(n):
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius = 0.04 + 0.01 * np.sin(3 * direction[:, 0]) + 0.008 * direction[:, 2] ** 2
    # As f32, in which the program has them.
    return (direction * radius[:, None] * [1.0, 0.8, 1.3]).astype(np.float32).astype(np.float64)


def nearest(points, to):
    return np.linalg.norm(points[:, None] - to[None], axis=2).min(axis=1)


def matrix(quaternion_wxyz):
    w, x, y, z = np.array(quaternion_wxyz) / np.linalg.norm(quaternion_wxyz)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


truth, estimate = surface(300), surface(211)
estimate[:60] += [0.0, 0.004, 0.011]
estimate = estimate.astype(np.float32).astype(np.float64)
thresholds = [0.001, 0.002, 0.005, 0.010, 0.020]
cases = []
for translation, quaternion in [
    ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]),
    ([0.001, -0.002, 0.0005], [0.999, 0.02, -0.01, 0.03]),
    ([0.02, 0.01, -0.03], [0.7, 0.1, -0.6, 0.2]),
    ([0.3, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]),
]:
    rotation = matrix(quaternion)
    moved = truth @ rotation.T + translation
    one, other = nearest(moved, truth).mean(), nearest(truth, moved).mean()
    shape = estimate @ rotation.T + translation
    to_truth, to_shape = nearest(shape, truth), nearest(truth, shape)
    precision = [float((to_truth < t).mean()) for t in thresholds]
    recall = [float((to_shape < t).mean()) for t in thresholds]
    with np.errstate(invalid="ignore"):
        f = [float(np.nan_to_num(2 * p * r / np.float64(p + r))) for p, r in zip(precision, recall)]
    cases.append(
        {
            "translation_m": translation,
            "quaternion_wxyz": quaternion,
            "one_directional_m": float(one),
            "symmetric_m": float((one + other) / 2),
            "precision": precision,
            "recall": recall,
            "f": f,
            "mesh_error_m": float(to_truth.mean()),
            "completeness_m": float(to_shape.mean()),
        }
    )

times = np.arange(90) / 10.0
errors = np.abs(rng.normal(0.004, 0.003, size=90))
errors[[60, 70, 71]] = [0.06, 0.051, 0.049]
kept = np.where((times < 5) | (errors > 0.05), np.nan, errors)
run = {
    "times_s": times.tolist(),
    "errors_m": errors.tolist(),
    "mean_m": float(errors.mean()),
    "median_m": float(np.median(errors)),
    "p95_m": float(np.percentile(errors, 95)),
    "final_m": float(errors[-1]),
    "mean_original_m": float(np.nanmean(kept)),
}

with open("metrics_oracle.json", "w") as file:
    points = {"truth": truth.round(9).tolist(), "estimate": estimate.round(9).tolist()}
    json.dump({**points, "thresholds_m": thresholds, "cases": cases, "run": run}, file)
    file.write("\n")
