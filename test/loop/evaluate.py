"""Figures of an episode from its record: errors against the truth, NEES, settling, commands."""

from dataclasses import dataclass

import numpy as np

import crane as c
import hardware as h
from quaternion import conjugate, from_vector, multiply, to_vector

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
        turned = to_vector(multiply(conjugate(a[6:10]), b[6:10]))
        position = a[3:6] + share * (b[3:6] - a[3:6])
        return position, multiply(a[6:10], from_vector(share * turned))

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
        r = to_vector(multiply([o.w, o.x, o.y, o.z], conjugate(quaternion)))
        covariance = np.array(message.pose.covariance).reshape(6, 6)
        rows.append((t, e, r, e @ np.linalg.solve(covariance[:3, :3], e),
                     r @ np.linalg.solve(covariance[3:, 3:], r)))
    if not rows:
        empty = np.zeros((0, 3))
        return Errors(np.zeros(0), empty, empty, np.zeros(0), np.zeros(0))
    return Errors(*(np.array(column) for column in zip(*rows)))


def settling_time(record, truth):
    """Time from the release, or from the push, until the swing stays below 1°, s."""
    begin = record.episode.push[0] if record.episode.push else 0.0
    late = truth.t[(truth.t >= begin) & (truth.swing > SETTLED)]
    return float(late[-1] - begin) if len(late) else 0.0


def waypoint_errors(record, truth):
    """Distances of the platform's origin from its goal, m: over all legs, and after 4 s of each."""
    goals = record.episode.goals
    all_legs, arrived = [], []
    for i, (begin, x, y, _) in enumerate(goals):
        end = goals[i + 1][0] if i + 1 < len(goals) else record.episode.seconds
        for wanted, errors_ in ((begin, all_legs), (begin + 4.0, arrived)):
            keep = (truth.t >= wanted) & (truth.t < end)
            errors_.append(np.hypot(truth.q[keep, 3] - x, truth.q[keep, 4] - y))
    return np.concatenate(all_legs), np.concatenate(arrived)


def rms(values):
    """Root of the mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else np.nan


def command_steps(record, begin, end):
    """Largest change of the commands per 10 ms: rails (m/s), thrust (N). While the controller stops
    and 0.3 s after it resumes no change is counted."""
    spans = invalid_spans(record)
    largest = []
    for name, values in (
        ("cmd_vel", lambda m: (m.twist.linear.x, m.twist.linear.y)),
        ("cmd_thrust", lambda m: (m.wrench.force.x, m.wrench.force.y)),
    ):
        rows = {h.to_seconds(m.header.stamp) - record.released: values(m)
                for _, m in record.received.get(name, [])}
        t = np.array(sorted(rows))
        u = np.array([rows[at] for at in t]).reshape(-1, 2)
        # A command after a longer pause may change by as much more.
        change = np.abs(np.diff(u, axis=0)) / np.maximum(np.diff(t) / 0.01, 1.0)[:, None]
        keep = (t[1:] >= begin) & (t[1:] < end)
        for stop, resumed in spans:
            keep &= ~((t[1:] >= stop) & (t[1:] < resumed + 0.3))
        largest.append(float(change[keep].max(initial=0)))
    return tuple(largest)


def invalid_spans(record):
    """Spans after the release in which the received status was not valid: (begin, end), s."""
    spans, since = [], None
    for t, message in record.received.get("status", []):
        if t < 0:
            continue
        if not message.valid and since is None:
            since = t
        elif message.valid and since is not None:
            spans.append((since, t))
            since = None
    if since is not None:
        spans.append((since, record.episode.seconds))
    return spans


def stops(record):
    """For each span without a valid pose: its length, the time until all commands are zero and,
    after it, until one is not (s; NaN where that does not happen)."""
    t = np.array([t for t, _ in record.commands])
    u = np.array([u for _, u in record.commands])
    moving = np.any(np.abs(u) > 1e-9, axis=1)
    rows = []
    for begin, end in invalid_spans(record):
        zero = t[(t >= begin) & (t <= end + 0.02) & ~moving]
        again = t[(t >= end) & moving]
        rows.append((end - begin, zero[0] - begin if len(zero) else np.nan,
                     again[0] - end if len(again) else np.nan))
    return rows


def stable(record):
    """Whether the damping loop is stable: in the last 2 s the thrust is not that of a limit cycle
    between its limits of 8 N (rms of the two axes below 3 N)."""
    u = np.array([u for t, u in record.commands if t > record.episode.seconds - 2.0])
    return rms(np.linalg.norm(u[:, 3:5], axis=1)) < 3.0


def stamp_errors(record):
    """Errors of the IMU driver's stamps, s: stamp minus the nearest sample's true time."""
    true = np.array(record.samples)
    stamps = [h.to_seconds(m.header.stamp) - record.released
              for _, m in record.received.get("imu", [])]
    return np.array([s - true[np.argmin(np.abs(true - s))] for s in stamps if s >= 0])


def swing_errors(record, truth):
    """Errors of `volant/swing`: angle of the rope against the vertical, degrees, and its length, m,
    with the length of the loaded rope as truth."""
    rows = []
    for _, m in record.received.get("swing", []):
        t = h.to_seconds(m.header.stamp) - record.released
        if t >= 0:
            angle = np.arctan(np.hypot(np.tan(m.angle_x), np.tan(m.angle_y)))
            rows.append((np.degrees(angle) - truth.at(t, truth.swing), m.rope_length - c.ROPE))
    return np.array(rows).reshape(-1, 2)
