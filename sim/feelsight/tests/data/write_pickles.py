"""Pickles the same data in every protocol: write_pickles.py FOLDER TAG writes FOLDER/TAG-<protocol>.pkl."""
import collections
import pickle
import sys

import numpy as np

folder, tag = sys.argv[1:]
matrix = np.arange(6, dtype=np.float64).reshape(2, 3) / 4
data = {
    "none": None,
    "bools": [True, False],
    "ints": [0, 255, 65535, -1, 2**31 - 1, -(2**31), 2**40, -(2**63), 2**63 - 1],
    "floats": [0.0, -1.5, 1e300, float("inf"), 0.1],
    "text": "g\u00fc\u20ac\U0001f600 \\u0041 'quoted'\n",
    "bytes": bytes(range(256)),
    "empty": [[], (), {}, "", b""],
    "tuples": (1, (2, 3), (4, 5, 6), (7, 8, 9, 10)),
    "ordered": collections.OrderedDict([("b", 1), ("a", 2)]),
    "matrix": matrix,
    "fortran": np.asfortranarray(matrix),
    "big": matrix.astype(">f4"),
    "kinds": [np.array([1, 0, 1], dtype=code) for code in "? i1 i2 i4 i8 u1 u2 u4 u8 f2 f4 f8".split()],
    "scalars": [np.float64(0.25), np.float32(0.5), np.int64(-7), np.uint8(200), np.bool_(True)],
    "zero": np.array(2.5),
    "hollow": np.zeros((0, 4)),
    "view": np.arange(10)[::3],
    "shared": [matrix] * 3,
}
for protocol in range(6):
    with open(f"{folder}/{tag}-{protocol}.pkl", "wb") as file:
        pickle.dump(data, file, protocol=protocol)
