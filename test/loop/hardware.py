"""The simulated hardware's ROS side: sensors out, commands in, and what the nodes publish.

Messages are polled: an executor would cost more than the physics. Stamps are simulated time.
"""

from array import array

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, TransformStamped, TwistStamped, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage, Imu, JointState
from tf2_msgs.msg import TFMessage
from volant_msgs.msg import MarkerObservations, PoseStatus, Swing

import crane as c
from quaternion import conjugate, from_vector, multiply, rotate

EPOCH = 1_000.0  # simulated time at the start, s: zero means "no time yet" to ROS nodes


def to_time(seconds):
    """Stamp of a time of the simulation, s."""
    nanoseconds = round((EPOCH + seconds) * 1e9)
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def to_seconds(stamp):
    """Time of the simulation, s."""
    return (stamp.sec - EPOCH) + stamp.nanosec * 1e-9


def set_pose(pose, position, quaternion):
    """Fills a geometry_msgs/Pose or Transform; the quaternion has w first."""
    place = getattr(pose, "position", None) or pose.translation
    turn = getattr(pose, "orientation", None) or pose.rotation
    place.x, place.y, place.z = map(float, position)
    turn.w, turn.x, turn.y, turn.z = map(float, quaternion)


class Hardware:
    """Publishers of the sensors and of the truth, and the newest or all received messages."""

    def __init__(self, domain, truth):
        self.context = rclpy.Context()
        self.context.init(args=[], domain_id=domain)
        self.node = rclpy.create_node("simulated_hardware", context=self.context)
        reliable = QoSProfile(depth=10)
        self._out = {
            "clock": self._advertise(Clock, "/clock", QoSProfile(
                depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)),
            "image": self._advertise(CompressedImage, "climber/camera/image_raw/compressed",
                                     qos_profile_sensor_data),
            "info": self._advertise(CameraInfo, "climber/camera/camera_info",
                                    qos_profile_sensor_data),
            "joints": self._advertise(JointState, "climber/joint_states", reliable),
            "goal": self._advertise(PoseStamped, "swing_control/goal", reliable),
        }
        if truth:
            self._out |= {
                "odometry": self._advertise(Odometry, "truth/volant/odometry", reliable),
                "predicted": self._advertise(
                    Odometry, "truth/volant/predicted_odometry", reliable),
                "status": self._advertise(PoseStatus, "truth/volant/status", reliable),
                "tf": self._advertise(TFMessage, "truth/tf", QoSProfile(depth=100)),
            }
        deep = QoSProfile(depth=200)
        fast = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._in = {
            "cmd_vel": self._subscribe(TwistStamped, "climber/cmd_vel", deep),
            "cmd_thrust": self._subscribe(WrenchStamped, "volant/cmd_thrust", deep),
            "odometry": self._subscribe(Odometry, "volant/odometry", deep),
            "predicted": self._subscribe(Odometry, "volant/predicted_odometry", deep),
            "status": self._subscribe(PoseStatus, "volant/status", deep),
            "swing": self._subscribe(Swing, "volant/swing", deep),
            "markers": self._subscribe(MarkerObservations, "climber/markers", fast),
            "imu": self._subscribe(Imu, "volant/imu/data", fast),
        }

    def _advertise(self, kind, topic, qos):
        return self.node.create_publisher(kind, topic, qos)

    def _subscribe(self, kind, topic, qos):
        return self.node.create_subscription(kind, topic, lambda message: None, qos)

    def publish(self, name, message):
        """Publishes on one of the outputs."""
        self._out[name].publish(message)

    def connected(self, name):
        """Number of subscriptions of an output."""
        return self._out[name].get_subscription_count()

    def poll(self):
        """Messages received since the last call: (input, message)."""
        received = []
        for name, subscription in self._in.items():
            while True:
                with subscription.handle:
                    taken = subscription.handle.take_message(subscription.msg_type, False)
                if taken is None:
                    break
                received.append((name, taken[0]))
        return received

    def close(self):
        """Leaves the DDS domain."""
        self.node.destroy_node()
        self.context.shutdown()


def clock(seconds):
    """Message of /clock."""
    return Clock(clock=to_time(seconds))


def image(seconds, jpeg):
    """A JPEG with the middle of its exposure as stamp."""
    message = CompressedImage(format="rgb8; jpeg compressed bgr8")
    message.header.stamp, message.header.frame_id = to_time(seconds), "camera_optical"
    message.data = array("B", jpeg)
    return message


def camera_info(seconds):
    """Intrinsics of the rendered camera."""
    fx, fy = map(float, c.FOCAL)
    cx, cy = map(float, c.PRINCIPAL)
    message = CameraInfo(width=c.WIDTH, height=c.HEIGHT_PX, distortion_model="plumb_bob")
    message.header.stamp, message.header.frame_id = to_time(seconds), "camera_optical"
    message.d = [0.0] * 5
    message.k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    message.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    message.p = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return message


def joint_states(seconds, values):
    """Encoder readings."""
    message = JointState(name=["rail_x", "rail_y", "turn"], position=list(map(float, values)))
    message.header.stamp = to_time(seconds)
    return message


def goal(seconds, x, y, heading):
    """Where the platform is to hang."""
    message = PoseStamped()
    message.header.stamp, message.header.frame_id = to_time(seconds), "world"
    set_pose(message.pose, (x, y, 0.0), (np.cos(heading / 2), 0.0, 0.0, np.sin(heading / 2)))
    return message


def odometry(truth, ahead=0.0, acceleration=None):
    """The truth as odometry; `ahead` s in the future at constant acceleration (world, m/s²) and
    constant angular velocity."""
    message = Odometry(child_frame_id="volant")
    message.header.stamp, message.header.frame_id = to_time(truth.time + ahead), "world"
    velocity = rotate(truth.quaternion, truth.linear)
    position, quaternion, linear = truth.position, truth.quaternion, truth.linear
    if ahead:
        position = position + velocity * ahead + acceleration * ahead**2 / 2
        quaternion = multiply(quaternion, from_vector(truth.angular * ahead))
        linear = rotate(conjugate(quaternion), velocity + acceleration * ahead)
    set_pose(message.pose.pose, position, quaternion)
    twist = message.twist.twist
    twist.linear.x, twist.linear.y, twist.linear.z = map(float, linear)
    twist.angular.x, twist.angular.y, twist.angular.z = map(float, truth.angular)
    return message


def status(seconds):
    """A status that is always valid."""
    message = PoseStatus(state=PoseStatus.TRACKING, valid=True)
    message.header.stamp, message.header.frame_id = to_time(seconds), "world"
    return message


def climber_tf(truth):
    """world → climber."""
    transform = TransformStamped(child_frame_id="climber")
    transform.header.stamp, transform.header.frame_id = to_time(truth.time), "world"
    x, y, turn = truth.joints
    set_pose(transform.transform, (x, y, c.HEIGHT), (np.cos(turn / 2), 0, 0, np.sin(turn / 2)))
    return TFMessage(transforms=[transform])
