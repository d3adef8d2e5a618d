"""Figures of an episode from its record: errors against the truth, NEES, settling, commands."""

from dataclasses import dataclass

import numpy as np

import crane as c
import hardware as h

SETTLED = 1.0  # degrees
PLATFORM = slice(3, 7 + 3)  # position and quaternion of the platform in qpos


class TruthLine:
    """The truth at any time: position (m), quaternion (w first), rates, swing (degrees)."""

    def __init__(self, record):
        self.t = np.array([t for t, _, _ in record.truth])
        self.q = np.array([q for _, q, _ in record.truth])
        self.v = np.array([v for _, _, v in record.truth])
        self.swing = np.degrees(swing_of(self.q))

    def pose(self, t):
        """Position and quaternion at t, interpolated between samples 2 ms apart."""
        i = int(np.clip(np.searchsorted(self.t, t) - 1, 0, len(self.t) - 2))
        share = (t - self.t[i]) / (self.t[i + 1] - self.t[i])
        a, b = self.q[i], self.q[i + 1]
        turned = c.to_vector(c.multiply(c.conjugate(a[6:10]), b[6:10]))
        position = a[3:6] + share * (b[3:6] - a[3:6])
        return position, c.multiply(a[6:10], c.from_vector(share * turned))

    def at(self, t, values):
        """Any series of the truth at times t."""
        return np.interp(t, self.t, values)


def swing_of(q):
    """Angle of the rope against the vertical, rad, from qpos (N, …)."""
    def turned(quaternion, vector):
        w, xyz = quaternion[:, :1], quaternion[:, 1:]
        cross = np.cross(xyz, vector) * 2
        return vector + w * cross + np.cross(xyz, cross)

    half = q[:, 2] / 2
    turn = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], 1)
    ones = np.ones((len(q), 1))
    top = np.stack([q[:, 0], q[:, 1], np.full(len(q), c.HEIGHT)], 1)
    top = top + turned(turn, ones * np.array(c.CLIMBER_ATTACHMENT))
    rope = q[:, 3:6] + turned(q[:, 6:10], ones * np.array(c.PLATFORM_ATTACHMENT)) - top
    return np.arctan2(np.hypot(rope[:, 0], rope[:, 1]), -rope[:, 2])


@dataclass
class Errors:
    """Errors of an odometry; position in world axes (m), rotation vector in world axes (rad)."""

    t: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    nees_position: np.ndarray
    nees_rotation: np.ndarray

    def part(self, begin, end):
        """Those with begin <= t < end."""
        keep = (self.t >= begin) & (self.t < end)
        return Errors(*(values[keep] for values in vars(self).values()))

    def rmse(self):
        """RMSE of the position (3-D norm, mm) and of the rotation (degrees)."""
        norm = lambda e: np.sqrt(np.mean(np.sum(e**2, 1))) if len(e) else np.nan
        return 1e3 * norm(self.position), np.degrees(norm(self.rotation))

    def largest(self):
        """Largest errors: mm, degrees."""
        norm = lambda e: np.max(np.linalg.norm(e, axis=1), initial=0.0)
        return 1e3 * norm(self.position), np.degrees(norm(self.rotation))

    def nees(self):
        """Mean NEES of position and rotation (3 degrees of freedom each)."""
        if not len(self.t):
            return np.nan, np.nan
        return float(np.mean(self.nees_position)), float(np.mean(self.nees_rotation))


def errors(record, name, truth):
    """Errors of the received odometry `name` ("odometry" or "predicted")."""
    rows = []
    for _, message in record.received.get(name, []):
        t = h.to_seconds(message.header.stamp) - record.released
        if not truth.t[0] <= t <= truth.t[-1]:
            continue
        pose = message.pose.pose
        p, o = pose.position, pose.orientation
        position, quaternion = truth.pose(t)
        e = np.array([p.x, p.y, p.z]) - position
        # world axes: estimate = exp(r) · truth
        r = c.to_vector(c.multiply([o.w, o.x, o.y, o.z], c.conjugate(quaternion)))
        covariance = np.array(message.pose.covariance).reshape(6, 6)
        rows.append((t, e, r, e @ np.linalg.solve(covariance[:3, :3], e),
                     r @ np.linalg.solve(covariance[3:, 3:], r)))
    if not rows:
        empty = np.zeros((0, 3))
        return Errors(np.zeros(0), empty, empty, np.zeros(0), np.zeros(0))
    return Errors(*(np.array(column) for column in zip(*rows)))
