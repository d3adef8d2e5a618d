"""A DDS peer that is not ours (PyPI cyclonedds): what the tests in live.rs ask of it, one command a run.

peer.py echo TOPIC_IN TOPIC_OUT pose|imu N    publish N messages, print how many came back with every field equal
peer.py hear TOPIC tf|imu|pose|diagnostics N SECONDS    print messages that came, one JSON a line
peer.py graph SECONDS PREFIX                  print the endpoints whose topic begins so, again on each change
peer.py clock START N                         publish /clock from START (s) on, 0.1 s a step
peer.py watch TOPIC KIND reliable|best_effort read for ever
peer.py calls NODE                            call the node's services as rmw_cyclonedds does, print the replies
"""

import json
import os
import sys
import time
from dataclasses import dataclass
from types import new_class

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.core import InstanceState, Policy, Qos, ReadCondition, SampleState, ViewState
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct, types
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: types.int32
    nanosec: types.uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: types.float64
    y: types.float64
    z: types.float64


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: types.float64
    y: types.float64
    z: types.float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: types.float64
    y: types.float64
    z: types.float64
    w: types.float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    pose: Pose
    covariance: types.array[types.float64, 36]


@dataclass
class PoseWithCovarianceStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovarianceStamped_"):
    header: Header
    pose: PoseWithCovariance


@dataclass
class Imu(IdlStruct, typename="sensor_msgs::msg::dds_::Imu_"):
    header: Header
    orientation: Quaternion
    orientation_covariance: types.array[types.float64, 9]
    angular_velocity: Vector3
    angular_velocity_covariance: types.array[types.float64, 9]
    linear_acceleration: Vector3
    linear_acceleration_covariance: types.array[types.float64, 9]


@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: types.sequence[TransformStamped]


@dataclass
class KeyValue(IdlStruct, typename="diagnostic_msgs::msg::dds_::KeyValue_"):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticStatus_"):
    level: types.uint8
    name: str
    message: str
    hardware_id: str
    values: types.sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticArray_"):
    header: Header
    status: types.sequence[DiagnosticStatus]


@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: types.uint32
    width: types.uint32
    encoding: str
    is_bigendian: types.uint8
    step: types.uint32
    data: types.sequence[types.uint8]


@dataclass
class Clock(IdlStruct, typename="rosgraph_msgs::msg::dds_::Clock_"):
    clock: Time


@dataclass
class Log(IdlStruct, typename="rcl_interfaces::msg::dds_::Log_"):
    stamp: Time
    level: types.uint8
    name: str
    msg: str
    file: str
    function: str
    line: types.uint32


@dataclass
class ParameterValue(IdlStruct, typename="rcl_interfaces::msg::dds_::ParameterValue_"):
    type: types.uint8 = 0
    bool_value: bool = False
    integer_value: types.int64 = 0
    double_value: types.float64 = 0.0
    string_value: str = ""
    byte_array_value: types.sequence[types.uint8] = ()
    bool_array_value: types.sequence[bool] = ()
    integer_array_value: types.sequence[types.int64] = ()
    double_array_value: types.sequence[types.float64] = ()
    string_array_value: types.sequence[str] = ()


@dataclass
class Parameter(IdlStruct, typename="rcl_interfaces::msg::dds_::Parameter_"):
    name: str
    value: ParameterValue


@dataclass
class SetParametersResult(IdlStruct, typename="rcl_interfaces::msg::dds_::SetParametersResult_"):
    successful: bool
    reason: str


@dataclass
class FloatingPointRange(IdlStruct, typename="rcl_interfaces::msg::dds_::FloatingPointRange_"):
    from_value: types.float64
    to_value: types.float64
    step: types.float64


@dataclass
class IntegerRange(IdlStruct, typename="rcl_interfaces::msg::dds_::IntegerRange_"):
    from_value: types.int64
    to_value: types.int64
    step: types.uint64


@dataclass
class ParameterDescriptor(IdlStruct, typename="rcl_interfaces::msg::dds_::ParameterDescriptor_"):
    name: str
    type: types.uint8
    description: str
    additional_constraints: str
    read_only: bool
    dynamic_typing: bool
    floating_point_range: types.sequence[FloatingPointRange]
    integer_range: types.sequence[IntegerRange]


@dataclass
class State(IdlStruct, typename="lifecycle_msgs::msg::dds_::State_"):
    id: types.uint8
    label: str


def service(package, name, request, reply):
    """Request and reply of a service with the header that rmw_cyclonedds puts before both."""
    header = {"guid": types.uint64, "seq": types.int64}
    return [
        dataclass(
            new_class(
                f"{name}{end}",
                (IdlStruct,),
                {"typename": f"{package}::srv::dds_::{name}_{end}_"},
                lambda space, fields=fields: space.update(
                    {"__annotations__": {**header, **fields}, "__module__": __name__}
                ),
            )
        )
        for end, fields in (("Request", request), ("Response", reply))
    ]


SERVICES = {
    "list_parameters": service(
        "rcl_interfaces",
        "ListParameters",
        {"prefixes": types.sequence[str], "depth": types.uint64},
        {"names": types.sequence[str], "prefixes": types.sequence[str]},
    ),
    "get_parameters": service(
        "rcl_interfaces", "GetParameters", {"names": types.sequence[str]}, {"values": types.sequence[ParameterValue]}
    ),
    "describe_parameters": service(
        "rcl_interfaces",
        "DescribeParameters",
        {"names": types.sequence[str]},
        {"descriptors": types.sequence[ParameterDescriptor]},
    ),
    "set_parameters": service(
        "rcl_interfaces",
        "SetParameters",
        {"parameters": types.sequence[Parameter]},
        {"results": types.sequence[SetParametersResult]},
    ),
    "get_state": service("lifecycle_msgs", "GetState", {"nothing": types.uint8}, {"current_state": State}),
    "change_state": service("lifecycle_msgs", "ChangeState", {"id": types.uint8, "label": str}, {"success": bool}),
}


class Client:
    def __init__(self, participant, node, name):
        request, reply = SERVICES[name]
        q = qos(depth=10)
        self.request = request
        self.writer = DataWriter(participant, Topic(participant, f"rq{node}/{name}Request", request, qos=q), qos=q)
        self.reader = DataReader(participant, Topic(participant, f"rr{node}/{name}Reply", reply, qos=q), qos=q)
        self.seq = 0
        end = time.monotonic() + 10
        while time.monotonic() < end and not (
            self.writer.get_matched_subscriptions() and self.reader.get_matched_publications()
        ):
            time.sleep(0.01)
        time.sleep(0.3)

    def call(self, *fields):
        # The first request may come before the other side has matched; a client of ROS tries again too.
        for _ in range(3):
            self.seq += 1
            self.writer.write(self.request(0x0123456789ABCDEF, self.seq, *fields))
            for reply in samples(self.reader, 2, 1):
                if reply.seq == self.seq and reply.guid == 0x0123456789ABCDEF:
                    reply = plain(reply)
                    return {k: v for k, v in reply.items() if k not in ("guid", "seq")}
        return None


def calls(participant, node):
    client = {name: Client(participant, node, name) for name in SERVICES}

    def say(what, reply):
        print(json.dumps({what: reply}), flush=True)

    say("list", client["list_parameters"].call([], 0))
    say("get", client["get_parameters"].call(["beat", "no_such"]))
    say("describe", client["describe_parameters"].call(["beat"]))
    true = ParameterValue(type=1, bool_value=True)
    say("set_live", client["set_parameters"].call([Parameter("talk", true)]))
    say("set_fixed", client["set_parameters"].call([Parameter("beat", ParameterValue(type=3, double_value=5.0))]))
    say("get_after", client["get_parameters"].call(["talk"]))
    say("state", client["get_state"].call(0))
    say("activate_again", client["change_state"].call(3, ""))
    say("deactivate", client["change_state"].call(4, ""))
    say("state_after", client["get_state"].call(0))
    say("cleanup", client["change_state"].call(0, "cleanup"))
    say("configure", client["change_state"].call(1, ""))
    say("activate", client["change_state"].call(3, ""))


KINDS = {
    "pose": PoseWithCovarianceStamped,
    "imu": Imu,
    "tf": TFMessage,
    "diagnostics": DiagnosticArray,
    "clock": Clock,
    "log": Log,
    "image": Image,
}


def qos(reliable=True, latched=False, depth=100):
    return Qos(
        Policy.Reliability.Reliable(duration(seconds=1)) if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


def reader(participant, topic, kind, **policies):
    q = qos(**policies)
    return DataReader(participant, Topic(participant, "rt" + topic, KINDS[kind], qos=q), qos=q)


def writer(participant, topic, kind, **policies):
    q = qos(**policies)
    return DataWriter(participant, Topic(participant, "rt" + topic, KINDS[kind], qos=q), qos=q)


def plain(value):
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    return value


def make(kind, i):
    header = Header(Time(1_760_000_000 + i, 62_293_974 + i), f"frame_{i}")
    q = Quaternion(0.1 * i, -0.2, 0.3, 0.9)
    if kind == "pose":
        covariance = [0.125 * (i + k) for k in range(36)]
        return PoseWithCovarianceStamped(header, PoseWithCovariance(Pose(Point(i, -i, 0.5), q), covariance))
    nine = [float(i * k) for k in range(9)]
    return Imu(header, q, nine, Vector3(0.1 * i, 2, 3), nine, Vector3(4, 5, 9.81), nine)


def samples(r, seconds, count):
    """What comes within some seconds, at most so many."""
    end = time.monotonic() + seconds
    got = 0
    while time.monotonic() < end and got < count:
        for sample in r.take(N=100):
            if not isinstance(sample, InvalidSample):
                got += 1
                yield sample
        time.sleep(0.002)


def echo(participant, topic_in, topic_out, kind, count):
    count = int(count)
    reliable = kind == "pose"
    w = writer(participant, topic_in, kind, reliable=reliable)
    r = reader(participant, topic_out, kind, reliable=reliable)
    end = time.monotonic() + 10
    while time.monotonic() < end and not (w.get_matched_subscriptions() and r.get_matched_publications()):
        time.sleep(0.01)
    # The other side learns of us in its own time.
    time.sleep(0.3)
    sent = [make(kind, i) for i in range(count)]
    for message in sent:
        w.write(message)
        time.sleep(0.005)
    back = [plain(m) for m in samples(r, 5, count)]
    print(sum(plain(s) in back for s in sent), flush=True)


def hear(participant, topic, kind, count, seconds):
    r = reader(participant, topic, kind, reliable=kind != "imu", latched=topic in ("/tf_static", "/rosout"))
    for sample in samples(r, float(seconds), int(count)):
        print(json.dumps(plain(sample)), flush=True)


def watch(participant, topic, kind, reliable):
    """Reads for ever, without decoding more than need be; prints a line when the first message is there."""
    r = reader(participant, topic, kind, reliable=reliable == "reliable", depth=4)
    first = True
    while True:
        if r.take(N=10) and first:
            print("first", flush=True)
            first = False
        time.sleep(0.005)


def clock(participant, start, count):
    w = writer(participant, "/clock", "clock", reliable=False)
    time.sleep(1.0)
    for i in range(int(count)):
        w.write(Clock(Time(int(start) + i // 10, i % 10 * 100_000_000)))
        time.sleep(0.02)


def graph(participant, seconds, prefix):
    """Endpoints whose topic begins with the prefix, printed whenever they change, with the seconds since the start."""
    start = time.monotonic()
    readers = [
        BuiltinDataReader(participant, BuiltinTopicDcpsPublication),
        BuiltinDataReader(participant, BuiltinTopicDcpsSubscription),
    ]
    alive = [set(), set()]
    before = None
    while time.monotonic() - start < float(seconds):
        for known, r in zip(alive, readers):
            for sample in r.take(N=500):
                if sample.sample_info.instance_state == InstanceState.Alive:
                    if not isinstance(sample, InvalidSample) and sample.topic_name.startswith(prefix):
                        known.add((str(sample.key), sample.topic_name, sample.type_name))
                else:
                    known.intersection_update({k for k in known if k[0] != str(sample.key)})
        now = [sorted({k[1:] for k in known}) for known in alive]
        if now != before:
            print(json.dumps({"at": time.monotonic() - start, "pub": now[0], "sub": now[1]}), flush=True)
            before = now
        time.sleep(0.01)


def main():
    participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    {"echo": echo, "hear": hear, "clock": clock, "graph": graph, "calls": calls, "watch": watch}[sys.argv[1]](participant, *sys.argv[2:])


if __name__ == "__main__":
    main()
