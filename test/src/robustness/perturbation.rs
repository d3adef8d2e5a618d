//! Perturbations: one change to a recording or its rig file each, by name.

use nalgebra::{UnitQuaternion, Vector2, Vector3};
use pose_fusion::Input;
use rig_model::{
    CameraModel, ClimberSample, ImuSample, MarkerObservation, MarkerObservations, Stamp,
};
use rig_simulator::{random::Random, recording::Recording};
use std::{f64::consts::TAU, fmt};

/// Beginning of a perturbation of limited duration, s after the first truth.
pub const PERTURBED_FROM: f64 = 5.0;

/// One change. One of limited duration begins at [`PERTURBED_FROM`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Perturbation {
    /// Gyroscope scale error, relative.
    GyroScale(f64),
    /// Accelerometer scale error, relative.
    AccelerometerScale(f64),
    /// The IMU's axes are rotated about its x axis, degrees.
    ImuMisaligned(f64),
    /// The IMU's axes are rotated about its z axis, degrees.
    ImuYaw(f64),
    /// The camera is rotated about its x axis against the rig file, degrees.
    CameraMounting(f64),
    /// Focal length of the camera's calibration, relative error.
    FocalLength(f64),
    /// Marker layout of the rig file, relative error.
    Layout(f64),
    /// The red marker is off its place in the rig file by this, m.
    MarkerOff(f64),
    /// Encoder scale, relative error.
    EncoderScale(f64),
    /// Encoder stamps are late by this, s.
    EncoderDelay(f64),
    /// The x encoder is off by this (m) for this time (s; 0: one reading).
    EncoderOff(f64, f64),
    /// The encoders repeat their reading for this time, s.
    EncoderFrozen(f64),
    /// The encoder of one axis (0: x, 1: y, 2: turn) repeats its reading for this time, s.
    AxisFrozen(usize, f64),
    /// The encoders' readings are off, each by another number, m (1 sigma).
    EncoderNoise(f64),
    /// The IMU reads zero for this time, s.
    ImuZeros(f64),
    /// The IMU repeats its last values for this time, s.
    ImuStuck(f64),
    /// One IMU sample has this specific force, m/s².
    ImuSpike(f64),
    /// The gyroscope saturates at this, rad/s.
    GyroSaturated(f64),
    /// No IMU samples for this time, s.
    ImuLost(f64),
    /// No encoder readings for this time, s.
    EncodersLost(f64),
    /// No images for this time, s.
    ImagesLost(f64),
    /// No input of any kind for this time, s.
    AllLost(f64),
    /// The clock of camera and encoders is ahead by this from [`PERTURBED_FROM`] on, s.
    ClockStep(f64),
    /// The camera's and encoders' stamps are late by this, s.
    CameraDelay(f64),
    /// The images' stamps are off by up to this, each by another number, s.
    ImageJitter(f64),
    /// All markers of an image are off together by this, px (1 sigma), by another number in each.
    CameraShake(f64),
    /// The camera vibrates: all markers are off together by up to this (px) at this frequency, Hz.
    CameraVibration(f64, f64),
    /// A second publisher repeats every IMU sample.
    ImuTwice,
    /// The IMU's samples arrive in bursts of this many, with the stamps of their arrival.
    ImuBursts(usize),
    /// Red is hidden, and green and blue are exchanged for this time, s.
    Exchanged(f64),
}

pub const TABLE: [Perturbation; 46] = {
    use Perturbation::*;
    [
        GyroScale(0.002),
        GyroScale(-0.002),
        GyroScale(0.005),
        GyroScale(-0.005),
        GyroScale(0.02),
        GyroScale(-0.02),
        GyroScale(-0.05),
        AccelerometerScale(0.01),
        ImuMisaligned(0.5),
        ImuYaw(1.0),
        CameraMounting(0.2),
        FocalLength(0.01),
        Layout(0.01),
        MarkerOff(0.002),
        MarkerOff(0.005),
        EncoderScale(0.01),
        EncoderDelay(-0.15),
        EncoderDelay(0.15),
        EncoderDelay(0.4),
        EncoderOff(100.0, 0.0),
        EncoderOff(1.0, 0.1),
        EncoderOff(10.0, 1.0),
        EncoderFrozen(2.0),
        AxisFrozen(0, 2.0),
        AxisFrozen(1, 2.0),
        AxisFrozen(2, 2.0),
        EncoderNoise(0.003),
        ImuZeros(1.0),
        ImuStuck(1.0),
        ImuSpike(1000.0),
        GyroSaturated(0.5),
        ImuLost(2.0),
        EncodersLost(2.0),
        ImagesLost(2.0),
        AllLost(1.5),
        ClockStep(0.015),
        ClockStep(0.06),
        ClockStep(0.2),
        CameraDelay(0.1),
        ImageJitter(0.005),
        CameraShake(0.3),
        CameraVibration(0.3, 7.0),
        CameraVibration(0.3, 3.0),
        ImuTwice,
        ImuBursts(5),
        Exchanged(0.5),
    ]
};

impl fmt::Display for Perturbation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::GyroScale(x) => write!(f, "gyro scale {:+.1} %", x * 100.0),
            Self::AccelerometerScale(x) => write!(f, "accelerometer scale {:+.1} %", x * 100.0),
            Self::ImuMisaligned(x) => write!(f, "IMU misaligned {x}°"),
            Self::ImuYaw(x) => write!(f, "IMU yaw off by {x}°"),
            Self::CameraMounting(x) => write!(f, "camera mounting off by {x}°"),
            Self::FocalLength(x) => write!(f, "focal length {:+.1} %", x * 100.0),
            Self::Layout(x) => write!(f, "layout {:+.1} %", x * 100.0),
            Self::MarkerOff(x) => write!(f, "one marker {:.0} mm off", x * 1e3),
            Self::EncoderScale(x) => write!(f, "encoder scale {:+.1} %", x * 100.0),
            Self::EncoderDelay(x) => write!(f, "encoder stamps {:+.0} ms", x * 1e3),
            Self::EncoderOff(x, t) if *t == 0.0 => write!(f, "one encoder reading {x} m off"),
            Self::EncoderOff(x, t) => write!(f, "encoders {x} m off for {t} s"),
            Self::EncoderFrozen(t) => write!(f, "encoders frozen {t} s"),
            Self::AxisFrozen(axis, t) => {
                write!(f, "{} encoder frozen {t} s", ["x", "y", "turn"][*axis])
            }
            Self::EncoderNoise(x) => write!(f, "encoder noise {:.0} mm", x * 1e3),
            Self::ImuZeros(t) => write!(f, "IMU zeros {t} s"),
            Self::ImuStuck(t) => write!(f, "IMU stuck {t} s"),
            Self::ImuSpike(x) => write!(f, "one IMU sample of {x} m/s²"),
            Self::GyroSaturated(x) => write!(f, "gyro saturated at {x} rad/s"),
            Self::ImuLost(t) => write!(f, "no IMU for {t} s"),
            Self::EncodersLost(t) => write!(f, "no encoders for {t} s"),
            Self::ImagesLost(t) => write!(f, "no images for {t} s"),
            Self::AllLost(t) => write!(f, "no input for {t} s"),
            Self::ClockStep(t) => {
                write!(f, "clock of camera and encoders steps by {:+.0} ms", t * 1e3)
            }
            Self::CameraDelay(t) => write!(f, "camera and encoder stamps {:+.0} ms", t * 1e3),
            Self::CameraShake(px) => write!(f, "camera shakes by {px} px"),
            Self::CameraVibration(px, hz) => write!(f, "camera vibrates by {px} px at {hz} Hz"),
            Self::ImageJitter(t) => write!(f, "image stamps off by up to {:.0} ms", t * 1e3),
            Self::ImuTwice => write!(f, "every IMU sample twice"),
            Self::ImuBursts(n) => write!(f, "IMU stamped on arrival in bursts of {n}"),
            Self::Exchanged(t) => write!(f, "red hidden, green and blue exchanged {t} s"),
        }
    }
}

impl Perturbation {
    /// Returns how long it lasts, s: 0 for one sample, infinite for the whole run.
    pub fn duration(&self) -> f64 {
        match self {
            Self::EncoderOff(_, t)
            | Self::EncoderFrozen(t)
            | Self::AxisFrozen(_, t)
            | Self::AllLost(t)
            | Self::Exchanged(t)
            | Self::ImuZeros(t)
            | Self::ImuStuck(t)
            | Self::ImuLost(t)
            | Self::EncodersLost(t)
            | Self::ImagesLost(t) => *t,
            Self::ImuSpike(_) => 0.0,
            _ => f64::INFINITY,
        }
    }

    pub fn apply(&self, recording: &mut Recording) {
        self.apply_from(PERTURBED_FROM, recording);
    }

    /// Applies it; one of limited duration begins `from` seconds after the first truth.
    pub fn apply_from(&self, from: f64, recording: &mut Recording) {
        let from = recording.start().plus_seconds(from);
        let lasts = self.duration();
        let within = |stamp: Stamp| (0.0..lasts.max(1e-9)).contains(&stamp.seconds_since(from));
        let turn = |axis: Vector3<f64>, degrees: f64| {
            UnitQuaternion::from_scaled_axis(axis * degrees.to_radians())
        };
        // The first sample of the perturbed time.
        let mut once = true;
        let mut first = |stamp: Stamp| stamp >= from && std::mem::take(&mut once);
        match *self {
            Self::GyroScale(x) => each_imu(recording, |s| s.angular_velocity *= 1.0 + x),
            Self::AccelerometerScale(x) => each_imu(recording, |s| s.specific_force *= 1.0 + x),
            Self::ImuMisaligned(x) => rotate_imu(recording, turn(Vector3::x(), x)),
            Self::ImuYaw(x) => rotate_imu(recording, turn(Vector3::z(), x)),
            Self::CameraMounting(x) => {
                recording.rig.climber_from_camera.rotation *= turn(Vector3::x(), x)
            }
            Self::FocalLength(x) => each_camera(recording, |camera| {
                let (f, c) = (camera.focal_lengths() * (1.0 + x), camera.principal_point());
                let (w, h) = camera.size();
                let scaled = CameraModel::new(w, h, [f.x, f.y, c.x, c.y], *camera.distortion());
                *camera = scaled.unwrap_or_else(|_| camera.clone());
            }),
            Self::Layout(x) => {
                recording.rig.markers.centers.0.iter_mut().for_each(|c| c.coords *= 1.0 + x);
                recording.rig.markers.side *= 1.0 + x;
            }
            Self::MarkerOff(x) => recording.rig.markers.centers.0[0].x += x,
            Self::EncoderScale(x) => each_climber(recording, |s| {
                s.world_from_climber.translation.vector.x *= 1.0 + x;
                s.world_from_climber.translation.vector.y *= 1.0 + x;
            }),
            Self::EncoderDelay(x) => each_climber(recording, |s| s.stamp = s.stamp.plus_seconds(x)),
            Self::EncoderOff(x, duration) => each_climber(recording, |s| {
                let hit = if duration == 0.0 { first(s.stamp) } else { within(s.stamp) };
                if hit {
                    s.world_from_climber.translation.vector.x += x;
                }
            }),
            Self::EncoderFrozen(_) => {
                let mut frozen = None;
                each_climber(recording, |s| {
                    if within(s.stamp) {
                        s.world_from_climber = *frozen.get_or_insert(s.world_from_climber);
                    }
                });
            }
            Self::AxisFrozen(axis, _) => {
                let mut frozen = None;
                each_climber(recording, |s| {
                    if within(s.stamp) {
                        let held = frozen.get_or_insert(s.world_from_climber);
                        if axis < 2 {
                            let place = &mut s.world_from_climber.translation.vector;
                            place[axis] = held.translation.vector[axis];
                        } else {
                            s.world_from_climber.rotation = held.rotation;
                        }
                    }
                });
            }
            Self::EncoderNoise(sigma) => {
                let mut random = Random::fork(1, "encoders");
                each_climber(recording, |s| {
                    let off = Vector2::from_fn(|_, _| sigma * random.normal());
                    s.world_from_climber.translation.vector += off.push(0.0);
                });
            }
            Self::ImuZeros(_) => each_imu(recording, |s| {
                if within(s.stamp) {
                    (s.specific_force, s.angular_velocity) = (Vector3::zeros(), Vector3::zeros());
                }
            }),
            Self::ImuStuck(_) => {
                let mut stuck = None;
                each_imu(recording, |s| {
                    if within(s.stamp) {
                        (s.specific_force, s.angular_velocity) =
                            *stuck.get_or_insert((s.specific_force, s.angular_velocity));
                    }
                });
            }
            Self::ImuSpike(x) => each_imu(recording, |s| {
                if first(s.stamp) {
                    s.specific_force.x = x;
                }
            }),
            Self::GyroSaturated(x) => each_imu(recording, |s| {
                s.angular_velocity = s.angular_velocity.map(|w| w.clamp(-x, x))
            }),
            Self::ImuLost(_) => {
                recording.inputs.retain(|(_, i)| !matches!(i, Input::Imu(s) if within(s.stamp)));
            }
            Self::EncodersLost(_) => {
                let lost = |i: &Input| matches!(i, Input::Climber(s) if within(s.stamp));
                recording.inputs.retain(|(_, i)| !lost(i));
            }
            Self::ImagesLost(_) => {
                let lost = |i: &Input| matches!(i, Input::Markers(s) if within(s.stamp));
                recording.inputs.retain(|(_, i)| !lost(i));
            }
            Self::AllLost(_) => {
                let lost = |i: &Input| match i {
                    Input::Imu(s) => within(s.stamp),
                    Input::Climber(s) => within(s.stamp),
                    Input::Markers(m) => within(m.stamp),
                    Input::Camera(_) => false,
                };
                recording.inputs.retain(|(_, i)| !lost(i));
            }
            Self::ClockStep(x) => {
                let step = |stamp: &mut Stamp| {
                    if *stamp >= from {
                        *stamp = stamp.plus_seconds(x);
                    }
                };
                each_climber(recording, |s| step(&mut s.stamp));
                each_image(recording, |m| step(&mut m.stamp));
            }
            Self::CameraDelay(x) => {
                each_climber(recording, |s| s.stamp = s.stamp.plus_seconds(x));
                each_image(recording, |m| m.stamp = m.stamp.plus_seconds(x));
            }
            Self::ImageJitter(most) => {
                let mut random = Random::fork(1, "stamps");
                each_image(recording, |m| {
                    m.stamp = m.stamp.plus_seconds(random.within(-most, most));
                });
            }
            Self::CameraShake(sigma) => {
                let mut random = Random::fork(1, "shake");
                each_image(recording, |m| {
                    let off = Vector2::from_fn(|_, _| sigma * random.normal());
                    m.markers.0.iter_mut().for_each(|marker| marker.centroid += off);
                });
            }
            Self::CameraVibration(amplitude, frequency) => {
                let start = recording.start();
                each_image(recording, |m| {
                    let phase = m.stamp.seconds_since(start) * frequency * TAU;
                    let off = Vector2::new(phase.sin(), 0.6 * phase.cos()) * amplitude;
                    m.markers.0.iter_mut().for_each(|marker| marker.centroid += off);
                });
            }
            Self::ImuTwice => {
                let twice = recording.inputs.drain(..).flat_map(|(at, input)| {
                    let count = if matches!(input, Input::Imu(_)) { 2 } else { 1 };
                    std::iter::repeat_n((at, input), count)
                });
                recording.inputs = twice.collect();
            }
            Self::ImuBursts(count) => recording.arrive_in_bursts(count, Some(1e-4)),
            Self::Exchanged(_) => each_image(recording, |m| {
                if within(m.stamp) {
                    m.markers.0[0] = MarkerObservation::lost(1);
                    m.markers.0.swap(1, 2);
                }
            }),
        }
    }
}

/// Functions that change every input of one kind.
macro_rules! each {
    ($($name:ident: $kind:ident($input:ty);)*) => {
        $(pub(crate) fn $name(recording: &mut Recording, mut change: impl FnMut(&mut $input)) {
            for (_, input) in &mut recording.inputs {
                if let Input::$kind(input) = input {
                    change(input);
                }
            }
        })*
    };
}

each! {
    each_imu: Imu(ImuSample);
    each_climber: Climber(ClimberSample);
    each_image: Markers(MarkerObservations);
    each_camera: Camera(CameraModel);
}

fn rotate_imu(recording: &mut Recording, turn: UnitQuaternion<f64>) {
    each_imu(recording, |s| {
        s.specific_force = turn * s.specific_force;
        s.angular_velocity = turn * s.angular_velocity;
    });
}
