#!/usr/bin/env python3
"""Drives a platform on a rope to goals and damps its swing, with the pose that Volant estimates.

An example to copy: it knows topics, /tf and `volant/status`. Relative names: a namespace or a remap
moves them.

Subscriptions:
    volant/odometry            nav_msgs/Odometry, world → volant; twist in volant axes
    volant/predicted_odometry  the same, ahead by pose_fusion's `prediction_horizon`; used instead
                               of volant/odometry with `use_prediction`
    volant/status              volant_msgs/PoseStatus: may the pose be used?
    /tf                        world → climber, from climber_driver
    swing_control/goal         geometry_msgs/PoseStamped in world: x, y (m) and heading of the
                               platform at rest. Without a goal the swing is damped in place.
Publications:
    climber/cmd_vel            geometry_msgs/TwistStamped in world: speeds of the rails, linear.x
                               and linear.y (m/s), and of the turn, angular.z (rad/s)
    volant/cmd_thrust          geometry_msgs/WrenchStamped in volant: force.x, force.y (N) and
                               torque.z (N m) of the thrusters
Control law, horizontal components in world axes:
    swing     d = p − h         platform minus the point h below the rope's upper end, m
    rails     u = k_p (g − h) + k_s d              limited in speed, acceleration and by the rails
    thrust    F = −D (v − u)                       v: velocity of the platform, m/s
    heading   τ = −k_h (ψ − ψ_g) − d_h ω_z         and the turn follows ψ_g
Moving the rope's upper end after the swing damps a pendulum of angular frequency ω with the ratio
k_s / 2ω; the thrusters add D / 2mω.
Safety: while `valid` is false, or status, odometry or /tf are late, all commands go to zero within
their limits on rates (0.4 m/s at 2.5 m/s² in 0.16 s). Control resumes when `valid` is true.
"""

import math
import signal

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from tf2_msgs.msg import TFMessage
from volant_msgs.msg import PoseStatus

PARAMETERS = {
    "use_prediction": True,  # feedback from volant/predicted_odometry
    "climber_frame": "climber",
    "rest_offset": [0.0, 0.12],  # x, y of the platform at rest in the climber frame, m
    "rail_ends": [-1.2, 1.2],  # both rails, m
    "rail_margin": 0.05,  # kept from the ends, m
    "position_gain": 0.9,  # k_p, 1/s
    "swing_gain": 1.1,  # k_s, 1/s
    "speed_limit": 0.4,  # of each rail, m/s
    "acceleration_limit": 2.5,  # of each rail, m/s²
    "turn_gain": 1.0,  # 1/s
    "turn_speed_limit": 0.3,  # rad/s
    "turn_acceleration_limit": 2.0,  # rad/s²
    "damping": 12.0,  # D, N s/m
    "force_limit": 6.0,  # of each axis, N
    "force_rate_limit": 80.0,  # N/s
    "heading_gain": 0.4,  # k_h, N m/rad
    "heading_damping": 0.35,  # d_h, N m s/rad
    "torque_limit": 0.6,  # N m
    "torque_rate_limit": 8.0,  # N m/s
    "status_timeout": 0.2,  # s; the status comes at 10 Hz at least
    "odometry_timeout": 0.2,  # s; it pauses for 0.15 s where the IMU falls silent
    "tf_timeout": 0.3,  # s
}


def rotation(quaternion):
    """Rotation matrix (3, 3) of a geometry_msgs/Quaternion."""
    x, y, z, w = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def heading(matrix):
    """Angle of the x axis about the vertical, rad."""
    return math.atan2(matrix[1, 0], matrix[0, 0])


class Commands:
    """Rail speeds, turn rate, forces and torque: five commands with limits and limited rates."""

    def __init__(self, p):
        self.limits = np.array([p["speed_limit"]] * 2 + [p["turn_speed_limit"]]
                               + [p["force_limit"]] * 2 + [p["torque_limit"]])
        self.rates = np.array([p["acceleration_limit"]] * 2 + [p["turn_acceleration_limit"]]
                              + [p["force_rate_limit"]] * 2 + [p["torque_rate_limit"]])
        self.values = np.zeros(6)

    def approach(self, wanted, seconds):
        """Moves the commands towards the wanted ones, (6,), as far as `seconds` allow."""
        step = self.rates * seconds
        wanted = np.clip(wanted, -self.limits, self.limits)
        self.values = self.values + np.clip(wanted - self.values, -step, step)
        return self.values


def wanted_commands(p, platform, climber, goal, rails):
    """The control law without limits on rates.

    platform: position (3,) and rotation (3, 3), world from volant; velocity and angular velocity
    (3,), volant axes. climber: position (2,), m, and heading, rad. goal: x, y (m), heading (rad)
    or None. rails: speeds commanded now, (2,), m/s. Returns six commands as in `Commands`.
    """
    position, world_from_volant, velocity, angular_velocity = platform
    place, turn = climber
    c, s = math.cos(turn), math.sin(turn)
    below = place + np.array([[c, -s], [s, c]]) @ p["rest_offset"]
    target, target_heading = (below, turn) if goal is None else (goal[:2], goal[2])
    travel = np.clip(p["position_gain"] * (target - below), -p["speed_limit"], p["speed_limit"])
    speed = travel + p["swing_gain"] * (position[:2] - below)
    # Never faster than what the acceleration limit stops before the end of a rail.
    low, high = np.array(p["rail_ends"]) + [p["rail_margin"], -p["rail_margin"]]
    brake = lambda room: np.sqrt(2 * 0.5 * p["acceleration_limit"] * np.maximum(room, 0.0))
    speed = np.clip(speed, -brake(place - low), brake(high - place))
    force = np.zeros(3)
    force[:2] = -p["damping"] * ((world_from_volant @ velocity)[:2] - rails)
    # Within ±π: the short way.
    error = math.remainder(target_heading - heading(world_from_volant), math.tau)
    turn_error = math.remainder(target_heading - turn, math.tau)
    return np.array([
        *speed,
        p["turn_gain"] * turn_error,
        *(world_from_volant.T @ force)[:2],
        p["heading_gain"] * error - p["heading_damping"] * angular_velocity[2],
    ])


class SwingControl(Node):
    """The node: keeps the newest inputs, checks their age, runs the law on each odometry."""

    def __init__(self):
        super().__init__("swing_control")
        for name, default in PARAMETERS.items():
            self.declare_parameter(name, default)
        self.p = {name: self.get_parameter(name).value for name in PARAMETERS}
        self.commands = Commands(self.p)
        self.odometry = self.status = self.climber = self.goal = None
        self.received = {}  # name of an input → time of its receipt
        self.commanded_at, self.stopped_because = self.get_clock().now(), ""
        odometry = "volant/predicted_odometry" if self.p["use_prediction"] else "volant/odometry"
        self.create_subscription(Odometry, odometry, self.on_odometry, 10)
        self.create_subscription(PoseStatus, "volant/status", self.on_status, 10)
        self.create_subscription(TFMessage, "/tf", self.on_tf, 100)
        self.create_subscription(PoseStamped, "swing_control/goal", self.on_goal, 10)
        self.cmd_vel = self.create_publisher(TwistStamped, "climber/cmd_vel", 10)
        self.cmd_thrust = self.create_publisher(WrenchStamped, "volant/cmd_thrust", 10)
        # Ramps down when the odometry, which otherwise sets the pace, has stopped.
        self.create_timer(0.02, self.watch)

    def note(self, name):
        self.received[name] = self.get_clock().now()

    def age(self, name):
        """Time since an input was received, s."""
        at = self.received.get(name)
        return math.inf if at is None else (self.get_clock().now() - at).nanoseconds * 1e-9

    def on_status(self, message):
        self.note("status")
        self.status = message
        if not message.valid:
            self.control()  # does not wait for the next odometry

    def on_goal(self, message):
        place, attitude = message.pose.position, message.pose.orientation
        self.goal = (place.x, place.y, heading(rotation(attitude)))

    def on_tf(self, message):
        for transform in message.transforms:
            if transform.child_frame_id == self.p["climber_frame"]:
                self.note("tf")
                self.climber = transform

    def on_odometry(self, message):
        self.note("odometry")
        self.odometry = message
        self.control()

    def watch(self):
        if (self.get_clock().now() - self.commanded_at).nanoseconds > 40_000_000:
            self.control()

    def obstacle(self):
        """Why control is not possible; empty if it is."""
        for name in ("status", "odometry", "tf"):
            if self.age(name) > self.p[f"{name}_timeout"]:
                return f"no {name} for {self.age(name):.2f} s"
        return "" if self.status.valid else f"the pose is not valid: {self.status.reason}"

    def control(self):
        """Computes and publishes the commands."""
        now = self.get_clock().now()
        # Simulated time may jump back.
        seconds = min(max((now - self.commanded_at).nanoseconds * 1e-9, 0.0), 0.05)
        self.commanded_at = now
        why = self.obstacle()
        if bool(why) != bool(self.stopped_because):  # its figures change all the time
            self.get_logger().info(f"stopped: {why}" if why else "in control")
        self.stopped_because = why
        self.publish(self.commands.approach(np.zeros(6) if why else self.wanted(), seconds))

    def publish(self, values):
        """Publishes the six commands."""
        twist, wrench = TwistStamped(), WrenchStamped()
        twist.header.stamp = wrench.header.stamp = self.get_clock().now().to_msg()
        twist.header.frame_id, wrench.header.frame_id = "world", "volant"
        twist.twist.linear.x, twist.twist.linear.y, twist.twist.angular.z = map(float, values[:3])
        wrench.wrench.force.x, wrench.wrench.force.y = map(float, values[3:5])
        wrench.wrench.torque.z = float(values[5])
        self.cmd_vel.publish(twist)
        self.cmd_thrust.publish(wrench)

    def wanted(self):
        """The commands that the control law asks for, (6,)."""
        pose, twist = self.odometry.pose.pose, self.odometry.twist.twist
        vector = lambda v: np.array([v.x, v.y, v.z])
        transform = self.climber.transform
        # The odometry may be predicted: the climber moves on at its commanded speed until then.
        stamp = Time.from_msg(self.odometry.header.stamp)
        ahead = (stamp - Time.from_msg(self.climber.header.stamp)).nanoseconds * 1e-9
        rails, turn_rate = self.commands.values[:2], self.commands.values[2]
        place = vector(transform.translation)[:2] + rails * ahead
        turn = heading(rotation(transform.rotation)) + turn_rate * ahead
        platform = (vector(pose.position), rotation(pose.orientation),
                    vector(twist.linear), vector(twist.angular))
        return wanted_commands(self.p, platform, (place, turn), self.goal, rails)


def main():
    # Own handlers, so that zero commands are the last ones.
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node, executor, ending = SwingControl(), SingleThreadedExecutor(), []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ending.append(True))
    executor.add_node(node)
    while not ending:
        executor.spin_once(timeout_sec=0.1)
    node.publish(np.zeros(6))
    rclpy.shutdown()


if __name__ == "__main__":
    main()
