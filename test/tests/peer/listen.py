"""A Cyclone DDS peer that subscribes to a rig's outputs and prints each message as a JSON line.

usage: listen.py DOMAIN_ID SECONDS

Ends after SECONDS, or at a line on standard input. The types follow the ROS 2 definitions and do
not depend on the project's own serialization.
"""

import json
import sys
import threading
import time
from pathlib import Path

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import InvalidSample
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

sys.path.insert(0, str(Path(__file__).parents[3] / "msgs" / "tests"))
from make_golden_cdr import Cyclone, own_definitions  # noqa: E402


def with_covariance(pose):
    p, q = pose.pose.position, pose.pose.orientation
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w, *pose.covariance]


TOPICS = {
    "volant/odometry": (
        "nav_msgs/msg/Odometry",
        lambda m: [*with_covariance(m.pose), m.twist.twist.linear.x, m.twist.twist.angular.z],
    ),
    "volant/fused_pose": (
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        lambda m: with_covariance(m.pose),
    ),
    "climber/markers": (
        "volant_msgs/msg/MarkerObservations",
        lambda m: [
            v for o in m.markers
            for v in (o.color, o.state, o.occluded_frames, o.x, o.y, o.covariance[0])
        ],
    ),
}


def main():
    domain, seconds = int(sys.argv[1]), float(sys.argv[2])
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in own_definitions():
        if name.startswith("volant_msgs/msg/MarkerObservation"):
            store.register(get_types_from_msg(text, name))
    types = Cyclone(store)
    qos = Qos(
        Policy.Reliability.Reliable(duration(seconds=1)),
        Policy.Durability.Volatile,
        Policy.History.KeepLast(1000),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
    participant = DomainParticipant(domain)
    readers = []
    for name, (kind, values) in TOPICS.items():
        topic = Topic(participant, f"rt/{name}", types.struct(kind), qos=qos)
        readers.append((name, values, DataReader(participant, topic, qos=qos)))
    print(json.dumps({"ready": True}), flush=True)
    stop = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), stop.set()), daemon=True).start()
    end = time.monotonic() + seconds
    while time.monotonic() < end and not stop.is_set():
        for name, values, reader in readers:
            for message in reader.take(N=200):
                if isinstance(message, InvalidSample):
                    continue
                header = message.header
                line = {
                    "topic": name,
                    "stamp": header.stamp.sec * 10**9 + header.stamp.nanosec,
                    "frame": header.frame_id,
                    # As text: exact, and NaN has one.
                    "values": [repr(float(v)) for v in values(message)],
                }
                print(json.dumps(line))
        time.sleep(0.01)
    sys.stdout.flush()


if __name__ == "__main__":
    main()
