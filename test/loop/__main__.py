"""Closed loop of the live nodes on third-party physics: runs the episodes, writes the report.

    python test/loop --out FOLDER [--only NAME,…] [--without-gains] [--seconds S] [--table FILE]

Each episode runs with the truth as feedback and with Volant as feedback; the controller is the
same (examples/swing_control). The folder gets report.html, figures.csv, per run a CSV and a film
(SVG), and the logs of all processes. A folder with anything else in it is refused; what an earlier
run wrote is removed. Exit status 0 when every figure is reached, 1 when one is not, 2 for a wrong
command line.
"""

import argparse
import os
import signal
import sys

# Nodes and hardware are on this computer; also read by the nodes.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

import crane
import episodes
import figures
import report
from folder import RunFolder, ForeignFile
from processes import executables
from simulation import Simulation

HERE = os.path.dirname(os.path.abspath(__file__))
GAINS = (60, 75, 90, 105, 120, 135, 155, 180, 205, 235, 270, 310)  # N s/m


def run(episode, feedback, folder, rig, domain):
    """Runs one episode; prints a line."""
    path = os.path.join(folder, f"{episode.name}-{feedback}")
    os.makedirs(path)
    record = Simulation(episode, feedback, path, rig, domain).run()
    factor = record.wall["simulated"] / record.wall["total"]
    print(f"{episode.title}, feedback {feedback}: {factor:.2f} of real time", flush=True)
    figures.write_csv(record, os.path.join(folder, f"{episode.name}-{feedback}.csv"))
    return record


def largest_gain(predict, folder, rig, domain, tried):
    """The largest of GAINS with which the loop is stable; notes what it tried."""
    low, high = -1, len(GAINS)
    while high - low > 1:
        middle = (low + high) // 2
        episode = episodes.damping_episode(GAINS[middle], predict)
        holds = figures.is_stable(run(episode, "volant", folder, rig, domain))
        tried.append((predict, GAINS[middle], holds))
        low, high = (middle, high) if holds else (low, middle)
    return GAINS[low] if low >= 0 else 0


def main():
    parser = argparse.ArgumentParser(prog="test/loop", description=__doc__.splitlines()[0])
    parser.add_argument("--out", required=True, help="folder of the report")
    parser.add_argument("--only", help="names of episodes, separated by commas")
    parser.add_argument("--without-gains", action="store_true",
                        help="leave out the search of the largest stable damping gains")
    parser.add_argument("--table", help="also write the table of figures to this Markdown file; "
                        "one that is there must have been written so")
    parser.add_argument("--seconds", type=float, help="shorten the episodes to this")
    parser.add_argument("--domain", type=int, default=20 + os.getpid() % 80,
                        help="DDS domain, below 102; by default it depends on the process")
    options = parser.parse_args()
    names = options.only.split(",") if options.only else [e.name for e in episodes.EPISODES]
    unknown = set(names) - {e.name for e in episodes.EPISODES}
    if unknown:
        known = ", ".join(e.name for e in episodes.EPISODES)
        parser.error(f"no episode is named {', '.join(sorted(unknown))}; there are {known}")
    executables()
    if options.table and not figures.replaceable(options.table):
        print(f"test/loop: {options.table} was not written by this command; nothing is replaced: "
              "give --table another name", file=sys.stderr)
        return 1
    try:
        out = RunFolder(options.out)
    except (ForeignFile, OSError) as error:
        print(f"test/loop: {error}", file=sys.stderr)
        return 1
    rig = crane.load_rig(os.path.join(HERE, "rig.yaml"))
    with out:
        pairs, gains, tried = [], {}, []
        for name in names:
            episode = episodes.by_name(name)
            if options.seconds:
                episode = episodes.shortened(episode, options.seconds)
            pairs.append([run(episode, f, out.path, rig, options.domain)
                          for f in ("truth", "volant")])
        if not options.without_gains:
            for predict in (False, True):
                gains[predict] = largest_gain(predict, out.path, rig, options.domain, tried)
        rows = figures.table(pairs, gains)
        for _, volant in pairs:
            name = os.path.join(out.path, f"{volant.episode.name}.svg")
            with open(name, "x", encoding="utf-8") as file:
                file.write(report.film_file(volant))
        figures.write_table(rows, os.path.join(out.path, "figures.csv"))
        report.write(os.path.join(out.path, "report.html"), pairs, rows, gains, tried)
        text = figures.as_text(rows)
        if options.table:
            figures.write_page(options.table, text)
        print(text)
        print(os.path.join(out.path, "report.html"))
    return 0 if all(row.holds is not False for row in rows) else 1


if __name__ == "__main__":
    # The renderer's library hangs in its destructors on some systems; all files are written.
    # The nodes are ended then, as on SIGINT.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        status = main()
    except KeyboardInterrupt:
        status = 130
    except SystemExit as end:
        status = end.code or 0
    except RuntimeError as error:
        print(f"test/loop: {error}", file=sys.stderr)
        status = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)
