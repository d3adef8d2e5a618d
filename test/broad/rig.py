"""The virtual part of a recording: climber, camera and markers around a real motion."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

COLORS = ("red", "green", "blue", "yellow")
SIDE = 0.076
SIZE = (640, 480)
# fx, fy, cx, cy (px); k1, k2, p1, p2, k3.
CAMERA = (603.71118, 603.7269, 320.78842, 235.8736)
DISTORTION = (-0.211499, 0.065446, -0.000237, 0.000166, -0.012092)
PIXEL_NOISE = 0.1
CLIMBER_HEIGHT, PLATFORM_HEIGHT = 2.8, 1.0
# The climber follows the platform with this time constant, s.
FOLLOWS = 2.0
ENCODER_STEP, TURN_STEP = 1e-3, 1e-3


@dataclass
class Rig:
    """True values; a transform reads climber_from_camera."""

    camera_place: np.ndarray
    camera_turn: Rotation
    imu_place: np.ndarray
    imu_turn: Rotation
    markers: np.ndarray


def random_rig(random):
    corners = 0.152 * np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)], float)
    corners += random.normal(0, 0.003, corners.shape)
    down = Rotation.from_quat([-0.70351575, -0.71054366, 0.008454, 0.0110372])
    return Rig(
        np.r_[random.uniform(-0.03, 0.03, 2), -0.117].round(4),
        down * Rotation.from_euler("xyz", random.uniform(-1, 1, 3), degrees=True),
        random.uniform(-0.08, 0.08, 3).round(3),
        Rotation.from_euler("xyz", random.uniform(-3, 3, 3), degrees=True),
        np.c_[corners, np.full(4, 0.0151)].round(4),
    )


class Scene:
    """Platform and climber as functions of the time, s. The pose is world_from_volant."""

    def __init__(self, motion, period, rig, random):
        self.rig, self.time = rig, np.arange(len(motion.place)) * period
        turn = motion.turn * rig.imu_turn.inv()
        place = motion.place - turn.apply(rig.imu_place)
        heading = Rotation.from_euler("z", random.uniform(-180, 180), degrees=True)
        self.turn, self.place = heading * turn, heading.apply(place - place.mean(0))
        self.place[:, 2] += PLATFORM_HEIGHT
        self.rate = rig.imu_turn.apply(motion.rate)
        self.velocity = np.gradient(self.place, period, axis=0)
        climber, at = np.zeros((len(self.place), 2)), self.place[0, :2].copy()
        for k, target in enumerate(self.place[:, :2]):
            at += (target - at) * period / FOLLOWS
            climber[k] = at
        self.climber = climber
        swing = 0.15 * np.sin(2 * np.pi * self.time / 20 + random.uniform(0, 6))
        self.climber_turn = random.uniform(-np.pi, np.pi) + swing
        self.turn_at = Slerp(self.time, self.turn)

    def platform(self, time):
        place = [np.interp(time, self.time, self.place[:, k]) for k in range(3)]
        return np.array(place), self.turn_at(time)

    def climber_at(self, time):
        x, y = (np.interp(time, self.time, self.climber[:, k]) for k in range(2))
        return np.array([x, y, CLIMBER_HEIGHT]), np.interp(time, self.time, self.climber_turn)

    def encoders(self, time):
        """Return what the encoders read: the climber in their steps."""
        place, turn = self.climber_at(time)
        place[:2] = (place[:2] / ENCODER_STEP).round() * ENCODER_STEP
        return place, Rotation.from_euler("z", round(turn / TURN_STEP) * TURN_STEP)

    def camera_at(self, time):
        place, turn = self.climber_at(time)
        climber = Rotation.from_euler("z", turn)
        return place + climber.apply(self.rig.camera_place), climber * self.rig.camera_turn

    def image(self, time):
        """Return per marker the pixel of its center, the centroid of its image and whether all of
        it is seen from above."""
        place, turn = self.platform(time)
        camera_place, camera_turn = self.camera_at(time)
        to_camera = camera_turn.inv()
        above = (to_camera * turn).apply([0.0, 0.0, 1.0])[2] < -0.2
        found = []
        for center in self.rig.markers:
            points = np.vstack([center, center + EDGE])
            points = to_camera.apply(place + turn.apply(points) - camera_place)
            pixels = project(points)
            inside = ((pixels > 2) & (pixels < np.array(SIZE) - 3)).all()
            seen = above and inside and (points[:, 2] > 0).all()
            found.append((pixels[0], centroid(pixels[1:]), bool(seen)))
        return found


_along, _side = np.linspace(-1, 1, 9)[:-1] * SIDE / 2, np.full(8, SIDE / 2)
EDGE = np.c_[
    np.r_[_along, _side, -_along, -_side], np.r_[-_side, _along, _side, -_along], np.zeros(32)
]


def project(points):
    """Return the distorted pixels of points in the camera's frame (m)."""
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    k1, k2, p1, p2, k3 = DISTORTION
    r = x * x + y * y
    radial = 1 + r * (k1 + r * (k2 + r * k3))
    u = x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x)
    v = y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y
    return np.c_[CAMERA[0] * u + CAMERA[2], CAMERA[1] * v + CAMERA[3]]


def centroid(polygon):
    """Return the centroid of a polygon's area."""
    origin = polygon.mean(0)
    here, following = polygon - origin, np.roll(polygon - origin, -1, 0)
    cross = here[:, 0] * following[:, 1] - following[:, 0] * here[:, 1]
    return origin + ((here + following) * cross[:, None]).sum(0) / (3 * cross.sum())
