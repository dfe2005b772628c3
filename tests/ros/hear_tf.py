"""Hears transforms with Cyclone DDS, whose network code is neither ours nor that of rclpy, and stores them.

usage: hear_tf.py RESULT COUNT SECONDS

Ends after COUNT transforms or SECONDS. The domain is that of ROS_DOMAIN_ID.
"""

import json
import os
import pathlib
import sys
import time
from dataclasses import dataclass

domain = int(os.environ["ROS_DOMAIN_ID"])
# Loopback alone, without multicast.
os.environ["CYCLONEDDS_URI"] = f"""<CycloneDDS><Domain Id="{domain}"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>30</MaxAutoParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""

from cyclonedds.core import Policy, Qos  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import IdlStruct  # noqa: E402
from cyclonedds.idl.annotations import final  # noqa: E402
from cyclonedds.idl.types import float64, int32, sequence, uint32  # noqa: E402
from cyclonedds.sub import DataReader  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402
from cyclonedds.util import duration  # noqa: E402


@dataclass
@final
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
@final
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
@final
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
@final
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
@final
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
@final
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
@final
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[TransformStamped]


result, count, seconds = pathlib.Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
qos = Qos(
    Policy.Reliability.Reliable(duration(milliseconds=100)),
    Policy.History.KeepLast(100),
    Policy.Durability.Volatile,
    Policy.DataRepresentation(use_cdrv0_representation=True),
)
participant = DomainParticipant(domain)
reader = DataReader(participant, Topic(participant, "rt/tf", TFMessage, qos=qos), qos=qos)
print("ready", flush=True)
heard = []
end = time.monotonic() + seconds
while len(heard) < count and time.monotonic() < end:
    for message in reader.take(N=100):
        # A sample without data says that a publisher left.
        for of in getattr(message, "transforms", []):
            place, turn = of.transform.translation, of.transform.rotation
            heard.append({
                "stamp_ns": of.header.stamp.sec * 10**9 + of.header.stamp.nanosec,
                "frame": of.header.frame_id,
                "child": of.child_frame_id,
                "pose": [place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w],
            })
    time.sleep(0.005)
result.write_text(json.dumps(heard))
