"""The table of figures, row by row, and the CSV files."""

import csv
import os
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import evaluate as e

ROOT = Path(__file__).resolve().parents[2]


def recorded():
    """RMSE of the odometry on the recording `nominal`, mm and degrees (docs/src/figures.md)."""
    with open(ROOT / "volant/tests/replay_figures.csv", newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            run = (row["bag"], row["model"], row["estimate"])
            if run == ("nominal", "tight", "volant/odometry"):
                return float(row["position_rmse_mm"]), float(row["rotation_rmse_deg"])
    raise ValueError("volant/tests/replay_figures.csv: no odometry of nominal")


# Figures that an episode may exceed by this ratio.
RECORDED = recorded()
RATIO = 1.15
# As `volant evaluate` does it for the recordings, errors are those without the first second, s: a
# camera time offset is not observable at rest, and is found while the platform begins to move.
FIRST = 1.0


@dataclass
class Row:
    """One figure; `holds` is None where nothing is required."""

    what: str
    required: str
    measured: str
    holds: bool = None


def is_stable(record):
    """Whether the damping loop of a record is stable."""
    return e.stable(record)


def by_name(pairs, name):
    """The records of an episode, with the truth and with Volant; None where it did not run."""
    return next((pair for pair in pairs if pair[0].episode.name == name), None)


def table(pairs, gains):
    """All rows for the episodes that ran."""
    rows = []
    for name in ("swing", "push"):
        if pair := by_name(pairs, name):
            truth, volant = (e.settling_time(r, e.TruthLine(r)) for r in pair)
            rows.append(Row(
                f"{pair[0].episode.title}: settling time below 1°, Volant over truth", "≤ 1.10",
                f"{volant / truth:.3f} ({volant:.2f} s / {truth:.2f} s)", volant / truth <= 1.1))
    if pair := by_name(pairs, "waypoints"):
        errors = [e.waypoint_errors(r, e.TruthLine(r)) for r in pair]
        for k, what in ((1, "from 4 s after each goal"), (0, "whole legs")):
            truth, volant = (e.rms(pair_errors[k]) for pair_errors in errors)
            rows.append(Row(
                f"way-point error, {what}: RMS, Volant over truth", "≤ 1.10",
                f"{volant / truth:.3f} ({1e3 * volant:.1f} mm / {1e3 * truth:.1f} mm)",
                volant / truth <= 1.1))
    faults = [pair for pair in pairs if pair[0].episode.fault()]
    if pairs:
        collided = [r.episode.name for pair in pairs for r in pair if r.collided]
        rows.append(Row("collisions with the ends of the rails", "none",
                        ", ".join(collided) or "none", not collided))
    for truth, volant in faults:
        rows += fault_rows(truth, volant)
    rows += estimator_rows(pairs)
    if len(gains) == 2:
        ratio = gains[True] / gains[False] if gains[False] else np.nan
        rows.append(Row("largest stable damping gain, with prediction over without", "≥ 1.30",
                        f"{ratio:.2f} ({gains[True]} / {gains[False]} N s/m)", ratio >= 1.3))
    return rows


def fault_rows(truth, volant):
    """Stops, resumption and command steps of a fault episode."""
    title, rows = volant.episode.title, []
    begin, end = volant.episode.fault()
    for length, stop, resume in e.stops(volant):
        in_time = stop <= 0.2 or length < 0.2
        rows.append(Row(
            f"{title}: {length:.2f} s without a valid pose: commands zero after, resumed after",
            "≤ 0.20 s, yes", f"{stop:.2f} s, {resume:.2f} s", bool(in_time and resume < 1.0)))
    if not e.stops(volant):
        rows.append(Row(f"{title}: the pose stays valid", "", "yes"))
    for k, what in enumerate(("rails, m/s", "thrust, N")):
        # In the whole episode; and from the fault's begin until 1 s after its end, where with the
        # truth nothing happens.
        ours, theirs = (e.command_steps(r, 0.0, np.inf)[k] for r in (volant, truth))
        near, quiet = (e.command_steps(r, begin, end + 1.0)[k] for r in (volant, truth))
        rows.append(Row(
            f"{title}: largest command step in 10 ms ({what}), Volant over truth", "≤ 1.20",
            f"{ours / theirs:.2f} ({ours:.3f} / {theirs:.3f}; about the fault {near:.3f} / "
            f"{quiet:.3f})", ours <= 1.2 * theirs))
    return rows


def estimator_rows(pairs):
    """Errors and NEES of odometry and prediction against the truth."""
    rows = []
    for _, volant in pairs:
        truth = e.TruthLine(volant)
        title, plain = volant.episode.title, not volant.episode.fault()
        whole = e.errors(volant, "odometry", truth).part(0.0, np.inf)
        odometry = whole.part(FIRST, np.inf)
        millimeters, degrees = odometry.rmse()
        position, rotation = odometry.nees()
        largest = odometry.largest()
        text = (f"{millimeters:.2f} mm, {degrees:.3f}° (largest {largest[0]:.1f} mm, "
                f"{largest[1]:.2f}°; with the first second {whole.rmse()[0]:.2f} mm)")
        near = millimeters <= RATIO * RECORDED[0] and degrees <= RATIO * RECORDED[1]
        rows.append(Row(
            f"{title}: RMSE of volant/odometry",
            f"≤ {RATIO * RECORDED[0]:.2f} mm, {RATIO * RECORDED[1]:.3f}°" if plain else "",
            text, near if plain else None))
        inside = all(0.5 <= n <= 6.0 for n in (position, rotation))
        rows.append(Row(f"{title}: NEES of position, rotation", "0.5 to 6",
                        f"{position:.2f}, {rotation:.2f}", inside))
        if plain:
            ahead = e.errors(volant, "predicted", truth).part(FIRST, np.inf)
            position, rotation = ahead.nees()
            millimeters, degrees = ahead.rmse()
            rows.append(Row(
                f"{title}: NEES of the 50 ms prediction, position, rotation", "1.5 to 6",
                f"{position:.2f}, {rotation:.2f} (RMSE {millimeters:.2f} mm, {degrees:.3f}°)",
                all(1.5 <= n <= 6.0 for n in (position, rotation))))
            angle, _ = e.swing_errors(volant, truth).T
            rows.append(Row(f"{title}: RMSE of volant/swing's angle", "", f"{e.rms(angle):.4f}°"))
    stamps = np.concatenate([e.stamp_errors(v) for _, v in pairs]) if pairs else np.zeros(0)
    if len(stamps):
        rows.append(Row("stamps of imu_driver against the true sample times: largest error", "",
                        f"{1e6 * np.abs(stamps).max():.0f} µs"))
    factors = [v.wall["simulated"] / v.wall["total"] for _, v in pairs]
    if factors:
        rows.append(Row("real-time factor with the live nodes", "1, or lock-step",
                        f"{min(factors):.2f} to {max(factors):.2f}"
                        + ("" if min(factors) > 0.97 else ": lock-step")))
        gaps = sum(len(v.gaps) for _, v in pairs)
        rows.append(Row("messages that the lock-step waited for in vain (0.3 s of real time)", "",
                        str(gaps)))
    return rows


def write_table(rows, path):
    """Writes the rows as CSV."""
    with open(path, "x", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(["what", "required", "measured", "holds"])
        for row in rows:
            out.writerow([row.what, row.required, row.measured,
                          {True: "yes", False: "no", None: ""}[row.holds]])


HEAD = """# Closed loop on third-party physics

Written by `make loop TABLE=test/LOOP.md`. A crane in MuJoCo with the live nodes and
`examples/swing_control`, each episode with the truth and with Volant as feedback. RMSE and NEES are
required as in the recordings: 1.15 times the RMSE of `nominal`, and NEES from 0.5 to 6, where 3 is
that of an exact covariance; without the first second after the release, in which the camera time
offset is found.
"""


def replaceable(path):
    """Whether a page may be written: it does not exist, or was written by this command."""
    if not os.path.exists(path):
        return True
    with open(path, encoding="utf-8") as file:
        return file.readline() == HEAD.splitlines(keepends=True)[0]


def measured_with():
    """Sentence that names the version and commit of a table."""
    manifest = (ROOT / "Cargo.toml").read_text(encoding="utf-8")
    version = re.search(r'^version = "(.*)"', manifest, re.MULTILINE)[1]
    command = ["git", "-C", str(ROOT), "log", "-1", "--format=, commit %h of %cs"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return f"Measured with version {version}{done.stdout.rstrip()}."


def write_page(path, text):
    """Writes the table as a page of the documentation, complete or not at all."""
    partial = f"{path}.{os.getpid()}.partial"
    with open(partial, "x", encoding="utf-8") as file:
        file.write(f"{HEAD}\n{measured_with()}\n\n{text}\n")
    os.replace(partial, path)


def as_text(rows):
    """The rows as a Markdown table."""
    mark = {True: "holds", False: "does not hold", None: ""}
    lines = ["| what | required | measured | |", "| --- | --- | --- | --- |"]
    lines += [f"| {r.what} | {r.required} | {r.measured} | {mark[r.holds]} |" for r in rows]
    return "\n".join(lines)


def series(record):
    """Columns of a run at 100 Hz, by name: time, truth, estimate, status, commands."""
    truth = e.TruthLine(record)
    t = np.array([t for t, _ in record.commands])
    u = np.array([u for _, u in record.commands]).reshape(-1, 6)
    columns = {"t": t, "swing_deg": truth.at(t, truth.swing)}
    for i, name in enumerate(("rail_x", "rail_y", "turn", "x", "y", "z")):
        columns[name] = truth.at(t, truth.q[:, i])
    for i, name in enumerate(("speed_x", "speed_y", "turn_rate", "force_x", "force_y", "torque")):
        columns[name] = u[:, i]
    odometry = record.received.get("odometry", [])
    if odometry:
        at = np.array([e.h.to_seconds(m.header.stamp) - record.released for _, m in odometry])
        for axis in "xyz":
            values = np.array([getattr(m.pose.pose.position, axis) for _, m in odometry])
            # No estimate within 50 ms: a gap.
            far = np.abs(at[np.clip(np.searchsorted(at, t), 0, len(at) - 1)] - t) > 0.05
            columns[f"estimate_{axis}"] = np.where(far, np.nan, np.interp(t, at, values))
    status = record.received.get("status", [])
    if status:
        at = np.array([s for s, _ in status])
        index = np.clip(np.searchsorted(at, t, side="right") - 1, 0, len(at) - 1)
        columns["state"] = np.array([m.state for _, m in status])[index]
        columns["valid"] = np.array([int(m.valid) for _, m in status])[index]
    return columns


def write_csv(record, path):
    """Writes the series of a run."""
    columns = series(record)
    with open(path, "x", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(columns)
        out.writerows([f"{value:.6g}" for value in row] for row in zip(*columns.values()))
