//! Parameters of the adjustment: what the filter takes as given, and the sensors' biases.

use crate::recording::{Moving, Recording};
use nalgebra::{DVector, Isometry3, Matrix2, Translation3, UnitQuaternion, Vector2, Vector3};
use rig_model::{CameraModel, Distortion, MarkerLayout, Rig};
use std::ops::Range;

/// Number of parameters.
pub const PARAMETERS: usize = 54;
/// Rotation of the camera about the climber's axes, rad.
pub const CAMERA_TURN: Range<usize> = 0..3;
/// Position of the camera in the climber frame, m.
pub const CAMERA_PLACE: Range<usize> = 3..6;
/// Rotation of the IMU about the volant axes, rad.
pub const IMU_TURN: Range<usize> = 6..9;
/// Position of the IMU in the volant frame, m.
pub const IMU_PLACE: Range<usize> = 9..12;
/// Positions of the four markers, m.
pub const MARKERS: Range<usize> = 12..24;
/// Accelerometer bias, m/s².
pub const FORCE_BIAS: Range<usize> = 24..27;
/// Gyroscope bias, rad/s.
pub const RATE_BIAS: Range<usize> = 27..30;
/// Camera stamp + this = IMU time, s.
pub const CAMERA_CLOCK: usize = 30;
/// Climber stamp + this = camera time, s.
pub const CLIMBER_CLOCK: usize = 31;
/// Logarithm of the focal length's factor.
pub const FOCAL: usize = 32;
/// Principal point, px.
pub const PRINCIPAL: Range<usize> = 33..35;
/// First four distortion coefficients.
pub const DISTORTION: Range<usize> = 35..39;
/// Logarithm of the layout's factor.
pub const LAYOUT_SCALE: usize = 39;
/// World axes over rail readings, row-major 2×2, minus identity.
pub const RAILS: Range<usize> = 40..44;
/// Factor of the climber's turn, minus one.
pub const TURN_SCALE: usize = 44;
/// Scale of each gyroscope axis, minus one.
pub const RATE_SCALE: Range<usize> = 45..48;
/// Scale of each accelerometer axis, minus one.
pub const FORCE_SCALE: Range<usize> = 48..51;
/// Readout time of a rolling shutter, s.
pub const READOUT: usize = 51;
/// Tilt of the climber by its acceleration along the world's x and y, rad/(m/s²).
pub const CARRIAGE: Range<usize> = 52..54;

/// Parameters on which pixels depend.
pub fn of_pixels(i: usize) -> bool {
    i < 6 || MARKERS.contains(&i) || (CLIMBER_CLOCK..=TURN_SCALE).contains(&i) || i >= READOUT
}

/// Parameters on which the IMU's motion between two images depends.
pub fn of_motion(i: usize) -> bool {
    (6..12).contains(&i)
        || (24..=CAMERA_CLOCK).contains(&i)
        || (RATE_SCALE.start..READOUT).contains(&i)
}

/// Rig under refinement, with camera, sensor errors, clock offsets and encoder scales: the flat
/// record that a step of [`PARAMETERS`] numbers changes.
#[derive(Clone, Debug)]
pub struct Parameters {
    /// The rig.
    pub rig: Rig,
    /// Logarithm of the layout's factor.
    pub layout_scale: f64,
    /// The rig's layout times that factor.
    pub layout: MarkerLayout,
    /// The camera.
    pub camera: CameraModel,
    /// Accelerometer and gyroscope errors.
    pub sensor: SensorErrors,
    /// Camera clock offset, s (camera stamp + offset = IMU time).
    pub camera_clock: f64,
    /// Climber clock offset, s (climber stamp + offset = camera time).
    pub climber_clock: f64,
    /// Readout time of a rolling shutter from the first row to the last, s.
    pub readout: f64,
    /// World axes over rail readings.
    pub rails: Matrix2<f64>,
    /// Factor of the climber's turn.
    pub turn_scale: f64,
    /// Tilt of the climber by its acceleration along x and y, rad/(m/s²): about y and about −x.
    pub carriage: Vector2<f64>,
    /// Climber axes (x, y, turn) whose readings are not used.
    pub ignored: [bool; 3],
    /// Readings (x, y, turn) about which the encoders' scales act: of the rails, whose origin is
    /// free, their mean.
    pub pivot: Vector3<f64>,
}

/// Errors of the IMU: measured = scale · true + bias, per axis.
#[derive(Clone, Copy, Debug)]
pub struct SensorErrors {
    /// Accelerometer bias, m/s².
    pub force_bias: Vector3<f64>,
    /// Gyroscope bias, rad/s.
    pub rate_bias: Vector3<f64>,
    /// Scale of the accelerometer's axes.
    pub force_scale: Vector3<f64>,
    /// Scale of the gyroscope's axes.
    pub rate_scale: Vector3<f64>,
}

impl Parameters {
    /// Starts at the files' values.
    pub fn new(rig: &Rig, recording: &Recording) -> Self {
        let n = recording.climber.len().max(1) as f64;
        let readings = recording.climber.iter().map(|c| Vector3::new(c.1.x, c.1.y, c.2));
        let pivot: Vector3<f64> = readings.sum();
        Self {
            rig: rig.clone(),
            layout_scale: 0.0,
            layout: rig.markers.clone(),
            camera: recording.camera.clone(),
            sensor: SensorErrors {
                force_bias: Vector3::zeros(),
                rate_bias: Vector3::zeros(),
                force_scale: Vector3::repeat(1.0),
                rate_scale: Vector3::repeat(1.0),
            },
            camera_clock: 0.0,
            climber_clock: 0.0,
            readout: 0.0,
            rails: Matrix2::identity(),
            turn_scale: 1.0,
            carriage: Vector2::zeros(),
            ignored: [false; 3],
            pivot: (pivot / n).xy().push(0.0),
        }
    }

    /// Applies a step of [`PARAMETERS`] numbers.
    pub fn moved(&self, step: &[f64]) -> Self {
        let v =
            |at: Range<usize>| Vector3::new(step[at.start], step[at.start + 1], step[at.start + 2]);
        let mut next = self.clone();
        let camera = &mut next.rig.climber_from_camera;
        camera.rotation = UnitQuaternion::from_scaled_axis(v(CAMERA_TURN)) * camera.rotation;
        camera.translation.vector += v(CAMERA_PLACE);
        let imu = &mut next.rig.imu.volant_from_imu;
        imu.rotation = UnitQuaternion::from_scaled_axis(v(IMU_TURN)) * imu.rotation;
        imu.translation.vector += v(IMU_PLACE);
        for (i, center) in next.rig.markers.centers.0.iter_mut().enumerate() {
            let at = MARKERS.start + 3 * i;
            center.coords += v(at..at + 3);
        }
        next.sensor.force_bias += v(FORCE_BIAS);
        next.sensor.rate_bias += v(RATE_BIAS);
        next.sensor.rate_scale += v(RATE_SCALE);
        next.sensor.force_scale += v(FORCE_SCALE);
        next.camera_clock += step[CAMERA_CLOCK];
        next.climber_clock += step[CLIMBER_CLOCK];
        next.readout += step[READOUT];
        next.layout_scale += step[LAYOUT_SCALE];
        next.layout = scaled(&next.rig.markers, next.layout_scale.exp());
        if step[FOCAL..LAYOUT_SCALE].iter().any(|s| *s != 0.0) {
            next.camera = changed(&self.camera, &step[FOCAL..LAYOUT_SCALE]);
        }
        let r = &step[RAILS];
        next.rails += Matrix2::new(r[0], r[1], r[2], r[3]);
        next.turn_scale += step[TURN_SCALE];
        next.carriage += Vector2::new(step[CARRIAGE.start], step[CARRIAGE.start + 1]);
        next
    }

    /// Difference to another set of parameters.
    pub fn minus(&self, other: &Self) -> DVector<f64> {
        let mut d = DVector::zeros(PARAMETERS);
        let mut put = |at: Range<usize>, v: Vector3<f64>| {
            d.rows_mut(at.start, 3).copy_from(&v);
        };
        let (a, b) = (&self.rig.climber_from_camera, &other.rig.climber_from_camera);
        let (c, e) = (&self.rig.imu.volant_from_imu, &other.rig.imu.volant_from_imu);
        put(CAMERA_TURN, (a.rotation * b.rotation.inverse()).scaled_axis());
        put(CAMERA_PLACE, a.translation.vector - b.translation.vector);
        put(IMU_TURN, (c.rotation * e.rotation.inverse()).scaled_axis());
        put(IMU_PLACE, c.translation.vector - e.translation.vector);
        for i in 0..4 {
            let at = MARKERS.start + 3 * i;
            let moved = self.rig.markers.centers.0[i] - other.rig.markers.centers.0[i];
            put(at..at + 3, moved);
        }
        let (s, o) = (&self.sensor, &other.sensor);
        put(FORCE_BIAS, s.force_bias - o.force_bias);
        put(RATE_BIAS, s.rate_bias - o.rate_bias);
        put(RATE_SCALE, s.rate_scale - o.rate_scale);
        put(FORCE_SCALE, s.force_scale - o.force_scale);
        d[CAMERA_CLOCK] = self.camera_clock - other.camera_clock;
        d[CLIMBER_CLOCK] = self.climber_clock - other.climber_clock;
        d[READOUT] = self.readout - other.readout;
        d[FOCAL] = (self.camera.focal_lengths().x / other.camera.focal_lengths().x).ln();
        let point = self.camera.principal_point() - other.camera.principal_point();
        d.rows_mut(PRINCIPAL.start, 2).copy_from(&point);
        let lenses = [self, other].map(|p| p.camera.distortion().coefficients());
        for (i, (a, b)) in lenses[0].iter().zip(lenses[1]).take(DISTORTION.len()).enumerate() {
            d[DISTORTION.start + i] = a - b;
        }
        d[LAYOUT_SCALE] = self.layout_scale - other.layout_scale;
        let rails = (self.rails - other.rails).transpose();
        d.rows_mut(RAILS.start, 4).copy_from_slice(rails.as_slice());
        d[TURN_SCALE] = self.turn_scale - other.turn_scale;
        d.rows_mut(CARRIAGE.start, 2).copy_from(&(self.carriage - other.carriage));
        d
    }

    /// Largest tilt of the climber at the images, rad.
    pub fn largest_tilt(&self, recording: &Recording) -> f64 {
        let tilt = |time: f64| {
            let moving = recording.climber_at(time - self.climber_clock);
            self.carriage.component_mul(&moving.acceleration.xy()).norm()
        };
        recording.shots.iter().map(|shot| tilt(shot.time)).fold(0.0, f64::max)
    }

    /// `world_from_climber` at a time of the camera's clock, with the encoders' scales.
    pub fn world_from_climber(&self, recording: &Recording, time: f64) -> Isometry3<f64> {
        let Moving { position, turn, acceleration } =
            recording.climber_at(time - self.climber_clock);
        let about = self.pivot.xy();
        let moved: Vector2<f64> = about + self.rails * (position.xy() - about);
        let turn = self.pivot.z + self.turn_scale * (turn - self.pivot.z);
        let tilt = self.carriage.component_mul(&acceleration.xy());
        Isometry3::from_parts(
            Translation3::new(moved.x, moved.y, position.z),
            UnitQuaternion::from_scaled_axis(Vector3::new(-tilt.y, tilt.x, 0.0))
                * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn),
        )
    }
}

fn scaled(layout: &MarkerLayout, factor: f64) -> MarkerLayout {
    let mut layout = layout.clone();
    layout.side *= factor;
    layout.centers.0.iter_mut().for_each(|c| c.coords *= factor);
    layout
}

/// Applies a step of focal length, principal point and distortion; an invalid step changes nothing.
fn changed(camera: &CameraModel, step: &[f64]) -> CameraModel {
    let (f, c, (w, h)) =
        (camera.focal_lengths() * step[0].exp(), camera.principal_point(), camera.size());
    let mut lens = *camera.distortion();
    let coefficients: &mut [f64] = match &mut lens {
        Distortion::PlumbBob(d) => d,
        Distortion::RationalPolynomial(d) => d,
        Distortion::Equidistant(d) => d,
    };
    coefficients.iter_mut().zip(&step[3..]).for_each(|(d, s)| *d += s);
    CameraModel::new(w, h, [f.x, f.y, c.x + step[1], c.y + step[2]], lens)
        .unwrap_or_else(|_| camera.clone())
}
