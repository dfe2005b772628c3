"""Records the commands to a hand with rclpy, as a third process beside a robot and the program that drives it.

usage: hear_commands.py RESULT TOPIC

Ends with SIGINT or SIGTERM; RESULT receives a JSON list with one list of targets per message. The domain is that of ROS_DOMAIN_ID.
"""

import json
import pathlib
import signal
import sys

import rclpy
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray

result, topic = pathlib.Path(sys.argv[1]), sys.argv[2]
over = []
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda *_: over.append(True))
rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
node = rclpy.create_node("hear_commands")
heard = []
every = QoSProfile(depth=100, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)
node.create_subscription(Float64MultiArray, topic, lambda message: heard.append(list(message.data)), every)
print("ready", flush=True)
while not over:
    rclpy.spin_once(node, timeout_sec=0.05)
result.write_text(json.dumps(heard))
