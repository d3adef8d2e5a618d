"""Reads bags with independent readers; prints one line per reader and bag."""

import sys
from pathlib import Path

from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader

for path in map(Path, sys.argv[1:]):
    counts, texts = {}, []
    # Its AnyReader rejects a wrong type hash or definition.
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            counts[connection.topic] = counts.get(connection.topic, 0) + 1
            if connection.topic == "/text":
                texts.append(message.data)
    listed = " ".join(f"{topic} {count}" for topic, count in sorted(counts.items()))
    print(f"rosbags {path.name}: {listed} first {texts[0]!r} last {texts[-1]!r}")
    if path.is_file():
        counts, texts = {}, []
        for message in read_ros2_messages(path):
            counts[message.channel.topic] = counts.get(message.channel.topic, 0) + 1
            if message.channel.topic == "/text":
                texts.append(message.ros_msg.data)
        listed = " ".join(f"{topic} {count}" for topic, count in sorted(counts.items()))
        print(f"mcap-ros2 {path.name}: {listed} first {texts[0]!r} last {texts[-1]!r}")
