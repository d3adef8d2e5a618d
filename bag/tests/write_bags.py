"""Writes bags with independent writers to the given folder."""

import sys
from pathlib import Path

from mcap.writer import CompressionType, Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

folder = Path(sys.argv[1])
store = get_typestore(Stores.ROS2_JAZZY)
Text = store.types["std_msgs/msg/String"]
START = 1_760_000_000_000_000_000


def rosbag2(name, plugin=StoragePlugin.MCAP, mode=None):
    writer = Writer(folder / name, version=9, storage_plugin=plugin)
    if mode:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/text", Text.__msgtype__, typestore=store)
        for i in range(50):
            data = store.serialize_cdr(Text(f"message {i}"), Text.__msgtype__)
            writer.write(connection, START + i * 10_000_000, data)


def lone(path, **options):
    with open(path, "wb") as file:
        writer = McapWriter(file, **options)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(Text.__msgtype__, "ros2msg", b"string data\n")
        channel = writer.register_channel("/text", "cdr", schema)
        for i in range(50):
            time = START + i * 10_000_000
            data = bytes(store.serialize_cdr(Text(f"message {i}"), Text.__msgtype__))
            writer.add_message(channel, log_time=time, publish_time=time, data=data)
        writer.finish()


rosbag2("plain")
rosbag2("zstd_file", mode=CompressionMode.FILE)
rosbag2("sqlite", plugin=StoragePlugin.SQLITE3)
lone(folder / "zstd_chunks", compression=CompressionType.ZSTD, chunk_size=300)
lone(folder / "lz4_chunks", compression=CompressionType.LZ4, chunk_size=300)
lone(folder / "unchunked.mcap", use_chunking=False)
