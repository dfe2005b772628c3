"""RGB-D sequences without a hand as logs."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mambavitact import FileError, Log, Slam


@pytest.fixture(scope="module")
def folder(log: Log, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The frames of a log as folders of images, the mask of frame 2 missing."""
    folder = tmp_path_factory.mktemp("sequence")
    for name in ("rgb", "depth", "masks"):
        (folder / name).mkdir()
    np.savetxt(folder / "cam_K.txt", log.cameras[0].intrinsics)
    (folder / "rgbd.toml").write_text("frame_hz = 30.0\n")
    for k, frame in enumerate(log):
        with Image.open(log.folder / "realsense" / log.cameras[0].name / "seg" / f"{k}.jpg") as image:
            mask = np.asarray(image) > 191
        Image.fromarray(frame.color[0]).save(folder / "rgb" / f"{k:06}.png")
        Image.fromarray((1000.0 * frame.depth_m[0]).round().astype(np.uint16)).save(folder / "depth" / f"{k:06}.png")
        if k != 2:
            Image.fromarray(mask.astype(np.uint8) * 255).save(folder / "masks" / f"{k:06}.png")
    return folder


@pytest.mark.filterwarnings("ignore:.*29 of 30 frames have a mask")
def test_a_folder_of_images_is_a_log(folder: Path, log: Log) -> None:
    sequence = Log(folder)
    assert len(sequence) == len(log) == 30
    assert sequence.names[3] == "000003"
    assert sequence.joints.shape == (30, 0)
    assert sequence.object == "unknown"
    assert sequence.seed is None
    assert np.isnan(sequence.object_poses).all()
    assert np.abs(sequence.times_s - np.arange(30) / 30.0).max() < 1e-9
    (camera,) = sequence.cameras
    assert (camera.width, camera.height) == (log.cameras[0].width, log.cameras[0].height)
    frames = list(sequence)
    assert len(frames) == 30
    frame = sequence[-1]
    assert np.array_equal(frame.masks[0], frames[-1].masks[0]) and frame.masks[0].dtype == bool
    assert np.abs(frame.depth_m[0] - log[-1].depth_m[0]).max() < 1e-3
    assert np.array_equal(frame.color[0], log[-1].color[0])
    assert frames[2].masks == [] and frame.touch_images is None and frame.joints.shape == (0,)
    assert frame.camera_pose is not None and np.array_equal(frame.camera_pose, np.eye(4))


@pytest.mark.filterwarnings("ignore:.*29 of 30 frames have a mask")
def test_its_object_is_tracked(folder: Path) -> None:
    sequence = Log(folder)
    slam = Slam(sequence.cameras, rig="none", settings={"slam.map.first_steps": 40})
    estimates = [slam.observe(frame) for frame in sequence if frame.masks]
    assert len(estimates) == 29
    assert all(estimate.is_tracking for estimate in estimates)
    assert slam.mesh() is not None


def test_what_is_missing_is_named(folder: Path, tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="29 of 30 frames have a mask"):
        Log(folder)
    bag = tmp_path / "a.mcap"
    bag.write_bytes(b"no bag")
    with pytest.raises(FileError, match="it is no bag of ROS 2"):
        Log(bag)
    (tmp_path / "rgb").mkdir()
    (tmp_path / "depth").mkdir()
    with pytest.raises(FileError, match=r"cam_K\.txt"):
        Log(tmp_path)
