"""Independent client of `volant play`'s rosbag2 services.

PyPI's cyclonedds, with rmw_cyclonedds' header.
"""

import json
import os
import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "node_kit" / "tests"))
import peer  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import types  # noqa: E402

NOTHING = {"structure_needs_at_least_one_member": types.uint8}
SERVICES = {
    "pause": ("Pause", NOTHING, NOTHING),
    "resume": ("Resume", NOTHING, NOTHING),
    "toggle_paused": ("TogglePaused", NOTHING, NOTHING),
    "is_paused": ("IsPaused", NOTHING, {"paused": bool}),
    "get_rate": ("GetRate", NOTHING, {"rate": types.float64}),
    "set_rate": ("SetRate", {"rate": types.float64}, {"success": bool}),
    "play_next": ("PlayNext", NOTHING, {"success": bool}),
    "burst": ("Burst", {"num_messages": types.uint64}, {"actually_burst": types.uint64}),
    "seek": ("Seek", {"time": peer.Time}, {"success": bool}),
    "stop": ("Stop", NOTHING, NOTHING),
}


def main():
    """Reads calls from standard input, a service and its fields per line; replies with JSON lines."""
    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    peer.SERVICES = {
        name: peer.service("rosbag2_interfaces", *rest) for name, rest in SERVICES.items()
    }
    clients = {name: peer.Client(participant, "/rosbag2_player", name) for name in SERVICES}
    print(json.dumps({"ready": True}), flush=True)
    for line in sys.stdin:
        name, *fields = line.split()
        request = SERVICES[name][1]
        if name == "seek":
            fields = [peer.Time(int(fields[0]), int(fields[1]))]
        elif request is NOTHING:
            fields = [0]
        else:
            fields = [float(field) if "rate" in request else int(field) for field in fields]
        print(json.dumps(clients[name].call(*fields)), flush=True)


if __name__ == "__main__":
    main()
