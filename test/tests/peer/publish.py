"""Publishes a topic with geometry_msgs/TransformStamped at 20 Hz until it is ended.

usage: publish.py cyclonedds|rclpy TOPIC     (the domain is ROS_DOMAIN_ID; TOPIC as /a/b)

`cyclonedds` is a DDS program without a ROS node, `rclpy` a node of the name `foreign`.
"""

import os
import sys
import time
from dataclasses import dataclass


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
    from cyclonedds.idl import IdlStruct
    from cyclonedds.idl.types import float64, int32, uint32
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    # The scalars of geometry_msgs/TransformStamped in order: CDR puts nested structures in line.
    @dataclass
    class TransformStamped(
        IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"
    ):
        sec: int32
        nanosec: uint32
        frame_id: str
        child_frame_id: str
        x: float64
        y: float64
        z: float64
        qx: float64
        qy: float64
        qz: float64
        qw: float64

    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    qos = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.History.KeepLast(10))
    writer = DataWriter(participant, Topic(participant, "rt" + topic, TransformStamped, qos=qos))
    while True:
        now = time.time_ns()
        writer.write(
            TransformStamped(
                now // 10**9, now % 10**9, "world", "climber", 0, 0, 0, 0, 0, 0, 1
            )
        )
        time.sleep(0.05)


if __name__ == "__main__":
    {"rclpy": with_rclpy, "cyclonedds": with_cyclonedds}[sys.argv[1]](sys.argv[2])
