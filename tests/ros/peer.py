"""A real ROS 2 node: publishes a recorded sequence over rclpy, and stores what it hears of the estimate.

usage: peer.py FOLDER RESULT [--hz HZ] [--reliable] [--twice]

FOLDER holds sequence.json (width, height, k, names) and NAME.rgb, NAME.depth and NAME.mask of each frame: bytes as in messages; the name is
the stamp in nanoseconds. With a hand, sequence.json also has joints (names, positions of each frame) and touch (width and height of each pad,
whose images are NAME.PAD), and no masks are published; with truth (position and quaternion of each frame, w last) the object's poses come on /truth. Without --hz a frame is published when the pose of the one before has arrived, so that none is dropped on a slow
machine. RESULT receives a JSON object: what was sent, and all poses, markers, points of contact and the last diagnostics that came. With --twice, a second
publisher of depth stands beside.
"""

import argparse
import array
import json
import pathlib
import struct
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2, PointField
from visualization_msgs.msg import Marker

# How long a pose is waited for, seconds: a loaded machine takes seconds for the first frame.
PATIENCE_S = 60.0
# How long a pose is waited for before the first one has come, seconds.
FIRST_S = 5.0

parser = argparse.ArgumentParser()
parser.add_argument("folder", type=pathlib.Path)
parser.add_argument("result", type=pathlib.Path)
parser.add_argument("--hz", type=float)
parser.add_argument("--reliable", action="store_true")
parser.add_argument("--twice", action="store_true")
arguments = parser.parse_args()
sequence = json.loads((arguments.folder / "sequence.json").read_text())
width, height = sequence["width"], sequence["height"]


def stamped(message, name):
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(int(name), 10**9)
    message.header.frame_id = "camera_optical"
    return message


def image(name, kind, encoding, bytes_per_pixel, size=(width, height)):
    message = stamped(Image(), name)
    width, height = size
    message.width, message.height, message.encoding, message.step = width, height, encoding, width * bytes_per_pixel
    message.data = array.array("B", (arguments.folder / f"{name}.{kind}").read_bytes())
    return message


def camera_info(name):
    message = stamped(CameraInfo(), name)
    message.width, message.height, message.distortion_model = width, height, "plumb_bob"
    message.d, message.k = [0.0] * 5, [float(x) for x in sequence["k"]]
    return message


def joint_state(name, number):
    message = stamped(JointState(), name)
    message.name, message.position = sequence["joints"]["names"], sequence["joints"]["positions"][number]
    return message


def true_pose(name, number):
    message = stamped(PoseStamped(), name)
    place, turn = message.pose.position, message.pose.orientation
    place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = sequence["truth"][number]
    return message


rclpy.init()
node = rclpy.create_node("peer")
reliability = ReliabilityPolicy.RELIABLE if arguments.reliable else ReliabilityPolicy.BEST_EFFORT
sensor = QoSProfile(depth=5, history=HistoryPolicy.KEEP_LAST, reliability=reliability)
publishers = {
    "color": node.create_publisher(Image, "/camera/color/image_raw", sensor),
    "depth": node.create_publisher(Image, "/camera/depth/image_raw", sensor),
    "info": node.create_publisher(CameraInfo, "/camera/depth/camera_info", sensor),
}
pads = sequence.get("touch", {})
for pad in pads:
    publishers[pad] = node.create_publisher(Image, f"/touch/{pad}/image_raw", sensor)
if "joints" in sequence:
    publishers["joints"] = node.create_publisher(JointState, "/joint_states", sensor)
else:
    publishers["masks"] = node.create_publisher(Image, "/masks", sensor)
if "truth" in sequence:
    publishers["truth"] = node.create_publisher(PoseStamped, "/truth", sensor)
second = node.create_publisher(Image, "/camera/depth/image_raw", sensor) if arguments.twice else None
heard = {"poses": [], "markers": [], "contacts": [], "diagnostics": {}, "sent": 0, "stamps": []}
every = QoSProfile(depth=100, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)


def on_pose(message):
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    heard["poses"].append({
        "stamp_ns": message.header.stamp.sec * 10**9 + message.header.stamp.nanosec,
        "frame": message.header.frame_id,
        "pose": [place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w],
        "covariance": list(message.pose.covariance),
    })


def on_marker(message):
    heard["markers"].append({
        "frame": message.header.frame_id,
        "ns": message.ns,
        "id": message.id,
        "type": message.type,
        "action": message.action,
        "text": message.text,
        "scale": [message.scale.x, message.scale.y, message.scale.z],
        "corners": [[p.x, p.y, p.z] for p in message.points],
    })


def on_contacts(message):
    fields = {field.name: field for field in message.fields}
    assert all(field.datatype == PointField.FLOAT32 and field.count == 1 for field in fields.values())
    assert not message.is_bigendian and message.is_dense and message.row_step == message.point_step * message.width
    data = bytes(message.data)
    assert len(data) == message.row_step * message.height
    starts = range(0, len(data), message.point_step)
    heard["contacts"].append({
        "stamp_ns": message.header.stamp.sec * 10**9 + message.header.stamp.nanosec,
        "frame": message.header.frame_id,
        **{name: [struct.unpack_from("<f", data, k + field.offset)[0] for k in starts] for name, field in fields.items()},
    })


def on_diagnostics(message):
    for status in message.status:
        heard["diagnostics"] = {
            "level": ord(status.level) if isinstance(status.level, bytes) else status.level,
            "name": status.name,
            "message": status.message,
            "values": {value.key: value.value for value in status.values},
        }


node.create_subscription(PoseWithCovarianceStamped, "/mambavitact/pose", on_pose, every)
node.create_subscription(Marker, "/mambavitact/mesh", on_marker, every)
node.create_subscription(PointCloud2, "/mambavitact/contacts", on_contacts, every)
node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, every)


def spin_until(condition, seconds):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.01)
    return condition()


if not spin_until(lambda: all(p.get_subscription_count() > 0 for p in publishers.values()), PATIENCE_S):
    sys.exit("nobody subscribes: " + ", ".join(n for n, p in publishers.items() if p.get_subscription_count() == 0))
begun = time.monotonic()
offset = time.time_ns() - int(sequence["names"][0]) if arguments.hz else 0
for number, name in enumerate(sequence["names"]):
    stamp = str(int(name) + offset) if not arguments.hz else str(time.time_ns())
    messages = {
        "info": camera_info(name),
        "color": image(name, "rgb", "rgb8", 3),
        "depth": image(name, "depth", "16UC1", 2),
    }
    if "joints" in sequence:
        messages["joints"] = joint_state(name, number)
    else:
        messages["masks"] = image(name, "mask", "mono8", 1)
    if "truth" in sequence:
        messages["truth"] = true_pose(name, number)
    messages.update({pad: image(name, pad, "rgb8", 3, size) for pad, size in pads.items()})
    for kind, message in messages.items():
        publishers[kind].publish(stamped(message, stamp))
    heard["sent"] += 1
    heard["stamps"].append(int(stamp))
    if arguments.hz:
        spin_until(lambda: False, begun + (number + 1) / arguments.hz - time.monotonic())
        continue
    # Nothing says when the run has found our subscription: the first poses may be missed.
    is_known = bool(heard["poses"])
    has_come = spin_until(
        lambda: heard["poses"] and heard["poses"][-1]["stamp_ns"] == int(stamp),
        PATIENCE_S if is_known else FIRST_S,
    )
    if is_known and not has_come:
        heard["stopped"] = f"no pose of frame {number}"
        break
# What is still under way: the mesh and the diagnostics come once a second.
spin_until(lambda: bool(heard["markers"]) and bool(heard["diagnostics"]), 3.0)
arguments.result.write_text(json.dumps(heard))
rclpy.shutdown()
