"""Calls the services of `pose_fusion` with PyPI's cyclonedds and rmw_cyclonedds' header."""

import json
import os
import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).parents[3] / "node_kit" / "tests"))
import peer  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import types  # noqa: E402

TRIGGER = (
    "Trigger",
    {"structure_needs_at_least_one_member": types.uint8},
    {"success": bool, "message": str},
)
SERVICES = {
    "reset": TRIGGER,
    "freeze": ("SetBool", {"data": bool}, {"success": bool, "message": str}),
    "save_checkpoint": TRIGGER,
    "load_checkpoint": TRIGGER,
}


def main():
    """A line of standard input is a call: the service, and 0 or 1; the reply is a line of JSON."""
    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    # One type a name: the services that share one share it here too.
    made = {
    kind: peer.service("std_srvs", *rest)
    for kind, *rest in [(v[0], *v) for v in SERVICES.values()]
    }
    peer.SERVICES = {name: made[kind[0]] for name, kind in SERVICES.items()}
    clients = {name: peer.Client(participant, "/pose_fusion", name) for name in SERVICES}
    print(json.dumps({"ready": True}), flush=True)
    for line in sys.stdin:
        name, data = line.split()
        argument = bool(int(data)) if name == "freeze" else 0
        print(json.dumps(clients[name].call(argument)), flush=True)


if __name__ == "__main__":
    main()
