//! Sensor data of a motion: IMU samples, encoder samples and marker coordinates in order of
//! arrival.
//!
//! Input: a [`Motion`], a [`Rig`], a [`CameraModel`] and a [`SensorConfig`]. Output: [`Samples`].

use crate::{motion::Motion, random::Random};
use nalgebra::{Matrix2, Matrix3, UnitQuaternion, Vector2, Vector3};
use rig_model::{
    CameraModel, ClimberSample, ImuSample, MarkerColor, MarkerObservation, MarkerObservations,
    MarkerState, OrientationSample, PerColor, Rig, Sample, Stamp,
};

/// Errors, rates and delays of the sensors; noise densities come from the rig. One flat struct, so
/// that a test changes single fields by struct update.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorConfig {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Stamp of t = 0.
    pub epoch: Stamp,
    /// IMU samples per second.
    pub imu_rate: f64,
    /// From sample to arrival, s: shortest and longest.
    pub imu_delay: [f64; 2],
    /// Factor on the rig file's noise densities.
    pub imu_noise_factor: f64,
    /// Bias of the accelerometer, imu axes, m/s².
    pub accelerometer_bias: Vector3<f64>,
    /// Bias of the gyroscope, imu axes, rad/s.
    pub gyroscope_bias: Vector3<f64>,
    /// Gravity, m/s².
    pub gravity: f64,
    /// Roll and pitch error of the IMU's own attitude, rad (1 sigma); it drifts within seconds. 0:
    /// no attitude.
    pub attitude_error: f64,
    /// Images per second.
    pub image_rate: f64,
    /// Time from the exposure of the first row of an image to that of the last, s.
    pub image_readout: f64,
    /// Noise of a marker's coordinates, px (1 sigma).
    pub pixel_noise: f64,
    /// From exposure to arrival, s: shortest and longest.
    pub image_delay: [f64; 2],
    /// The camera's clock minus the IMU's, s: stamps are too late by it.
    pub camera_clock_ahead: f64,
    /// Encoder samples per second.
    pub climber_rate: f64,
    /// White noise of x and y, m, and of the turn, rad (1 sigma).
    pub climber_noise: [f64; 2],
    /// Steps of x and y, m, and of the turn, rad; 0: none.
    pub climber_quantum: [f64; 2],
    /// From reading to arrival, s: shortest and longest.
    pub climber_delay: [f64; 2],
    /// The climber's clock minus the IMU's, s.
    pub climber_clock_ahead: f64,
    /// Hidden markers: color, from, to (s).
    pub hidden: Vec<(MarkerColor, f64, f64)>,
    /// Share of images of which one marker lies somewhere else or two are swapped.
    pub false_markers: f64,
}

impl SensorConfig {
    /// As in the recordings with ground truth, with marker coordinates of 0.1 px.
    pub fn nominal(seed: u64) -> Self {
        let mut r = Random::fork(seed, "biases");
        let mut bias = |sigma: f64| Vector3::new(r.normal(), r.normal(), r.normal()) * sigma;
        Self {
            seed,
            epoch: Stamp::from_nanos(1_700_000_000_000_000_000),
            imu_rate: 100.0,
            imu_delay: [0.001, 0.003],
            imu_noise_factor: 1.0,
            accelerometer_bias: bias(0.03),
            gyroscope_bias: bias(0.008),
            gravity: 9.81,
            attitude_error: 0.0096,
            image_rate: 30.0,
            image_readout: 0.0,
            pixel_noise: 0.1,
            image_delay: [0.025, 0.045],
            camera_clock_ahead: 0.0,
            climber_rate: 50.0,
            climber_noise: [0.0, 0.0],
            climber_quantum: [0.001, 0.05_f64.to_radians()],
            climber_delay: [0.002, 0.010],
            climber_clock_ahead: 0.0,
            hidden: Vec::new(),
            false_markers: 0.0,
        }
    }
}

/// The samples of a run with their times of arrival, in order of arrival; none is of the camera.
pub type Samples = Vec<(Stamp, Sample)>;

/// The sensors of one rig.
#[derive(Clone, Debug)]
pub struct Sensors<'a> {
    motion: &'a Motion,
    rig: &'a Rig,
    camera: &'a CameraModel,
    config: &'a SensorConfig,
}

impl<'a> Sensors<'a> {
    /// The sensors of `rig` in `motion`.
    pub fn new(
        motion: &'a Motion,
        rig: &'a Rig,
        camera: &'a CameraModel,
        config: &'a SensorConfig,
    ) -> Self {
        Self { motion, rig, camera, config }
    }

    /// IMU sample at `t` seconds without noise and bias: specific force and angular rate (imu
    /// axes).
    pub fn ideal_imu(&self, t: f64) -> (Vector3<f64>, Vector3<f64>) {
        let k = self.motion.kinematics(t);
        let mounting = &self.rig.imu.volant_from_imu;
        let lever = mounting.translation.vector;
        let (w, dw) = (k.angular_velocity, k.angular_acceleration);
        let to_volant = k.world_from_volant.rotation.inverse();
        let force = to_volant * (k.acceleration + Vector3::new(0.0, 0.0, self.config.gravity))
            + dw.cross(&lever)
            + w.cross(&w.cross(&lever));
        let to_imu = mounting.rotation.inverse();
        (to_imu * force, to_imu * w)
    }

    /// The marker's true centroid at `t` seconds, px; `None` where the camera does not see it.
    pub fn ideal_centroid(&self, color: MarkerColor, t: f64) -> Option<(Vector2<f64>, f64)> {
        let camera_from_volant =
            self.motion.world_from_camera(t, self.rig).inverse() * self.motion.world_from_volant(t);
        let c = self.rig.markers.projected_centroid(color, self.camera, &camera_from_volant)?;
        let (w, h) = self.camera.size();
        let margin = (c.area.sqrt()) * 0.75;
        let inside = c.pixel.x > margin
            && c.pixel.y > margin
            && c.pixel.x < f64::from(w) - margin
            && c.pixel.y < f64::from(h) - margin;
        inside.then_some((c.pixel, c.area))
    }

    /// Every IMU sample with its arrival.
    pub fn imu(&self) -> Samples {
        let c = self.config;
        let mut r = Random::fork(c.seed, "imu");
        let accel_sigma =
            self.rig.imu.accelerometer_noise_density * c.imu_rate.sqrt() * c.imu_noise_factor;
        let gyro_sigma =
            self.rig.imu.gyroscope_noise_density * c.imu_rate.sqrt() * c.imu_noise_factor;
        // The attitude error wanders with a time constant of ten seconds.
        let keep = (-1.0 / (10.0 * c.imu_rate)).exp();
        let heading = r.within(-3.0, 3.0);
        let mut error = Vector3::new(r.normal(), r.normal(), 2.0 * r.normal()) * c.attitude_error;
        let mut samples = Vec::new();
        let count = (self.motion.duration() * c.imu_rate) as usize;
        for i in 0..count {
            let t = (i as f64 + 0.3) / c.imu_rate + 1.5e-4 * r.normal();
            let (force, rate) = self.ideal_imu(t);
            let mut white = |sigma: f64| Vector3::new(r.normal(), r.normal(), r.normal()) * sigma;
            error = error * keep + white(c.attitude_error * (1.0 - keep * keep).sqrt());
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading);
            let attitude = UnitQuaternion::from_scaled_axis(error)
                * turn
                * self.motion.world_from_volant(t).rotation
                * self.rig.imu.volant_from_imu.rotation;
            let variance = c.attitude_error * c.attitude_error;
            let sample = ImuSample {
                stamp: c.epoch.plus_seconds(t),
                specific_force: force + c.accelerometer_bias + white(accel_sigma),
                angular_velocity: rate + c.gyroscope_bias + white(gyro_sigma),
                orientation: (c.attitude_error > 0.0).then(|| OrientationSample {
                    enu_from_imu: attitude,
                    covariance: Some(Matrix3::from_diagonal(&Vector3::new(
                        variance,
                        variance,
                        4.0 * variance,
                    ))),
                }),
            };
            samples.push((
                c.epoch.plus_seconds(t + r.within(c.imu_delay[0], c.imu_delay[1])),
                Sample::Imu(sample),
            ));
        }
        samples
    }

    /// Every IMU sample.
    pub fn imu_samples(&self) -> Vec<ImuSample> {
        let samples = self.imu().into_iter();
        samples.filter_map(|(_, s)| if let Sample::Imu(s) = s { Some(s) } else { None }).collect()
    }

    /// What the encoders read at `t` seconds: x, y (m) and turn (rad), with noise and steps.
    pub fn encoders(&self, t: f64, random: &mut Random) -> [f64; 3] {
        let (noise, quantum) = (self.config.climber_noise, self.config.climber_quantum);
        let mut reading = self.motion.climber(t);
        for (value, kind) in reading.iter_mut().zip([0, 0, 1]) {
            *value += noise[kind] * random.normal();
            if quantum[kind] > 0.0 {
                *value = (*value / quantum[kind]).round() * quantum[kind];
            }
        }
        reading
    }

    /// Every encoder sample with its arrival.
    pub fn climber(&self) -> Samples {
        let c = self.config;
        let mut r = Random::fork(c.seed, "climber");
        let count = (self.motion.duration() * c.climber_rate) as usize;
        (0..count)
            .map(|i| {
                let t = (i as f64 + 0.45) / c.climber_rate + 1e-4 * r.normal();
                let reading = self.encoders(t, &mut r);
                let sample = ClimberSample {
                    stamp: c.epoch.plus_seconds(t + c.climber_clock_ahead),
                    world_from_climber: self.motion.climber_pose(reading),
                };
                let delay = r.within(c.climber_delay[0], c.climber_delay[1] + 1e-9);
                (c.epoch.plus_seconds(t + delay), Sample::Climber(sample))
            })
            .collect()
    }

    /// Every image's markers with their arrival.
    pub fn markers(&self) -> Samples {
        let c = self.config;
        let mut r = Random::fork(c.seed, "markers");
        let count = ((self.motion.duration() - 0.08) * c.image_rate) as usize;
        let mut hidden_for = [u16::MAX; 4];
        let mut images = Vec::with_capacity(count);
        for i in 0..count {
            let t = 0.06 + i as f64 / c.image_rate + 2e-4 * r.normal();
            let mut markers = PerColor::from_fn(|color| {
                let k = color.index();
                let noise = Vector2::new(r.normal(), r.normal()) * c.pixel_noise;
                let hidden =
                    c.hidden.iter().any(|(h, from, to)| *h == color && t >= *from && t < *to);
                // A row of the marker is exposed where the marker is by then.
                let row = self.ideal_centroid(color, t).map_or(0.0, |(pixel, _)| pixel.y);
                let late = c.image_readout * (row / f64::from(self.camera.size().1) - 0.5);
                match self.ideal_centroid(color, t + late) {
                    Some((pixel, area)) if !hidden => {
                        hidden_for[k] = 0;
                        let covariance = Matrix2::identity() * c.pixel_noise.max(1e-3).powi(2);
                        MarkerObservation::detected(pixel + noise, covariance, area)
                    }
                    _ => {
                        hidden_for[k] = hidden_for[k].saturating_add(1);
                        MarkerObservation::lost(hidden_for[k])
                    }
                }
            });
            if r.unit() < c.false_markers {
                let (a, b) = (r.index(4), r.index(4));
                let swap = r.unit() < 0.3 && a != b;
                let elsewhere = Vector2::new(r.within(20.0, 620.0), r.within(20.0, 460.0));
                if swap && markers.0[a].state == markers.0[b].state {
                    let (pa, pb) = (markers.0[a].centroid, markers.0[b].centroid);
                    markers.0[a].centroid = pb;
                    markers.0[b].centroid = pa;
                } else if markers.0[a].state == MarkerState::Detected {
                    markers.0[a].centroid = elsewhere;
                }
            }
            let observations = MarkerObservations {
                stamp: c.epoch.plus_seconds(t + c.camera_clock_ahead),
                markers,
            };
            let delay = r.within(c.image_delay[0], c.image_delay[1] + 1e-9);
            images.push((c.epoch.plus_seconds(t + delay), Sample::Markers(observations)));
        }
        images
    }

    /// All samples in order of arrival.
    pub fn record(&self) -> Samples {
        let mut all = self.imu();
        all.extend(self.climber());
        all.extend(self.markers());
        all.sort_by_key(|(arrival, _)| *arrival);
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::MotionConfig;

    #[test]
    fn a_stationary_imu_measures_gravity_upwards_and_data_arrive_in_order() {
        let rig = Rig::from_yaml(crate::RIG_YAML).unwrap();
        let camera = crate::render::tests::camera();
        let motion = Motion::new(MotionConfig::rest(1));
        let config = SensorConfig::nominal(1);
        let sensors = Sensors::new(&motion, &rig, &camera, &config);
        let (force, rate) = sensors.ideal_imu(3.0);
        assert!((force.norm() - 9.81).abs() < 1e-6 && rate.norm() < 1e-9, "{force} {rate}");
        let recording = sensors.record();
        assert!(recording.windows(2).all(|w| w[0].0 <= w[1].0));
        let images = recording.iter().filter(|(_, m)| matches!(m, Sample::Markers(_))).count();
        assert!((300..400).contains(&images));
        assert_eq!(recording, Sensors::new(&motion, &rig, &camera, &config).record());
    }
}
