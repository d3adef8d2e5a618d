"""Physics of the crane: a MuJoCo model of rails, turn, rope, platform, thrusters and IMU.

The climber hangs on two rails (joints `rail_x`, `rail_y`, m) and turns about the vertical (`turn`,
rad). A rope, an elastic spatial tendon that only pulls, holds the platform. The engine integrates
with fourth-order Runge-Kutta steps of 1 ms and computes the readings of the IMU; nothing here is
an equation of Volant's own simulator.

Frames as in the contract: `world`, `climber`, `camera_optical`, `volant`, `imu`; `a_from_b` maps
coordinates of b to a. Quaternions are w, x, y, z, as in MuJoCo.
"""

import os
from collections import deque
from dataclasses import dataclass

# Read when mujoco is imported: images in software, without a display.
os.environ.setdefault("MUJOCO_GL", "osmesa")

import mujoco
import numpy as np
import yaml

from quaternion import conjugate, from_vector, multiply, rotate

STEP = 0.001  # s
HEIGHT = 2.8  # climber frame above the world's origin, m
ROPE = 1.65  # m, without load
ROPE_STIFFNESS = 40_000.0  # N/m: a braided polymer rope of 6 mm stretches by 1.4 mm under the load
ROPE_DAMPING = 60.0  # N s/m
CLIMBER_ATTACHMENT = (0.0, 0.12, 0.0)  # climber frame, m
PLATFORM_ATTACHMENT = (0.0, 0.0, 0.1)  # volant frame, m
RAIL = 1.2  # the rails end at ± this, m
CENTER = (0.0, 0.0, -0.03)  # where the thrust acts, near the center of mass, volant frame, m

SPEED_LIMIT = (0.8, 0.8, 1.5)  # of the drives: m/s, m/s, rad/s
FORCE_LIMIT = (250.0, 150.0, 15.0)  # of the motors: N, N, N m
DRIVE_GAIN = (1500.0, 900.0, 60.0)  # proportional, N per m/s
DRIVE_INTEGRAL = (6000.0, 4000.0, 300.0)  # N per m
DRIVE_TIMEOUT = 0.1  # a drive without a new command stops after this, s
THRUST_LIMIT = (8.0, 8.0, 1.5)  # N, N, N m in the volant frame
THRUST_DEAD_TIME = 0.03  # from the command to the motor controllers' output, s
THRUST_LAG = 0.1  # time constant of the ducted fans, s

COLORS = {  # muted paper, as on the rig
    "red": (0.77, 0.16, 0.23),
    "green": (0.27, 0.63, 0.30),
    "blue": (0.19, 0.40, 0.72),
    "yellow": (0.89, 0.81, 0.24),
}
TURNS = {"red": 2.1, "green": -3.4, "blue": 1.3, "yellow": -1.9}  # of the squares, degrees

WIDTH, HEIGHT_PX = 640, 480
FOCAL = (590.0, 588.0)  # px
PRINCIPAL = (319.5, 239.5)  # px, with the center of the top left pixel at (0, 0)


@dataclass
class Rig:
    """What a rig file says that the model needs; positions in m, quaternions w, x, y, z."""

    camera: tuple  # climber_from_camera_optical
    imu: tuple  # volant_from_imu
    accelerometer_noise: float  # m/s²/√Hz
    gyroscope_noise: float  # rad/s/√Hz
    side: float  # of a marker, m
    markers: dict  # color → center in the volant frame, m


def load_rig(path):
    """Reads a rig file."""
    with open(path, encoding="utf-8") as file:
        rig = yaml.safe_load(file)["/**"]["ros__parameters"]

    def mounting(block):
        x, y, z, w = block["orientation"]
        quaternion = np.array([w, x, y, z])
        return np.array(block["position"]), quaternion / np.linalg.norm(quaternion)

    return Rig(
        camera=mounting(rig["camera"]),
        imu=mounting(rig["imu"]),
        accelerometer_noise=rig["imu"]["accelerometer_noise_density"],
        gyroscope_noise=rig["imu"]["gyroscope_noise_density"],
        side=rig["markers"]["size"],
        markers={color: np.array(rig["markers"][color]) for color in COLORS},
    )


def text(values):
    """Numbers as an XML attribute."""
    return " ".join(f"{v:.9g}" for v in np.ravel(values))


def model_xml(rig):
    """The model in MuJoCo's format."""
    # MuJoCo's camera looks along -z with y up; an optical frame looks along z with y down.
    camera = multiply(rig.camera[1], [0.0, 1.0, 0.0, 0.0])
    squares = "".join(
        f'<geom name="{color}" type="box" pos="{text(center - [0, 0, 0.0005])}" '
        f'size="{rig.side / 2:.6g} {rig.side / 2:.6g} 0.0005" euler="0 0 {TURNS[color]}" '
        f'rgba="{text(COLORS[color])} 1" class="visual"/>'
        for color, center in rig.markers.items()
    )
    # MuJoCo measures the principal point from the image's center.
    offset = (PRINCIPAL[0] - (WIDTH - 1) / 2, PRINCIPAL[1] - (HEIGHT_PX - 1) / 2)
    return f"""
<mujoco model="crane">
  <compiler angle="degree" autolimits="true"/>
  <option timestep="{STEP}" integrator="RK4" gravity="0 0 -9.81" density="1.2"
    viscosity="1.8e-5"/>
  <visual>
    <quality offsamples="4" shadowsize="0" numquads="1"/>
    <global offwidth="{WIDTH}" offheight="{HEIGHT_PX}"/>
    <headlight ambient="0.55 0.55 0.55" diffuse="0 0 0" specular="0 0 0"/>
    <map znear="0.02" zfar="20"/>
    <scale framewidth="0.001"/>
  </visual>
  <default>
    <default class="visual"><geom contype="0" conaffinity="0" mass="0"/></default>
    <default class="solid"><geom contype="0" conaffinity="0"/></default>
  </default>
  <asset>
    <texture name="floor" type="2d" builtin="flat" mark="random" random="0.08" width="512"
      height="512" rgb1="0.42 0.41 0.40" markrgb="0.52 0.50 0.48"/>
    <material name="floor" texture="floor" texrepeat="4 4" specular="0" shininess="0"
      reflectance="0"/>
  </asset>
  <worldbody>
    <light pos="1.5 -1 4" dir="-0.3 0.2 -1" directional="true" castshadow="false"
      diffuse="0.55 0.55 0.55" specular="0 0 0" ambient="0 0 0"/>
    <geom type="plane" size="4 4 0.1" material="floor" contype="0" conaffinity="0"/>
    <body name="gantry" pos="0 0 {HEIGHT}">
      <joint name="rail_x" type="slide" axis="1 0 0" range="-{RAIL} {RAIL}" damping="20"
        frictionloss="12" solreflimit="0.01 1"/>
      <geom type="box" size="0.05 1.4 0.04" pos="0 0 0.12" mass="35" rgba="0.6 0.6 0.65 1"
        class="solid"/>
      <body name="trolley">
        <joint name="rail_y" type="slide" axis="0 1 0" range="-{RAIL} {RAIL}" damping="15"
          frictionloss="8" solreflimit="0.01 1"/>
        <geom type="box" size="0.12 0.12 0.03" pos="0 0 0.06" mass="14" rgba="0.5 0.5 0.5 1"
          class="solid"/>
        <body name="climber">
          <joint name="turn" type="hinge" axis="0 0 1" damping="0.5" frictionloss="0.3"/>
          <geom type="cylinder" size="0.1 0.02" pos="0 0 0.02" mass="6" rgba="0.4 0.4 0.4 1"
            class="solid"/>
          <camera name="climber_camera" pos="{text(rig.camera[0])}" quat="{text(camera)}"
            resolution="{WIDTH} {HEIGHT_PX}" sensorsize="{WIDTH * 1e-5} {HEIGHT_PX * 1e-5}"
            focalpixel="{text(FOCAL)}" principalpixel="{text(offset)}"/>
          <site name="rope_top" pos="{text(CLIMBER_ATTACHMENT)}" size="0.005"/>
        </body>
      </body>
    </body>
    <body name="hand" mocap="true"/>
    <body name="cover" mocap="true" pos="0 0 -1">
      <geom name="cover" type="box" size="0.27 0.27 0.002" rgba="0.5 0.48 0.45 1"
        class="visual"/>
    </body>
    <body name="volant" pos="0 0 {HEIGHT - ROPE}">
      <freejoint name="platform"/>
      <geom type="box" size="0.21 0.21 0.008" pos="0 0 0.0065" mass="2.2"
        rgba="0.30 0.30 0.31 1" class="solid"/>
      <geom type="box" size="0.08 0.06 0.03" pos="0.01 -0.005 -0.05" mass="1.9"
        rgba="0.2 0.2 0.2 1" class="solid"/>
      <geom type="cylinder" size="0.06 0.012" pos="0.30 0 -0.03" mass="0.15"
        rgba="0.25 0.25 0.25 1" class="solid"/>
      <geom type="cylinder" size="0.06 0.012" pos="-0.30 0 -0.03" mass="0.15"
        rgba="0.25 0.25 0.25 1" class="solid"/>
      <geom type="cylinder" size="0.06 0.012" pos="0 0.30 -0.03" mass="0.15"
        rgba="0.25 0.25 0.25 1" class="solid"/>
      <geom type="cylinder" size="0.06 0.012" pos="0 -0.30 -0.03" mass="0.15"
        rgba="0.25 0.25 0.25 1" class="solid"/>
      <geom type="cylinder" size="0.012 0.042" pos="0 0 0.057" mass="0.2"
        rgba="0.45 0.45 0.45 1" class="solid"/>
      {squares}
      <site name="hook" pos="{text(PLATFORM_ATTACHMENT)}" size="0.005"/>
      <site name="thrust" pos="{text(CENTER)}" size="0.005"/>
      <site name="imu" pos="{text(rig.imu[0])}" quat="{text(rig.imu[1])}" size="0.003"/>
      <body name="payload" pos="0 0 -0.1">
        <joint name="payload" type="slide" axis="0.8 0.6 0" range="-0.1 0.1" damping="2"/>
        <geom type="box" size="0.03 0.03 0.015" mass="0.8" rgba="0.1 0.1 0.1 1" class="solid"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <spatial name="rope" springlength="0 {ROPE}" stiffness="{ROPE_STIFFNESS}"
      damping="{ROPE_DAMPING}" width="0.004" rgba="0.85 0.85 0.8 1">
      <site site="rope_top"/>
      <site site="hook"/>
    </spatial>
  </tendon>
  <equality>
    <weld name="hold" body1="volant" body2="hand" relpose="0 0 0 1 0 0 0" active="false"
      solref="0.02 1"/>
  </equality>
  <actuator>
    <motor name="rail_x" joint="rail_x" forcerange="-{FORCE_LIMIT[0]} {FORCE_LIMIT[0]}"/>
    <motor name="rail_y" joint="rail_y" forcerange="-{FORCE_LIMIT[1]} {FORCE_LIMIT[1]}"/>
    <motor name="turn" joint="turn" forcerange="-{FORCE_LIMIT[2]} {FORCE_LIMIT[2]}"/>
    <general name="thrust_x" site="thrust" gear="1 0 0 0 0 0" dyntype="filterexact"
      dynprm="{THRUST_LAG}" ctrlrange="-{THRUST_LIMIT[0]} {THRUST_LIMIT[0]}"/>
    <general name="thrust_y" site="thrust" gear="0 1 0 0 0 0" dyntype="filterexact"
      dynprm="{THRUST_LAG}" ctrlrange="-{THRUST_LIMIT[1]} {THRUST_LIMIT[1]}"/>
    <general name="torque_z" site="thrust" gear="0 0 0 0 0 1" dyntype="filterexact"
      dynprm="{THRUST_LAG}" ctrlrange="-{THRUST_LIMIT[2]} {THRUST_LIMIT[2]}"/>
    <position name="payload" joint="payload" kp="200" kv="20"/>
  </actuator>
  <sensor>
    <accelerometer name="accelerometer" site="imu"/>
    <gyro name="gyroscope" site="imu"/>
  </sensor>
</mujoco>"""


@dataclass
class Truth:
    """Motion at one instant."""

    time: float  # s
    position: np.ndarray  # world_from_volant, m
    quaternion: np.ndarray
    linear: np.ndarray  # velocity of the volant frame's origin, volant axes, m/s
    angular: np.ndarray  # angular velocity, volant axes, rad/s
    joints: np.ndarray  # rail_x, rail_y (m), turn (rad)
    joint_rates: np.ndarray
    swing: float  # angle of the rope against the vertical, rad


class Crane:
    """The crane and its drives. Time counts from the start of the simulation, s."""

    def __init__(self, rig):
        self.rig = rig
        self.model = mujoco.MjModel.from_xml_string(model_xml(rig))
        self.data = mujoco.MjData(self.model)
        names = ("rail_x", "rail_y", "turn")
        joints = [self.model.joint(name) for name in names]
        self._q = [joint.qposadr[0] for joint in joints]
        self._v = [joint.dofadr[0] for joint in joints]
        self._platform = self.model.joint("platform").qposadr[0]
        self._body = self.model.body("volant").id
        self._rope = [self.model.site(name).id for name in ("rope_top", "hook")]
        self._drives = [self.model.actuator(name).id for name in names]
        self._thrusters = [
            self.model.actuator(name).id for name in ("thrust_x", "thrust_y", "torque_z")
        ]
        self._payload = self.model.actuator("payload").id
        self._hold = self.model.equality("hold").id
        self._cover = self.model.body("cover").mocapid[0]
        self._hand = self.model.body("hand").mocapid[0]
        self._sensors = [self.model.sensor(n).adr[0] for n in ("accelerometer", "gyroscope")]
        self.speeds = np.zeros(3)
        self._speeds_at = -np.inf
        self._integral = np.zeros(3)
        self._wrenches = deque()  # (time at which it takes effect, wrench)
        self._steps = 0
        self.covered = 0.0  # 0: nothing covers the markers, 1: all of them are covered
        self.payload_motion = 0.0  # amplitude, m
        self.hang(0.0, 0.0)

    @property
    def time(self):
        """Time, s."""
        return self._steps * STEP

    def hang(self, angle, direction):
        """Places the platform at rest on the taut rope, `angle` rad from the vertical toward the
        world's `direction` (rad from x). The drives are at their zeros."""
        stretch = self.weight() / ROPE_STIFFNESS * np.cos(angle)
        down = from_vector(angle * np.array([np.sin(direction), -np.cos(direction), 0.0]))
        hook = np.array([0.0, 0.0, HEIGHT]) + CLIMBER_ATTACHMENT
        hook = hook + rotate(down, [0.0, 0.0, -(ROPE + stretch)])
        # The center of mass hangs below the hook.
        lever = self._center_of_mass() - PLATFORM_ATTACHMENT
        lean = from_vector(np.cross(lever, [0.0, 0.0, -1.0]) / np.linalg.norm(lever))
        posture = multiply(down, lean)
        q = self._platform
        self.data.qpos[q : q + 3] = hook - rotate(posture, PLATFORM_ATTACHMENT)
        self.data.qpos[q + 3 : q + 7] = posture
        self.data.mocap_pos[self._hand] = self.data.qpos[q : q + 3]
        self.data.mocap_quat[self._hand] = posture
        self.data.qvel[:] = 0.0
        mujoco.mj_forward(self.model, self.data)

    def _center_of_mass(self):
        """Center of mass of the platform with its payload, volant frame, m."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        turned = conjugate(self.data.xquat[self._body])
        return rotate(turned, self.data.subtree_com[self._body] - self.data.xpos[self._body])

    def weight(self):
        """Weight of the platform with its payload, N."""
        return self.model.body_subtreemass[self._body] * 9.81

    def hold(self, active):
        """Holds the platform where [`hang`] placed it, or releases it."""
        self.data.eq_active[self._hold] = int(active)

    def push(self, force):
        """Applies a force (world axes, N) to the platform's center of mass until the next call."""
        self.data.xfrc_applied[self._body, :3] = force

    def drive(self, speeds):
        """Commands the drives: rail_x, rail_y (m/s), turn (rad/s)."""
        self.speeds = np.clip(speeds, -np.array(SPEED_LIMIT), SPEED_LIMIT)
        self._speeds_at = self.time

    def thrust(self, wrench):
        """Commands the thrusters: force x, y (N) and torque z (N m), volant axes."""
        self._wrenches.append((self.time + THRUST_DEAD_TIME, np.array(wrench, float)))

    def step(self):
        """Advances by one step: motor controllers, thrusters, physics."""
        now, data = self.time, self.data
        if now - self._speeds_at > DRIVE_TIMEOUT:
            self.speeds = np.zeros(3)
        error = self.speeds - data.qvel[self._v]
        limit = np.array(FORCE_LIMIT)
        force = np.array(DRIVE_GAIN) * error + np.array(DRIVE_INTEGRAL) * self._integral
        # A saturated motor controller does not wind up.
        free = (np.abs(force) < limit) | (force * error < 0)
        self._integral += np.where(free, error * STEP, 0.0)
        data.ctrl[self._drives] = np.clip(force, -limit, limit)
        while self._wrenches and self._wrenches[0][0] <= now + STEP / 2:
            data.ctrl[self._thrusters] = self._wrenches.popleft()[1]
        data.ctrl[self._payload] = self.payload_motion * np.sin(2 * np.pi * 0.35 * now)
        mujoco.mj_step(self.model, data)
        self._steps += 1

    def imu(self):
        """Specific force (m/s²) and angular velocity (rad/s) now, imu axes, without errors."""
        mujoco.mj_forward(self.model, self.data)
        return [self.data.sensordata[a : a + 3].copy() for a in self._sensors]

    def attitude(self):
        """Quaternion of the platform now, world from volant."""
        return self.data.qpos[self._platform + 3 : self._platform + 7].copy()

    def at_rail_end(self):
        """Whether the climber touches the end of a rail."""
        return bool(np.any(np.abs(self.data.qpos[self._q[:2]]) > RAIL - 1e-3))

    def truth(self):
        """Motion now."""
        data = self.data
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        mujoco.mj_comVel(self.model, data)
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(
            self.model, data, mujoco.mjtObj.mjOBJ_XBODY, self._body, velocity, 1
        )
        rope = data.site_xpos[self._rope[1]] - data.site_xpos[self._rope[0]]
        return Truth(
            time=self.time,
            position=data.xpos[self._body].copy(),
            quaternion=data.xquat[self._body].copy(),
            linear=velocity[3:].copy(),
            angular=velocity[:3].copy(),
            joints=data.qpos[self._q].copy(),
            joint_rates=data.qvel[self._v].copy(),
            swing=float(np.arctan2(np.hypot(rope[0], rope[1]), -rope[2])),
        )

    def world_from_camera(self):
        """Position and quaternion of the optical frame."""
        camera = self.model.camera("climber_camera").id
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, self.data.cam_xmat[camera])
        return self.data.cam_xpos[camera].copy(), multiply(quaternion, [0.0, 1.0, 0.0, 0.0])

    def place_cover(self):
        """Moves the cover with the platform: it slides in along the volant frame's x."""
        q = self._platform
        away = np.array([0.7 * (1.0 - self.covered), 0.0, 0.06])
        position, quaternion = self.data.qpos[q : q + 3], self.data.qpos[q + 3 : q + 7]
        place = position + rotate(quaternion, away) if self.covered > 0 else np.array([0, 0, -1])
        self.data.mocap_pos[self._cover] = place
        self.data.mocap_quat[self._cover] = quaternion
