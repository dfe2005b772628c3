"""Estimates pose and shape of an object in an episode, and scores both."""

import numpy as np

from mambavitact import Episode, Slam, score, score_poses

episode = Episode("cube70", seed=2, duration_s=2.0)
slam = Slam(episode.cameras)
poses, true_poses = [], []
while True:
    frame = episode.observe()
    estimate = slam.observe(frame)
    assert frame.object_pose is not None, "the simulator knows it"
    poses.append(estimate.pose)
    true_poses.append(frame.object_pose)
    if len(poses) % 10 == 0:
        print(f"{estimate.time_s:.2f} s: {estimate.state}, confidence {estimate.confidence:.2f}")
    if not episode.step(steps=10):
        break

# The estimate has its own frame of the object; the first pose ties it to the true one.
object_from_model = np.linalg.inv(true_poses[0]) @ poses[0]
errors_mm, _ = score_poses(np.array(poses) @ np.linalg.inv(object_from_model), np.array(true_poses), "cube70")
print(f"ADD-S: {errors_mm.mean():.2f} mm on average")

mesh = slam.mesh()
assert mesh is not None
report = score(mesh, "cube70", np.linalg.inv(true_poses[-1]) @ poses[-1])
at_5_mm = next(row for row in report["original"]["scores"] if row["threshold_mm"] == 5.0)
print(f"F-score at 5 mm: {at_5_mm['f']:.3f} ({len(mesh[0])} vertices)")
result = slam.distances_and_gradients(mesh[0][:5] + 0.003)
assert result is not None
print("distances 3 mm off along each axis:", result[0], "m; gradients have shape", result[1].shape)
