"""Depth archives as recorded data may have them: write_depths.py FOLDER. All hold the depths 0, 0.1, ... 2.3 m but for sign."""
import sys

import numpy as np

folder = sys.argv[1]
tenths = np.arange(24).reshape(2, 3, 4)
save = np.savez_compressed
save(f"{folder}/depth-u2.npz", depth=(100 * tenths).astype(np.uint16), depth_scale=np.array([0.001], np.float32))
save(f"{folder}/depth-i2.npz", depth=(-100 * tenths).astype(">i2"), depth_scale=-0.001)
save(f"{folder}/depth-f4.npz", depth=(-0.1 * tenths).astype(np.float32), depth_scale=np.array(1.0))
save(f"{folder}/depth-f8.npz", depth=-0.1 * tenths)
np.savez(f"{folder}/depth-f2.npz", depth_scale=np.int64(1), depth=(-0.1 * tenths).astype(np.float16))
save(f"{folder}/depth-fortran.npz", depth=np.asfortranarray(tenths), depth_scale=1.0)
save(f"{folder}/depth-flat.npz", depth=tenths[0], depth_scale=1.0)
save(f"{folder}/depth-objects.npz", depth=np.array([[[None]]]), depth_scale=1.0)
save(f"{folder}/depth-none.npz", color=tenths)
