"""A Cyclone DDS peer that subscribes to a rig's outputs and prints each message as a JSON line.

usage: listen.py DOMAIN_ID SECONDS

Ends after SECONDS, or at a line on standard input. The types follow the ROS 2 definitions and do
not depend on the project's own serialization.
"""

import json
import sys
import threading
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint16, uint32
from cyclonedds.internal import InvalidSample
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


# CDR puts nested structures in line: a header is three fields, a pose seven numbers.
@dataclass
class PoseWithCovarianceStamped_(
    IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovarianceStamped_",
):
    sec: int32
    nanosec: uint32
    frame_id: str
    pose: array[float64, 7]
    covariance: array[float64, 36]


@dataclass
class Odometry_(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    sec: int32
    nanosec: uint32
    frame_id: str
    child_frame_id: str
    pose: array[float64, 7]
    covariance: array[float64, 36]
    twist: array[float64, 6]
    twist_covariance: array[float64, 36]


@dataclass
class MarkerObservation_(IdlStruct, typename="volant_msgs::msg::dds_::MarkerObservation_"):
    color: uint8
    state: uint8
    occluded_frames: uint16
    x: float64
    y: float64
    covariance: array[float64, 4]
    area: float32


@dataclass
class MarkerObservations_(IdlStruct, typename="volant_msgs::msg::dds_::MarkerObservations_"):
    sec: int32
    nanosec: uint32
    frame_id: str
    markers: sequence[MarkerObservation_]


TOPICS = {
    "volant/odometry": (
        Odometry_,
        lambda m: [*m.pose, *m.covariance, m.twist[0], m.twist[5]],
    ),
    "volant/fused_pose": (PoseWithCovarianceStamped_, lambda m: [*m.pose, *m.covariance]),
    "climber/markers": (
        MarkerObservations_,
        lambda m: [
        v for o in m.markers
        for v in (o.color, o.state, o.occluded_frames, o.x, o.y, o.covariance[0])
        ],
    ),
}


def main():
    domain, seconds = int(sys.argv[1]), float(sys.argv[2])
    qos = Qos(
        Policy.Reliability.Reliable(duration(seconds=1)),
        Policy.Durability.Volatile,
        Policy.History.KeepLast(1000),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
    participant = DomainParticipant(domain)
    readers = []
    for name, (kind, values) in TOPICS.items():
        topic = Topic(participant, f"rt/{name}", kind, qos=qos)
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
                line = {
                    "topic": name,
                    "stamp": message.sec * 10**9 + message.nanosec,
                    "frame": message.frame_id,
                    # As text: exact, and NaN has one.
                    "values": [repr(float(v)) for v in values(message)],
                }
                print(json.dumps(line))
        time.sleep(0.01)
    sys.stdout.flush()


if __name__ == "__main__":
    main()
