"""Figures of made-up records whose values are known."""

import unittest

import paths  # noqa: F401
import numpy as np

try:
    import evaluate as e
    import hardware as h
    from geometry_msgs.msg import TwistStamped, WrenchStamped
    from volant_msgs.msg import PoseStatus
except ImportError as error:
    raise unittest.SkipTest(f"{error}: test/loop/setup FOLDER makes an environment") from error
import crane as c
from quaternion import from_vector, multiply
from episodes import Episode
from simulation import Record

ATTITUDE = from_vector([0.1, -0.05, 0.4])


def record(seconds=4.0, **episode):
    """A platform that moves along x at 0.5 m/s; nothing was received."""
    made = Record(Episode("made", "made up", seconds, **episode), "volant")
    for t in np.arange(-0.1, seconds, 0.002):
        qpos = np.zeros(11)
        qpos[3:6] = [0.5 * t, 0.12, 1.05]
        qpos[6:10] = ATTITUDE
        made.truth.append((t, qpos, np.zeros(10)))
    return made


def odometry(t, error, turn, sigma):
    """The truth at t plus an error (m), turned by a rotation vector about the world's axes."""
    truth = c.Truth(t, np.array([0.5 * t, 0.12, 1.05]) + error,
                    multiply(from_vector(turn), ATTITUDE), *[np.zeros(3)] * 4, 0.0)
    message = h.odometry(truth)
    message.pose.covariance = np.diag(np.square([sigma] * 6)).ravel().tolist()
    return message


class Errors(unittest.TestCase):
    def test_errors_and_nees_are_those_that_were_made(self):
        made = record()
        error, turn = np.array([1e-3, -2e-3, 2e-3]), np.array([0.002, 0.0, -0.001])
        made.received["odometry"] = [(t, odometry(t, error, turn, 1e-3))
                                     for t in np.arange(0.0, 3.0, 0.0101)]
        found = e.errors(made, "odometry", e.TruthLine(made))
        np.testing.assert_allclose(found.position, np.tile(error, (len(found.t), 1)), atol=1e-9)
        np.testing.assert_allclose(found.rotation, np.tile(turn, (len(found.t), 1)), atol=1e-9)
        np.testing.assert_allclose(found.nees(), [9.0, 5.0], rtol=1e-5)
        np.testing.assert_allclose(found.rmse(), [3.0, np.degrees(np.sqrt(5e-6))], rtol=1e-5)


class Control(unittest.TestCase):
    def test_settling_is_the_last_time_above_one_degree(self):
        made = record()
        truth = e.TruthLine(made)
        truth.swing = np.where(truth.t < 2.5, 3.0, 0.5)
        self.assertAlmostEqual(e.settling_time(made, truth), 2.5, 2)
        pushed = record(push=(1.0, 1.1, 10.0, 0.0))
        self.assertAlmostEqual(e.settling_time(pushed, truth), 1.5, 2)

    def test_waypoint_errors_are_distances_from_the_goal(self):
        made = record(seconds=6.0, goals=((0.0, 0.0, 0.12, 0.0),))
        legs, arrived = e.waypoint_errors(made, e.TruthLine(made))
        self.assertAlmostEqual(legs.max(), 3.0, 2)
        self.assertAlmostEqual(arrived.min(), 2.0, 2)

    def test_a_stop_is_measured_from_the_invalid_status(self):
        made = record()
        for t in np.arange(0.0, 4.0, 0.01):
            made.received.setdefault("status", []).append(
                (t, PoseStatus(valid=not 1.0 <= t < 1.5)))
            stopped = 1.12 <= t < 1.53
            made.commands.append((t, np.full(6, 0.0 if stopped else 0.2)))
        (length, zero, again), = e.stops(made)
        self.assertAlmostEqual(length, 0.5, 2)
        self.assertAlmostEqual(zero, 0.12, 2)
        self.assertAlmostEqual(again, 0.03, 2)

    def test_command_steps_are_per_ten_milliseconds(self):
        made = record()
        for k, t in enumerate((0.0, 0.01, 0.02, 0.06)):
            vel, thrust = TwistStamped(), WrenchStamped()
            vel.header.stamp = thrust.header.stamp = h.to_time(t)
            vel.twist.linear.x = [0.0, 0.01, 0.01, 0.09][k]
            thrust.wrench.force.y = [0.0, 0.5, 0.4, 0.4][k]
            made.received.setdefault("cmd_vel", []).append((t, vel))
            made.received.setdefault("cmd_thrust", []).append((t, thrust))
        np.testing.assert_allclose(e.command_steps(made, 0.0, 1.0), [0.02, 0.5], rtol=1e-6)


if __name__ == "__main__":
    unittest.main()
