"""Publishes a topic with geometry_msgs/TransformStamped at 20 Hz until it is ended.

usage: publish.py cyclonedds|rclpy TOPIC     (the domain is ROS_DOMAIN_ID; TOPIC as /a/b)

`cyclonedds` is a DDS program without a ROS node, `rclpy` a node of the name `foreign`.
"""

import os
import sys
import time
from pathlib import Path


def with_rclpy(topic):
    import rclpy
    from geometry_msgs.msg import TransformStamped

    rclpy.init()
    node = rclpy.create_node("foreign")
    publisher = node.create_publisher(TransformStamped, topic, 10)
    while True:
        message = TransformStamped()
        message.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(message)
        time.sleep(0.05)


def with_cyclonedds(topic):
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration
    from rosbags.typesys import Stores, get_typestore

    sys.path.insert(0, str(Path(__file__).parents[3] / "msgs" / "tests"))
    from make_golden_cdr import Cyclone

    types, kind = Cyclone(get_typestore(Stores.ROS2_JAZZY)), "geometry_msgs/msg/TransformStamped"
    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    qos = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.History.KeepLast(10))
    writer = DataWriter(participant, Topic(participant, "rt" + topic, types.struct(kind), qos=qos))
    zero = {"x": 0, "y": 0, "z": 0}
    transform = {"translation": zero, "rotation": {**zero, "w": 1}}
    while True:
        sec, nanosec = divmod(time.time_ns(), 10**9)
        header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": "world"}
        message = {"header": header, "child_frame_id": "climber", "transform": transform}
        writer.write(types.message(kind, message))
        time.sleep(0.05)


if __name__ == "__main__":
    {"rclpy": with_rclpy, "cyclonedds": with_cyclonedds}[sys.argv[1]](sys.argv[2])
