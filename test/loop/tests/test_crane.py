"""The model against its own motion: frames, IMU, camera, drives."""

import unittest

import paths
import numpy as np
import crane as c
import evaluate
from quaternion import conjugate, multiply, rotate, to_vector

RIG = c.load_rig(paths.RIG)


def released(angle=15.0, direction=-105.0):
    crane = c.Crane(RIG)
    crane.hang(np.radians(angle), np.radians(direction))
    return crane


class Frames(unittest.TestCase):
    def test_velocity_is_the_derivative_of_the_position(self):
        crane = released()
        for _ in range(200):
            crane.step()
        before = crane.truth()
        crane.step()
        now = crane.truth()
        crane.step()
        after = crane.truth()
        velocity = rotate(now.quaternion, now.linear)
        np.testing.assert_allclose(
            (after.position - before.position) / (2 * c.STEP), velocity, atol=1e-4)
        turned = multiply(conjugate(before.quaternion), after.quaternion)
        np.testing.assert_allclose(to_vector(turned) / (2 * c.STEP), now.angular, atol=1e-3)

    def test_the_imu_measures_acceleration_minus_gravity_at_its_place(self):
        crane = released()
        lever, mounting = RIG.imu
        places, readings = [], []
        for _ in range(300):
            truth = crane.truth()
            places.append(truth.position + rotate(truth.quaternion, lever))
            force, rate = crane.imu()
            attitude = multiply(truth.quaternion, mounting)
            readings.append(rotate(attitude, force) - [0.0, 0.0, 9.81])
            np.testing.assert_allclose(rotate(mounting, rate), truth.angular, atol=1e-9)
            crane.step()
        places, readings = np.array(places), np.array(readings)
        acceleration = (places[2:] - 2 * places[1:-1] + places[:-2]) / c.STEP**2
        np.testing.assert_allclose(acceleration[50:], readings[51:-1], atol=5e-3)

    def test_at_rest_the_platform_hangs_still_below_its_attachment(self):
        crane = released(0.0)
        for _ in range(1000):
            crane.step()
        truth = crane.truth()
        self.assertLess(np.degrees(truth.swing), 0.05)
        self.assertLess(np.linalg.norm(truth.linear), 0.005)
        force, _ = crane.imu()
        self.assertAlmostEqual(np.linalg.norm(force), 9.81, 2)

    def test_the_swing_of_the_evaluation_is_that_of_the_model(self):
        crane = released(8.0)
        for _ in range(350):
            crane.step()
        expected = crane.truth().swing
        self.assertAlmostEqual(evaluate.swing_of(crane.data.qpos[None])[0], expected, 9)


class Drives(unittest.TestCase):
    def test_a_drive_reaches_its_speed_and_stops_without_commands(self):
        crane = released(0.0)
        for k in range(1000):
            if k % 10 == 0:
                crane.drive([0.3, 0.0, 0.0])
            crane.step()
        self.assertAlmostEqual(crane.truth().joint_rates[0], 0.3, 1)
        for _ in range(600):
            crane.step()
        self.assertAlmostEqual(crane.truth().joint_rates[0], 0.0, 1)

    def test_thrust_acts_after_its_dead_time(self):
        crane = released(0.0)
        crane.thrust([5.0, 0.0, 0.0])
        for _ in range(int(c.THRUST_DEAD_TIME / c.STEP)):
            crane.step()
        self.assertEqual(crane.data.act[0], 0.0)
        for _ in range(100):
            crane.step()
        self.assertGreater(crane.data.act[0], 1.0)


class Images(unittest.TestCase):
    """Area centroids of the squares in the image against the pinhole of camera_info."""

    @classmethod
    def setUpClass(cls):
        try:
            from camera import Camera
            cls.crane = released(6.0)
            cls.camera = Camera(cls.crane, 1)
        except Exception as error:
            raise unittest.SkipTest(f"no offscreen renderer: {error}") from error

    def project(self, point):
        place, attitude = self.crane.world_from_camera()
        x, y, z = rotate(conjugate(attitude), point - place)
        return np.array([c.FOCAL[0] * x / z + c.PRINCIPAL[0], c.FOCAL[1] * y / z + c.PRINCIPAL[1]])

    def centroid(self, color, truth):
        """Area centroid of the projected square, px."""
        angle, half = np.radians(c.TURNS[color]), RIG.side / 2
        cos, sin = np.cos(angle), np.sin(angle)
        corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
        x, y = np.array([
            self.project(truth.position + rotate(truth.quaternion, RIG.markers[color] + [
                cos * u - sin * v, sin * u + cos * v, 0.0]))
            for u, v in corners]).T
        cross = x * np.roll(y, -1) - np.roll(x, -1) * y
        return np.array([((x + np.roll(x, -1)) * cross).sum(),
                         ((y + np.roll(y, -1)) * cross).sum()]) / (3 * cross.sum())

    def test_centroids_are_within_a_twentieth_of_a_pixel(self):
        image = self.camera.render().astype(float)
        truth = self.crane.truth()
        rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
        for color in RIG.markers:
            expected = self.centroid(color, truth)
            row, column = np.round(expected[::-1]).astype(int)
            away = np.maximum(np.abs(columns - column), np.abs(rows - row))
            paper = image[away <= 3].mean(0)
            plate = np.median(image[away == 18], axis=0)
            cover = (image - plate) @ (paper - plate) / np.sum((paper - plate) ** 2)
            cover = np.where(away < 18, np.clip(cover, 0.0, 1.0), 0.0)
            found = np.array([(cover * columns).sum(), (cover * rows).sum()]) / cover.sum()
            with self.subTest(color):
                np.testing.assert_allclose(found, expected, atol=0.05)


if __name__ == "__main__":
    unittest.main()
