"""The four nodes and the controller as processes."""

import os
import signal
import subprocess
import sys

NODES = ("marker_tracker", "imu_driver", "climber_driver", "pose_fusion")
HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(os.path.dirname(HERE))
CONTROLLER = os.path.join(ROOT, "examples", "swing_control", "swing_control.py")
TOPICS = ("volant/odometry", "volant/predicted_odometry", "volant/status")


def executables():
    """Folder of the nodes: VOLANT_BIN, else the workspace's release build."""
    folder = os.environ.get("VOLANT_BIN") or os.path.join(ROOT, "target", "release")
    missing = [name for name in NODES if not os.path.isfile(os.path.join(folder, name))]
    if missing:
        raise RuntimeError(
            f"no {', '.join(missing)} in {folder}; build them with `cargo build "
            "--release --workspace --bins`, or name their folder in VOLANT_BIN"
        )
    return folder


class Processes:
    """Processes with their logs in a folder; ended by `stop`."""

    def __init__(self, folder, domain):
        self.folder = folder
        self.environment = os.environ | {
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": folder,
        }
        self.running = {}

    def start(self, name, command):
        """Starts a process; its output goes to NAME.log."""
        with open(os.path.join(self.folder, f"{name}.log"), "ab") as log:
            # In a session of its own: Ctrl-C reaches the loop only, which then calls `stop`.
            self.running[name] = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=self.environment,
                start_new_session=True,
            )

    def start_node(self, name, port):
        """Starts one of the four nodes with the rig file and the loop's parameters."""
        command = [os.path.join(executables(), name), "--ros-args", "-p", "use_sim_time:=true"]
        for file in ("rig.yaml", "nodes.yaml"):
            command += ["--params-file", os.path.join(HERE, file)]
        if name == "imu_driver":
            command += ["-p", f"port:={port}"]
        self.start(name, command)

    def end(self, name):
        """Ends one process."""
        process = self.running.pop(name)
        process.terminate()
        process.wait(timeout=10)

    def start_controller(self, parameters, truth):
        """Starts the controller; with `truth` its topics are remapped to the truth's."""
        command = [sys.executable, CONTROLLER, "--ros-args", "-p", "use_sim_time:=true"]
        for name, value in parameters.items():
            command += ["-p", f"{name}:={str(value).lower()}"]
        if truth:
            for topic in TOPICS:
                command += ["-r", f"{topic}:=truth/{topic}"]
            command += ["-r", "/tf:=truth/tf"]
        self.start("swing_control", command)

    def settled(self, name):
        """Whether a process has read all datagrams and all its threads sleep: it has processed
        what was sent to it. Raises if it has ended."""
        try:
            return self._sleeps(f"/proc/{self.running[name].pid}")
        except (FileNotFoundError, ProcessLookupError):
            self.running[name].wait(timeout=1)
            self.check()
            raise

    @staticmethod
    def _sleeps(process):
        """`settled` for a process given by its folder in /proc."""
        sockets = set()
        for entry in os.scandir(f"{process}/fd"):
            try:
                target = os.readlink(entry.path)
            except FileNotFoundError:
                continue
            if target.startswith("socket:["):
                sockets.add(target[8:-1])
        with open(f"{process}/net/udp", encoding="ascii") as table:
            for row in table.readlines()[1:]:
                fields = row.split()
                if fields[9] in sockets and not fields[4].endswith(":00000000"):
                    return False
        for task in os.listdir(f"{process}/task"):
            try:
                with open(f"{process}/task/{task}/stat", encoding="ascii") as stat:
                    if stat.read().rpartition(")")[2].split()[0] == "R":
                        return False
            except FileNotFoundError:
                continue  # the thread has ended
        return True

    def check(self):
        """Raises if a process has ended."""
        for name, process in self.running.items():
            if process.poll() is not None:
                log = os.path.join(self.folder, f"{name}.log")
                raise RuntimeError(f"{name} ended with status {process.returncode}; see {log}")

    def stop(self):
        """Ends all processes; returns the exit status of each."""
        for name, process in self.running.items():
            # rclpy raises KeyboardInterrupt anywhere on SIGINT, and shuts down on SIGTERM.
            process.send_signal(signal.SIGINT if name in NODES else signal.SIGTERM)
        status = {}
        for name, process in self.running.items():
            try:
                status[name] = process.wait(timeout=5)
            except subprocess.TimeoutExpired:
                process.kill()
                status[name] = process.wait()
        self.running = {}
        return status
