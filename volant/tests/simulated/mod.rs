//! Bags of a simulated rig: at rest, a jog of the encoders over the platform on the floor, and a
//! swing with all axes moving.

#![allow(dead_code)]

use bag::{BagWriter, Qos, Topic, WriteOptions};
use nalgebra::{Isometry3, Matrix2, Matrix6, Translation3, UnitQuaternion, Vector2, Vector3};
use node_kit::convert;
use rig_model::{
    CameraModel, Distortion, Frames, MarkerObservation, MarkerObservations, PerColor, Rig, Sample,
    Stamp, topics::absolute,
};
use rig_simulator::{
    RIG_YAML,
    inertial::{SensorConfig, Sensors},
    motion::{Motion, MotionConfig},
    random::Random,
};
use std::{f64::consts::TAU, path::Path};
use volant_msgs::{Message, sensor_msgs::msg::JointState};

/// Encoders: names, units per reading and readings at the world's origin, x, y, turn.
pub struct Encoders {
    pub names: [&'static str; 3],
    pub scale: [f64; 3],
    pub zero: [f64; 3],
}

/// The simulated rig.
pub struct Simulated {
    pub rig: Rig,
    pub camera: CameraModel,
    pub encoders: Encoders,
    pub height: f64,
    pub seed: u64,
    /// The climber's clock minus that of a rig with synchronized stamps, s.
    pub climber_clock_ahead: f64,
}

/// Where the platform rests on the floor.
pub fn resting() -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(0.1, -0.05, 0.12),
        UnitQuaternion::from_euler_angles(0.01, -0.02, 0.4),
    )
}

/// Writes a message that is logged `at`.
fn put<M: Message>(bag: &mut BagWriter, topic: &str, at: Stamp, message: &M) {
    let topic = bag.add_topic(Topic::of::<M>(topic, &Qos::RELIABLE));
    bag.write_message(topic, u64::try_from(at.as_nanos()).unwrap(), message).unwrap();
}

impl Simulated {
    /// A rig whose encoders count in other units, directions and names than the parameters'
    /// defaults.
    pub fn new(seed: u64) -> Self {
        let distortion = Distortion::PlumbBob([-0.23, 0.08, 7e-4, -4e-4, -0.006]);
        let camera = CameraModel::new(640, 480, [480.0, 481.0, 321.5, 238.0], distortion).unwrap();
        Self {
            rig: Rig::from_yaml(RIG_YAML).unwrap(),
            camera,
            encoders: Encoders {
                names: ["trolley", "bridge", "slewing"],
                scale: [-5e-5, 1e-3, -0.0174532925],
                zero: [12_345.0, -250.0, 15.0],
            },
            height: 2.8,
            seed,
            climber_clock_ahead: 0.0,
        }
    }

    fn joint_state(&self, stamp: Stamp, axes: [f64; 3]) -> JointState {
        let e = &self.encoders;
        JointState {
            header: convert::header("", stamp),
            name: e.names.map(str::to_owned).to_vec(),
            position: (0..3).map(|i| e.zero[i] + axes[i] / e.scale[i]).collect(),
            ..JointState::default()
        }
    }

    /// Writes the sensors of a motion; `transform`: whether the climber's pose too.
    pub fn write(&self, path: &Path, motion: &Motion, transform: bool) {
        let mut bag = BagWriter::create(path, WriteOptions::default()).unwrap();
        let mut config = SensorConfig::nominal(self.seed);
        config.climber_clock_ahead += self.climber_clock_ahead;
        let frames = Frames::default();
        let info = convert::camera_message(&frames.camera, config.epoch, &self.camera);
        put(&mut bag, absolute::CAMERA_INFO, config.epoch, &info);
        for (at, sample) in Sensors::new(motion, &self.rig, &self.camera, &config).record() {
            match sample {
                Sample::Imu(sample) => {
                    let message = convert::imu_message(&frames.imu, &sample, None, None);
                    put(&mut bag, absolute::IMU, at, &message);
                }
                Sample::Markers(markers) => {
                    let message = convert::markers_message(&frames.camera, &markers);
                    put(&mut bag, absolute::MARKERS, at, &message);
                }
                Sample::Climber(sample) => {
                    let pose = sample.world_from_climber;
                    let p = pose.translation;
                    let axes = [p.x, p.y, pose.rotation.scaled_axis().z];
                    let message = self.joint_state(sample.stamp, axes);
                    put(&mut bag, absolute::JOINT_STATES, at, &message);
                    if transform {
                        let message = convert::climber_message(&sample, &frames);
                        put(&mut bag, absolute::CLIMBER_TRANSFORM, at, &message);
                    }
                }
                Sample::Camera(_) => {}
            }
        }
        bag.finish().unwrap();
    }

    /// Writes a minute of the IMU at rest.
    pub fn write_rest(&self, path: &Path) {
        let motion = MotionConfig { duration: 60.0, ..MotionConfig::rest(self.seed) };
        self.write(path, &Motion::new(motion), false);
    }

    /// A swing with all axes moving; a vigorous one for the calibration.
    pub fn motion(&self, seconds: f64, vigorous: bool) -> Motion {
        let [swing, wobble, yaw] = if vigorous { [0.3, 0.15, 1.0] } else { [0.14, 0.06, 0.4] };
        Motion::new(MotionConfig {
            duration: seconds,
            still_until: 1.5,
            swing,
            wobble,
            yaw,
            climber_turn_rate: 0.3,
            climber_height: self.height,
            ..MotionConfig::nominal(self.seed)
        })
    }

    /// Writes the ground truth of a motion.
    pub fn write_truth(&self, path: &Path, motion: &Motion) {
        let mut bag = BagWriter::create(path, WriteOptions::default()).unwrap();
        let (epoch, none) = (SensorConfig::nominal(self.seed).epoch, Matrix6::zeros());
        for i in 0..(motion.duration() * 200.0) as usize {
            let t = i as f64 / 200.0;
            let (k, stamp) = (motion.kinematics(t), epoch.plus_seconds(t));
            let velocity = k.world_from_volant.rotation.inverse() * k.velocity;
            let message = convert::odometry_message(
                "world",
                "volant",
                stamp,
                &k.world_from_volant,
                &none,
                &velocity,
                &k.angular_velocity,
                &none,
            );
            put(&mut bag, absolute::GROUND_TRUTH, stamp, &message);
        }
        bag.finish().unwrap();
    }

    /// Writes a jog, one axis after the other, over the platform on the floor.
    pub fn write_jog(&self, path: &Path, turns: bool) {
        let mut bag = BagWriter::create(path, WriteOptions::default()).unwrap();
        let (frames, epoch) = (Frames::default(), Stamp::from_nanos(1_700_000_000_000_000_000));
        let mut random = Random::fork(self.seed, "jog");
        let axes = |t: f64| {
            let jog = |from: f64| (TAU * ((t - from) / 8.0).clamp(0.0, 1.0)).sin();
            let turn = if turns { 0.1 + 0.8 * jog(19.0) } else { 0.0 };
            [0.8 * jog(1.0), 0.7 * jog(10.0), turn]
        };
        let info = convert::camera_message(&frames.camera, epoch, &self.camera);
        put(&mut bag, absolute::CAMERA_INFO, epoch, &info);
        for i in 0..28 * 60 {
            let (t, stamp) = (f64::from(i) / 60.0, epoch.plus_seconds(f64::from(i) / 60.0));
            let mut readings = self.joint_state(stamp, axes(t));
            readings.position[0] = readings.position[0].round();
            if !turns {
                readings.name.truncate(2);
                readings.position.truncate(2);
            }
            put(&mut bag, absolute::JOINT_STATES, stamp, &readings);
            if i % 3 != 0 {
                continue;
            }
            let [x, y, turn] = axes(t);
            let climber = Isometry3::from_parts(
                Translation3::new(x, y, self.height),
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn),
            );
            let view = (climber * self.rig.climber_from_camera).inverse() * resting();
            let markers = PerColor::from_fn(|color| {
                let exact =
                    self.rig.markers.projected_centroid(color, &self.camera, &view).unwrap();
                let centroid = exact.pixel + Vector2::from_fn(|_, _| 0.05 * random.normal());
                MarkerObservation::detected(centroid, Matrix2::identity() * 0.0025, exact.area)
            });
            let observed = MarkerObservations { stamp: stamp.plus_seconds(0.001), markers };
            let message = convert::markers_message(&frames.camera, &observed);
            put(&mut bag, absolute::MARKERS, stamp, &message);
        }
        bag.finish().unwrap();
    }
}
