#!/usr/bin/env python3
"""Simulates a run, replays it, and prints one line with the score of the VALID poses.

    run.py --seed 3 --shake-deg 0.03 --shake-hz 7            every option of sim.py
    run.py --bag DIR                                          scores a bag that exists already

A pose is valid if the volant/status with its stamp says so. NEES is of 3 degrees of freedom, of
position and rotation each; its mean is near 3 and above 30 once in 700,000 for a filter that knows
its errors.
"""

import bisect
import json
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

import sim
from bag import START_NS, VOLANT
from rotations import quaternion_product

CONFIRMED = 0.5  # s
STATES = ["INITIALIZING", "TRACKING", "COASTING", "VISION_ONLY", "LOST"]
USUAL = (
    "filter: initialized from the image",
    "filter: camera time offset",
)  # lines that report no trouble


def messages(path, *topics):
    """Topic, stamp in seconds since the bag's start, message."""
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(topics=topics):
            stamp = message.header.stamp
            yield channel.topic, stamp.sec - START_NS // 10**9 + stamp.nanosec * 1e-9, message


def pose_of(odometry):
    p, q = odometry.pose.pose.position, odometry.pose.pose.orientation
    return np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w])


class Truth:
    def __init__(self, path):
        rows = [(t, *pose_of(m)) for _, t, m in messages(path, "/ground_truth/odometry")]
        self.times, self.positions, self.quaternions = zip(*rows)

    def at(self, t):
        i = min(max(bisect.bisect_right(self.times, t) - 1, 0), len(self.times) - 2)
        part = (t - self.times[i]) / (self.times[i + 1] - self.times[i])
        a, b = self.quaternions[i], self.quaternions[i + 1]
        blend = a + part * (b - a if a @ b > 0 else -b - a)
        position = self.positions[i] + part * (self.positions[i + 1] - self.positions[i])
        return position, blend / np.linalg.norm(blend)


def rotation_error(estimate, truth):
    """Rotation vector in the world from truth to estimate."""
    inverse = truth * [-1, -1, -1, 1]
    q = quaternion_product(estimate, inverse)
    q = q if q[3] > 0 else -q
    sine = np.linalg.norm(q[:3])
    return q[:3] * (2 * np.arctan2(sine, q[3]) / sine if sine > 1e-12 else 2.0)


def replay(bag, out):
    """Runs `volant replay`; returns the lines in which the nodes speak of trouble."""
    command = [
        VOLANT,
        "replay",
        bag / "in.mcap",
        "--rig",
        bag / "rig.yaml",
        "--out",
        out,
        "--overwrite",
        "--threads",
        "1",
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, command))}: {done.stderr.strip()}")
    spoken = [line.removeprefix("volant: ") for line in done.stderr.splitlines()]
    return [line for line in spoken if not line.startswith(USUAL)]


def spans(times, flags, gap=0.3):
    """[first, last] of the times whose flag is set; pauses below `gap` are bridged."""
    found = []
    for t in (t for t, flag in zip(times, flags) if flag):
        if found and t - found[-1][1] < gap:
            found[-1][1] = t
        else:
            found.append([t, t])
    return [[round(a, 2), round(b, 2)] for a, b in found]


def score(out, truth):
    """Figures of the odometry in `out`, from the first pose on."""
    status, rows = {}, []
    for topic, t, message in messages(out, "/volant/status", "/volant/odometry"):
        if topic == "/volant/status":
            status[round(t, 6)] = message
        else:
            rows.append((t, message))
    figures, reasons = [], {}
    for t, odometry in rows:
        said = status[round(t, 6)]
        position, quaternion = pose_of(odometry)
        true_position, true_quaternion = truth.at(t)
        covariance = np.reshape(odometry.pose.covariance, (6, 6))
        shift, turn = position - true_position, rotation_error(quaternion, true_quaternion)
        figures.append(
            (
                t,
                said.valid,
                said.state == 4,
                np.linalg.norm(shift),
                np.degrees(np.linalg.norm(turn)),
                shift @ np.linalg.solve(covariance[:3, :3], shift),
                turn @ np.linalg.solve(covariance[3:, 3:], turn),
            )
        )
        if said.reason:
            reason = f"{STATES[said.state]}: {re.sub(r'[-+]?[0-9]+([.][0-9]+)?', '#', said.reason)}"
            reasons[reason] = reasons.get(reason, 0) + 1
    if not figures:
        return {"poses": 0}
    t, valid, lost, shift, turn, nees_position, nees_rotation = map(np.array, zip(*figures))
    valid = valid.astype(bool)
    result = {
        "poses": len(t),
        # Until images have confirmed the first pose, none is valid.
        "invalid": round(float(1 - valid[t > t[0] + CONFIRMED].mean()), 4),
        "lost": round(float(lost.mean()), 4),
        "invalid_spans_s": spans(t, ~valid),
        "reasons": reasons,
    }
    if valid.any():
        t, shift, turn = t[valid], shift[valid], turn[valid]
        nees_position, nees_rotation = nees_position[valid], nees_rotation[valid]
        worst = int(shift.argmax())
        result |= {
            "rmse_mm": round(1e3 * float(np.sqrt((shift**2).mean())), 2),
            "max_mm": round(1e3 * float(shift[worst]), 1),
            "max_mm_at_s": round(float(t[worst]), 2),
            "max_deg": round(float(turn.max()), 2),
            "max_deg_at_s": round(float(t[turn.argmax()]), 2),
            "nees_position": round(float(nees_position.mean()), 2),
            "nees_rotation": round(float(nees_rotation.mean()), 2),
            "max_nees_position": round(float(nees_position.max()), 1),
            "max_nees_position_at_s": round(float(t[nees_position.argmax()]), 2),
            "max_nees_rotation": round(float(nees_rotation.max()), 1),
            "max_nees_rotation_at_s": round(float(t[nees_rotation.argmax()]), 2),
            "nees_above_30_spans_s": spans(t, (nees_position > 30) | (nees_rotation > 30)),
        }
    return result


def run(bag):
    """Replays and scores the bag in a folder."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.mcap"
        warnings = replay(bag, out)
        return score(out, Truth(bag / "truth.mcap")) | {"warnings": warnings}


def line(result):
    if not result.get("rmse_mm"):
        return f"no valid pose of {result['poses']}; {result['warnings']}"
    return (
        f"rmse {result['rmse_mm']} mm, max {result['max_mm']} mm at {result['max_mm_at_s']} s, "
        f"{result['max_deg']} deg; NEES {result['nees_position']}/{result['nees_rotation']}, "
        f"max {result['max_nees_position']}/{result['max_nees_rotation']}; "
        f"invalid {result['invalid']:.1%}, LOST {result['lost']:.1%}; reasons {result['reasons']}; "
        f"{result['warnings']}"
    )


def main():
    parser = sim.arguments()
    parser.add_argument(
        "--bag",
        type=Path,
        help="score this folder (in.mcap, truth.mcap, rig.yaml); simulate nothing",
    )
    parser.add_argument("--keep", type=Path, help="simulate into this folder and keep it")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        bag = options.bag or options.keep or Path(scratch)
        if not options.bag:
            sim.simulate(options, bag)
        result = run(bag)
    print(json.dumps(result) if options.json else line(result))


if __name__ == "__main__":
    main()
