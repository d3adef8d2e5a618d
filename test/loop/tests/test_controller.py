"""The controller's law, limits and stops; its node runs without others."""

import unittest

import paths  # noqa: F401
import numpy as np

try:
    import rclpy
    import swing_control as sc
    from volant_msgs.msg import PoseStatus
except ImportError as error:
    raise unittest.SkipTest(f"{error}: test/loop/setup FOLDER makes an environment") from error

P = dict(sc.PARAMETERS)


def law(position=(0.0, 0.12, 1.0), velocity=(0.0, 0.0, 0.0), goal=None, place=(0.0, 0.0),
        turn=0.0, attitude=np.eye(3), rate=(0.0, 0.0, 0.0)):
    platform = (np.array(position), attitude, np.array(velocity), np.array(rate))
    return sc.wanted_commands(P, platform, (np.array(place), turn), goal, np.zeros(2))


class Law(unittest.TestCase):
    def test_nothing_is_commanded_at_rest_below_the_rope(self):
        np.testing.assert_allclose(law(), np.zeros(6), atol=1e-12)

    def test_the_rails_follow_the_swing_and_the_thrust_opposes_the_velocity(self):
        wanted = law(position=(0.1, 0.12, 1.0), velocity=(0.2, 0.0, 0.0))
        self.assertAlmostEqual(wanted[0], 0.1 * P["swing_gain"])
        self.assertAlmostEqual(wanted[3], -0.2 * P["damping"])

    def test_thrust_is_in_the_axes_of_the_platform(self):
        quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        # Body x points along world y; the platform moves along world x, which is body -y.
        wanted = law(velocity=(0.0, -0.2, 0.0), attitude=quarter)
        np.testing.assert_allclose(wanted[3:5], [0.0, 0.2 * P["damping"]], atol=1e-12)

    def test_a_goal_draws_the_rails_with_limited_speed(self):
        wanted = law(goal=(3.0, 0.12, 0.0))
        self.assertAlmostEqual(wanted[0], P["speed_limit"])
        self.assertAlmostEqual(wanted[1], 0.0)

    def test_no_speed_leads_into_the_end_of_a_rail(self):
        at_end = law(position=(1.2, 0.12, 1.0), place=(1.16, 0.0), goal=(3.0, 0.12, 0.0))
        self.assertEqual(at_end[0], 0.0)
        outward = law(position=(-1.0, 0.12, 1.0), place=(1.16, 0.0), goal=(-3.0, 0.12, 0.0))
        self.assertLess(outward[0], 0.0)

    def test_the_heading_turns_the_short_way(self):
        angle = np.radians(170.0)
        attitude = np.array([[np.cos(angle), -np.sin(angle), 0.0],
                             [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
        wanted = law(attitude=attitude, goal=(0.0, 0.12, np.radians(-170.0)))
        self.assertGreater(wanted[5], 0.0)


class Limits(unittest.TestCase):
    def test_commands_stop_within_a_fifth_of_a_second(self):
        commands = sc.Commands(P)
        commands.values = commands.limits.copy()
        for _ in range(20):
            values = commands.approach(np.zeros(6), 0.01)
        np.testing.assert_array_equal(values, np.zeros(6))

    def test_a_command_changes_by_its_rate_at_most(self):
        commands = sc.Commands(P)
        values = commands.approach(np.full(6, 1e3), 0.01)
        np.testing.assert_allclose(values, commands.rates * 0.01)


class Stops(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rclpy.init(domain_id=101)
        cls.node = sc.SwingControl()

    @classmethod
    def tearDownClass(cls):
        cls.node.destroy_node()
        rclpy.shutdown()

    def test_the_reason_of_a_stop_names_what_is_missing_or_why_the_pose_is_not_valid(self):
        node = self.node
        node.received.clear()
        self.assertIn("no status", node.obstacle())
        node.on_status(PoseStatus(valid=True))
        self.assertIn("no odometry", node.obstacle())
        node.note("odometry")
        node.note("tf")
        self.assertEqual(node.obstacle(), "")
        node.status = PoseStatus(valid=False, reason="no image for 3 s")
        self.assertIn("no image for 3 s", node.obstacle())

    def test_an_invalid_status_ramps_the_commands_down_without_an_odometry(self):
        node = self.node
        node.commands.values = node.commands.limits.copy()
        node.commanded_at = node.get_clock().now() - rclpy.duration.Duration(seconds=1.0)
        node.on_status(PoseStatus(valid=False))
        self.assertLess(node.commands.values[0], node.commands.limits[0])


if __name__ == "__main__":
    unittest.main()
