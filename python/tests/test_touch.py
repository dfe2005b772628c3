"""Touch images against `touch render`, and the network."""

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import run

from mambavitact import ArgumentError, Episode, FileError, Log, TouchNetwork, render_touch

# A box with its face 1 mm inside the gel, which is 22 mm from the camera.
BOX = (
    np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float) * [0.02, 0.008, 0.008],
    np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    ),
)
POSE = np.array([[1, 0, 0, 0.021], [0, 1, 0, -0.004], [0, 0, 1, -0.004], [0, 0, 0, 1.0]])


@pytest.mark.parametrize("sensor", ["fork", "tacto"])
def test_a_press_is_that_of_the_command(tmp_path: Path, sensor: str) -> None:
    mesh = tmp_path / "box.obj"
    vertices, faces = BOX
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in vertices) + "".join(f"f {a} {b} {c}\n" for a, b, c in faces + 1)
    mesh.write_text(text)
    (tmp_path / "pose.json").write_text(json.dumps(POSE.tolist()))
    run("touch", "render", "--mesh", mesh, "--pose", tmp_path / "pose.json", "--config", sensor, "--out", tmp_path / "a")
    for rendered in (render_touch(mesh, POSE, sensor), render_touch(BOX, POSE, sensor)):
        assert np.array_equal(rendered.raw, np.load(tmp_path / "a_rgb_raw.npy"))
        assert np.array_equal(rendered.calibrated, np.load(tmp_path / "a_rgb_cal.npy"))
        assert np.array_equal(rendered.depth_m, np.load(tmp_path / "a_depth.npy"))
    if sensor == "fork":
        assert abs(rendered.depth_m[160, 120] - 0.021) < 1e-4


def test_the_network_finds_the_presses_of_a_log(log: Log) -> None:
    network = TouchNetwork()
    frame = max(log, key=lambda frame: 0 if frame.contact is None else int(frame.contact.sum()))
    assert frame.touch_images is not None and frame.contact is not None and frame.indentation_mm is not None
    untouched = Episode("cube70").untouched()
    compared = 0
    for finger in range(4):
        found = network.predict(frame.touch_images[finger : finger + 1], untouched=untouched[finger])
        assert found.plausibility[0] > 0.5
        true = frame.contact[finger]
        if true.mean() < 0.01:
            continue
        compared += 1
        shared = (found.contact[0] & true).sum() / (found.contact[0] | true).sum()
        assert shared > 0.6
        error = np.abs(found.indentation_mm[0] - frame.indentation_mm[finger])[true].mean()
        assert error < 0.2
    assert compared > 0


def test_images_are_independent() -> None:
    network = TouchNetwork()
    images = Episode("cube70").untouched()
    together, alone = network.predict(images), [network.predict(image[None]) for image in images]
    assert np.array_equal(together.indentation_mm, np.concatenate([one.indentation_mm for one in alone]))
    assert together.indentation_mm.dtype == np.float32
    assert network.predict(images[:0]).plausibility.shape == (0,)
    black = network.predict(np.zeros((1, 320, 240, 3), np.uint8))
    assert black.plausibility[0] < 0.5 and not black.contact.any()


def test_wrong_arguments_are_named(tmp_path: Path) -> None:
    network = TouchNetwork()
    image = np.zeros((320, 240, 3), np.uint8)
    expected = r"images: expected an array of dtype uint8 and shape \(N, 320, 240, 3\), got dtype "
    for wrong, came in [
        (image, r"uint8 and shape \(320, 240, 3\)"),
        (image[None].astype(float), r"float64 and shape \(1, 320, 240, 3\)"),
        (image[None].transpose(0, 2, 1, 3), r"uint8 and shape \(1, 240, 320, 3\)"),
        (image[None].transpose(0, 3, 1, 2), r"uint8 and shape \(1, 3, 320, 240\)"),
    ]:
        with pytest.raises(ArgumentError, match=expected + came):
            network.predict(wrong)
    with pytest.raises(ArgumentError, match="untouched: expected"):
        network.predict(image[None], untouched=image[None])
    with pytest.raises(FileError, match="missing.st"):
        TouchNetwork(tmp_path / "missing.st")
    with pytest.raises(ArgumentError, match="fork or tacto"):
        render_touch(BOX, POSE, "gelsight")
    with pytest.raises(ArgumentError, match="not a rigid|rigid"):
        render_touch(BOX, 2 * POSE)
    with pytest.raises(ArgumentError, match=r"corner 8, but there are 8 vertices"):
        render_touch((BOX[0], BOX[1] + 1), POSE)
    with pytest.raises(ArgumentError, match="pair of arrays"):
        render_touch(BOX[0], POSE)  # type: ignore[arg-type]
    with pytest.raises(FileError, match="missing.obj"):
        render_touch(tmp_path / "missing.obj", POSE)
    with pytest.raises(ArgumentError, match="NaN"):
        render_touch((BOX[0] * np.nan, BOX[1]), POSE)
