//! Least squares on the markers' pixels.

use super::{
    AxisCalibration, ClimberCalibration, ClimberError, Jog, RESIDUAL, Series, Shot, Value,
    assign::Assigned,
};
use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix2, Translation3, UnitQuaternion, Vector2, Vector3,
};
use rig_model::{MarkerColor, median};

/// Parameters of the fit: rotation of the platform (3), climber at the first image from the
/// platform (3, m) and its turn (rad), logarithmic change of the scales (3), camera tilt about the
/// climber's x and y (2, rad), camera offset (2, m), time offset (s).
const SIZE: usize = 15;
const SCALES: usize = 7;
const TILT: usize = 10;
const OFFSET: usize = 12;
const TIME: usize = 14;

/// Standard deviations of the priors: what a tape and a level give; wide for the rest.
const PRIOR: [f64; SIZE] =
    [0.1, 0.1, 10.0, 10.0, 10.0, 10.0, 10.0, 0.5, 0.5, 0.5, 0.05, 0.05, 0.1, 0.1, 0.1];
/// Steps of the numerical derivatives.
const STEP: f64 = 1e-6;
/// Largest last step of a fit that has converged, in standard deviations.
const CONVERGED: f64 = 0.1;
/// Assumed standard deviation of a centroid, px; the residuals scale the result.
const PIXEL: f64 = 0.1;
/// Largest standard deviation at which the camera's tilt (rad) and offset (m) count as determined.
const DETERMINED: [f64; 2] = [0.005, 0.01];

struct Problem<'a> {
    jog: &'a Jog<'a>,
    shots: Vec<&'a Shot>,
    /// Joint series and initial scale of each axis.
    axes: [Option<(&'a Series, f64)>; 3],
    /// Reading of each axis that counts as the first.
    first: [f64; 3],
    start: [f64; SIZE],
}

struct Solution {
    parameters: DVector<f64>,
    /// Normal matrix.
    normal: DMatrix<f64>,
    residuals: DVector<f64>,
    converged: bool,
}

impl Problem<'_> {
    /// Pose of the platform in the camera's frame at a shot.
    fn view(&self, p: &DVector<f64>, shot: &Shot) -> Isometry3<f64> {
        let axis = |i: usize| {
            self.axes[i].map_or(0.0, |(series, scale)| {
                let reading = series.at(shot.time + p[TIME]).unwrap_or(self.first[i]);
                scale * p[SCALES + i].exp() * (reading - self.first[i])
            })
        };
        let rotation = |x, y, z| UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z));
        // The platform's yaw outermost: tilt and yaw do not mix.
        let platform = rotation(0.0, 0.0, p[2]) * rotation(p[0], p[1], 0.0);
        let climber = Isometry3::from_parts(
            Translation3::new(p[3] + axis(0), p[4] + axis(1), p[5]),
            rotation(0.0, 0.0, p[6] + axis(2)),
        );
        let mounting = &self.jog.rig.climber_from_camera;
        let camera = Isometry3::from_parts(
            Translation3::from(
                mounting.translation.vector + Vector3::new(p[OFFSET], p[OFFSET + 1], 0.0),
            ),
            rotation(p[TILT], p[TILT + 1], 0.0) * mounting.rotation,
        );
        (climber * camera).inverse() * platform
    }

    /// Pixel residuals, shot by shot; `None` where a marker is behind the camera.
    fn residuals(&self, p: &DVector<f64>) -> Option<DVector<f64>> {
        let mut all = Vec::with_capacity(8 * self.shots.len());
        for shot in &self.shots {
            let view = self.view(p, shot);
            for (color, pixel) in MarkerColor::ALL.into_iter().zip(&shot.pixels) {
                let layout = &self.jog.rig.markers;
                let off = layout.projected_centroid(color, self.jog.camera, &view)?.pixel - pixel;
                all.extend([off.x / PIXEL, off.y / PIXEL]);
            }
        }
        Some(DVector::from_vec(all))
    }

    /// Gauss–Newton with priors, in at most `rounds` steps.
    fn solve(&self, mut p: DVector<f64>, rounds: usize) -> Option<Solution> {
        let start = DVector::from_row_slice(&self.start);
        for round in 1..=rounds {
            let residuals = self.residuals(&p)?;
            let mut jacobian = DMatrix::zeros(residuals.len(), SIZE);
            for i in 0..SIZE {
                let mut ahead = p.clone();
                ahead[i] += STEP;
                jacobian.set_column(i, &((self.residuals(&ahead)? - &residuals) / STEP));
            }
            let mut normal = jacobian.transpose() * &jacobian;
            let mut right = -(jacobian.transpose() * &residuals);
            for i in 0..SIZE {
                normal[(i, i)] += PRIOR[i].powi(-2);
                right[i] -= (p[i] - start[i]) / PRIOR[i].powi(2);
            }
            let step = normal.clone().cholesky()?.solve(&right);
            p += &step;
            if step.amax() < 1e-9 || round == rounds {
                let converged = step.dot(&(&normal * &step)) < CONVERGED * CONVERGED;
                let residuals = self.residuals(&p)?;
                return Some(Solution { parameters: p, normal, residuals, converged });
            }
        }
        None
    }
}

pub(super) fn fit(
    jog: &Jog<'_>,
    shots: &[Shot],
    series: &[Series],
    assigned: &Assigned,
    rounds: usize,
) -> Result<ClimberCalibration, ClimberError> {
    let axes = assigned.axes.map(|axis| axis.map(|(joint, scale)| (&series[joint], scale)));
    let first = axes.map(|a| a.and_then(|(s, _)| s.at(shots[0].time)).unwrap_or(0.0));
    let height = -shots[0].climber_from_volant.translation.vector.z;
    let mut start = [0.0; SIZE];
    start[2] = assigned.platform_yaw;
    start[3..7].copy_from_slice(&[assigned.position.x, assigned.position.y, height, assigned.turn]);
    let mut problem = Problem { jog, shots: shots.iter().collect(), axes, first, start };
    let solve =
        |problem: &Problem<'_>, p| problem.solve(p, rounds).ok_or_else(ClimberError::diverged);
    let Solution { parameters, residuals, .. } = solve(&problem, DVector::from_row_slice(&start))?;
    // Images in which the tracker measured something else.
    let size = |i: usize| residuals.rows(8 * i, 8).norm();
    let limit = 4.0 * median((0..shots.len()).map(size).collect()).unwrap_or(0.0);
    problem.shots =
        shots.iter().enumerate().filter(|(i, _)| size(*i) <= limit).map(|s| s.1).collect();
    let Solution { parameters, normal, residuals, converged } = solve(&problem, parameters)?;
    let pixel_rms = PIXEL * (residuals.norm_squared() / residuals.len() as f64).sqrt();
    if pixel_rms > RESIDUAL {
        let millimeters = 1e3 * pixel_rms * height / jog.camera.focal_lengths().mean();
        return Err(ClimberError(format!(
            "the markers are {pixel_rms:.1} px (RMS, {millimeters:.0} mm) from where the encoders \
             put them; was the platform moved during the recording? lower it onto the floor and \
             jog again"
        )));
    }
    if !converged {
        return Err(ClimberError::diverged());
    }
    let covariance = normal.try_inverse().ok_or_else(ClimberError::diverged)?
        * (pixel_rms / PIXEL).powi(2).max(1.0);
    Ok(problem.result(&parameters, &covariance, pixel_rms))
}

impl Problem<'_> {
    fn result(
        &self,
        p: &DVector<f64>,
        covariance: &DMatrix<f64>,
        pixel_rms: f64,
    ) -> ClimberCalibration {
        let value = |i: usize| -> Value { (p[i], covariance[(i, i)].sqrt()) };
        let determined = |i: usize, limit: f64| {
            let pair = [value(i), value(i + 1)];
            pair.iter().all(|v| v.1 < limit).then_some(pair)
        };
        let rails = self.axes[0].is_some() || self.axes[1].is_some();
        let axes = [0, 1, 2].map(|i| {
            let (series, start) = self.axes[i]?;
            let scale = start * p[SCALES + i].exp();
            // Parameter that is the position of the first reading, and that of the platform.
            let known = match (i, self.jog.platform) {
                (2, _) if rails => Some((6, 0.0)),
                (0 | 1, Some(platform)) => Some((3 + i, platform[i])),
                _ => None,
            };
            let zero = |(k, platform): (usize, f64)| {
                let pair = [k, SCALES + i];
                let covariance =
                    Matrix2::from_fn(|row, column| covariance[(pair[row], pair[column])]);
                reading_at_origin(self.first[i], p[k] + platform, scale, &covariance)
            };
            Some(AxisCalibration {
                joint: series.name.clone(),
                scale: (scale, scale.abs() * value(SCALES + i).1),
                zero: known.map(zero),
            })
        });
        ClimberCalibration {
            axes,
            height: self.jog.platform.map(|platform| (p[5] + platform.z, value(5).1)),
            camera_offset: determined(OFFSET, DETERMINED[1]),
            camera_tilt: determined(TILT, DETERMINED[0]),
            time_offset: value(TIME),
            images: self.shots.len(),
            pixel_rms,
        }
    }
}

/// Reading at the world's origin, `first − at / scale`, where `first` is that at the position `at`;
/// `covariance`: of `at` and the logarithm of the scale.
fn reading_at_origin(first: f64, at: f64, scale: f64, covariance: &Matrix2<f64>) -> Value {
    let slope = Vector2::new(-1.0, at) / scale;
    (first - at / scale, slope.dot(&(covariance * slope)).max(0.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_zero_far_from_the_readings_is_as_uncertain_as_the_scale_is() {
        // 1 mm at 4 m, in counts of 50 µm, of which the scale is known to 0.1 %.
        let covariance = Matrix2::new(1e-6, 0.0, 0.0, 1e-6);
        let (zero, sigma) = reading_at_origin(100.0, 4.0, -5e-5, &covariance);
        assert!((zero - 80_100.0).abs() < 1e-6, "{zero}");
        assert!((sigma - 1e-3 * 17f64.sqrt() / 5e-5).abs() < 1e-6, "{sigma}");
    }
}
