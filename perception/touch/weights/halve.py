#!/usr/bin/env python3
"""Writes a file of weights with 16-bit instead of 32-bit floats: halve.py IN OUT. Needs NumPy.

The shipped weights were made from the files of their training in this way.
"""

import json
import sys
import zlib

import numpy

ZEROS = "00000000"


def main(source, target):
    data = open(source, "rb").read()
    start = 8 + int.from_bytes(data[:8], "little")
    header = json.loads(data[8:start])
    metadata = header.pop("__metadata__")
    metadata.pop("checksum", None)
    # The checksum stands first, see mvt_files::seal.
    halved = {"__metadata__": {"checksum": ZEROS} | metadata}
    parts, end = [], 0
    for name, tensor in sorted(header.items(), key=lambda item: item[1]["data_offsets"]):
        first, last = tensor["data_offsets"]
        assert tensor["dtype"] == "F32", f"{name} is {tensor['dtype']}"
        part = numpy.frombuffer(data[start + first : start + last], "<f4").astype("<f2").tobytes()
        halved[name] = {"dtype": "F16", "shape": tensor["shape"], "data_offsets": [end, end + len(part)]}
        parts.append(part)
        end += len(part)
    text = json.dumps(halved, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    file = bytearray(len(text).to_bytes(8, "little") + text + b"".join(parts))
    place = file.index(ZEROS.encode())
    file[place : place + 8] = f"{zlib.crc32(file):08x}".encode()
    open(target, "wb").write(file)


main(*sys.argv[1:])
