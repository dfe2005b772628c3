"""Renders a ball on a DIGIT, and reads the image with the shipped network."""

import numpy as np

from mambavitact import TouchNetwork, render_touch

RADIUS_M, DEPTH_M, GEL_M = 0.008, 0.0008, 0.022

# A ball of rings around the x axis, which points from the camera to the gel.
polar, around = np.meshgrid(np.linspace(0, np.pi, 65), np.linspace(0, 2 * np.pi, 129)[:-1], indexing="ij")
ball = RADIUS_M * np.stack([-np.cos(polar), np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around)], axis=-1)
ring, step = (index.ravel() for index in np.meshgrid(np.arange(64), np.arange(128), indexing="ij"))
a, b = ring * 128 + step, ring * 128 + (step + 1) % 128
faces = np.concatenate([np.stack([a, b, a + 128], axis=-1), np.stack([b, b + 128, a + 128], axis=-1)])
mesh = (ball.reshape(-1, 3), faces[:, ::-1])

pose = np.eye(4)
pose[0, 3] = GEL_M + RADIUS_M - DEPTH_M
pressed = render_touch(mesh, pose)
pose[0, 3] = 0.1
untouched = render_touch(mesh, pose)
true_mm = 1e3 * (untouched.depth_m - pressed.depth_m)

found = TouchNetwork().predict(pressed.calibrated[None], untouched=untouched.calibrated)
touching = true_mm > 0.1
print(f"true: {true_mm.max():.2f} mm deep on {touching.mean():.1%} of the image")
print(f"found: {found.indentation_mm.max():.2f} mm deep on {found.contact.mean():.1%}, plausibility {found.plausibility[0]:.2f}")
print(f"mean error in contact: {np.abs(found.indentation_mm[0] - true_mm)[touching].mean():.3f} mm")
