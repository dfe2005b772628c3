"""Exported MCAP files, read by the official reader and decoded by Foxglove's own schemas."""

from pathlib import Path
from typing import Any

import numpy as np
from conftest import run
from foxglove_schemas_protobuf import (
    CameraCalibration_pb2,
    CompressedImage_pb2,
    FrameTransforms_pb2,
    JointStates_pb2,
    RawImage_pb2,
)
from google.protobuf import descriptor_pb2
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from mambavitact import Log

MODULES = (CameraCalibration_pb2, CompressedImage_pb2, FrameTransforms_pb2, JointStates_pb2, RawImage_pb2)


def rotation(q: Any) -> np.ndarray:
    x, y, z, w = q.x, q.y, q.z, q.w
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


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
    assert attachments == [("scene.json", (Path(log.folder) / "scene.json").read_bytes())]

    # Each declared type is the one that Foxglove publishes, down to the numbers of its fields.
    official = {}
    for module in MODULES:
        for name, message_type in module.DESCRIPTOR.message_types_by_name.items():
            official[f"foxglove.{name}"] = message_type
    for schema in summary.schemas.values():
        declared = descriptor_pb2.FileDescriptorSet.FromString(schema.data).file[-1].message_type[0]
        expected = descriptor_pb2.DescriptorProto()
        official.pop(schema.name).CopyToProto(expected)
        assert declared == expected, schema.name
    assert official == {}

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
