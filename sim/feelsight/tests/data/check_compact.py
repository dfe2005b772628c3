"""Reads a compact log as docs/compact_log.md says, and compares it with what our reader made of it: check_compact.py LOG DUMP FRAMES."""
import io
import os
import pickle
import sys
import zipfile

import numpy as np
from PIL import Image

log, dump, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
# Decoders round and interpolate colours differently.
LEVELS = 4
with open(os.path.join(log, "data.pkl"), "rb") as file:
    data = pickle.load(file)
assert len(data["time"]) == count

frames = zipfile.ZipFile(os.path.join(log, "frames.zip"))
assert frames.testzip() is None
image = lambda name: np.asarray(Image.open(io.BytesIO(frames.read(name))))
ours = lambda name, like, kind=np.uint8: np.fromfile(os.path.join(dump, name), kind).reshape(like.shape)


def near(name, theirs):
    assert theirs.shape[2] == 3
    difference = np.abs(ours(name, theirs).astype(int) - theirs).max()
    assert difference <= LEVELS, f"{name}: {difference} levels apart"


for i in range(count):
    for finger in ("index", "middle", "ring", "thumb"):
        untouched = image(f"allegro/{finger}/untouched.png").astype(int)
        difference = image(f"allegro/{finger}/difference/{i}.jpg")
        near(f"{finger}-{i}", np.clip(untouched + difference - 128, 0, 255))
        level = image(f"allegro/{finger}/depth/{i}.png") + image("allegro/gel.png")
        depth = -(level / data["digit_info"]["depth_scale"] + data["digit_info"]["cam_dist"])
        assert np.abs(ours(f"{finger}-depth-{i}", level, np.float32) - depth).max() < 1e-7
        mask = image(f"allegro/{finger}/mask/{i}.png")
        assert set(np.unique(mask)) <= {0, 255}
        assert (ours(f"{finger}-contact-{i}", mask) == (mask > 0)).all()
    for camera, info in data["realsense"].items():
        near(f"{camera}-{i}", image(f"realsense/{camera}/image/{i}.jpg"))
        steps = image(f"realsense/{camera}/depth/{i}.png")
        assert steps.dtype == np.uint16 and steps.shape == (info["intrinsics"]["h"], info["intrinsics"]["w"])
        assert (ours(f"{camera}-depth-{i}", steps, np.float32) == (steps * 1e-4).astype(np.float32)).all()
        assert set(np.unique(image(f"realsense/{camera}/seg/{i}.png"))) <= {0, 127, 255}
