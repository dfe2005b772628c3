"""Times ONNX Runtime and our engine in turns; started by run.sh."""

import json
import os
import statistics
import subprocess
import sys
import threading
import time

import numpy as np
import onnxruntime

ours, model = sys.argv[1:3]
rounds, seconds = (int(a) for a in (sys.argv[3:] + ["5", "4"][len(sys.argv) - 3 :]))
threads = int(os.environ.get("THREADS", "2"))
image = np.random.default_rng(0).random((1, 3, 224, 224), np.float32)


def session(count):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = count
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
    # Spinning threads would take the cores from the other side.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0" if threads > 1 and count == 1 else "1")
    return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])


def one_after_another(peer):
    """Returns images per second with all threads on one image."""
    begun, done = time.perf_counter(), 0
    while time.perf_counter() - begun < seconds / 2:
        peer.run(None, {"image": image})
        done += 1
    return done / (time.perf_counter() - begun)


def side_by_side(peers):
    """Returns images per second with one thread per image."""
    done = [0] * len(peers)
    begun = time.perf_counter()

    def work(k):
        while time.perf_counter() - begun < seconds / 2:
            peers[k].run(None, {"image": image})
            done[k] += 1

    workers = [threading.Thread(target=work, args=(k,)) for k in range(len(peers))]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    return sum(done) / (time.perf_counter() - begun)


def our_rate():
    network = ["--weights", os.environ["WEIGHTS"]] if "WEIGHTS" in os.environ else ["--networks", "default"]
    command = [ours, "bench", "networks", *network, "--input", "240x320", "--batch", "4", "--threads", str(threads)]
    answer = subprocess.run([*command, "--seconds", str(seconds), "--json"], check=True, capture_output=True, text=True)
    (figure,) = json.loads(answer.stdout)
    return figure["images_per_second"], figure["instructions"]


together, apart = session(threads), [session(1) for _ in range(threads)]
for peer in together, *apart:
    peer.run(None, {"image": image})
theirs, mine = [], []
for _ in range(rounds):
    # Whichever way of using the threads is the better one for it.
    theirs.append(max(one_after_another(together), side_by_side(apart)))
    rate, instructions = our_rate()
    mine.append(rate)
    print(f"ONNX Runtime {theirs[-1]:.1f} images/s, ours {rate:.1f} ({instructions}), ratio {rate / theirs[-1]:.1f}", flush=True)
ratios = [a / b for a, b in zip(mine, theirs)]
print(
    f"{threads} threads, median of {rounds} rounds: ONNX Runtime {onnxruntime.__version__} with ViT-S + DPT at 224 "
    f"{statistics.median(theirs):.1f} images/s, ours with `default` at 240x320 {statistics.median(mine):.1f} images/s"
)
bar = 6
ratio = statistics.median(ratios)
print(f"ratio {ratio:.1f} ({min(ratios):.1f} to {max(ratios):.1f}); {'met' if ratio >= bar else 'MISSED'}: at least {bar}")
sys.exit(ratio < bar)
