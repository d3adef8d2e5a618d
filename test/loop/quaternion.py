"""Unit quaternions w, x, y, z, as in MuJoCo."""

import mujoco
import numpy as np


def multiply(a, b):
    """Product of two quaternions."""
    out = np.zeros(4)
    mujoco.mju_mulQuat(out, np.asarray(a, float), np.asarray(b, float))
    return out


def rotate(quaternion, vector):
    """Rotates a vector."""
    out = np.zeros(3)
    mujoco.mju_rotVecQuat(out, np.asarray(vector, float), np.asarray(quaternion, float))
    return out


def conjugate(quaternion):
    """Inverse of a unit quaternion."""
    return np.asarray(quaternion) * np.array([1.0, -1.0, -1.0, -1.0])


def from_vector(vector):
    """Quaternion of a rotation vector, rad."""
    vector = np.asarray(vector, float)
    angle = np.linalg.norm(vector)
    if angle < 1e-12:
        return np.array([1.0, *(0.5 * vector)])
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * vector / angle)])


def to_vector(quaternion):
    """Rotation vector of a unit quaternion, rad."""
    q = np.asarray(quaternion, float)
    q = q if q[0] >= 0 else -q
    norm = np.linalg.norm(q[1:])
    return 2 * q[1:] if norm < 1e-12 else q[1:] * (2 * np.arctan2(norm, q[0]) / norm)
