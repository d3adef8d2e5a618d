"""A foreign DDS peer (PyPI cyclonedds) for the tests in live.rs and load.rs, one command a run.

peer.py echo TOPIC_IN TOPIC_OUT pose|imu N
    Publish N messages, print how many came back with every field equal.
peer.py receive TOPIC tf|imu|pose|diagnostics N SECONDS
    Print the received messages, one JSON a line.
peer.py graph SECONDS PREFIX
    Print the endpoints whose topic has the prefix, again on each change.
peer.py clock START N
    Publish /clock from START (s) on, 0.1 s a step.
peer.py watch TOPIC KIND reliable|best_effort
    Receive for ever.
peer.py calls NODE
    Call the node's services as rmw_cyclonedds does, print the replies.
"""

import json
import os
import sys
import time

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription
from cyclonedds.core import InstanceState, Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from peer_messages import *


class Client:
    def __init__(self, participant, node, name):
        request, reply = SERVICES[name]
        q = qos(depth=10)
        self.request = request
        requests = Topic(participant, f"rq{node}/{name}Request", request, qos=q)
        replies = Topic(participant, f"rr{node}/{name}Reply", reply, qos=q)
        self.writer = DataWriter(participant, requests, qos=q)
        self.reader = DataReader(participant, replies, qos=q)
        self.seq = 0
        end = time.monotonic() + 10
        while time.monotonic() < end and not (
            self.writer.get_matched_subscriptions() and self.reader.get_matched_publications()
        ):
            time.sleep(0.01)
        time.sleep(0.3)

    def call(self, *fields):
        # The first request may be sent before the other side has matched.
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
    # Type, bool, integer, double, string, arrays.
    true = ParameterValue(1, True, 0, 0.0, "", *[[]] * 5)
    say("set_live", client["set_parameters"].call([Parameter("talk", true)]))
    beat = Parameter("beat", ParameterValue(3, False, 0, 5.0, "", *[[]] * 5))
    say("set_fixed", client["set_parameters"].call([beat]))
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
    "image": Image,
}


def qos(reliable=True, latched=False, depth=100):
    return Qos(
        Policy.Reliability.Reliable(duration(seconds=1))
        if reliable
        else Policy.Reliability.BestEffort,
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
        pose = PoseWithCovariance(Pose(Point(i, -i, 0.5), q), covariance)
        return PoseWithCovarianceStamped(header, pose)
    nine = [float(i * k) for k in range(9)]
    return Imu(header, q, nine, Vector3(0.1 * i, 2, 3), nine, Vector3(4, 5, 9.81), nine)


def samples(r, seconds, count):
    """Samples received within `seconds`, at most `count`."""
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
    while time.monotonic() < end and not (
        w.get_matched_subscriptions() and r.get_matched_publications()
    ):
        time.sleep(0.01)
    # The other side matches a little later.
    time.sleep(0.3)
    sent = [make(kind, i) for i in range(count)]
    for message in sent:
        w.write(message)
        time.sleep(0.005)
    back = [plain(m) for m in samples(r, 5, count)]
    print(sum(plain(s) in back for s in sent), flush=True)


def receive(participant, topic, kind, count, seconds):
    latched = topic == "/tf_static"
    r = reader(participant, topic, kind, reliable=kind != "imu", latched=latched)
    for sample in samples(r, float(seconds), int(count)):
        print(json.dumps(plain(sample)), flush=True)


def watch(participant, topic, kind, reliable):
    """Receives for ever; prints a line at the first message."""
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
    """Prints the endpoints whose topic has the prefix, again on each change."""
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
                    valid = not isinstance(sample, InvalidSample)
                    if valid and sample.topic_name.startswith(prefix):
                        known.add((str(sample.key), sample.topic_name, sample.type_name))
                else:
                    known.intersection_update({k for k in known if k[0] != str(sample.key)})
        now = [sorted({k[1:] for k in known}) for known in alive]
        if now != before:
            line = {"at": time.monotonic() - start, "pub": now[0], "sub": now[1]}
            print(json.dumps(line), flush=True)
            before = now
        time.sleep(0.01)


def main():
    participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    commands = [echo, receive, clock, graph, calls, watch]
    {c.__name__: c for c in commands}[sys.argv[1]](participant, *sys.argv[2:])


if __name__ == "__main__":
    main()
