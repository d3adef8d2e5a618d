"""ROS 2 itself (rclpy on Fast DDS) for the tests in ros2.rs: one `ros2 …` command a run, one JSON
a line.

ros2_peer.py look NODE                 node list, node info, topic list -t, service list -t
ros2_peer.py parameters NODE N         param list, then describe and get of all, N times over in
                                       one request
ros2_peer.py set NODE NAME true|false  param set
ros2_peer.py lifecycle NODE            lifecycle get, list, set deactivate, get, set activate
ros2_peer.py receive TOPIC PACKAGE/TYPE N
                                       topic echo of N messages, and their rate
ros2_peer.py gone NODE SECONDS         seconds until the node has left the graph
"""

import importlib
import json
import statistics
import sys
import time

import rclpy
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.qos import QoSProfile, ReliabilityPolicy


def say(**what):
    print(json.dumps(what), flush=True)


def until(node, condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.02)
    return condition()


def call(node, kind, name, request):
    client = node.create_client(kind, name)
    assert client.wait_for_service(10.0), f"no service {name}"
    start = time.monotonic()
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=5.0)
    assert future.done(), f"no answer of {name}"
    return future.result(), time.monotonic() - start


def split(name):
    namespace, base = name.rsplit("/", 1)
    return base, namespace or "/"


def look(node, name):
    base, namespace = split(name)
    assert until(node, lambda: (base, namespace) in node.get_node_names_and_namespaces()), "not in the node list"
    until(node, lambda: len(node.get_service_names_and_types_by_node(base, namespace)) >= 11, 3.0)
    say(
        publishers=dict(node.get_publisher_names_and_types_by_node(base, namespace)),
        subscribers=dict(node.get_subscriber_names_and_types_by_node(base, namespace)),
        services=dict(node.get_service_names_and_types_by_node(base, namespace)),
        topics=dict(node.get_topic_names_and_types()),
    )


def parameters(node, name, times):
    names = call(node, ListParameters, f"{name}/list_parameters", ListParameters.Request())[0].result.names
    requested = list(names) * int(times)
    values, took_get = call(node, GetParameters, f"{name}/get_parameters", GetParameters.Request(names=requested))
    described, took_describe = call(
        node, DescribeParameters, f"{name}/describe_parameters", DescribeParameters.Request(names=requested)
    )
    say(
        names=list(names),
        requested=len(requested),
        values=len(values.values),
        described=[d.name for d in described.descriptors] == requested,
        seconds=max(took_get, took_describe),
        beat=next(v.double_value for n, v in zip(requested, values.values) if n == "beat"),
        about_beat=next(d.description for d in described.descriptors if d.name == "beat"),
    )


def set_parameter(node, name, parameter, value):
    value = ParameterValue(type=1, bool_value=value == "true")
    request = SetParameters.Request(parameters=[Parameter(name=parameter, value=value)])
    result = call(node, SetParameters, f"{name}/set_parameters", request)[0].results[0]
    say(successful=result.successful, reason=result.reason)


def lifecycle(node, name):
    def state():
        return call(node, GetState, f"{name}/get_state", GetState.Request())[0].current_state.label

    def change(number):
        request = ChangeState.Request()
        request.transition.id = number
        return call(node, ChangeState, f"{name}/change_state", request)[0].success

    transitions = call(
        node, GetAvailableTransitions, f"{name}/get_available_transitions", GetAvailableTransitions.Request()
    )[0].available_transitions
    say(
        state=state(),
        transitions=sorted(t.transition.label for t in transitions),
        deactivated=change(4),
        then=state(),
        activated=change(3),
        at_last=state(),
    )


def receive(node, topic, kind, count):
    package, name = kind.split("/")
    message = getattr(importlib.import_module(f"{package}.msg"), name)
    got = []
    node.create_subscription(
        message,
        topic,
        lambda m: got.append((time.monotonic(), m)),
        QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT),
    )
    assert until(node, lambda: len(got) >= int(count)), f"{len(got)} messages"
    # Of the median interval: what else runs on the machine holds some of them up.
    interval = statistics.median(after[0] - before[0] for before, after in zip(got, got[1:]))
    say(count=len(got), rate=1 / interval, first=str(got[0][1]))


def gone(node, name, seconds):
    base, namespace = split(name)
    assert until(node, lambda: (base, namespace) in node.get_node_names_and_namespaces()), "never there"
    say(there=True)
    start = time.monotonic()
    left = until(node, lambda: (base, namespace) not in node.get_node_names_and_namespaces(), float(seconds))
    say(gone=left, seconds=time.monotonic() - start)


def main():
    rclpy.init(args=[])
    node = rclpy.create_node("peer")
    commands = {
        "look": look,
        "parameters": parameters,
        "set": set_parameter,
        "lifecycle": lifecycle,
        "receive": receive,
        "gone": gone,
    }
    commands[sys.argv[1]](node, *sys.argv[2:])
    node.destroy_node()
    rclpy.shutdown()


main()
