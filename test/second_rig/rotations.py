"""Rotations: quaternions are x, y, z, w; a vector is axis times angle, rad."""

import math

import numpy as np


def cross(a, b):
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def matrix_from_quaternion(q):
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_product(a, b):
    return np.append(a[3] * b[:3] + b[3] * a[:3] + cross(a[:3], b[:3]), a[3] * b[3] - a[:3] @ b[:3])


def quaternion_from_vector(v):
    angle = math.sqrt(v @ v)
    half = 0.5 if angle < 1e-9 else math.sin(angle / 2) / angle
    return np.append(v * half, math.cos(angle / 2))


def matrix_from_vector(v):
    return matrix_from_quaternion(quaternion_from_vector(np.asarray(v, float)))
