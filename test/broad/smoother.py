"""Motion of an IMU from its samples and from optical motion capture: a fixed-interval smoother.

The optical pose alone is no ground truth for an inertial estimator: its attitude is off by some
tenths of a degree, and its marker body is not the IMU. The smoother estimates the trajectory with
the biases, the lever arm, the turn of the marker body and the tilt of the optical frame, by
Gauss-Newton: each iteration is a Kalman filter with a backward pass (Rauch, Tung, Striebel 1965)
over the errors of the trajectory before.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

GRAVITY = np.array([0.0, 0.0, -9.81])
# Error state: attitude (turn of the body, rad), velocity (m/s), position (m), biases of gyroscope
# (rad/s) and accelerometer (m/s²), lever arm (m), turn of the marker body (rad), of the optical
# frame (rad; about its vertical it is fixed).
TURN, SPEED, PLACE, GYRO, ACCEL, LEVER, BODY, FRAME = (slice(3 * k, 3 * k + 3) for k in range(8))
SIZE = 24
START = np.repeat([0.2, 1.0, 1.0, 0.02, 0.3, 0.3, 0.05, 0.03], 3)
START[-1] = 1e-5
# Noise of a sample: rad/s, m/s²; random walk of the biases per √s.
RATE_NOISE, FORCE_NOISE = 1.7e-3, 0.06
GYRO_WALK, ACCEL_WALK = 2e-5, 1e-3
# The optical errors are correlated over many samples; as white noise they count as these: m, rad.
OPTICAL = np.r_[np.full(3, 1e-3), np.full(3, np.radians(4.0))]


@dataclass
class Motion:
    """Trajectory of the IMU: `turn` is world_from_imu, the rest in m, rad/s and m/s²."""

    turn: Rotation
    place: np.ndarray
    rate: np.ndarray
    misfit_mm: float


def skew(v):
    zero = np.zeros_like(v[..., 0])
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    rows = [np.stack(row, -1) for row in ([zero, -z, y], [z, zero, -x], [-y, x, zero])]
    return np.stack(rows, -2)


def smooth(force, rate, turn, place, period, iterations=4):
    """Return the motion of an IMU with samples `force` (m/s²) and `rate` (rad/s), `period` s apart,
    and optical poses at the same instants: `turn` (quaternions x, y, z, w; NaN where unseen) and
    `place` (m)."""
    count = len(force)
    seen = np.isfinite(turn).all(1) & np.isfinite(place).all(1)
    index = np.arange(count)
    turn = np.stack([np.interp(index, index[seen], turn[seen, k]) for k in range(4)], 1)
    place = np.stack([np.interp(index, index[seen], place[seen, k]) for k in range(3)], 1)
    optical = Rotation.from_quat(turn)
    attitude, position = optical, place.copy()
    velocity = np.gradient(position, period, axis=0)
    biases = np.zeros((count, 6))
    lever, body, frame = np.zeros(3), Rotation.identity(), Rotation.identity()
    for _ in range(iterations):
        matrices = attitude.as_matrix()
        clean_rate, clean_force = rate - biases[:, :3], force - biases[:, 3:]
        acceleration = np.einsum("nij,nj->ni", matrices, clean_force) + GRAVITY
        mean = (acceleration[:-1] + acceleration[1:]) / 2
        step = Rotation.from_rotvec((clean_rate[:-1] + clean_rate[1:]) / 2 * period)
        ahead = attitude[:-1] * step
        moved = np.zeros((count, SIZE))
        moved[1:, TURN] = (attitude[1:].inv() * ahead).as_rotvec()
        moved[1:, SPEED] = velocity[:-1] + mean * period - velocity[1:]
        moved[1:, PLACE] = position[:-1] + velocity[:-1] * period - position[1:]
        moved[1:, PLACE] += mean * period**2 / 2
        moved[1:, GYRO.start : ACCEL.stop] = biases[:-1] - biases[1:]
        turned = np.swapaxes(Rotation.from_rotvec(clean_rate * period).as_matrix(), 1, 2)
        by_turn = matrices @ skew(clean_force)
        seen_place = frame.apply(place)
        residual = np.zeros((count, 6))
        residual[:, :3] = seen_place - position - matrices @ lever
        residual[:, 3:] = (attitude.inv() * frame * optical * body).as_rotvec()
        optics = (lever, seen_place, residual, seen)
        errors = backward(forward(moved, turned, by_turn, matrices, optics, period))
        attitude = attitude * Rotation.from_rotvec(errors[:, TURN])
        velocity, position = velocity + errors[:, SPEED], position + errors[:, PLACE]
        biases = biases + errors[:, GYRO.start : ACCEL.stop]
        constant = errors[count // 2]
        lever = lever + constant[LEVER]
        body = body * Rotation.from_rotvec(constant[BODY])
        frame = Rotation.from_rotvec(constant[FRAME]) * frame
    misfit = frame.apply(place) - position - attitude.apply(lever)
    misfit_mm = 1e3 * np.sqrt((misfit[seen] ** 2).sum(1).mean())
    return Motion(attitude, position, rate - biases[:, :3], misfit_mm)


def forward(moved, turned, by_turn, matrices, optics, period):
    """Kalman filter. Return per sample the filtered and predicted mean and covariance, and the
    transition to it."""
    lever, seen_place, residual, seen = optics
    one = np.eye(SIZE)
    noise = np.zeros(SIZE)
    noise[TURN], noise[SPEED], noise[PLACE] = RATE_NOISE * period, FORCE_NOISE * period, 1e-7
    noise[GYRO], noise[ACCEL] = GYRO_WALK * period**0.5, ACCEL_WALK * period**0.5
    mean, covariance = np.zeros(SIZE), np.diag(START**2)
    steps = []
    for k in range(len(moved)):
        transition = one.copy()
        if k > 0:
            transition[TURN, TURN], transition[TURN, GYRO] = turned[k - 1], -period * np.eye(3)
            transition[SPEED, TURN] = -by_turn[k - 1] * period
            transition[SPEED, ACCEL] = -matrices[k - 1] * period
            transition[PLACE, TURN] = -by_turn[k - 1] * period**2 / 2
            transition[PLACE, ACCEL] = -matrices[k - 1] * period**2 / 2
            transition[PLACE, SPEED] = period * np.eye(3)
            mean = transition @ mean + moved[k]
            covariance = transition @ covariance @ transition.T + np.diag(noise**2)
        predicted = (mean, covariance)
        if seen[k]:
            rows = np.zeros((6, SIZE))
            rows[:3, PLACE], rows[:3, LEVER] = np.eye(3), matrices[k]
            rows[:3, TURN] = -matrices[k] @ skew(lever)
            rows[:3, FRAME] = skew(seen_place[k])
            rows[3:, TURN], rows[3:, BODY] = np.eye(3), -np.eye(3)
            rows[3:, FRAME] = -matrices[k].T
            spread = rows @ covariance @ rows.T + np.diag(OPTICAL**2)
            gain = np.linalg.solve(spread, rows @ covariance).T
            mean = mean + gain @ (residual[k] - rows @ mean)
            covariance = covariance - gain @ rows @ covariance
            covariance = (covariance + covariance.T) / 2
        steps.append((mean, covariance, *predicted, transition))
    return steps


def backward(steps):
    """Backward pass. Return the smoothed errors, one row per sample."""
    smoothed = np.stack([step[0] for step in steps])
    tiny = 1e-18 * np.eye(SIZE)
    for k in range(len(steps) - 2, -1, -1):
        mean, covariance = steps[k][:2]
        _, _, predicted, spread, transition = steps[k + 1]
        gain = np.linalg.solve(spread + tiny, transition @ covariance).T
        smoothed[k] = mean + gain @ (smoothed[k + 1] - predicted)
    return smoothed
