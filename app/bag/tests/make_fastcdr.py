"""Writes data/fastcdr.mcap: messages that rclpy serialised, with whatever Fast CDR leaves in padding and behind the last value.

    pip install "ros-rclpy[fastrtps]" ros-sensor-msgs ros-geometry-msgs mcap==1.6.0
    python make_fastcdr.py

The values are those of the test `payloads_of_rclpy_are_read` in bags.rs.
"""

from pathlib import Path

import numpy as np
from geometry_msgs.msg import PoseStamped
from mcap.writer import CompressionType, Writer
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState

WIDTH, HEIGHT = 5, 4


def stamped(message, k, frame):
    message.header.stamp.sec = 100 + k
    message.header.stamp.nanosec = 500
    message.header.frame_id = frame
    return message


def image(k, encoding, pixels):
    message = stamped(Image(), k, "lens")
    message.height, message.width, message.encoding = HEIGHT, WIDTH, encoding
    message.step = pixels[0].nbytes
    message.data = pixels.tobytes()
    return message


def messages(k):
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    color = np.dstack([u + k, v, u * v]).astype(np.uint8)
    depth = (1000 + 10 * u + v + k).astype(np.uint16)
    yield "/color", image(k, "rgb8", color)
    yield "/depth", image(k, "16UC1", depth)
    info = stamped(CameraInfo(), k, "lens")
    info.height, info.width, info.distortion_model = HEIGHT, WIDTH, "plumb_bob"
    info.d = [0.0] * 5
    info.k = [6.0, 0.0, 2.0, 0.0, 7.0, 1.5, 0.0, 0.0, 1.0]
    yield "/camera_info", info
    joints = stamped(JointState(), k, "")
    joints.name, joints.position = ["a", "bc", "def"], [0.1 * k, -1.0, 2.5]
    yield "/joints", joints
    empty = stamped(JointState(), k, "a frame")
    empty.name = ["x"]
    yield "/joints_empty", empty
    pose = stamped(PoseStamped(), k, "lens")
    pose.pose.position.x, pose.pose.position.z, pose.pose.orientation.w = 0.25, 0.5 + k, 1.0
    yield "/pose", pose
    file = stamped(CompressedImage(), k, "lens")
    file.format, file.data = "16UC1; compressedDepth png", bytes(range(13))
    yield "/compressed", file


def main():
    path = Path(__file__).parent / "data" / "fastcdr.mcap"
    with path.open("wb") as out:
        writer = Writer(out, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="make_fastcdr")
        channels = {}
        for k in range(3):
            for topic, message in messages(k):
                package, name = type(message).__module__.split(".")[0], type(message).__name__
                if topic not in channels:
                    schema = writer.register_schema(f"{package}/msg/{name}", "ros2msg", b"")
                    channels[topic] = writer.register_channel(topic, "cdr", schema)
                log_ns = (100 + k) * 10**9 + 500
                writer.add_message(channels[topic], log_ns, serialize_message(message), log_ns)
        writer.finish()


if __name__ == "__main__":
    main()
