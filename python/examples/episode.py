"""Plays a gait, saves the state in the middle, and plays the second half again with targets of its own."""

import numpy as np

from mambavitact import Episode

episode = Episode("cube70", seed=1, duration_s=4.0)
for _ in range(50):
    episode.step()
state = episode.save()
print(f"{episode.time_s:.2f} s: turned by {episode.turned_rad:.2f} rad, pads press with {episode.pad_forces.round(2)} N")

while episode.step():
    pass
print(f"{episode.time_s:.2f} s with the gait: turned by {episode.turned_rad:.2f} rad, {episode.end}")

episode.restore(state)
held = episode.joint_targets
while episode.step(held):
    pass
print(f"{episode.time_s:.2f} s with fingers that stand still: turned by {episode.turned_rad:.2f} rad")

frame = episode.observe()
assert frame.touch_images is not None
print("images:", frame.color[0].shape, frame.depth_m[0].shape, frame.touch_images.shape)
print("object at", np.round(episode.object_pose[:3, 3], 3), "m")
