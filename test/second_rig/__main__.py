"""The estimator on a second simulator, written from the frames, topics and the rig file alone.

    python test/second_rig [--only NAME] [--seeds N] [--keep FOLDER]

Each case is simulated and replayed with several seeds; a line says what became of it. --keep writes
new files only. Exit status 0 when every run stays within its limits, 1 when one does not.
"""

import argparse
import shlex
import sys
import tempfile
from pathlib import Path

import run
import sim

# Name, options of sim.py, largest error of a valid pose (mm), largest share of invalid poses.
CASES = (
    ("clean", "", 12, 0.001),
    ("clean, 60 Hz", "--camera-rate 60", 12, 0.001),
    ("clean, 10 Hz, rope of 3 m", "--camera-rate 10 --rope 3 --duration 20", 60, 0.05),
    ("rope of 3 m, 0.3 px", "--rope 3 --pixel-noise 0.3", 60, 0.01),
    (
        "three markers at the start, swing of 9 deg",
        "--hidden-start 1.4 --start-swing 9 --camera-rate 25 --duration 8",
        80,
        0.02,
    ),
    ("camera shakes 0.03 deg, 3 Hz", "--shake-deg 0.03 --shake-hz 3", 40, 0.01),
    ("camera shakes 0.03 deg, 7 Hz", "--shake-deg 0.03 --shake-hz 7", 15, 0.01),
    ("60 Hz, shakes 0.02 deg, 12 Hz", "--camera-rate 60 --shake-deg 0.02 --shake-hz 12", 15, 0.01),
    ("60 Hz, shakes 0.02 deg, 8 Hz", "--camera-rate 60 --shake-deg 0.02 --shake-hz 8", 75, 0.02),
    ("encoders 20 ms late", "--encoder-late 0.02", 40, 0.01),
    ("carriage rocks 0.1 deg", "--rock-deg 0.1", 60, 0.2),
    ("rail waves by 5 mm", "--rail-sine 0.005 2", 15, 0.01),
)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--seeds", type=int, default=3, help="runs per case")
    parser.add_argument("--keep", type=Path, help="folder for the bags")
    options = parser.parse_args()
    cases = [case for case in CASES if options.only in case[0]]
    if not cases or options.seeds < 1:
        parser.error(f"no run: --only one of {', '.join(repr(case[0]) for case in CASES)}")
    failed = False
    with tempfile.TemporaryDirectory() as scratch:
        for name, arguments, largest, invalid in cases:
            for seed in range(1, options.seeds + 1):
                bag = (options.keep or Path(scratch)) / name.replace(" ", "_") / str(seed)
                given = [*shlex.split(arguments), "--seed", str(seed)]
                sim.simulate(sim.arguments().parse_args(given), bag)
                result = run.run(bag)
                held = result.get("max_mm", 1e9) <= largest and result["invalid"] <= invalid
                failed |= not held
                verdict = "" if held else f" BEYOND {largest} mm, {invalid:.1%} invalid"
                print(f"{name}, seed {seed}:{verdict} {run.line(result)}", flush=True)
    sys.exit(failed)


if __name__ == "__main__":
    main()
