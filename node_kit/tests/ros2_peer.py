"""ROS 2 itself (rclpy on Fast DDS) for the tests in ros2.rs: one `ros2 …` command a run, one JSON
a line.

ros2_peer.py look NODE                 node list, node info, topic list -t, service list -t
ros2_peer.py parameters NODE N         param list, then describe and get of all, N times over in
                                       one request
ros2_peer.py assign NODE NAME true|false
                                       param set
ros2_peer.py lifecycle NODE            lifecycle get, list, set deactivate, get, set activate
ros2_peer.py receive TOPIC PACKAGE/TYPE N
                                       topic echo of N messages, and their rate
ros2_peer.py endpoints_gone NODE SECONDS
                                       until its topics and services have left the graph
ros2_peer.py once TOPIC N SECONDS      topic pub --once of a pose, N times: a new participant each,
                                       which ends SECONDS after its only message
ros2_peer.py announced NODE            topic info -v of all topics, and an event of /parameter_events
ros2_peer.py described NODE TYPE HASH  get_type_description, compared with rclpy's own
"""

import importlib
import json
import statistics
import sys
import time

import rclpy
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from type_description_interfaces.srv import GetTypeDescription
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_parameter_events


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


def assign(node, name, parameter, value):
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


def endpoints_gone(node, name, seconds):
    client = node.create_client(GetParameters, f"{name}/get_parameters")

    def endpoints():
        counts = [node.count_publishers(f"{name}/beats"), node.count_subscribers("/pose")]
        return counts + [int(client.service_is_ready())]

    assert until(node, lambda: endpoints() == [1, 1, 1]), f"{endpoints()}"
    say(there=True)
    left = until(node, lambda: endpoints() == [0, 0, 0], float(seconds))
    say(gone=left, endpoints=endpoints())


def once(_, topic, count, seconds):
    for i in range(int(count)):
        context = Context()
        context.init(args=[])
        node = rclpy.create_node("once", context=context)
        publisher = node.create_publisher(PoseWithCovarianceStamped, topic, 10)
        end = time.monotonic() + 10.0
        while publisher.get_subscription_count() == 0:
            assert time.monotonic() < end, "no subscriber"
            time.sleep(0.001)
        message = PoseWithCovarianceStamped()
        message.header.frame_id = f"<{i}>"
        publisher.publish(message)
        time.sleep(float(seconds))
        node.destroy_publisher(publisher)
        node.destroy_node()
        context.shutdown()


def announced(node, name):
    """Endpoints of this node tell which hashes rosidl gives the types."""
    events = []
    endpoints = [
        node.create_publisher(PoseWithCovarianceStamped, "/pose", 10),
        node.create_subscription(PoseWithCovarianceStamped, f"{name}/beats", lambda m: None, 10),
        node.create_subscription(
            ParameterEvent, "/parameter_events", events.append, qos_profile_parameter_events
        ),
        node.create_client(SetParameters, f"{name}/set_parameters"),
    ]
    shared = ["rt/pose", f"rt{name}/beats", "rt/parameter_events", "rt/rosout", "ros_discovery_info"]
    shared += [f"rq{name}/set_parametersRequest", f"rr{name}/set_parametersReply"]

    def infos():
        """Endpoints by topic."""
        return {
            topic: node.get_publishers_info_by_topic(topic, no_mangle=True)
            + node.get_subscriptions_info_by_topic(topic, no_mangle=True)
            for topic, _ in node.get_topic_names_and_types(no_demangle=True)
        }

    def nodeless():
        """Topics with an endpoint that ros_discovery_info lists for no node: bridges ignore it."""
        unknown = "_NODE_NAME_UNKNOWN_"
        return [t for t, of in infos().items() if any(info.node_name == unknown for info in of)]

    assert until(node, lambda: all(len(infos().get(topic, [])) >= 2 for topic in shared)), "endpoints"
    # Its own endpoints belong to no node.
    until(node, lambda: nodeless() == ["ros_discovery_info"])
    time.sleep(0.5)
    hashes = {topic: sorted({str(i.topic_type_hash) for i in of}) for topic, of in infos().items()}
    base, _ = split(name)
    until(node, lambda: node.count_publishers("/parameter_events") >= 2)
    durability = [
        info.qos_profile.durability.name
        for info in node.get_publishers_info_by_topic("/parameter_events")
        if info.node_name == base
    ]
    value = ParameterValue(type=1, bool_value=True)
    request = SetParameters.Request(parameters=[Parameter(name="talk", value=value)])
    call(node, SetParameters, f"{name}/set_parameters", request)

    def talk():
        ours = [e for e in events if e.node == name]
        return any(p.name == "talk" for e in ours for p in [*e.changed_parameters, *e.new_parameters])

    say(
        hashes=hashes,
        one_each=all(len(set(h)) == 1 for h in hashes.values()),
        valid=all(h[0].startswith("RIHS01_") for h in hashes.values()),
        enclaves=[e for n, _, e in node.get_node_names_and_namespaces_with_enclaves() if n == base],
        durability=durability,
        nodeless=nodeless(),
        event=until(node, talk, 5.0),
    )
    del endpoints


def described(node, name, kind, type_hash):
    """A node of rclpy tells what rcl answers about the types that it uses."""
    rcl = rclpy.create_node("described")
    keep = rcl.create_publisher(PoseWithCovarianceStamped, "/another_pose", 10)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.add_node(rcl)
    request = GetTypeDescription.Request(type_name=kind, type_hash=type_hash, include_type_sources=True)

    def answer(of):
        client = node.create_client(GetTypeDescription, f"{of}/get_type_description")
        assert client.wait_for_service(10.0), f"no service of {of}"
        future = client.call_async(request)
        executor.spin_until_future_complete(future, timeout_sec=5.0)
        assert future.done() and future.result().successful, f"{of}: {future.result()}"
        return future.result()

    def code(text):
        """Without comments, which our copies of the standard interfaces leave out."""
        lines = (" ".join(line.split("#")[0].split()) for line in text.splitlines())
        return [line for line in lines if line]

    answers = [answer(name), answer("/described")]
    texts = [[(s.type_name, s.encoding, code(s.raw_file_contents)) for s in a.type_sources] for a in answers]
    say(
        equal=answers[0].type_description == answers[1].type_description,
        texts_equal=texts[0] == texts[1],
        different=[pair for pair in zip(*texts) if pair[0] != pair[1]],
        counts=[len(t) for t in texts],
    )
    rcl.destroy_node()
    del keep


def main():
    rclpy.init(args=[])
    node = rclpy.create_node("peer")
    commands = [look, parameters, assign, lifecycle, receive, endpoints_gone, once, announced, described]
    {c.__name__: c for c in commands}[sys.argv[1]](node, *sys.argv[2:])
    node.destroy_node()
    rclpy.shutdown()


main()
