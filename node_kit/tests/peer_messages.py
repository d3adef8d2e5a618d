"""Messages and services of the peer in peer.py, as ROS 2 has them in DDS."""

from dataclasses import dataclass
from types import new_class

from cyclonedds.idl import IdlStruct, types


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: types.int32
    nanosec: types.uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: types.float64
    y: types.float64
    z: types.float64


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: types.float64
    y: types.float64
    z: types.float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: types.float64
    y: types.float64
    z: types.float64
    w: types.float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    pose: Pose
    covariance: types.array[types.float64, 36]


@dataclass
class PoseWithCovarianceStamped(
    IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovarianceStamped_"
):
    header: Header
    pose: PoseWithCovariance


@dataclass
class Imu(IdlStruct, typename="sensor_msgs::msg::dds_::Imu_"):
    header: Header
    orientation: Quaternion
    orientation_covariance: types.array[types.float64, 9]
    angular_velocity: Vector3
    angular_velocity_covariance: types.array[types.float64, 9]
    linear_acceleration: Vector3
    linear_acceleration_covariance: types.array[types.float64, 9]


@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: types.sequence[TransformStamped]


@dataclass
class KeyValue(IdlStruct, typename="diagnostic_msgs::msg::dds_::KeyValue_"):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticStatus_"):
    level: types.uint8
    name: str
    message: str
    hardware_id: str
    values: types.sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticArray_"):
    header: Header
    status: types.sequence[DiagnosticStatus]


@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: types.uint32
    width: types.uint32
    encoding: str
    is_bigendian: types.uint8
    step: types.uint32
    data: types.sequence[types.uint8]


@dataclass
class Clock(IdlStruct, typename="rosgraph_msgs::msg::dds_::Clock_"):
    clock: Time


@dataclass
class ParameterValue(IdlStruct, typename="rcl_interfaces::msg::dds_::ParameterValue_"):
    type: types.uint8 = 0
    bool_value: bool = False
    integer_value: types.int64 = 0
    double_value: types.float64 = 0.0
    string_value: str = ""
    byte_array_value: types.sequence[types.uint8] = ()
    bool_array_value: types.sequence[bool] = ()
    integer_array_value: types.sequence[types.int64] = ()
    double_array_value: types.sequence[types.float64] = ()
    string_array_value: types.sequence[str] = ()


@dataclass
class Parameter(IdlStruct, typename="rcl_interfaces::msg::dds_::Parameter_"):
    name: str
    value: ParameterValue


@dataclass
class SetParametersResult(IdlStruct, typename="rcl_interfaces::msg::dds_::SetParametersResult_"):
    successful: bool
    reason: str


@dataclass
class FloatingPointRange(IdlStruct, typename="rcl_interfaces::msg::dds_::FloatingPointRange_"):
    from_value: types.float64
    to_value: types.float64
    step: types.float64


@dataclass
class IntegerRange(IdlStruct, typename="rcl_interfaces::msg::dds_::IntegerRange_"):
    from_value: types.int64
    to_value: types.int64
    step: types.uint64


@dataclass
class ParameterDescriptor(IdlStruct, typename="rcl_interfaces::msg::dds_::ParameterDescriptor_"):
    name: str
    type: types.uint8
    description: str
    additional_constraints: str
    read_only: bool
    dynamic_typing: bool
    floating_point_range: types.sequence[FloatingPointRange]
    integer_range: types.sequence[IntegerRange]


@dataclass
class State(IdlStruct, typename="lifecycle_msgs::msg::dds_::State_"):
    id: types.uint8
    label: str


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


SERVICES = {
    "list_parameters": service(
        "rcl_interfaces",
        "ListParameters",
        {"prefixes": types.sequence[str], "depth": types.uint64},
        {"names": types.sequence[str], "prefixes": types.sequence[str]},
    ),
    "get_parameters": service(
        "rcl_interfaces", "GetParameters", {"names": types.sequence[str]}, {"values": types.sequence[ParameterValue]}
    ),
    "describe_parameters": service(
        "rcl_interfaces",
        "DescribeParameters",
        {"names": types.sequence[str]},
        {"descriptors": types.sequence[ParameterDescriptor]},
    ),
    "set_parameters": service(
        "rcl_interfaces",
        "SetParameters",
        {"parameters": types.sequence[Parameter]},
        {"results": types.sequence[SetParametersResult]},
    ),
    "get_state": service("lifecycle_msgs", "GetState", {"nothing": types.uint8}, {"current_state": State}),
    "change_state": service("lifecycle_msgs", "ChangeState", {"id": types.uint8, "label": str}, {"success": bool}),
}
