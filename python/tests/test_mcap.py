"""Exported MCAP files, read by the official reader and decoded by Foxglove's own schemas; and files that the official writer wrote, imported."""

import csv
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
from conftest import run, run_json
from foxglove_schemas_protobuf import (
    CameraCalibration_pb2,
    CompressedImage_pb2,
    FrameTransforms_pb2,
    JointStates_pb2,
    Log_pb2,
    PointCloud_pb2,
    RawImage_pb2,
    SceneUpdate_pb2,
)
from google.protobuf import descriptor_pb2, descriptor_pool
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mcap_protobuf.writer import Writer
from PIL import Image

from mambavitact import Log

# They declare Foxglove's types.
MODULES = (
    CameraCalibration_pb2,
    CompressedImage_pb2,
    FrameTransforms_pb2,
    JointStates_pb2,
    Log_pb2,
    PointCloud_pb2,
    RawImage_pb2,
    SceneUpdate_pb2,
)


def rotation(q: Any) -> np.ndarray:
    x, y, z, w = q.x, q.y, q.z, q.w
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def check_schema(data: bytes) -> None:
    """Check that each declared type is the one that Foxglove publishes, down to the numbers of its fields."""
    for file in descriptor_pb2.FileDescriptorSet.FromString(data).file:
        if file.package == "mambavitact":
            continue
        for declared in file.message_type:
            expected = descriptor_pb2.DescriptorProto()
            descriptor_pool.Default().FindMessageTypeByName(f"{file.package}.{declared.name}").CopyToProto(expected)
            for field in expected.field:
                field.ClearField("json_name")
            assert declared == expected, declared.name


def test_the_official_reader_finds_everything(log: Log, tmp_path: Path) -> None:
    file = tmp_path / "log.mcap"
    run("export", "mcap", log.folder, "--out", file)
    seen: dict[str, list[Any]] = {}
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        for _, channel, message, decoded in reader.iter_decoded_messages():
            assert message.log_time == decoded_ns(decoded), channel.topic
            seen.setdefault(channel.topic, []).append(decoded)
        attachments = [(attachment.name, attachment.data) for attachment in reader.iter_attachments()]
    assert summary.statistics.message_count == sum(map(len, seen.values()))
    assert attachments == [(name, (Path(log.folder) / name).read_bytes()) for name in ("scene.json", "data.pkl")]

    for schema in summary.schemas.values():
        check_schema(schema.data)

    frames = list(log)
    names = [camera.name for camera in log.cameras]
    fingers = ["index", "middle", "ring", "thumb"]
    topics = {"/tf", "/hand/joints"}
    topics |= {f"/camera/{name}/{kind}" for name in names for kind in ("color", "labels", "depth", "calibration")}
    topics |= {f"/touch/{finger}/{kind}" for finger in fingers for kind in ("image", "depth", "contact")}
    assert set(seen) == topics and all(len(messages) == len(frames) for messages in seen.values())

    folder = Path(log.folder)
    optical = np.diag([1.0, -1.0, -1.0])
    for k, frame in enumerate(frames):
        poses = {pose.child_frame_id: pose for pose in seen["/tf"][k].transforms}
        assert {pose.parent_frame_id for pose in poses.values()} == {"world"}
        assert [joint.position for joint in seen["/hand/joints"][k].joints] == frame.joints.tolist()
        assert frame.object_pose is not None
        assert np.abs(rotation(poses["object"].rotation) - frame.object_pose[:3, :3]).max() < 1e-12
        origin = poses["object"].translation
        assert np.array_equal([origin.x, origin.y, origin.z], frame.object_pose[:3, 3])
        for camera, depth_m in zip(log.cameras, frame.depth_m, strict=True):
            depth = seen[f"/camera/{camera.name}/depth"][k]
            assert (depth.encoding, depth.step) == ("32FC1", 4 * depth.width)
            assert np.array_equal(np.frombuffer(depth.data, "<f4").reshape(depth.height, depth.width), depth_m)
            calibration = seen[f"/camera/{camera.name}/calibration"][k]
            assert np.array_equal(np.reshape(calibration.K, (3, 3)), camera.intrinsics)
            assert np.abs(rotation(poses[f"camera/{camera.name}"].rotation) - camera.pose[:3, :3] @ optical).max() < 1e-12
            for kind, name in (("color", "image"), ("labels", "seg")):
                image = seen[f"/camera/{camera.name}/{kind}"][k]
                assert image.frame_id == depth.frame_id == f"camera/{camera.name}"
                assert image.format == ("jpeg" if kind == "color" else "png")
                assert image.data == (folder / "realsense" / camera.name / name / f"{k}.jpg").read_bytes()
        for finger in fingers:
            for kind, name in (("image", "image"), ("depth", "depth"), ("contact", "mask")):
                data = seen[f"/touch/{finger}/{kind}"][k].data
                assert data == (folder / "allegro" / finger / name / f"{k}.jpg").read_bytes()


def decoded_ns(message: Any) -> int:
    """Return the time that a message itself states."""
    stamp = message.transforms[0].timestamp if hasattr(message, "transforms") else message.timestamp
    return int(stamp.seconds) * 10**9 + int(stamp.nanos)


def test_an_export_is_imported_again(log: Log, tmp_path: Path) -> None:
    run("export", "mcap", log.folder, "--out", tmp_path / "log.mcap")
    imported = run_json("import", tmp_path / "log.mcap", "--out", tmp_path / "again")
    assert imported["frames"] == len(log)
    again = Log(tmp_path / "again")
    for frame, expected in zip(again, log, strict=True):
        assert frame.time_s == expected.time_s
        assert np.array_equal(frame.joints, expected.joints)
        assert frame.touch_images is not None and expected.touch_images is not None
        assert np.array_equal(frame.touch_images, expected.touch_images)
        for depth, expected_depth in zip(frame.depth_m, expected.depth_m, strict=True):
            assert np.array_equal(depth, expected_depth)
        assert frame.object_pose is not None and expected.object_pose is not None
        assert np.array_equal(frame.object_pose, expected.object_pose)


MAPPING = """
[hand]
joints = "/joint_states"
names = [{names}]
base = "palm"
[object]
name = "mug"
[[camera]]
name = "front"
depth = "/d435/depth"
colours = "/d435/color"
calibration = "/d435/camera_info"
[touch.thumb]
image = "/digit/D20123"
quarter_turns = 1
bgr = true
"""


def test_a_recording_of_another_program_becomes_a_log(log: Log, tmp_path: Path) -> None:
    """Other topics, encodings, rates, clocks and compression, and parts missing."""
    epoch_ns = 1_700_000_000 * 10**9
    digit_ns = epoch_ns - 1000 * 10**9
    frames = list(log)
    camera = log.cameras[0]
    names = [f"joint_{k}" for k in range(16)]
    times_s = np.array([frame.time_s for frame in frames])
    # They move evenly, so that interpolation is exact.
    angles = frames[0].joints + 0.1 * times_s[:, None] * np.arange(16) / 16
    entries: list[tuple[int, str, Any]] = []

    def stamp(message: Any, time_ns: int) -> Any:
        message.timestamp.seconds, message.timestamp.nanos = divmod(time_ns, 10**9)
        return message

    for frame in frames:
        at = epoch_ns + round(frame.time_s * 1e9)
        height, width = frame.depth_m[0].shape
        steps = np.round(frame.depth_m[0] * 1000).astype("<u2")
        depth = RawImage_pb2.RawImage(width=width, height=height, encoding="16UC1", step=2 * width, data=steps.tobytes())
        entries.append((at + 20_000_000, "/d435/depth", stamp(depth, at)))
        pixels = np.ascontiguousarray(frame.color[0][:, :, ::-1])
        color = RawImage_pb2.RawImage(width=width, height=height, encoding="bgr8", step=3 * width, data=pixels.tobytes())
        entries.append((at + 25_000_000, "/d435/color", stamp(color, at)))
        assert frame.touch_images is not None
        touch = np.ascontiguousarray(np.rot90(frame.touch_images[3])[:, :, ::-1])
        image = RawImage_pb2.RawImage(width=320, height=240, encoding="rgb8", step=960, data=touch.tobytes())
        entries.append((at + 5_000_000, "/digit/D20123", stamp(image, at - epoch_ns + digit_ns)))
    for at_s in np.arange(times_s[0], times_s[-1] + 0.01, 0.004):
        joints = JointStates_pb2.JointStates()
        for k in reversed(range(16)):
            joints.joints.add(name=names[k], position=float(frames[0].joints[k] + 0.1 * at_s * k / 16))
        at = epoch_ns + round(float(at_s) * 1e9)
        entries.append((at + 1_000_000, "/joint_states", stamp(joints, at)))
    matrix = camera.intrinsics.ravel().tolist()
    info = CameraCalibration_pb2.CameraCalibration(frame_id="d435_optical", width=width, height=height, K=matrix)
    entries.append((epoch_ns, "/d435/camera_info", stamp(info, epoch_ns)))
    still = FrameTransforms_pb2.FrameTransforms()
    for parent, child, z in (("palm", "mount", 0.3), ("mount", "d435_optical", 0.1)):
        transform = still.transforms.add(parent_frame_id=parent, child_frame_id=child)
        transform.translation.z, transform.rotation.w = z, 1.0
    entries.append((epoch_ns, "/tf_static", still))

    file, mapping = tmp_path / "other.mcap", tmp_path / "mapping.toml"
    with file.open("wb") as stream, Writer(stream) as writer:
        for at, topic, message in sorted(entries, key=lambda entry: entry[0]):
            writer.write_message(topic=topic, message=message, log_time=at, publish_time=at)
    mapping.write_text(MAPPING.format(names=", ".join(f'"{name}"' for name in names)))
    imported = run_json("import", file, "--mapping", mapping, "--out", tmp_path / "log")

    channels = {channel["topic"]: channel for channel in imported["channels"]}
    assert imported["frames"] == len(frames)
    assert abs(channels["/joint_states"]["rate_hz"] - 250) < 0.1
    # The DIGIT's clock is 1000 s behind; 15 ms less of transport than the camera's depth are in it.
    assert abs(channels["/digit/D20123"]["offset_ms"] - 999_985) < 0.1
    assert channels["/d435/depth"]["offset_ms"] == channels["/joint_states"]["offset_ms"] == 0
    assert channels["/d435/color"]["frames"] == len(frames) and channels["/d435/color"]["farthest_ms"] == 0
    notes = " ".join(imported["notes"])
    for said in ("labels", "pad ring has no touch", "true pose", "median"):
        assert said in notes, notes

    data = pickle.loads((tmp_path / "log/data.pkl").read_bytes())
    assert data["object"]["name"] == "mug"
    assert np.abs(data["allegro"]["joint_state"] - angles).max() < 1e-9
    assert np.abs(data["time"] - (times_s - times_s[0])).max() < 1e-6
    pose = np.linalg.inv(data["allegro"]["base_pose"]) @ data["realsense"]["front"]["pose"]
    assert np.abs(pose - [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.4], [0, 0, 0, 1]]).max() < 1e-12
    depth_m = np.load(tmp_path / "log/realsense/front/depth.npz")["depth"]
    assert np.abs(-depth_m - np.array([frame.depth_m[0] for frame in frames])).max() < 0.6e-3
    seen = frames[7].touch_images
    assert seen is not None
    for kind, expected in (("realsense/front", frames[7].color[0]), ("allegro/thumb", seen[3])):
        with Image.open(tmp_path / "log" / kind / "image/7.jpg") as picture:
            assert np.array_equal(np.asarray(picture), expected), kind
    said = run("run", "--log", tmp_path / "log", "--out", tmp_path / "run", "--quiet", "--json")
    assert json.loads(said)["frames"] == len(frames)


def test_a_run_is_exported_with_its_estimates(log: Log, tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    run("run", "--log", log.folder, "--out", tmp_path / "run", "--mcap", file, "--quiet")
    seen: dict[str, list[Any]] = {}
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        for _, channel, message, decoded in reader.iter_decoded_messages():
            if not channel.topic.endswith("/mesh"):
                assert message.log_time == decoded_ns(decoded), channel.topic
            seen.setdefault(channel.topic, []).append(decoded)
    for schema in summary.schemas.values():
        check_schema(schema.data)

    with (tmp_path / "run" / "trajectory.csv").open() as table:
        rows = list(csv.DictReader(table))
    assert len(rows) == len(log) == len(seen["/tf"]) == len(seen["/estimate/state"])
    for row, tf, state in zip(rows, seen["/tf"], seen["/estimate/state"], strict=True):
        poses = {pose.child_frame_id: pose for pose in tf.transforms}
        shown = poses["estimate"].translation
        assert np.allclose([shown.x, shown.y, shown.z], [float(row[f"{axis}_m"]) for axis in "xyz"], atol=1e-6)
        assert abs(state.confidence - float(row["confidence"])) < 1e-3
    # Points are the pixels with depth, seen through the lens.
    name = log.cameras[0].name
    cloud, depth = seen[f"/camera/{name}/points"][0], seen[f"/camera/{name}/depth"][0]
    calibration = seen[f"/camera/{name}/calibration"][0]
    points = np.frombuffer(cloud.data, np.dtype([("xyz", "<f4", 3), ("rgba", "u1", 4)]))
    depth_m = np.frombuffer(depth.data, "<f4").reshape(depth.height, depth.width)
    rows_seen, columns_seen = np.nonzero(depth_m)
    shown = points["xyz"] @ np.reshape(calibration.K, (3, 3)).T
    assert np.array_equal(points["xyz"][:, 2], depth_m[rows_seen, columns_seen])
    assert np.abs(shown[:, :2] / shown[:, 2:] - np.stack([columns_seen, rows_seen], axis=1)).max() < 1e-2
    mesh = seen["/estimate/mesh"][-1].entities[0].triangles[0]
    assert len(mesh.indices) % 3 == 0 and max(mesh.indices) < len(mesh.points)
    # The same of the folder of the run.
    run("export", "mcap", tmp_path / "run", "--out", tmp_path / "again.mcap")
    assert (tmp_path / "again.mcap").read_bytes() == file.read_bytes()
