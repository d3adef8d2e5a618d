"""Recordings with the IMU samples of the BROAD data set, and what the estimator reaches on them.

BROAD (Laidig, Caruso, Cereatti, Seel: "BROAD: A Benchmark for Robust Inertial Orientation
Estimation", Data 6(7), 2021, CC BY 4.0, https://github.com/dlaidig/broad) has the samples of an IMU
(286 Hz) that is moved by hand, with optical motion capture. IMU samples and motion are real here;
camera, markers (centroids with 0.1 px of noise, no images) and climber are virtual. Trials in which
the IMU is turned over are left out. The estimator was tuned on none of these windows.

The truth is smoothed from motion capture and the same IMU samples (smoother.py): what motion capture
does not resolve follows the IMU, and an error of the IMU shows less than it would against a
reference of its own.

    make broad BROAD=/path/to/broad/data_mat
"""

import argparse
import concurrent.futures
import json
import os
import re
import subprocess
import sys
from pathlib import Path

# One thread per recording: the matrices are small.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import scipy.io

import recording
from rig import Scene, random_rig
from smoother import smooth

# Trial, and beginnings of the windows, s.
WINDOWS = {
    "07_undisturbed_fast_rotation_B": (70, 85, 110),
    "10_undisturbed_slow_translation_A": (40, 75, 110),
    "11_undisturbed_slow_translation_B": (60, 140),
    "12_undisturbed_slow_translation_C": (35, 70, 110),
    "14_undisturbed_slow_translation_with_breaks_B": (45, 80, 120),
    "15_undisturbed_fast_translation_A": (80, 115),
    "16_undisturbed_fast_translation_B": (40, 80, 120),
    "18_undisturbed_fast_translation_with_breaks_B": (35, 70, 110),
    "25_disturbed_tapping_B": (90, 120),
    "27_disturbed_phone_vibration_B": (45, 80, 120),
}
SECONDS = 30.0
# The estimates are compared from here on, s.
SETTLED = 3
MARGIN = 300
# The optical poses are late against the samples by this many of them: the shift with the smallest
# misfit in trials 11, 15 and 16.
LATE = 0.85
OFFSETS = (0.0, 0.004, -0.006, 0.012, -0.018, 0.03)


def shifted(values, first, count, late):
    place = np.arange(first, first + count) - late
    low = np.floor(place).astype(int)
    share = (place - low)[:, None]
    a, b = values[low], values[low + 1]
    if values.shape[1] == 4:
        b = np.where((a * b).sum(1, keepdims=True) < 0, -b, b)
    return a * (1 - share) + b * share


def make(folder, trial, begin, seed, out, texts):
    random = np.random.default_rng(seed)
    data = scipy.io.loadmat(Path(folder) / f"{trial}.mat")
    period = 1.0 / float(data["sampling_rate"].squeeze())
    first, count = int(begin / period) - MARGIN, int(SECONDS / period) + 2 * MARGIN
    window = slice(first, first + count)
    force, rate = data["imu_acc"][window], data["imu_gyr"][window]
    # BROAD's quaternions begin with w.
    turn = shifted(data["opt_quat"][:, [1, 2, 3, 0]], first, count, LATE)
    motion = smooth(force, rate, turn, shifted(data["opt_pos"], first, count, LATE), period)
    rest = slice(600, 600 + int(3 / period))
    noise = [np.sqrt((data[key][rest].var(0)).mean() * period) for key in ("imu_acc", "imu_gyr")]
    scene = Scene(motion, period, random_rig(random), random)
    inside = range(MARGIN, count - MARGIN)
    samples = [(scene.time[k], force[k], rate[k]) for k in inside]
    start = 10**18 + int(random.integers(10, 90)) * 10**9
    offset = OFFSETS[seed % len(OFFSETS)]
    recording.write(out, texts, scene, samples, noise, start, offset, random)
    return f"{Path(out).name}: optical misfit {motion.misfit_mm:.2f} mm"


def run(volant, *arguments):
    command = [volant, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{volant} {arguments[0]}: {done.stderr.strip()}")


def evaluate(volant, folder):
    bag, estimates, result = (folder / n for n in ("in.mcap", "estimates.mcap", "result.json"))
    run(volant, "replay", bag, "--rig", folder / "rig.yaml", "--out", estimates, "--overwrite")
    truth = ["--truth", folder / "truth.mcap", "--skip", SETTLED]
    run(volant, "evaluate", estimates, *truth, "--json", result, "--overwrite")
    found = {e["estimate"]: e for e in json.loads(result.read_text())["estimates"]}
    return found["volant/odometry"]


def measured_with():
    """Sentence that names the version and commit of a table."""
    root = Path(__file__).resolve().parents[2]
    manifest = (root / "Cargo.toml").read_text(encoding="utf-8")
    version = re.search(r'^version = "(.*)"', manifest, re.MULTILINE)[1]
    command = ["git", "-C", str(root), "log", "-1", "--format=, commit %h of %cs"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return f"Measured with version {version}{done.stdout.rstrip()}."


def table(results):
    lines = [
        "# Real IMU samples",
        "",
        "Written by `make broad`: recordings whose IMU samples and motion are real (BROAD,",
        "Laidig et al. 2021, CC BY 4.0; 286 Hz, by hand, with optical motion capture) and whose",
        "camera, markers (0.1 px of noise), encoders and clock offset are virtual. Windows of",
        "30 s that the estimator was not tuned on, with its default parameters; from 3 s on.",
        "The name is the trial and the beginning of the window, s; 07 turns fast, 25 is tapped,",
        "27 vibrates, 15, 16 and 18 reach 5 to 10 g. NEES is 3 where the covariance is right.",
        "The truth is smoothed from motion capture and the same IMU samples: an error of the IMU",
        "shows less than it would against a reference of its own.",
        "",
        measured_with(),
        "",
        "| recording | position RMSE, max (mm) | rotation RMSE, max (°) | NEES position, rotation |",
        "| --- | --- | --- | --- |",
    ]
    for name, e in results:
        place, turn = e["position_mm"], e["rotation_deg"]
        lines.append(
            f"| {name} | {place['rmse']:.2f}, {place['max']:.1f} | {turn['rmse']:.3f}, "
            f"{turn['max']:.2f} | {e['nees_position']:.1f}, {e['nees_rotation']:.1f} |"
        )
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(prog="make broad", description=__doc__.split("\n\n")[0])
    parser.add_argument("data", help="folder data_mat of BROAD")
    parser.add_argument("--out", required=True, help="folder for the recordings")
    parser.add_argument("--volant", required=True, help="the program volant")
    parser.add_argument("--table", help="table to write")
    parser.add_argument("--overwrite", action="store_true", help="replace existing files")
    options = parser.parse_args()
    out = Path(options.out)
    for path in (out / "bags", *([Path(options.table)] if options.table else [])):
        if path.exists() and not options.overwrite:
            sys.exit(f"make broad: {path} exists; give another or --overwrite")
    missing = [t for t in WINDOWS if not (Path(options.data) / f"{t}.mat").is_file()]
    if missing:
        sys.exit(
            f"make broad: {options.data} has no {missing[0]}.mat: BROAD is the folder data_mat of "
            "https://github.com/dlaidig/broad"
        )
    template = out / "template"
    run(options.volant, "simulate", "--out", template, "--seconds", 2, "--overwrite")
    texts = recording.definitions(*template.rglob("*.mcap"))
    jobs = []
    with concurrent.futures.ProcessPoolExecutor() as pool:
        windows = [(trial, begin) for trial, begins in WINDOWS.items() for begin in begins]
        for seed, (trial, begin) in enumerate(windows):
            folder = out / "bags" / f"{trial[:2]}_{begin:03}"
            job = pool.submit(make, options.data, trial, begin, seed, folder, texts)
            jobs.append((folder, job))
        results = []
        for folder, job in jobs:
            print(job.result(), flush=True)
            results.append((folder.name, evaluate(options.volant, folder)))
    text = table(results)
    print(text)
    if options.table:
        new = Path(f"{options.table}.new")
        new.write_text(text)
        new.replace(options.table)


if __name__ == "__main__":
    main()
