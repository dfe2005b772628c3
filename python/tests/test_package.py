"""The package as a whole: words, signals, panics, the command."""

import inspect
import os
import signal
import subprocess
import sys
import time
from pathlib import Path


import mambavitact
import mambavitact.gym
from mambavitact import _native


def test_everything_public_has_words() -> None:
    missing = []
    for name in mambavitact.__all__:
        thing = getattr(mambavitact, name)
        if not thing.__doc__:
            missing.append(name)
        if inspect.isclass(thing) and not issubclass(thing, Exception):
            members = [member for member in vars(thing) if not member.startswith("_")]
            missing += [f"{name}.{member}" for member in members if not getattr(getattr(thing, member), "__doc__", None)]
    assert missing == []


def test_exceptions_have_bases_that_people_catch() -> None:
    assert issubclass(mambavitact.ArgumentError, (mambavitact.Error, ValueError))
    assert issubclass(mambavitact.ArgumentError, ValueError)
    assert issubclass(mambavitact.FileError, OSError)
    for name in ("ArgumentError", "FileError", "InternalError"):
        assert issubclass(getattr(mambavitact, name), mambavitact.Error)


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-P", "-c", "import sys; from mambavitact._command import main; sys.exit(main())", *arguments]
    return subprocess.run(words, capture_output=True, text=True, check=False)


def test_the_command_is_the_program() -> None:
    done = command("simulate", "--object", "cube70", "--duration", "1", "--json")
    assert done.returncode == 0 and '"survived_s":1.0' in done.stdout, done
    refused = command("simulate", "--object", "cub")
    assert refused.returncode == 1 and "cube70" in refused.stderr, refused
    assert command("dance").returncode == 2
    assert command("--version").stdout.split()[1] == _native.version() == mambavitact.__version__


INTERRUPTED = """
import signal, numpy as np, mambavitact
# The tests may run where SIGINT is ignored, as behind a shell's `&`.
signal.signal(signal.SIGINT, signal.default_int_handler)
network = mambavitact.TouchNetwork()
images = np.tile(mambavitact.Episode("cube70").untouched(), (100, 1, 1, 1))
print("ready", flush=True)
network.predict(images)
"""


def test_ctrl_c_ends_a_long_call() -> None:
    with subprocess.Popen(
        [sys.executable, "-P", "-c", INTERRUPTED], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGINT)
        process.wait(timeout=120)
        assert process.returncode == -signal.SIGINT
        assert "KeyboardInterrupt" in process.stderr.read()


def test_libmujoco_is_loaded_without_variables_of_the_environment(tmp_path: Path) -> None:
    environment = {key: os.environ[key] for key in ("PATH", "HOME") if key in os.environ}
    environment["PYTHONPATH"] = str(Path(mambavitact.__file__).resolve().parents[1])
    text = "import mambavitact; print(open('/proc/self/maps').read())"
    done = subprocess.run(
        [sys.executable, "-P", "-c", text], env=environment, cwd=tmp_path, capture_output=True, text=True, check=True
    )
    libraries = {line.split()[-1] for line in done.stdout.splitlines() if "libmujoco" in line}
    assert len(libraries) == 1 and "mujoco/libmujoco.so.3.17.0" in libraries.pop()


def test_other_threads_go_on_during_a_call() -> None:
    import threading

    episode = mambavitact.Episode("cube70", duration_s=3600.0)
    moments: list[float] = []
    thread = threading.Thread(target=lambda: episode.step(steps=20_000))
    thread.start()
    while thread.is_alive():
        moments.append(time.monotonic())
    thread.join()
    assert len(moments) > 100, "this thread ran while the other simulated"


def test_examples_run(tmp_path: Path) -> None:
    examples = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
    assert len(examples) >= 6
    for example in examples:
        # It needs torch and stable-baselines3.
        if example.name == "train_ppo.py":
            continue
        done = subprocess.run([sys.executable, example], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{example.name}: {done.stderr}"
