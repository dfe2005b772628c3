"""Plays a run to two clients of Foxglove's protocol for some minutes, and watches the memory of the server; prints a JSON line.

usage: soak.py --program PROGRAM --client FOLDER [--minutes 10]

Needs the packages mcap and websockets, and in FOLDER official_client.mjs beside the packages that it needs. The run is played again and
again in real time, 30 frames per second. Every channel of its export that has messages must come.
"""

import argparse
import atexit
import itertools
import json
import pathlib
import signal
import statistics
import subprocess
import tempfile
import time

from mcap.reader import make_reader
from websockets.sync.client import connect

SAMPLE_S = 5.0

parser = argparse.ArgumentParser()
parser.add_argument("--program", required=True)
parser.add_argument("--client", required=True)
parser.add_argument("--minutes", type=float, default=10.0)
arguments = parser.parse_args()
program = str(pathlib.Path(arguments.program).resolve())
folder = tempfile.mkdtemp(prefix="ros_soak.")


def resident_mb(process):
    status = pathlib.Path(f"/proc/{process}/status").read_text()
    line = next(line for line in status.splitlines() if line.startswith("VmRSS:"))
    return int(line.split()[1]) * 1024e-6


run = ["run", "--object", "cube70", "--duration", "6", "--out", "run", "--quiet"]
subprocess.run([program, *run], cwd=folder, check=True)
subprocess.run([program, "export", "mcap", "run", "--out", "run.mcap"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
with open(f"{folder}/run.mcap", "rb") as file:
    summary = make_reader(file).get_summary()
exported = {summary.channels[n].topic for n, count in summary.statistics.channel_message_counts.items() if count > 0}
server = subprocess.Popen([program, "view", "run", "--foxglove", "0"], cwd=folder, stdout=subprocess.PIPE, text=True)
# Nothing is left behind by a fault of this script.
atexit.register(server.kill)
address = next(word for word in server.stdout.readline().split() if word.startswith("ws://"))
official = subprocess.Popen(
    ["node", "official_client.mjs", address], cwd=arguments.client, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
)
with connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
    assert json.loads(socket.recv())["op"] == "serverInfo"
    channels = {channel["id"]: channel for channel in json.loads(socket.recv())["channels"]}
    socket.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": n, "channelId": n} for n in channels]}))
    begun = time.monotonic()
    memory_mb, received = [], {number: [] for number in channels}
    while (now_s := time.monotonic() - begun) < 60 * arguments.minutes:
        if now_s >= SAMPLE_S * len(memory_mb):
            memory_mb.append(resident_mb(server.pid))
        message = socket.recv()
        if isinstance(message, bytes) and message[0] == 1:
            received[int.from_bytes(message[1:5], "little")].append(now_s)
heard_by_official = set(json.loads(official.communicate()[0]))
server.send_signal(signal.SIGINT)
server.wait()
heard = {channels[n]["topic"] for n, times_s in received.items() if times_s and channels[n].get("schema")}
times_s = max(received.values(), key=len)
third = len(memory_mb) // 3
print(
    json.dumps({
        "channels": len(exported),
        # Those without a message or a schema.
        "missing": len(exported - heard),
        "missing_officially": len(exported - heard_by_official),
        # While it plays: it pauses before it begins again.
        "frames_per_s": 1 / statistics.median(after - before for before, after in itertools.pairwise(times_s)),
        "memory_mb": statistics.mean(memory_mb[third : 2 * third]),
        # The first third fills caches.
        "growth_mb": statistics.mean(memory_mb[2 * third :]) - statistics.mean(memory_mb[third : 2 * third]),
    })
)
