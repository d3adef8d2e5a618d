"""Writes a recording: a folder with in.mcap, rig.yaml, truth.mcap and truth_markers.csv."""

import csv
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.writer import Writer

from rig import CAMERA, COLORS, DISTORTION, PIXEL_NOISE, SIDE, SIZE

DETECTED, LOST = 0, 2
NEVER_HIDDEN = "marker,from_ns,to_ns\n"


def nanoseconds(seconds):
    return int(round(seconds * 1e9))


def header(stamp, frame):
    return {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": frame}


def vector(v):
    return dict(zip("xyz", map(float, v)))


def quaternion(turn):
    return dict(zip("xyzw", map(float, turn.as_quat())))


def diagonal(variance):
    return [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance]


def definitions(*bags):
    """Return the message definitions that are in these bags, by the names of the types."""
    found = {}
    for bag in bags:
        with open(bag, "rb") as file:
            for schema in make_reader(file).get_summary().schemas.values():
                found[schema.name] = schema.data.decode()
    return found


def write_bag(path, texts, messages):
    """Write (time of arrival in ns, topic, type, message) in the order of their arrival."""
    with open(path, "wb") as file:
        writer = Writer(file)
        names = sorted({name for _, _, name, _ in messages})
        schemas = {name: writer.register_msgdef(name, texts[name]) for name in names}
        for time, topic, name, message in sorted(messages, key=lambda m: m[0]):
            writer.write_message(topic, schemas[name], message, time, time)
        writer.finish()


def write(folder, texts, scene, samples, noise, start, offset, random):
    """Write the recording of `scene`. `samples`: (time s, force, rate) of the IMU; `noise`: its
    densities; `start`: stamp of time 0, ns; image and encoder stamps are `offset` s early."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    first, last = samples[0][0], samples[-1][0]

    def stamp(time):
        return start + nanoseconds(time)

    def later(at, least, mean):
        return at + nanoseconds(least + random.exponential(mean))

    messages = []
    period = (last - first) / (len(samples) - 1)
    for time, force, rate in samples:
        at = stamp(time)
        message = {
            "header": header(at, "imu"),
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            "orientation_covariance": [-1.0] + [0.0] * 8,
            "angular_velocity": vector(rate),
            "angular_velocity_covariance": diagonal(noise[1] ** 2 / period),
            "linear_acceleration": vector(force),
            "linear_acceleration_covariance": diagonal(noise[0] ** 2 / period),
        }
        messages.append((later(at, 1e-3, 1e-3), "/volant/imu/data", "sensor_msgs/msg/Imu", message))
    time = first + 0.004
    while time < last:
        place, turn = scene.encoders(time)
        at = stamp(time - offset)
        message = {
            "header": header(at, "world"),
            "child_frame_id": "climber",
            "transform": {"translation": vector(place), "rotation": quaternion(turn)},
        }
        name = "geometry_msgs/msg/TransformStamped"
        messages.append((later(at, 3e-3, 2e-3), "/climber/transform", name, message))
        time += 0.02 * (1 + random.normal(0, 0.005))
    rows = []
    time = first + 0.06
    while time < last - 0.05:
        at = stamp(time - offset)
        row, markers = [at, at], []
        for color, (center, area, seen) in enumerate(scene.image(time)):
            x, y = area + random.normal(0, PIXEL_NOISE, 2)
            row += [*center, *area, float(seen)]
            markers.append(
                {
                    "color": color,
                    "state": DETECTED if seen else LOST,
                    "occluded_frames": 0 if seen else 1,
                    "x": float(x) if seen else float("nan"),
                    "y": float(y) if seen else float("nan"),
                    "covariance": [PIXEL_NOISE**2, 0.0, 0.0, PIXEL_NOISE**2],
                    "area": 1000.0 if seen else 0.0,
                }
            )
        place, turn = scene.camera_at(time)
        rows.append([*row, *place, *turn.as_quat()])
        arrival = later(at, 22e-3, 3e-3)
        message = {"header": header(at, "camera_optical"), "markers": markers}
        name = "volant_msgs/msg/MarkerObservations"
        messages.append((arrival, "/climber/markers", name, message))
        message = camera_info(header(at, "camera_optical"))
        name = "sensor_msgs/msg/CameraInfo"
        messages.append((arrival + 10**5, "/climber/camera/camera_info", name, message))
        time += (1 + random.normal(0, 0.001)) / 29.97
    write_bag(folder / "in.mcap", texts, messages)
    write_bag(folder / "truth.mcap", texts, list(truth(scene, stamp)))
    write_rows(folder / "truth_markers.csv", rows)
    (folder / "rig.yaml").write_text(rig_file(scene.rig, noise))
    (folder / "windows.csv").write_text(NEVER_HIDDEN)


def camera_info(head):
    fx, fy, cx, cy = CAMERA
    return {
        "header": head,
        "width": SIZE[0],
        "height": SIZE[1],
        "distortion_model": "plumb_bob",
        "d": list(DISTORTION),
        "k": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "r": diagonal(1.0),
        "p": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def truth(scene, stamp):
    velocity = scene.turn.inv().apply(scene.velocity)
    for k, time in enumerate(scene.time):
        pose = {"position": vector(scene.place[k]), "orientation": quaternion(scene.turn[k])}
        twist = {"linear": vector(velocity[k]), "angular": vector(scene.rate[k])}
        message = {
            "header": header(stamp(time), "world"),
            "child_frame_id": "volant",
            "pose": {"pose": pose, "covariance": [0.0] * 36},
            "twist": {"twist": twist, "covariance": [0.0] * 36},
        }
        yield stamp(time), "/ground_truth/odometry", "nav_msgs/msg/Odometry", message


def write_rows(path, rows):
    names = [f"{c}_{what}" for c in COLORS for what in ("x", "y", "cx", "cy", "shown")]
    pose = ["cam_x", "cam_y", "cam_z", "cam_qx", "cam_qy", "cam_qz", "cam_qw"]
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["stamp_ns", "true_ns", *names, *pose])
        writer.writerows(rows)


def rig_file(rig, noise):
    def numbers(values):
        return "[" + ", ".join(f"{x:.8g}" for x in values) + "]"

    markers = "".join(f"      {c}: {numbers(p)}\n" for c, p in zip(COLORS, rig.markers))
    return f"""/**:
  ros__parameters:
    frames: {{world: world, climber: climber, camera: camera_optical, imu: imu, volant: volant}}
    camera:
      position: {numbers(rig.camera_place)}
      orientation: {numbers(rig.camera_turn.as_quat())}
    imu:
      position: {numbers(rig.imu_place)}
      orientation: {numbers(rig.imu_turn.as_quat())}
      accelerometer_noise_density: {noise[0]:.6g}
      gyroscope_noise_density: {noise[1]:.6g}
    markers:
      size: {SIDE}
{markers}"""
