"""Exported data sets of LeRobot, read by Apache Arrow's own reader."""

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest
from conftest import run
from PIL import Image

from mambavitact import Log, record_log


def picture(cell: dict[str, Any]) -> np.ndarray:
    with Image.open(io.BytesIO(cell["bytes"])) as image:
        return np.asarray(image)


@pytest.fixture(scope="module")
def exported(log: Log, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Log], Path]:
    """Two logs and their data set."""
    folder = tmp_path_factory.mktemp("lerobot")
    other = record_log(folder / "other", "mug", seed=4, duration_s=0.5)
    run("export", "lerobot", log.folder, other.folder, "--out", folder / "set")
    return [log, other], folder / "set"


def test_every_frame_is_there(exported: tuple[list[Log], Path]) -> None:
    logs, folder = exported
    info = json.loads((folder / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_episodes"]) == ("v3.0", 30, 2)
    assert info["total_frames"] == sum(map(len, logs))
    index = 0
    for episode, log in enumerate(logs):
        table = pq.read_table(folder / f"data/chunk-000/file-{episode:03d}.parquet")
        assert sorted(table.column_names) == sorted(info["features"])
        rows = table.to_pylist()
        assert len(rows) == len(log)
        for k, (row, frame) in enumerate(zip(rows, log, strict=True)):
            assert (row["frame_index"], row["episode_index"], row["index"], row["task_index"]) == (k, episode, index, episode)
            index += 1
            assert row["timestamp"] == np.float32(k / 30)
            assert row["observation.time_s"] == frame.time_s
            assert np.array_equal(row["observation.state"], frame.joints.astype("f4"))
            assert np.array_equal(row["action"], log.joints[min(k + 1, len(log) - 1)].astype("f4"))
            assert frame.object_pose is not None
            assert row["observation.object_pose"][:3] == frame.object_pose[:3, 3].tolist()
            name = log.cameras[0].name
            file = Path(log.folder) / "realsense" / name / "image" / f"{k}.jpg"
            assert row[f"observation.images.{name}"]["bytes"] == file.read_bytes()
            steps = picture(row[f"observation.images.{name}_depth"])
            assert np.abs(steps * 1e-4 - frame.depth_m[0]).max() < 0.6e-4
            for finger in ["index", "middle", "ring", "thumb"]:
                file = Path(log.folder) / "allegro" / finger / "image" / f"{k}.jpg"
                assert row[f"observation.images.touch_{finger}"]["bytes"] == file.read_bytes()


def test_episodes_tasks_and_statistics(exported: tuple[list[Log], Path]) -> None:
    logs, folder = exported
    episodes = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    lengths = [len(log) for log in logs]
    assert [episode["length"] for episode in episodes] == lengths
    assert [episode["dataset_from_index"] for episode in episodes] == [0, lengths[0]]
    assert [episode["dataset_to_index"] for episode in episodes] == [lengths[0], sum(lengths)]
    assert [episode["data/file_index"] for episode in episodes] == [0, 1]
    tasks = pq.read_table(folder / "meta/tasks.parquet")
    assert tasks["__index_level_0__"].to_pylist() == [task for episode in episodes for task in episode["tasks"]]
    assert b"__index_level_0__" in tasks.schema.metadata[b"pandas"]
    statistics = json.loads((folder / "meta/stats.json").read_text())
    assert set(statistics) | {f"observation.images.{logs[0].cameras[0].name}_depth"} == set(
        json.loads((folder / "meta/info.json").read_text())["features"]
    )
    joints = np.concatenate([log.joints for log in logs])
    state = statistics["observation.state"]
    for key, expected in (("min", joints.min(0)), ("max", joints.max(0)), ("mean", joints.mean(0)), ("std", joints.std(0))):
        assert np.allclose(state[key], expected, atol=1e-9), key
    assert state["count"] == [len(joints)]
    assert np.shape(statistics["observation.images.touch_ring"]["mean"]) == (3, 1, 1)


@pytest.mark.parametrize("compression", ["snappy", "zstd", "gzip", "brotli"])
@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_a_data_set_of_another_writer_is_imported(exported: tuple[list[Log], Path], tmp_path: Path, compression: str, version: str) -> None:
    logs, folder = exported
    log, camera = logs[1], logs[1].cameras[0]
    # As LeRobot's own recorder writes: both episodes in a file, compressed, with dictionaries, in groups, and columns of other names.
    tables = [pq.read_table(folder / f"data/chunk-000/file-{k:03d}.parquet") for k in range(2)]
    table = pa.concat_tables(tables)
    names = {"observation.state": "joints", f"observation.images.{camera.name}": "rgb", f"observation.images.{camera.name}_depth": "depth"}
    table = table.rename_columns([names.get(name, name) for name in table.column_names])
    info = json.loads((folder / "meta/info.json").read_text())
    info["features"] = {names.get(name, name): feature for name, feature in info["features"].items()}
    other = tmp_path / "other"
    (other / "data/chunk-000").mkdir(parents=True)
    (other / "meta/episodes/chunk-000").mkdir(parents=True)
    pq.write_table(table, other / "data/chunk-000/file-000.parquet", compression=compression, row_group_size=7, data_page_version=version)
    episodes = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet")
    place = episodes.column_names.index("data/file_index")
    episodes = episodes.set_column(place, "data/file_index", pa.array([0, 0]))
    pq.write_table(episodes, other / "meta/episodes/chunk-000/file-000.parquet")
    (other / "meta/info.json").write_text(json.dumps(info))
    mapping = (folder / "meta/mambavitact/episode-000001/mapping.toml").read_text()
    for name, new in names.items():
        mapping = mapping.replace(f'"{name}"', f'"{new}"')
    (tmp_path / "mapping.toml").write_text(mapping)
    run("import", other, "--episode", "1", "--mapping", tmp_path / "mapping.toml", "--out", tmp_path / "log")
    found = Log(tmp_path / "log")
    assert found.side == log.side and np.array_equal(found.times_s, log.times_s)
    assert np.abs(found.joints - log.joints).max() < 1e-6
    assert np.abs(found.object_poses - log.object_poses).max() < 1e-9
    for a, b in zip(found, log, strict=True):
        assert np.abs(a.depth_m[0] - b.depth_m[0]).max() < 0.6e-4
        assert np.array_equal(a.color[0], b.color[0])
        assert a.touch_images is not None and b.touch_images is not None and np.array_equal(a.touch_images, b.touch_images)


def test_estimates_of_runs_become_columns(log: Log, tmp_path: Path) -> None:
    run("run", "--log", log.folder, "--out", tmp_path / "run", "--quiet")
    run("export", "lerobot", log.folder, "--runs", tmp_path / "run", "--out", tmp_path / "set")
    table = pq.read_table(tmp_path / "set/data/chunk-000/file-000.parquet")
    info = json.loads((tmp_path / "set/meta/info.json").read_text())
    assert sorted(table.column_names) == sorted(info["features"])
    with (tmp_path / "run/trajectory.csv").open() as file:
        rows = list(csv.DictReader(file))
    keys = ["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"]
    expected = np.array([[float(row[key]) for key in keys] for row in rows])
    shown = np.array(table["observation.estimate_pose"].to_pylist())
    assert np.abs(shown - expected).max() < 1e-6
    confidence = [float(row["confidence"]) for row in rows]
    assert np.allclose(table["observation.estimate_confidence"].to_pylist(), confidence, atol=1e-3)
