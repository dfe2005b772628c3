"""Renders the corner of a box on a DIGIT, and reads the image with the shipped network."""

import numpy as np

from mambavitact import TouchNetwork, render_touch

corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * [0.02, 0.008, 0.008]
faces = [
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
]  # fmt: skip
pose = np.eye(4)
pose[:3, 3] = 0.0212, -0.004, -0.004  # 0.8 mm into the gel, which is 22 mm from the camera

pressed = render_touch((corners, faces), pose)
pose[0, 3] = 0.1
untouched = render_touch((corners, faces), pose)
true_mm = 1e3 * (untouched.depth_m - pressed.depth_m)

found = TouchNetwork().predict(pressed.calibrated[None], untouched=untouched.calibrated)
touching = true_mm > 0.1
print(f"true: {true_mm.max():.2f} mm deep on {touching.mean():.1%} of the image")
print(f"found: {found.indentation_mm.max():.2f} mm deep on {found.contact.mean():.1%}, plausibility {found.plausibility[0]:.2f}")
print(f"mean error in contact: {np.abs(found.indentation_mm[0] - true_mm)[touching].mean():.3f} mm")
