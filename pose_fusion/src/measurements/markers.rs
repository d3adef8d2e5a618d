//! Update of the state by the markers of one image: gates, the largest consistent subset and its
//! correction. The prediction is in [`super::marker_prediction`], the iterated update in
//! `marker_solution.rs`. Equations: `docs/src/equations.md`, "Markers".

use super::{
    Innovation, Outcome,
    geometry::{ClimberHeightTilt, Geometry},
    marker_misfit::{Misfit, misfit},
    marker_prediction::{
        by_calibration, innovation_spread, layout_spread, linearize, mean_variance,
        measurement_noise, times_error,
    },
    marker_solution::{Prediction, Solution, count, covariance_times, largest_consistent, solve},
};
use crate::{
    ekf::{
        calibration::OFFSETS,
        consider::{self, FILE_ERRORS, MARKERS, PARAMETERS, SIZE},
        propagation::ImuReading,
        state::{ATTITUDE, CLIMBER, N, POSITION, State},
        update::subtract_square,
    },
    health::rig_evidence::ImageEvidence,
};
use nalgebra::{Cholesky, Matrix2, SMatrix, SVector, Vector2};

/// Entries of the error that an image measures.
pub const SEEN: [usize; 9] = {
    let (p, a, c) = (POSITION, ATTITUDE, CLIMBER);
    [p, p + 1, p + 2, a, a + 1, a + 2, c, c + 1, c + 2]
};
/// Two rows per marker.
pub type Residual = SVector<f64, 8>;
/// Derivative of the residual's measurement by the entries [`SEEN`].
pub type Jacobian = SMatrix<f64, 8, 9>;
/// `P Hᵀ`.
pub type Gain = SMatrix<f64, N, 8>;
/// Covariance of the residual.
pub type Block = SMatrix<f64, 8, 8>;
/// Derivative of the measurement by the consider parameters.
pub type ByCalibration = SMatrix<f64, 8, PARAMETERS>;
/// Offsets of the markers' centers: x and y of red, green, blue, yellow, volant axes, m.
pub type Offsets = SVector<f64, OFFSETS>;
/// Sigma of the attitude, rad, above which one or two markers fit some attitude even if they are
/// false: they are not used where more are seen. Only above it does a marker that is seen alone
/// count as a contradiction.
pub const ATTITUDE_KNOWN: f64 = 0.02;
/// Largest squared misfit of markers that agree: χ² quantile (0.999), 2 degrees of freedom.
pub const AGREEING: f64 = 13.82;
/// Centroid (raw px) and covariance (px²) of each detected marker.
pub type Pixels = [Option<(Vector2<f64>, Matrix2<f64>)>; 4];

/// Markers of one image as the update needs them; small, because the history holds many.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Image {
    /// Centroid of each marker, raw px.
    centroids: [[f64; 2]; 4],
    /// Their covariances: xx, xy, yy, px².
    covariances: [[f32; 3]; 4],
    detected: [bool; 4],
    /// Camera time offset with which the image was placed on the IMU's time line, s.
    pub time_offset: f64,
    /// Standard deviation of the stamp, s.
    pub stamp_sigma: f32,
    /// Variance of the error that its markers share, x and y of the image, px².
    pub shake: [f32; 2],
    /// Height and tilt of the climber.
    pub rest: ClimberHeightTilt,
    /// By how much images newly contradict the places of the markers (1 sigma), m.
    pub layout_doubt: Option<f32>,
}

impl Image {
    /// Returns an image that was placed on the IMU's time line with a camera time offset, s.
    pub fn new(pixels: &Pixels, time_offset: f64, rest: ClimberHeightTilt) -> Self {
        let covariance = |c: Matrix2<f64>| [c.m11, c.m21, c.m22].map(|x| x as f32);
        Self {
            centroids: pixels.map(|marker| marker.map_or([0.0; 2], |(pixel, _)| pixel.into())),
            covariances: pixels.map(|marker| marker.map_or([0.0; 3], |(_, c)| covariance(c))),
            detected: pixels.map(|marker| marker.is_some()),
            time_offset,
            stamp_sigma: 0.0,
            shake: [0.0; 2],
            rest,
            layout_doubt: None,
        }
    }

    /// Returns the detected markers.
    pub fn pixels(&self) -> Pixels {
        std::array::from_fn(|i| {
            let [xx, xy, yy] = self.covariances[i].map(f64::from);
            self.detected[i].then(|| (self.centroids[i].into(), Matrix2::new(xx, xy, xy, yy)))
        })
    }

    /// Returns the image with the variance of its pixels times `factor`.
    pub fn with_noise(&self, factor: f64) -> Self {
        let covariances = self.covariances.map(|c| c.map(|x| x * factor as f32));
        Self { covariances, ..*self }
    }

    /// Returns whether a marker is detected.
    pub fn has(&self, marker: usize) -> bool {
        self.detected[marker]
    }

    /// Returns the number of detected markers.
    pub fn detected(&self) -> usize {
        self.detected.iter().filter(|detected| **detected).count()
    }
}

/// Records of one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageInnovation {
    /// Marker by marker, in the order of the colors.
    pub markers: [Innovation<2>; 4],
    /// Normalized innovation squared of all used markers (2 degrees of freedom each).
    pub nis: f64,
    /// Number of markers used.
    pub used: u32,
    /// What no pose explains; only with four detected markers, used or not.
    pub misfit: Option<Misfit>,
    /// NIS of four detected markers of which not all are used (8 degrees of freedom).
    pub against_prediction: Option<f64>,
    /// NIS of all detected markers that is left where x, y or turn of the climber is free.
    pub with_free_climber: [f64; 3],
    /// Variance of the mean marker without the shake of the camera, x and y of the image, px².
    pub mean_variance: Vector2<f64>,
    /// What the correction leaves of each marker's residual, px; NaN where there is none.
    pub left: [Vector2<f64>; 4],
    /// What the used markers show of errors of the rig's files.
    pub evidence: ImageEvidence,
}

impl ImageInnovation {
    /// Returns whether four markers agree with each other, whatever the prediction.
    pub fn agrees_with_itself(&self) -> bool {
        self.misfit.is_some_and(|misfit| misfit.squared() < AGREEING)
    }
}

/// Corrects `state` by the markers that pass the gates and returns what became of each. `gate` is
/// the largest NIS of one marker (2 degrees of freedom); infinite, nothing is rejected. `reading`
/// is the IMU's at the exposure, `gravity` in m/s². Without `apply` the state stays as it is.
pub fn update(
    state: &mut State,
    geometry: &Geometry,
    image: &Image,
    reading: &ImuReading,
    gate: f64,
    gravity: f64,
    apply: bool,
) -> ImageInnovation {
    let mut record = ImageInnovation {
        markers: [Innovation::without_values(Outcome::NotDetected); 4],
        nis: f64::NAN,
        used: 0,
        misfit: None,
        against_prediction: None,
        with_free_climber: [f64::NAN; 3],
        mean_variance: Vector2::zeros(),
        left: [Vector2::repeat(f64::NAN); 4],
        evidence: ImageEvidence::default(),
    };
    if let (Some(sigma), true) = (image.layout_doubt, apply) {
        state.calibration.open_layout(f64::from(sigma));
    }
    let linear = linearize(state, geometry, image, reading);
    let gain = covariance_times(&state.covariance, &linear.jacobian);
    let spread = innovation_spread(&linear.jacobian, &gain);
    let noise = measurement_noise(&linear, image);
    record.mean_variance = mean_variance(&noise, image);
    let seen =
        SMatrix::<f64, 9, PARAMETERS>::from_fn(|k, j| f64::from(state.sensitivity[(j, SEEN[k])]));
    let by_parameter = linear.jacobian * seen + by_calibration(&linear, geometry);
    let layout = layout_spread(state, &by_parameter);
    let at_prior = Prediction { linear, noise, by_parameter, layout };
    let (linear, whole) = (&at_prior.linear, spread + noise + layout);
    let mut pass = [false; 4];
    for i in (0..4).filter(|i| image.has(*i)) {
        let marker = &mut record.markers[i];
        if !linear.valid[i] {
            marker.outcome = Outcome::NotPredictable;
            continue;
        }
        marker.residual = linear.residual.fixed_rows::<2>(2 * i).into_owned();
        record.left[i] = marker.residual;
        marker.covariance = whole.fixed_view::<2, 2>(2 * i, 2 * i).into_owned();
        marker.nis = match Cholesky::new(marker.covariance) {
            Some(c) => marker.residual.dot(&c.solve(&marker.residual)),
            None => f64::INFINITY,
        };
        pass[i] = marker.nis <= gate;
        marker.outcome = if pass[i] { Outcome::Used } else { Outcome::Gated };
    }
    if linear.valid == [true; 4] {
        record.misfit = misfit(state, geometry, image, reading, linear);
    }
    let few = image.detected() <= 2 || state.sigmas(ATTITUDE).max() < ATTITUDE_KNOWN;
    let best = largest_consistent(&pass, gate.is_infinite(), |mask| {
        let solution = || solve(state, geometry, image, reading, &at_prior, mask);
        if count(mask) > 2 || few { solution() } else { None }
    });
    let chosen = best.as_ref().map_or([false; 4], |(mask, _)| *mask);
    for (i, marker) in record.markers.iter_mut().enumerate() {
        if pass[i] && !chosen[i] {
            marker.outcome = Outcome::Inconsistent;
        }
    }
    if let Some(cholesky) = Cholesky::new(whole) {
        let weighted = cholesky.solve(&linear.residual);
        let nis = linear.residual.dot(&weighted);
        record.against_prediction = record.misfit.map(|_| nis).filter(|_| count(&chosen) < 4);
        record.with_free_climber = std::array::from_fn(|axis| {
            let by_axis = linear.jacobian.column(6 + axis).into_owned();
            nis - by_axis.dot(&weighted).powi(2) / by_axis.dot(&cholesky.solve(&by_axis))
        });
    }
    let Some((_, solution)) = best else { return record };
    record.used = count(&chosen) as u32;
    record.nis = solution.nis;
    record.evidence = evidence(&solution, geometry);
    if apply {
        let offset = state.time_offset;
        state.add(&solution.step);
        for k in 0..2 * 4 {
            let (gain, row) = (solution.root.column(k), solution.by_parameter.row(k));
            consider::correct(&mut state.sensitivity, &gain.into(), &row.transpose());
        }
        let constants_step = state.calibration.correct(&solution.by_parameter, &solution.whitened);
        let constants_step = consider::of_constants(&state.sensitivity) * constants_step;
        state.add(&constants_step);
        let moved = times_error(&linear.jacobian, &(solution.step + constants_step));
        for (i, left) in record.left.iter_mut().enumerate() {
            *left -= moved.fixed_rows::<2>(2 * i);
        }
        state.shift_time(reading, state.time_offset - offset, gravity);
        subtract_square(&mut state.covariance, &solution.root);
    }
    record
}

/// Returns what the markers of a solution show of errors of the rig's files.
fn evidence(solution: &Solution, geometry: &Geometry) -> ImageEvidence {
    // The parameter in the place of the size is none of these errors.
    let mut by_error = solution.by_parameter.fixed_columns::<FILE_ERRORS>(0).into_owned();
    let by_offset = solution.by_parameter.fixed_columns::<OFFSETS>(MARKERS);
    by_error.set_column(SIZE, &(by_offset * consider::size(1.0, &geometry.markers)));
    ImageEvidence { by_error, by_climber: solution.by_climber, whitened: solution.whitened }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::ekf::{
        consider::MARKERS,
        propagation::{ProcessNoise, propagate},
        state::{Covariance, Error, TIME_OFFSET},
    };
    use nalgebra::{UnitQuaternion, Vector3};
    use rig_model::{CameraModel, Distortion, Rig};

    const RIG: &str = rig_simulator::RIG_YAML;
    pub const READING: ImuReading = ImuReading {
        specific_force: Vector3::new(0.0, 0.0, 9.8),
        angular_velocity: Vector3::new(0.5, -0.8, 0.3),
    };
    const GATE: f64 = 16.0;

    pub(in super::super) fn example() -> (State, Geometry, Image) {
        let rig = Rig::from_yaml(RIG).unwrap();
        let lens = Distortion::PlumbBob([-0.23, 0.08, 7e-4, -4e-4, -0.006]);
        let camera = CameraModel::new(640, 480, [590.0, 590.0, 319.5, 239.5], lens).unwrap();
        let geometry = Geometry::new(&rig, camera);
        let mut state = State::zero();
        state.position = Vector3::new(0.1, 0.05, 1.4);
        state.velocity = Vector3::new(0.4, -0.3, 0.1);
        state.attitude = UnitQuaternion::from_euler_angles(0.2, -0.1, 0.5);
        state.climber = Vector3::new(0.05, -0.02, 0.3);
        state.climber_rate = Vector3::new(0.2, 0.1, 0.15);
        state.time_offset = 0.004;
        let variance = Matrix2::identity() * 0.01;
        let rest = ClimberHeightTilt { height: 2.8, tilt: UnitQuaternion::identity() };
        let image = Image::new(&[Some((Vector2::zeros(), variance)); 4], 0.001, rest);
        let linear = linearize(&state, &geometry, &image, &READING);
        let pixels = std::array::from_fn(|i| {
            Some((-linear.residual.fixed_rows::<2>(2 * i).into_owned(), variance))
        });
        let image = Image::new(&pixels, 0.001, rest);
        state.covariance = Covariance::identity() * 1e-4;
        (state, geometry, image)
    }

    #[test]
    fn the_sensitivity_is_the_difference_to_a_filter_that_knows_the_markers_places() {
        let (mut plain, geometry, image) = example();
        for i in [3, 4, 5, 9, 10, 11, 12, 13, 14] {
            plain.covariance[(i, i)] = 1e-3;
        }
        // A nominal state moves with its time offset, its error does not.
        plain.set_sigma(TIME_OFFSET, 0.0);
        let mut informed = plain.clone();
        let offsets = Offsets::from_fn(|i, _| 5e-6 * ((3 * i + 1) as f64).sin());
        let mut known = geometry.clone();
        for (i, center) in known.markers.centers.0.iter_mut().enumerate() {
            center.x += offsets[2 * i];
            center.y += offsets[2 * i + 1];
        }
        let noise = ProcessNoise {
            force: 1e-5,
            rate: 1e-6,
            jerk: Vector3::repeat(0.01),
            ..Default::default()
        };
        let reading = ImuReading {
            specific_force: plain.attitude.inverse() * Vector3::z() * 9.81,
            angular_velocity: Vector3::zeros(),
        };
        for step in 0..40 {
            let mut seen = image;
            seen.time_offset = plain.time_offset;
            let true_pixels = linearize(&plain, &geometry, &seen, &reading).residual;
            for i in 0..4 {
                if (10..20).contains(&step) && i == 1 {
                    seen.detected[i] = false;
                } else {
                    seen.centroids[i][0] -= true_pixels[2 * i];
                    seen.centroids[i][1] -= true_pixels[2 * i + 1];
                }
            }
            for (state, geometry) in [(&mut plain, &geometry), (&mut informed, &known)] {
                let record = update(state, geometry, &seen, &reading, GATE, 9.81, true);
                assert!(record.used >= 3);
                propagate(state, &reading, &reading, 0.03, 9.81, &noise);
            }
        }
        let moved = informed.minus(&plain);
        let by_offset = plain.sensitivity.fixed_rows::<OFFSETS>(MARKERS).map(f64::from);
        let claimed = by_offset.transpose() * offsets;
        assert!(moved.fixed_rows::<3>(ATTITUDE).norm() > 1e-5, "{moved}");
        for i in POSITION..POSITION + 9 {
            assert!(
                (moved[i] - claimed[i]).abs() < 0.1 * moved.fixed_rows::<9>(0).amax(),
                "{moved}{claimed}"
            );
        }
    }

    #[test]
    fn a_climber_that_has_moved_along_an_axis_explains_an_image_by_that_axis() {
        for axis in 0..3 {
            let (mut state, geometry, image) = example();
            state.climber[axis] += 0.02;
            let record = update(&mut state, &geometry, &image, &READING, GATE, 9.81, false);
            for (i, left) in record.with_free_climber.into_iter().enumerate() {
                assert_eq!(left < 1.0, i == axis, "{axis} {i}: {left}");
            }
        }
    }

    #[test]
    fn two_markers_beside_a_rejected_one_count_only_with_a_known_attitude() {
        for (sigma, used) in [(0.01, 2), (0.1, 0)] {
            let (mut state, geometry, mut image) = example();
            state.set_sigmas(ATTITUDE, &Vector3::repeat(sigma));
            image.detected[3] = false;
            image.centroids[2][0] += 300.0;
            let record = update(&mut state, &geometry, &image, &READING, GATE, 9.81, true);
            assert_eq!(record.used, used, "{sigma}: {record:?}");
            // Where only two are seen, they are used.
            image.detected[2] = false;
            let record = update(&mut state, &geometry, &image, &READING, GATE, 9.81, true);
            assert_eq!(record.used, 2, "{sigma}: {record:?}");
        }
    }

    #[test]
    fn a_marker_that_contradicts_the_others_is_rejected_even_with_a_wide_prior() {
        let (mut state, geometry, mut image) = example();
        let truth = state.clone();
        state.covariance *= 100.0;
        state.set_sigma(TIME_OFFSET, 0.0);
        let mut off = Error::zeros();
        (off[0], off[7]) = (0.05, 0.05);
        state.add(&off);
        image.centroids[2][0] += 12.0;
        let record = update(&mut state, &geometry, &image, &READING, GATE, 9.81, true);
        assert_eq!(record.markers[2].outcome, Outcome::Inconsistent, "{record:?}");
        assert_eq!(record.used, 3);
        // The camera measures the platform against the climber, which is as uncertain.
        let there = (state.position - truth.position) - (state.climber - truth.climber);
        assert!(there.xy().norm() < 0.05, "{there}");
    }
}
