"""ROS 2 messages as dictionaries, and the bags that hold them (MCAP, CDR, as rosbag2 writes)."""

import functools
import subprocess
import tempfile
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.writer import Writer

VOLANT = Path(__file__).resolve().parents[2] / "target" / "release" / "volant"
START_NS = 1_760_001_000_000_000_000  # the bag's start; times `t` are seconds since then


def vector(v):
    return {"x": float(v[0]), "y": float(v[1]), "z": float(v[2])}


def quaternion_message(q):
    return {**vector(q), "w": float(q[3])}


def nanoseconds(t):
    return START_NS + round(t * 1e9)


def header(t, frame):
    sec, nanosec = divmod(nanoseconds(t), 1_000_000_000)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}


def transform(t, parent, child, translation, rotation):
    return {
        "header": header(t, parent),
        "child_frame_id": child,
        "transform": {"translation": vector(translation), "rotation": quaternion_message(rotation)},
    }


@functools.cache
def definitions():
    """Definition of each message type, from a bag that the command writes: nothing else of it."""
    if not VOLANT.is_file():
        raise SystemExit(f"{VOLANT} is missing: `make build` makes it")
    with tempfile.TemporaryDirectory() as folder:
        command = [VOLANT, "simulate", "--out", folder, "--seconds", "1"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{' '.join(map(str, command))}: {done.stderr.strip()}")
        with open(next(Path(folder).glob("*/in.mcap")), "rb") as file:
            schemas = make_reader(file).get_summary().schemas.values()
    found = {schema.name: schema.data.decode() for schema in schemas}
    transform_definition = found["geometry_msgs/msg/TransformStamped"]
    found["tf2_msgs/msg/TFMessage"] = (
        "geometry_msgs/TransformStamped[] transforms\n"
        + "=" * 80
        + "\nMSG: geometry_msgs/TransformStamped\n"
        + transform_definition
    )
    return found


def write_bag(path, messages):
    """Messages are (log time, topic, type, content), written in the order of their log times."""
    with open(path, "xb") as file:
        writer = Writer(file)
        schemas = {}
        for log_time, topic, kind, content in sorted(messages, key=lambda m: m[0]):
            if kind not in schemas:
                schemas[kind] = writer.register_msgdef(kind, definitions()[kind])
            writer.write_message(
                topic, schemas[kind], content, nanoseconds(log_time), nanoseconds(log_time)
            )
        writer.finish()
