"""ROS 2 messages as dictionaries, and the bags that hold them (MCAP, CDR, as rosbag2 writes)."""

import os

from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.writer import Writer

# Bags whose message definitions are used.
SCHEMAS = Path(os.environ.get("VOLANT_SHARED", "")) / "bags" / "real_slow"
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


def write_bag(path, messages):
    """Messages are (log time, topic, type, content), written in the order of their log times."""
    if not SCHEMAS.is_dir():
        raise SystemExit("set VOLANT_SHARED to the folder with bags/real_slow in it")
    definitions = {}
    for bag in ("in.mcap", "truth.mcap"):
        with open(SCHEMAS / bag, "rb") as file:
            for schema in make_reader(file).get_summary().schemas.values():
                definitions[schema.name] = schema.data.decode()
    with open(path, "wb") as file:
        writer = Writer(file)
        schemas = {}
        for log_time, topic, kind, content in sorted(messages, key=lambda m: m[0]):
            if kind not in schemas:
                schemas[kind] = writer.register_msgdef(kind, definitions[kind])
            writer.write_message(
                topic, schemas[kind], content, nanoseconds(log_time), nanoseconds(log_time)
            )
        writer.finish()
