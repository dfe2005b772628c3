"""Reads an exported MCAP file with the official reader and converts it with rerun. Prints one JSON line, and fails if a channel is missing.

    rerun.py DIR
"""

import argparse
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from mambavitact import Log, record_log

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("out", type=Path)
out = parser.parse_args().out
place, file, converted = out / "log", out / "log.mcap", out / "log.rrd"
log = Log(place) if place.exists() else record_log(place, "cube70", duration_s=2.0)
subprocess.run([sys.executable, "-m", "mambavitact", "export", "mcap", log.folder, "--out", file, "--overwrite"], check=True, stdout=subprocess.DEVNULL)

messages: Counter[str] = Counter()
with file.open("rb") as stream:
    reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
    for _, channel, _, _ in reader.iter_decoded_messages():
        messages[channel.topic] += 1

rerun = Path(sys.executable).with_name("rerun")
subprocess.run([rerun, "mcap", "convert", file, "-o", converted], check=True, capture_output=True)
shown = subprocess.run([rerun, "rrd", "print", converted], check=True, capture_output=True, text=True).stdout
entities = sorted(topic for topic in messages if topic != "/tf" and topic in shown)
missing = sorted(set(messages) - set(entities) - {"/tf"})
result = {"frames": len(log), "messages": dict(messages), "rerun_entities": entities, "missing": len(missing)}
print(json.dumps(result))
if missing:
    raise SystemExit(f"rerun shows none of {', '.join(missing)}")
