"""Plays a run to a client of Foxglove's protocol for some minutes, and watches the memory of the server; prints a JSON line.

usage: soak.py --program PROGRAM [--minutes 10]

Needs the package websockets. The run is played again and again in real time, 30 frames per second.
"""

import argparse
import json
import pathlib
import signal
import statistics
import subprocess
import tempfile
import time

from websockets.sync.client import connect

SAMPLE_S = 5.0

parser = argparse.ArgumentParser()
parser.add_argument("--program", required=True)
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
server = subprocess.Popen([program, "view", "run", "--foxglove", "0"], cwd=folder, stdout=subprocess.PIPE, text=True)
address = next(word for word in server.stdout.readline().split() if word.startswith("ws://"))
with connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
    assert json.loads(socket.recv())["op"] == "serverInfo"
    channels = {channel["id"]: channel for channel in json.loads(socket.recv())["channels"]}
    socket.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": n, "channelId": n} for n in channels]}))
    begun = time.monotonic()
    memory_mb, received = [], dict.fromkeys(channels, 0)
    while (now_s := time.monotonic() - begun) < 60 * arguments.minutes:
        if now_s >= SAMPLE_S * len(memory_mb):
            memory_mb.append(resident_mb(server.pid))
        message = socket.recv()
        if isinstance(message, bytes) and message[0] == 1:
            received[int.from_bytes(message[1:5], "little")] += 1
server.send_signal(signal.SIGINT)
server.wait()
third = len(memory_mb) // 3
print(
    json.dumps({
        "channels": len(channels),
        "silent": sum(count == 0 for count in received.values()),
        "without_schema": sum(not channel.get("schema") for channel in channels.values()),
        "frames_per_s": max(received.values()) / now_s,
        "memory_mb": statistics.mean(memory_mb[third : 2 * third]),
        # The first third fills caches.
        "growth_mb": statistics.mean(memory_mb[2 * third :]) - statistics.mean(memory_mb[third : 2 * third]),
    })
)
