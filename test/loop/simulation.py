"""One episode: the crane, its simulated hardware, the live nodes and the controller in a loop.

Time is simulated, on /clock, and never faster than real time. Where the machine is too slow, the
simulation waits for the nodes (lock-step): an image's markers may take `IMAGE_BUDGET`, and the
odometry of an IMU sample and the command that follows from it one cycle of 10 ms. The loop's delays
are then those of a machine that keeps pace, whatever this one does.
"""

import time
from collections import deque
from dataclasses import dataclass, field

import numpy as np

import crane as c
import hardware as h
import mtx
from camera import Camera
from processes import NODES, Processes
from quaternion import from_vector, multiply, rotate
from stream import Stream

CYCLE = 10  # steps of 1 ms: the IMU's period
IMAGE_RATE = 30.0  # Hz
IMAGE_DELAY = 0.012  # from the exposure to the published image: read-out and transfer, s
IMAGE_BUDGET = 0.045  # from the exposure to the markers, s
ENCODER_PERIOD = 20  # ms
ENCODER_DELAY = 0.004  # s
QUANTUM = (0.001, 0.001, np.radians(0.05))  # of the encoders: m, m, rad
PATIENCE = 0.3  # real time that a stream may take before it counts as interrupted, s
WARM_UP = 3.0  # without an estimator, s
VALID_FOR = 1.5  # the pose must have been valid this long before the release, s
LONGEST_WARM_UP = 20.0  # s
# Errors of the IMU, as the simulated rig has them (1 sigma): m/s², rad/s, rad.
ACCELEROMETER_BIAS, GYROSCOPE_BIAS, ATTITUDE_ERROR = 0.03, 0.008, 0.0096


@dataclass
class Record:
    """What happened; times in s from the release."""

    episode: object
    feedback: str
    released: float = 0.0  # time of the release in the simulation
    truth: list = field(default_factory=list)  # (t, qpos, qvel), every 2 ms
    commands: list = field(default_factory=list)  # (t, 6 commands), each cycle
    received: dict = field(default_factory=dict)  # input → [(t of receipt, message)]
    samples: list = field(default_factory=list)  # times of IMU samples that were sent
    collided: bool = False
    gaps: list = field(default_factory=list)  # when a node took longer than PATIENCE
    wall: dict = field(default_factory=dict)  # what took real time → s
    exits: dict = field(default_factory=dict)  # process → status
    restarts: list = field(default_factory=list)  # nodes that did not find /clock at once
    film: list = field(default_factory=list)  # JPEGs at 2 Hz


class Simulation:
    """Runs one episode. `feedback` is "volant" or "truth"; with the truth no node runs."""

    def __init__(self, episode, feedback, folder, rig, domain, seed=1):
        self.episode, self.feedback, self.rig = episode, feedback, rig
        self.random = np.random.default_rng(seed)
        self.crane = c.Crane(rig)
        self.crane.hang(np.radians(episode.angle), np.radians(episode.direction))
        self.crane.hold(True)
        self.live = feedback == "volant"
        self.hardware = h.Hardware(domain, truth=not self.live)
        self.processes = Processes(folder, domain)
        self.record = Record(episode, feedback)
        self.release = np.inf
        self.queue = []  # (time, output, message) to publish
        self.line = deque()  # (time of the last bit, bytes) of the IMU
        self.latest = {"cmd_vel": None, "cmd_thrust": None}
        self.held = []  # encoder readings that a cut network holds back
        self.streams = {
            name: Stream() for name in ("odometry", "markers", "cmd_vel", "cmd_thrust")
        }
        self.goals = deque(episode.goals)
        self.valid_since = None
        self.next_image = 0
        self.frozen = None
        self.wall = {"physics": 0.0, "images": 0.0, "waiting": 0.0, "pace": 0.0, "total": 0.0}
        if self.live:
            self.camera = Camera(self.crane, seed)
            self.port = mtx.Port(f"{folder}/mtx")
            self.mtx = mtx.Mtx(self.sample)
            self.biases = (
                self.random.normal(size=3) * ACCELEROMETER_BIAS,
                self.random.normal(size=3) * GYROSCOPE_BIAS,
            )
            self.heading = from_vector([0, 0, self.random.uniform(-3, 3)])
            self.wander = np.zeros(3)

    # Sensors

    def sample(self, _):
        """An IMU sample now, with bias, noise and a drifting attitude error of the device."""
        force, rate = self.crane.imu()
        root = np.sqrt(100.0)
        force = force + self.biases[0] + self.random.normal(size=3) * (
            self.rig.accelerometer_noise * root)
        rate = rate + self.biases[1] + self.random.normal(size=3) * self.rig.gyroscope_noise * root
        keep = np.exp(-0.001)  # over 10 ms, with a time constant of 10 s
        self.wander = self.wander * keep + self.random.normal(size=3) * (
            ATTITUDE_ERROR * np.sqrt(1 - keep**2))
        attitude = multiply(self.crane.attitude(), self.rig.imu[1])
        turned = multiply(self.heading, attitude)
        return force, rate, multiply(from_vector(self.wander), turned)

    def within(self, interval):
        """Whether an interval of the episode contains the present time."""
        t = self.crane.time - self.release
        return bool(interval) and interval[0] <= t < interval[1]

    def encoders(self, now):
        """Publishes a reading, unless the network is cut."""
        true = self.crane.truth().joints
        reading = np.round(true / QUANTUM) * QUANTUM
        if self.within(self.episode.outliers) and round(now * 1000) // ENCODER_PERIOD % 2:
            reading[0] += 0.5
        if self.live:
            message = h.joint_states(now, reading)
            self.queue.append((now + ENCODER_DELAY, "joints", message))
        else:
            self.queue.append((now + ENCODER_DELAY, "tf", h.climber_tf(self.crane.truth())))

    def image(self, now):
        """Takes an image if one is due."""
        if now + 1e-9 < self.next_image / IMAGE_RATE:
            return
        self.next_image += 1
        began = time.monotonic()
        if self.frozen is None or not self.within(self.episode.freeze):
            self.frozen = self.camera.shoot()
        self.wall["images"] += time.monotonic() - began
        at = now + IMAGE_DELAY
        self.queue.append((at, "image", h.image(now, self.frozen)))
        self.queue.append((at, "info", h.camera_info(now)))
        if not self.within(self.episode.cut):
            self.streams["markers"].expect(now + IMAGE_BUDGET, now)
        t = now - self.release
        if t > len(self.record.film) / 2:
            self.record.film.append(self.frozen)

    def publish(self, now):
        """Publishes what is due. A cut network loses images and holds back the newest encoder
        readings (best effort and reliable, keep last 10)."""
        cut = self.within(self.episode.cut)
        due = [entry for entry in self.queue if entry[0] <= now + 1e-9]
        self.queue = [entry for entry in self.queue if entry[0] > now + 1e-9]
        if not cut and self.held:
            due, self.held = self.held[-10:] + due, []
        for entry in sorted(due, key=lambda e: e[0]):
            if cut and entry[1] in ("joints", "tf"):
                self.held.append(entry)
            elif not (cut and entry[1] in ("image", "info")):
                self.hardware.publish(*entry[1:])

    def imu_line(self, now):
        """The IMU's serial line from now on for one step. /clock shows the instant of the last bit
        before the driver reads it: the driver stamps arrivals with it."""
        unplugged = self.within(self.episode.unplug)
        if unplugged and self.port.master is not None:
            self.port.unplug()
        elif not unplugged and self.port.master is None:
            self.port.plug()
        for reply in self.mtx.handle(self.port.read(), now):
            self.line.append(reply)
        for arrival, data, at in self.mtx.advance(now):
            self.line.append((arrival, data))
            if self.port.master is not None:
                self.streams["odometry"].expect(at + 0.0099, at)
                self.record.samples.append(at)
        while self.line and self.line[0][0] < now + c.STEP:
            arrival, data = self.line.popleft()
            self.hardware.publish("clock", h.clock(arrival))
            self.settle("imu_driver")
            self.port.write(data)

    def settle(self, name):
        """Waits until a node has processed what was published. The driver fits its stamps to the
        earliest arrivals: a single one on a /clock of before would move all of them."""
        began = time.monotonic()
        while not self.processes.settled(name) and time.monotonic() - began < PATIENCE:
            time.sleep(0.0001)
        self.wall["waiting"] += time.monotonic() - began

    # Loop

    def poll(self):
        """Takes what the nodes have published."""
        now = self.crane.time
        for name, message in self.hardware.poll():
            stamp = h.to_seconds(message.header.stamp)
            if name in self.latest:
                self.latest[name] = message
            if name in self.streams:
                self.streams[name].note(stamp)
            if name == "status":
                valid = message.valid
                self.valid_since = (self.valid_since or now) if valid else None
            self.record.received.setdefault(name, []).append((now, message))

    def wait(self):
        """Waits for the nodes where they lag."""
        now, began = self.crane.time, time.monotonic()
        while True:
            self.poll()
            late = [s for s in self.streams.values() if s.late(now)]
            waited = time.monotonic() - began
            if not late:
                self.wall["waiting"] += waited
                return
            if waited > PATIENCE:
                for stream in late:
                    stream.miss(now)
                    self.record.gaps.append(now)
            time.sleep(0.0003)

    def command(self):
        """Hands the newest commands to drives and thrusters, as every 10 ms a field bus does. They
        are enabled at the release."""
        if self.crane.time < self.release:
            return
        vel, thrust = self.latest["cmd_vel"], self.latest["cmd_thrust"]
        values = np.zeros(6)
        if vel is not None:
            twist = vel.twist
            values[:3] = twist.linear.x, twist.linear.y, twist.angular.z
        if thrust is not None:
            wrench = thrust.wrench
            values[3:] = wrench.force.x, wrench.force.y, wrench.torque.z
            self.crane.thrust(values[3:])
        self.record.commands.append((self.crane.time, values))
        if vel is not None and not self.within(self.episode.cut):
            # The drive's own time-out counts from the newest message.
            if self.crane.time - h.to_seconds(vel.header.stamp) < c.DRIVE_TIMEOUT:
                self.crane.drive(values[:3])

    def events(self, now):
        """Release, goals, push, cover, payload."""
        if self.release == np.inf:
            # The controller must be there for the goals.
            ready = self.latest["cmd_thrust"] is not None and self.hardware.connected("goal") and (
                now >= WARM_UP if not self.live else
                self.valid_since is not None and now - self.valid_since >= VALID_FOR)
            if ready or now >= LONGEST_WARM_UP:
                self.release = now + 0.1
                self.record.released = self.release
        t = now - self.release
        if t >= 0:
            self.crane.hold(False)
        while self.goals and t >= self.goals[0][0]:
            self.hardware.publish("goal", h.goal(now, *self.goals.popleft()[1:]))
        push = self.episode.push
        self.crane.push([*push[2:], 0.0] if push and push[0] <= t < push[1] else [0.0] * 3)
        self.crane.payload_motion = self.episode.payload if t >= 0 else 0.0
        cover = self.episode.cover
        if cover:
            slide = min((t - cover[0]) / 0.15 + 1.0, (cover[1] - t) / 0.15 + 1.0)
            self.crane.covered = float(np.clip(slide, 0.0, 1.0))

    def truth_feedback(self, now):
        """The truth as Volant would publish it, 6 ms after the sample."""
        truth = self.crane.truth()
        velocity = rotate(truth.quaternion, truth.linear)
        acceleration = (velocity - self.before) / (CYCLE * c.STEP) if hasattr(self, "before") \
            else np.zeros(3)
        self.before = velocity
        at = now + 0.006
        self.queue.append((at, "odometry", h.odometry(truth)))
        self.queue.append((at, "predicted", h.odometry(truth, 0.05, acceleration)))
        self.queue.append((at, "status", h.status(now)))

    def cycle(self):
        """10 ms."""
        now = self.crane.time
        self.events(now)
        if not self.live:
            self.truth_feedback(now)
        for k in range(CYCLE):
            now = self.crane.time
            if self.live:
                self.imu_line(now)
                self.image(now)
            if round(now * 1000) % ENCODER_PERIOD == 0:
                self.encoders(now)
            if k in (0, 3, 6):
                self.hardware.publish("clock", h.clock(now))
            self.publish(now)
            began = time.monotonic()
            if round(now * 1000) % 2 == 0:
                data = self.crane.data
                self.record.truth.append((now, data.qpos.copy(), data.qvel.copy()))
                self.record.collided |= self.crane.at_rail_end()
            self.crane.step()
            self.wall["physics"] += time.monotonic() - began
            if k == 6:
                self.poll()
        # A command follows each odometry. It is stamped with the time of its computation, which is
        # later than the arrival of the IMU sample at 5 ms.
        for name in self.latest:
            self.streams[name].expect(self.crane.time - 1e-6, self.crane.time - 0.0045)
        self.wait()
        self.command()

    def run(self):
        """Runs the episode; returns its record."""
        try:
            self.start()
            began = reference = time.monotonic()
            cycles = 0
            while self.crane.time - self.release < self.episode.seconds:
                self.cycle()
                cycles += 1
                if cycles % 100 == 0:
                    self.processes.check()
                # Never faster than real time; what was lost is not caught up.
                reference += CYCLE * c.STEP
                ahead = reference - time.monotonic()
                if ahead > 0:
                    time.sleep(ahead)
                    self.wall["pace"] += ahead
                else:
                    reference = time.monotonic()
            self.wall["total"] = time.monotonic() - began
            self.record.exits = self.processes.stop()
            return self.finished()
        finally:
            self.processes.stop()
            if self.live:
                self.port.unplug()
                self.camera.close()
            self.hardware.close()

    def start(self):
        """Starts nodes and controller one after the other: of several that start at once, some do
        not find /clock. Simulated time stands still meanwhile."""
        controller = "swing_control"
        names = ([*NODES] if self.live else []) + [controller]
        for count, name in enumerate(names, 1):
            for _ in range(3):
                if name == controller:
                    self.processes.start_controller(
                        self.episode.controller, truth=not self.live)
                else:
                    self.processes.start_node(name, self.port.link)
                end = time.monotonic() + 6.0
                while self.hardware.connected("clock") < count and time.monotonic() < end:
                    self.hardware.publish("clock", h.clock(0.0))
                    time.sleep(0.01)
                if self.hardware.connected("clock") >= count:
                    break
                self.record.restarts.append(name)
                self.processes.end(name)
            else:
                raise RuntimeError(f"{name} does not find /clock; see its log")

    def finished(self):
        """The record with all times counted from the release."""
        record, zero = self.record, self.release
        record.wall = self.wall | {"simulated": self.crane.time}
        record.truth = [(t - zero, q, v) for t, q, v in record.truth]
        record.commands = [(t - zero, u) for t, u in record.commands]
        record.gaps = [t - zero for t in record.gaps]
        record.samples = [t - zero for t in record.samples]
        record.received = {
            name: [(t - zero, message) for t, message in messages]
            for name, messages in record.received.items()
        }
        return record
