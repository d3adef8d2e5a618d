"""Independent client of Foxglove's WebSocket protocol: websockets and mcap-ros2-support of PyPI.

foxglove_client.py URL PROTOCOL SECONDS TOPIC…: subscribes to the topics, and prints what it
received as one line of JSON.
"""

import json
import struct
import sys
import time

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from websockets.sync.client import connect


def main():
    url, protocol, seconds, topics = sys.argv[1], sys.argv[2], float(sys.argv[3]), sys.argv[4:]
    with connect(url, subprotocols=[protocol], max_size=None) as socket:
        info = json.loads(socket.recv(timeout=5))
        channels, decoders, counts, latest = {}, {}, {}, {}
        warnings = []
        socket.send("this is not JSON")
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                message = socket.recv(timeout=0.1)
            except TimeoutError:
                continue
            if isinstance(message, str):
                message = json.loads(message)
                if message["op"] == "status":
                    warnings.append(message["message"])
                for channel in message.get("channels", []) if message["op"] == "advertise" else []:
                    channels[channel["id"]] = channel
                    if channel["topic"] in topics:
                        # Our number of the subscription is the channel's and a thousand.
                        subscription = {"id": channel["id"] + 1000, "channelId": channel["id"]}
                        request = {"op": "subscribe", "subscriptions": [subscription]}
                        socket.send(json.dumps(request))
                        schema = Schema(
                            id=channel["id"],
                            name=channel["schemaName"],
                            encoding=channel["schemaEncoding"],
                            data=channel["schema"].encode(),
                        )
                        decoder = DecoderFactory().decoder_for(channel["encoding"], schema)
                        decoders[channel["id"]] = decoder
                continue
            opcode, subscription, stamp = struct.unpack_from("<BIQ", message)
            channel = subscription - 1000
            assert opcode == 1 and abs(stamp * 1e-9 - time.time()) < 5, (opcode, stamp)
            topic = channels[channel]["topic"]
            counts[topic] = counts.get(topic, 0) + 1
            latest[topic] = decoders[channel](message[13:])
        got = {
            "protocol": socket.subprotocol,
            "name": info["name"],
            "op": info["op"],
            "warnings": warnings,
            "advertised": {c["topic"]: c["schemaName"] for c in channels.values()},
            "counts": counts,
        }
        if "/climber/camera/image_raw" in latest:
            image = latest["/climber/camera/image_raw"]
            pixels = image.data
            got["image"] = [image.width, image.height, image.encoding, len(pixels), pixels[-1]]
        if "/volant/odometry" in latest:
            pose = latest["/volant/odometry"].pose.pose
            got["z"] = pose.position.z
        if "/tf_static" in latest:
            got["tf_static"] = [
                [t.header.frame_id, t.child_frame_id] for t in latest["/tf_static"].transforms
            ]
        if "/diagnostics" in latest:
            got["diagnostics"] = latest["/diagnostics"].status[0].name
        print(json.dumps(got), flush=True)


main()
