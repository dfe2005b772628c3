"""Times TACTO and our renderer in turns on the same scenes; started by run.sh."""

import json
import logging
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

logging.disable(logging.WARNING)
# TACTO 0.0.3 uses np.float, which NumPy has removed.
np.float = float
import tacto.renderer  # noqa: E402

cv2.setNumThreads(1)
DATA = Path("sim/render/tests/data/tacto")


def scenes(folder):
    """Yields name, mesh file and T_sensor_object of each scene."""
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=0.008)
    sphere.export(folder / "sphere.stl")
    pose = np.eye(4)
    pose[:3, 3] = [0.0285, 0.001, 0.017]
    yield "sphere of 8 mm pressed 1.5 mm, 20,480 triangles", folder / "sphere.stl", pose
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mambavitact/ycb"
    ycb = Path(os.environ.get("YCB_DIR") or cache)
    for scene in json.loads((DATA / "scenes.json").read_text()):
        if "mesh" not in scene:
            continue
        pose = np.array(scene["T_sensor_object"])
        # These poses are for a camera at the origin; that of TACTO 0.0.3 lies at z = 15 mm.
        pose[2, 3] += 0.015
        if (ycb / scene["mesh"]).exists():
            yield scene["mesh"], ycb / scene["mesh"], pose
        else:
            print(f"skipped: {scene['mesh']} is not in {ycb}; download it with `mambavitact assets fetch`")
    if "MESH" in os.environ:
        yield os.environ["MESH"], Path(os.environ["MESH"]), np.array(json.loads(Path(os.environ["POSE"]).read_text()))


def make_background(path):
    """A smooth image in place of a real DIGIT's; both programs lay the contact over it."""
    rows, columns = np.mgrid[0:320, 0:240]
    image = np.stack([60 + rows / 4, 180 - rows / 4, 60 + columns / 2], axis=-1)
    cv2.imwrite(str(path), image.astype(np.uint8))


def make_tacto(mesh_file, pose, background):
    """TACTO as it installs itself, an object in view."""
    config = Path(tacto.renderer.__file__).with_name("config_digit.yml")
    background = cv2.imread(str(background))
    renderer = tacto.renderer.Renderer(width=240, height=320, background=background, config_path=str(config))
    euler = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz")
    renderer.add_object(trimesh.load(mesh_file), "object", position=pose[:3, 3], orientation=euler)
    return renderer


def main():
    ours, rounds, tacto_frames, our_frames = sys.argv[1], *(
        int(a) for a in (sys.argv[2:] + ["5", "20", "500"][len(sys.argv) - 2 :])
    )
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        background = folder / "background.png"
        make_background(background)
        for name, mesh_file, pose in scenes(folder):
            (folder / "pose.json").write_text(json.dumps(pose.tolist()))
            command = [ours, mesh_file, folder / "pose.json", background, str(our_frames), folder / "ours"]
            renderer = make_tacto(mesh_file, pose, background)
            renderer.render()
            theirs_ms, ours_ms = [], []
            for _ in range(rounds):
                start = time.process_time()
                for _ in range(tacto_frames):
                    renderer.render(noise=True, calibration=True)
                theirs_ms.append((time.process_time() - start) * 1e3 / tacto_frames)
                answer = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
                ours_ms.append(answer["cpu_ms_per_frame"])
            ratio = [a / b for a, b in zip(theirs_ms, ours_ms)]
            ratios.append(statistics.median(ratio))
            print(
                f"{name}\n  CPU ms per frame, median of {rounds} rounds: TACTO {statistics.median(theirs_ms):.1f}, "
                f"ours {statistics.median(ours_ms):.3f}; ratio {ratios[-1]:.0f} ({min(ratio):.0f} to {max(ratio):.0f})"
            )
            compare(renderer, folder)
            renderer.r.delete()
    print(f"least ratio: {min(ratios):.0f}")


def compare(renderer, folder):
    """Noise off: how far the images agree."""
    for kind, calibration in ("raw", False), ("calibrated", True):
        (color,), (depth,) = renderer.render(noise=False, calibration=calibration)
        image = cv2.imread(str(folder / f"ours_{kind}.png"))[:, :, ::-1]
        difference = np.abs(image.astype(int) - color.astype(int)).max(axis=2)
        print(f"  {kind}: {100 * (difference <= 1).mean():.3f} % of pixels within 1 grey, greatest difference {difference.max()}")
    our_depth = np.fromfile(folder / "ours_depth.f32", np.float32).reshape(depth.shape)
    error_um = np.abs(our_depth.astype(float) - depth) * 1e6
    contact = (renderer.depth0[0] - depth > 0).mean()
    print(f"  depth: rms {np.sqrt((error_um**2).mean()):.2f} um, 99.9 % within {np.percentile(error_um, 99.9):.2f} um; contact {100 * contact:.0f} %")


main()
