"""Messages and services of the peer in peer.py, as ROS 2 has them in DDS.

The definitions are those of ROS 2 Jazzy in PyPI rosbags, not this project's.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from types import new_class

from cyclonedds.idl import IdlStruct, types
from rosbags.typesys import Stores, get_typestore

sys.path.insert(0, str(Path(__file__).parents[2] / "msgs" / "tests"))
from make_golden_cdr import Cyclone  # noqa: E402

ROS = Cyclone(get_typestore(Stores.ROS2_JAZZY))
Time = ROS.struct("builtin_interfaces/msg/Time")
Header = ROS.struct("std_msgs/msg/Header")
Point, Vector3, Quaternion, Pose, PoseWithCovariance, PoseWithCovarianceStamped = (
    ROS.struct(f"geometry_msgs/msg/{name}")
    for name in ["Point", "Vector3", "Quaternion", "Pose", "PoseWithCovariance", "PoseWithCovarianceStamped"]
)
Imu = ROS.struct("sensor_msgs/msg/Imu")
Image = ROS.struct("sensor_msgs/msg/Image")
TFMessage = ROS.struct("tf2_msgs/msg/TFMessage")
DiagnosticArray = ROS.struct("diagnostic_msgs/msg/DiagnosticArray")
Clock = ROS.struct("rosgraph_msgs/msg/Clock")
ParameterValue, Parameter, SetParametersResult, ParameterDescriptor = (
    ROS.struct(f"rcl_interfaces/msg/{name}")
    for name in ["ParameterValue", "Parameter", "SetParametersResult", "ParameterDescriptor"]
)
State = ROS.struct("lifecycle_msgs/msg/State")


def service(package, name, request, reply):
    """Request and reply of a service with the header that rmw_cyclonedds puts before both."""
    header = {"guid": types.uint64, "seq": types.int64}
    return [
        dataclass(
            new_class(
                f"{name}{end}",
                (IdlStruct,),
                {"typename": f"{package}::srv::dds_::{name}_{end}_"},
                lambda space, fields=fields: space.update(
                    {"__annotations__": {**header, **fields}, "__module__": __name__}
                ),
            )
        )
        for end, fields in (("Request", request), ("Response", reply))
    ]


rcl, seq = "rcl_interfaces", types.sequence
SERVICES = {
    "list_parameters": service(
        rcl, "ListParameters", {"prefixes": seq[str], "depth": types.uint64}, {"names": seq[str], "prefixes": seq[str]}
    ),
    "get_parameters": service(rcl, "GetParameters", {"names": seq[str]}, {"values": seq[ParameterValue]}),
    "describe_parameters": service(
        rcl, "DescribeParameters", {"names": seq[str]}, {"descriptors": seq[ParameterDescriptor]}
    ),
    "set_parameters": service(
        rcl, "SetParameters", {"parameters": seq[Parameter]}, {"results": seq[SetParametersResult]}
    ),
    "get_state": service("lifecycle_msgs", "GetState", {"nothing": types.uint8}, {"current_state": State}),
    "change_state": service("lifecycle_msgs", "ChangeState", {"id": types.uint8, "label": str}, {"success": bool}),
}
