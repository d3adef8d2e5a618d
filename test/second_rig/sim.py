#!/usr/bin/env python3
"""Writes bags of a platform that hangs under a ceiling climber, with ground truth.

OUT/in.mcap has what a rig records (climber/markers, camera_info, climber/transform, /tf_static,
volant/imu/data), OUT/truth.mcap ground_truth/odometry, OUT/rig.yaml the rig file that fits unless
an option says otherwise. It knows the frames, the topics and the rig file, and nothing of the
estimator.

Frames are named as in `a_from_b`: it maps a point's coordinates in b to its coordinates in a.
Times are seconds since the bag's start on the IMU's clock; SI units, angles in radians unless named
`deg`.
"""

import argparse
import math
from pathlib import Path

import numpy as np

from bag import header, quaternion_message, transform, vector, write_bag
from rotations import (
    cross,
    matrix_from_quaternion,
    matrix_from_vector,
    quaternion_from_vector,
    quaternion_product,
)

GRAVITY = np.array([0.0, 0.0, -9.80665])
STEP = 0.002  # s, integration step; the climber's motion is sampled twice as densely
WIDTH, HEIGHT, FOCAL, CENTER = 640, 480, 600.0, (321.3, 237.8)
MARKER_SIZE = 0.076
ACCELEROMETER_WALK, GYROSCOPE_WALK = 1e-4, 1e-5  # m/s^2/sqrt(s), rad/s/sqrt(s)
CLIMBER_ACCELERATION, CLIMBER_SPEED = 0.4, 0.3  # m/s^2, m/s
TURN_ACCELERATION, TURN_SPEED = 0.5, 0.4  # rad/s^2, rad/s
MARKERS = {"red": (1, 1), "green": (-1, 1), "blue": (-1, -1), "yellow": (1, -1)}
ENCODER_STEPS = np.array([0.001, 0.001, math.radians(0.05)])  # m, m, rad
DETECTED, PREDICTED, LOST = 0, 1, 2


def axis_motion(rng, times, reach, speed, acceleration):
    """Position of an axis that drives to random places with pauses, acceleration-limited."""
    velocity = np.zeros_like(times)
    start, position = rng.uniform(1.0, 3.0), 0.0
    while start < times[-1]:
        target = rng.uniform(-reach, reach)
        distance = abs(target - position)
        top = min(speed, math.sqrt(distance * acceleration))
        ramp, cruise = top / acceleration, distance / top - top / acceleration
        elapsed = times - start
        profile = acceleration * np.minimum(elapsed, 2 * ramp + cruise - elapsed)
        velocity += math.copysign(1.0, target - position) * np.clip(profile, 0.0, top)
        start, position = start + 2 * ramp + cruise + rng.uniform(0.3, 3.0), target
    step = times[1] - times[0]
    window = np.ones(round(0.1 / step))  # limits the jerk
    padded = np.pad(velocity, (len(window), len(window)), mode="edge")
    velocity = np.convolve(padded, window / len(window), mode="same")[len(window) : -len(window)]
    return np.concatenate([[0.0], np.cumsum((velocity[1:] + velocity[:-1]) / 2) * step])


class Climber:
    """What the encoders say (`encoders`: x, y, turn) and where the carriage really is."""

    def __init__(self, rng, options, times):
        self.times, self.options, self.height = times, options, options.rope + 1.0
        self.encoders = np.column_stack(
            [
                axis_motion(rng, times, 1.0, CLIMBER_SPEED, CLIMBER_ACCELERATION),
                axis_motion(rng, times, 0.7, CLIMBER_SPEED, CLIMBER_ACCELERATION),
                axis_motion(rng, times, 0.6, TURN_SPEED, TURN_ACCELERATION),
            ]
        )
        x, y, _ = self.encoders.T
        self.position = np.column_stack([x, y, np.full(len(times), self.height)])
        if options.rail_sine:
            amplitude, wavelength = options.rail_sine
            phase = 2 * math.pi * x / wavelength
            self.position[:, 1] += amplitude * np.sin(phase + 1.0)
            self.position[:, 2] += amplitude * np.sin(phase)
        step = times[1] - times[0]
        acceleration = np.gradient(np.gradient(self.encoders[:, :2], step, axis=0), step, axis=0)
        rock = math.radians(options.rock_deg) * acceleration / CLIMBER_ACCELERATION
        self.tilt = np.column_stack(
            [-rock[:, 1], rock[:, 0], np.zeros(len(times))]
        )  # rotation vector, world

    def pose(self, t):
        """world_from_climber at t: rotation, translation."""
        turned = matrix_from_vector(self._at(self.tilt, t)) @ matrix_from_vector(
            [0, 0, self.encoder(t)[2]]
        )
        return turned, self._at(self.position, t)

    def encoder(self, t):
        return self._at(self.encoders, t)

    def _at(self, values, t):
        step = self.times[1] - self.times[0]
        where = min(max((t - self.times[0]) / step, 0.0), len(self.times) - 1.001)
        i = int(where)
        return values[i] + (where - i) * (values[i + 1] - values[i])


def smooth_noise(rng, count, sigma, tau, lag):
    """Gauss-Markov noise, 3 axes, that passes a first-order lag: forces that do not jump."""
    noise, filtered, values = sigma * rng.standard_normal(3), np.zeros(3), np.empty((count, 3))
    decay, blend = math.exp(-STEP / tau), 1 - math.exp(-STEP / lag)
    drive = sigma * math.sqrt(1 - decay * decay) * rng.standard_normal((count, 3))
    for i in range(count):
        noise = decay * noise + drive[i]
        filtered = filtered + blend * (noise - filtered)
        values[i] = filtered
    return values


class Platform:
    """A rigid body on an elastic rope: climber, hook, platform. The hook is fixed to the body,
    above its centre of mass, which is the origin of `volant`: a double pendulum.
    """

    HOOK = np.array([0.0, 0.0, 0.3])
    INERTIA = np.array([0.022, 0.024, 0.040])  # m^2, per kilogram
    STRETCH = 2 * math.pi * 7.0  # rad/s, of the rope as a spring

    def __init__(self, rng, options, climber):
        self.options, self.climber = options, climber
        poses = [climber.pose(t) for t in climber.times]
        suspension = np.array([*rng.uniform(-0.03, 0.03, 2), -0.05])
        self.anchor = np.array([r @ suspension + p for r, p in poses])
        half = climber.times[1] - climber.times[0]
        self.anchor_velocity = np.gradient(self.anchor, half, axis=0)
        self.turn = climber.encoders[:, 2]
        self.turn_rate = np.gradient(self.turn, half)
        count = len(climber.times) // 2
        self.force = smooth_noise(rng, count, options.thrust, 0.5, 0.05)
        self.torque = smooth_noise(rng, count, 2 * options.thrust, 0.3, 0.05) * [1, 1, 0.5]
        self.times = climber.times[0 : 2 * count : 2]
        self._integrate(self._start(rng), count)

    def _start(self, rng):
        swing = math.radians(self.options.start_swing)
        heading = rng.uniform(-math.pi, math.pi)
        lean = swing * np.array([math.cos(heading), math.sin(heading), 0.0])
        body = quaternion_product(
            quaternion_from_vector(lean * rng.uniform(0.7, 1.3)),
            quaternion_from_vector(np.array([0, 0, rng.uniform(-0.1, 0.1)])),
        )
        length = self.options.rope - GRAVITY[2] / self.STRETCH**2
        hook = self.anchor[0] + matrix_from_vector(lean) @ np.array([0, 0, -length])
        position = hook - matrix_from_quaternion(body) @ self.HOOK
        return np.concatenate(
            [position, self.anchor_velocity[0], body, rng.normal(0, swing, 3) * [1, 1, 0.3]]
        )

    def _derivative(self, state, k, i):
        """Of position, velocity, quaternion, body rate; k: the climber's sample, i: the noise's."""
        velocity, q, rate = state[3:6], state[6:10], state[10:13]
        r = matrix_from_quaternion(q)
        lever = r @ self.HOOK
        rope = state[:3] + lever - self.anchor[k]
        length = math.sqrt(rope @ rope)
        along = rope / length
        stretching = along @ (velocity + r @ cross(rate, self.HOOK) - self.anchor_velocity[k])
        pull = self.STRETCH**2 * (length - self.options.rope) + 2 * 0.05 * self.STRETCH * stretching
        tension = -max(pull, 0.0) * along
        yaw = math.atan2(r[1, 0], r[0, 0]) - self.turn[k]
        twist = math.remainder(yaw, 2 * math.pi)
        torsion = -(0.9**2) * twist - 0.15 * (r[2] @ rate - self.turn_rate[k])
        acceleration = GRAVITY + tension + r @ self.force[i] - 0.04 * velocity
        torque = (
            r.T @ (cross(lever, tension)) / self.INERTIA + self.torque[i] + r.T @ [0, 0, torsion]
        )
        gyroscopic = cross(rate, self.INERTIA * rate) / self.INERTIA
        turning = torque - gyroscopic - 0.25 * rate
        spin = 0.5 * quaternion_product(q, np.append(rate, 0.0))
        return np.concatenate([velocity, acceleration, spin, turning])

    def _integrate(self, state, count):
        self.states, self.derivatives = np.empty((count, 13)), np.empty((count, 13))
        for i in range(count):
            k, last = 2 * i, min(2 * i + 2, len(self.turn) - 1)
            after = min(i + 1, count - 1)
            a = self._derivative(state, k, i)
            self.states[i], self.derivatives[i] = state, a
            b = self._derivative(state + STEP / 2 * a, k + 1, i)
            c = self._derivative(state + STEP / 2 * b, k + 1, after)
            d = self._derivative(state + STEP * c, last, after)
            state = state + STEP / 6 * (a + 2 * b + 2 * c + d)
            state[6:10] /= math.sqrt(state[6:10] @ state[6:10])

    def at(self, t):
        """Position, velocity, world_from_volant, rate, acceleration, angular acceleration."""
        where = min(max((t - self.times[0]) / STEP, 0.0), len(self.times) - 1.001)
        i = int(where)
        part = where - i
        state = self.states[i] + part * (self.states[i + 1] - self.states[i])
        rates = self.derivatives[i] + part * (self.derivatives[i + 1] - self.derivatives[i])
        bend = 0.5 * part * (part - 1) * STEP**2  # of a line against a parabola
        quaternion = state[6:10] / np.linalg.norm(state[6:10])
        return (
            state[:3] + bend * rates[3:6],
            state[3:6],
            quaternion,
            state[10:13],
            rates[3:6],
            rates[10:13],
        )


class Rig:
    """What rig.yaml says, rounded as it says it."""

    def __init__(self, rng):
        def around(quaternion, deg):
            tilt = quaternion_from_vector(rng.normal(0, math.radians(deg), 3))
            return np.round(quaternion_product(np.array(quaternion), tilt), 8)

        self.camera_position = np.round(
            [*rng.uniform(-0.02, 0.02, 2), rng.uniform(-0.13, -0.09)], 4
        )
        self.camera_orientation = around([math.sqrt(0.5), math.sqrt(0.5), 0, 0], 0.7)
        self.imu_position = np.round(rng.uniform(-0.03, 0.03, 3), 4)
        self.imu_orientation = around([0, 0, 0, 1], 1.5)
        height = rng.uniform(0.01, 0.03)
        self.markers = {
            name: np.round(
                [
                    0.15 * x + rng.uniform(-0.008, 0.008),
                    0.15 * y + rng.uniform(-0.008, 0.008),
                    height,
                ],
                4,
            )
            for name, (x, y) in MARKERS.items()
        }
        self.corners = {
            name: self._square(center, math.radians(rng.uniform(-5, 5)))
            for name, center in self.markers.items()
        }

    @staticmethod
    def _square(center, turn):
        c, s, h = math.cos(turn), math.sin(turn), MARKER_SIZE / 2
        return np.array(
            [
                center + [c * x - s * y, s * x + c * y, 0]
                for x, y in ((h, h), (-h, h), (-h, -h), (h, -h))
            ]
        )

    def yaml(self, options):
        def numbers(values):
            return "[" + ", ".join(f"{v:.10g}" for v in values) + "]"

        lines = [
            "/**:",
            "  ros__parameters:",
            "    frames: {world: world, climber: climber, camera: camera_optical, imu: imu, "
            "volant: volant}",
            f"    camera: {{position: {numbers(self.camera_position)}, "
            f"orientation: {numbers(self.camera_orientation)}}}",
            f"    imu: {{position: {numbers(self.imu_position)}, "
            f"orientation: {numbers(self.imu_orientation)}, "
            f"accelerometer_noise_density: {options.accelerometer_density}, "
            f"gyroscope_noise_density: {options.gyroscope_density}}}",
            f"    markers: {{size: {MARKER_SIZE}, "
            + ", ".join(f"{name}: {numbers(center)}" for name, center in self.markers.items())
            + "}",
        ]
        return "\n".join(lines) + "\n"


def centroid(polygon):
    """Area centroid and area of a polygon, rows of x, y."""
    base = polygon.mean(axis=0)
    a = polygon - base
    b = np.roll(a, -1, axis=0)
    twice = a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1]
    return base + ((a + b) * twice[:, None]).sum(axis=0) / (3 * twice.sum()), abs(twice.sum()) / 2


class Camera:
    """Makes marker observations; keeps what a tracker keeps between images."""

    def __init__(self, rng, options, rig, climber, platform):
        self.rng, self.options, self.rig = rng, options, rig
        self.climber, self.platform = climber, platform
        self.shake_phase = rng.uniform(0, 2 * math.pi, 2)
        self.noise = {name: options.pixel_noise * rng.standard_normal(2) for name in MARKERS}
        self.before = {name: None for name in MARKERS}  # centroid in the image before
        self.occluded = {name: 65535 for name in MARKERS}
        self.hidden = {name: self._hidden_intervals() for name in MARKERS}
        self.hidden[list(MARKERS)[options.seed % 4]].append((0.0, options.hidden_start))

    def _hidden_intervals(self):
        intervals, t = [], 0.0
        while self.options.occlusions > 0 and t < self.options.duration:
            t += self.rng.exponential(1 / self.options.occlusions)
            length = self.rng.uniform(0.1, 1.0)
            intervals.append((t, t + length))
            t += length
        return intervals

    def _project(self, points, t):
        """Pixels of points of the volant frame."""
        position, _, quaternion, *_ = self.platform.at(t)
        turn, place = self.climber.pose(t)
        phase = 2 * math.pi * self.options.shake_hz * t + self.shake_phase
        shake = math.radians(self.options.shake_deg) * np.sin(phase)
        mount = matrix_from_vector([shake[0], shake[1], 0]) @ matrix_from_quaternion(
            self.rig.camera_orientation
        )
        world = points @ matrix_from_quaternion(quaternion).T + position
        in_climber = (world - place) @ turn
        seen = (in_climber - self.rig.camera_position) @ mount
        return FOCAL * seen[:, :2] / seen[:, 2:] + CENTER

    def _true_centroid(self, name, t):
        corners = self._project(self.rig.corners[name], t)
        if self.options.rolling_shutter:  # each row has its own time; t is the middle row's
            for _ in range(3):
                rows = (corners[:, 1] / HEIGHT - 0.5) * self.options.rolling_shutter
                corners = np.array(
                    [
                        self._project(corner[None], t + late)[0]
                        for corner, late in zip(self.rig.corners[name], rows)
                    ]
                )
        inside = np.all((corners > 0) & (corners < [WIDTH - 1, HEIGHT - 1]))
        return *centroid(corners), inside

    def _draw_noise(self, name):
        fresh, tau = (
            self.options.pixel_noise * self.rng.standard_normal(2),
            self.options.centroid_noise_tau,
        )
        decay = math.exp(-1 / (self.options.camera_rate * tau)) if tau > 0 else 0.0
        self.noise[name] = decay * self.noise[name] + math.sqrt(1 - decay**2) * fresh
        return self.noise[name]

    def observe(self, t):
        """The four MarkerObservation of an image taken at t."""
        detected, areas = {}, {}
        for name in MARKERS:
            place, area, inside = self._true_centroid(name, t)
            measured = place + self._draw_noise(name)
            if inside and not any(a <= t < b for a, b in self.hidden[name]):
                detected[name], areas[name] = measured, area
        flow = [
            place - self.before[name]
            for name, place in detected.items()
            if self.before[name] is not None
        ]
        observations = []
        for color, name in enumerate(MARKERS):
            state, place, sigma = LOST, None, math.nan
            if name in detected:
                state, place, sigma, self.occluded[name] = (
                    DETECTED,
                    detected[name],
                    self.options.pixel_noise,
                    0,
                )
            else:
                self.occluded[name] = min(self.occluded[name] + 1, 65535)
                if self.occluded[name] <= 6 and flow and self.before[name] is not None:
                    state, place = PREDICTED, self.before[name] + np.mean(flow, axis=0)
                    sigma = 2.0 * self.occluded[name]
            self.before[name] = place
            x, y = (math.nan, math.nan) if place is None else place
            observations.append(
                {
                    "color": color,
                    "state": state,
                    "occluded_frames": self.occluded[name],
                    "x": float(x),
                    "y": float(y),
                    "area": float(areas.get(name, 0.0)),
                    "covariance": [sigma**2, 0.0, 0.0, sigma**2],
                }
            )
        return observations


class Imu:
    def __init__(self, rng, options, rig, platform):
        self.rng, self.options, self.rig, self.platform = rng, options, rig, platform
        self.accelerometer_bias = rng.normal(0, options.accelerometer_bias, 3)
        self.gyroscope_bias = rng.normal(0, options.gyroscope_bias, 3)

    def sample(self, t):
        """Rate and specific force in the imu frame at t, with bias and noise."""
        _, _, quaternion, rate, acceleration, turning = self.platform.at(t)
        lever, volant_from_imu = self.rig.imu_position, matrix_from_quaternion(
            self.rig.imu_orientation
        )
        force = matrix_from_quaternion(quaternion).T @ (acceleration - GRAVITY)
        force = force + cross(turning, lever) + cross(rate, cross(rate, lever))
        o, hz, draw = self.options, self.options.imu_rate, self.rng.standard_normal
        self.accelerometer_bias += ACCELEROMETER_WALK / math.sqrt(hz) * draw(3)
        self.gyroscope_bias += GYROSCOPE_WALK / math.sqrt(hz) * draw(3)
        return (
            volant_from_imu.T @ rate
            + self.gyroscope_bias
            + o.gyroscope_density * math.sqrt(hz) * draw(3),
            volant_from_imu.T @ force
            + self.accelerometer_bias
            + o.accelerometer_density * math.sqrt(hz) * draw(3),
        )


def static_transforms(rig):
    transforms = [
        transform(0, "climber", "camera_optical", rig.camera_position, rig.camera_orientation),
        transform(0, "volant", "imu", rig.imu_position, rig.imu_orientation),
    ]
    return [(0.0, "/tf_static", "tf2_msgs/msg/TFMessage", {"transforms": transforms})]


def imu_messages(rng, options, imu):
    gyroscope, accelerometer = (
        (density**2 * options.imu_rate * np.eye(3)).ravel().tolist()
        for density in (options.gyroscope_density, options.accelerometer_density)
    )
    for t in np.arange(0.003, options.duration, 1 / options.imu_rate):
        rate, force = imu.sample(t)
        yield t + rng.uniform(2e-4, 8e-4), "/volant/imu/data", "sensor_msgs/msg/Imu", {
            "header": header(t, "imu"),
            "orientation": quaternion_message([0, 0, 0, 1]),
            "orientation_covariance": [-1.0] + 8 * [0.0],
            "angular_velocity": vector(rate),
            "angular_velocity_covariance": gyroscope,
            "linear_acceleration": vector(force),
            "linear_acceleration_covariance": accelerometer,
        }


def encoder_messages(rng, options, climber):
    """The climber's computer stamps these and the images, `offset` before the IMU's clock."""
    for t in np.arange(0.011, options.duration, 1 / options.encoder_rate):
        steps = climber.encoder(t) / ENCODER_STEPS
        if options.encoder_noise:
            steps = steps + options.encoder_noise * rng.standard_normal(3)
        x, y, turn = np.round(steps) * ENCODER_STEPS
        stamp = t + options.encoder_late - options.offset
        yield t + options.encoder_late + rng.uniform(
            3e-4, 1e-3
        ), "/climber/transform", "geometry_msgs/msg/TransformStamped", transform(
            stamp,
            "world",
            "climber",
            [x, y, climber.height],
            quaternion_from_vector(np.array([0, 0, turn])),
        )


def camera_messages(rng, options, camera):
    k = [FOCAL, 0.0, CENTER[0], 0.0, FOCAL, CENTER[1], 0.0, 0.0, 1.0]
    info = {
        "height": HEIGHT,
        "width": WIDTH,
        "distortion_model": "plumb_bob",
        "d": 5 * [0.0],
        "k": k,
        "r": [1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0],
        "p": [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0],
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }
    for t in np.arange(0.027, options.duration, 1 / options.camera_rate):
        stamp, log = header(
            t - options.offset, "camera_optical"
        ), t + options.latency + rng.uniform(0, 4e-3)
        yield log, "/climber/camera/camera_info", "sensor_msgs/msg/CameraInfo", {
            "header": stamp,
            **info,
        }
        yield log + 1e-4, "/climber/markers", "volant_msgs/msg/MarkerObservations", {
            "header": stamp,
            "markers": camera.observe(t),
        }


def truth_messages(options, platform):
    for t in np.arange(0.0, options.duration + 0.02, 0.005):
        position, velocity, quaternion, rate, *_ = platform.at(t)
        twist = {
            "linear": vector(matrix_from_quaternion(quaternion).T @ velocity),
            "angular": vector(rate),
        }
        yield t, "/ground_truth/odometry", "nav_msgs/msg/Odometry", {
            "header": header(t, "world"),
            "child_frame_id": "volant",
            "pose": {
                "pose": {
                    "position": vector(position),
                    "orientation": quaternion_message(quaternion),
                },
                "covariance": 36 * [0.0],
            },
            "twist": {"twist": twist, "covariance": 36 * [0.0]},
        }


def simulate(options, out):
    """Writes out/in.mcap, out/truth.mcap and out/rig.yaml."""
    # One stream each, so that an option changes nothing but what it names.
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(options.seed).spawn(6)]
    rig = Rig(streams[0])
    climber = Climber(streams[1], options, np.arange(0.0, options.duration + 0.1, STEP / 2))
    platform = Platform(streams[2], options, climber)
    camera, imu = Camera(streams[3], options, rig, climber, platform), Imu(
        streams[4], options, rig, platform
    )
    out.mkdir(parents=True, exist_ok=True)
    existing = [name for name in ("in.mcap", "truth.mcap", "rig.yaml") if (out / name).exists()]
    if existing:
        raise SystemExit(f"{out} has {existing[0]} already: choose another folder")
    write_bag(
        out / "in.mcap",
        [
            *static_transforms(rig),
            *imu_messages(streams[5], options, imu),
            *encoder_messages(streams[5], options, climber),
            *camera_messages(streams[5], options, camera),
        ],
    )
    write_bag(out / "truth.mcap", truth_messages(options, platform))
    (out / "rig.yaml").write_text(rig.yaml(options))


NUMBERS = (  # option, default, meaning
    ("--duration", 40.0, "s"),
    ("--rope", 1.6, "length from climber to hook, m"),
    ("--start-swing", 2.0, "angle of the rope at the start, deg"),
    ("--thrust", 0.1, "disturbance by thrusters, m/s^2 (1 sigma)"),
    ("--camera-rate", 30.0, "Hz"),
    ("--imu-rate", 100.0, "Hz"),
    ("--encoder-rate", 50.0, "Hz"),
    ("--encoder-noise", 0.0, "of the encoders before rounding, steps (1 sigma)"),
    ("--pixel-noise", 0.1, "of a centroid, px (1 sigma), as its covariance says"),
    ("--occlusions", 0.0, "per marker and second, of 0.1 to 1 s each"),
    ("--hidden-start", 0.0, "one marker is hidden for so long from the start, s"),
    ("--latency", 0.025, "from exposure to observation, s"),
    ("--offset", 0.0, "s, image time + offset = IMU time; the encoders' too"),
    ("--accelerometer-density", 0.002, "white noise, m/s^2/sqrt(Hz)"),
    ("--gyroscope-density", 0.00087, "white noise, rad/s/sqrt(Hz)"),
    ("--accelerometer-bias", 0.05, "at the start, m/s^2 (1 sigma)"),
    ("--gyroscope-bias", 0.01, "at the start, rad/s (1 sigma)"),
)
FAULTS = (
    ("--shake-deg", 0.0, "amplitude of the camera against its mount, deg"),
    ("--shake-hz", 7.0, "frequency of that shake, Hz"),
    ("--rock-deg", 0.0, "tilt of the carriage at its full acceleration, deg"),
    ("--encoder-late", 0.0, "s by which encoder samples are stamped too late"),
    ("--rolling-shutter", 0.0, "s from the first row to the last"),
    ("--centroid-noise-tau", 0.0, "correlation time of the pixel noise, s"),
)


def arguments():
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    rig = parser.add_argument_group("rig and motion")
    fault = parser.add_argument_group("what the rig file does not know")
    rig.add_argument("--seed", type=int, default=1, help="of everything random")
    fault.add_argument(
        "--rail-sine",
        type=float,
        nargs=2,
        metavar=("AMPLITUDE", "WAVELENGTH"),
        help="the x rail waves in y and z, m",
    )
    for group, numbers in ((rig, NUMBERS), (fault, FAULTS)):
        for name, default, meaning in numbers:
            group.add_argument(name, type=float, default=default, metavar="N", help=meaning)
    return parser


if __name__ == "__main__":
    command = arguments()
    command.add_argument("--out", type=Path, required=True, help="folder to write")
    options = command.parse_args()
    simulate(options, options.out)
