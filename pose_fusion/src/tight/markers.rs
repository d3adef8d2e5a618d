//! The markers of one image correct the state.
//!
//! A marker's predicted centroid is that of the projected square at
//! `camera_from_volant = (world_from_climber · climber_from_camera)⁻¹ · world_from_imu · imu_from_volant` (eq. 5), at the
//! time of the exposure. With `c` the square's centre and `R_wc` the camera's attitude,
//! `δc = R_wcᵀ (δp − [R m]× δθ − e_xy δc_xy − (e_z × (X − X_climber)) δturn)`, and the square turns about its centre by
//! `R_wcᵀ (δθ − e_z δturn)`. The clock offset has no part in it (see [`super::state`]).
//!
//! All markers of an image are used together, by an iterated update (Bell and Cathey 1993) where the step is large enough for
//! the projection to bend. Each marker must pass its own gate, and those that passed must agree with each other:
//! otherwise the largest subset that agrees is used. The covariance is corrected by `P − W Wᵀ` with
//! `W = P Hᵀ L⁻ᵀ`, `L Lᵀ = H P Hᵀ + R`: symmetric to the last bit, and equal to Joseph's form at the optimal gain.

use super::{
    geometry::{ClimberRest, Geometry},
    propagate::{Felt, retime},
    state::{ATTITUDE, CLIMBER, Covariance, Error, N, POSITION, State},
};
use nalgebra::{Cholesky, Const, Matrix2, Matrix2x3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};
use rig_model::MarkerColor;

/// The entries of the error that an image sees.
const SEEN: [usize; 9] = [
    POSITION,
    POSITION + 1,
    POSITION + 2,
    ATTITUDE,
    ATTITUDE + 1,
    ATTITUDE + 2,
    CLIMBER,
    CLIMBER + 1,
    CLIMBER + 2,
];
const M: usize = 8;
type Jacobian = SMatrix<f64, M, 9>;
type Residual = SVector<f64, M>;
type Gain = SMatrix<f64, N, M>;
type Innovation = SMatrix<f64, M, M>;

/// A χ² quantile (0.9999) for 2, 4, 6, 8 degrees of freedom.
const JOINT_LIMIT: [f64; 5] = [0.0, 18.42, 23.51, 27.86, 31.83];

/// The markers of one image as the update needs them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Centroid (raw px) and covariance (px², everything included) of each detected marker.
    pub pixels: [Option<(Vector2<f64>, Matrix2<f64>)>; 4],
    /// The camera clock offset that placed the image on the inertial unit's time line, s.
    pub clock: f64,
    /// What the unit felt then.
    pub felt: Felt,
    /// Height and tilt of the climber.
    pub rest: ClimberRest,
}

/// Why a marker was not used, or that it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Not in the sighting.
    Absent,
    /// It corrected the state.
    Used,
    /// Too unlikely on its own.
    Gated,
    /// Contradicts the others.
    Inconsistent,
    /// Cannot be projected.
    NotPredictable,
}

/// What became of one marker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerReport {
    /// Measured minus predicted, px.
    pub innovation: Vector2<f64>,
    /// Its covariance, px².
    pub covariance: Matrix2<f64>,
    /// Normalised innovation squared.
    pub nis: f64,
    /// Used or not.
    pub verdict: Verdict,
}

/// What became of an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Marker by marker.
    pub markers: [MarkerReport; 4],
    /// Normalised innovation squared of all used markers together (2 degrees of freedom each).
    pub nis: f64,
    /// How many were used.
    pub used: u32,
    /// Minus twice the logarithm of the image's likelihood, up to a constant: to weigh hypotheses.
    pub surprise: f64,
}

/// Limits of the update.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gates {
    /// Gravity, m/s².
    pub gravity: f64,
    /// Normalised innovation squared of one marker.
    pub marker: f64,
    /// Factor on the joint limit.
    pub joint: f64,
}

struct Linear {
    residual: Residual,
    jacobian: Jacobian,
    valid: [bool; 4],
}

/// Corrects `state` by the markers that pass, unless `frozen`. Says what became of each.
pub fn update(
    state: &mut State,
    geometry: &Geometry,
    sighting: &Sighting,
    gates: &Gates,
    frozen: bool,
) -> Report {
    let absent = MarkerReport {
        innovation: Vector2::repeat(f64::NAN),
        covariance: Matrix2::repeat(f64::NAN),
        nis: f64::NAN,
        verdict: Verdict::Absent,
    };
    let mut report = Report { markers: [absent; 4], nis: f64::NAN, used: 0, surprise: 0.0 };
    let linear = linearise(state, geometry, sighting);
    let gain = covariance_times(&state.covariance, &linear.jacobian);
    let spread = jacobian_times(&linear.jacobian, &gain);
    let mut pass = [false; 4];
    for (i, pixel) in sighting.pixels.iter().enumerate() {
        let Some((_, noise)) = pixel else { continue };
        let marker = &mut report.markers[i];
        if !linear.valid[i] {
            marker.verdict = Verdict::NotPredictable;
            continue;
        }
        marker.innovation = linear.residual.fixed_rows::<2>(2 * i).into_owned();
        marker.covariance = spread.fixed_view::<2, 2>(2 * i, 2 * i) + noise;
        marker.nis = match Cholesky::new(marker.covariance) {
            Some(c) => marker.innovation.dot(&c.solve(&marker.innovation)),
            None => f64::INFINITY,
        };
        pass[i] = marker.nis <= gates.marker;
        marker.verdict = if pass[i] { Verdict::Used } else { Verdict::Gated };
    }
    let count = |mask: &[bool; 4]| mask.iter().filter(|m| **m).count();
    let mut best = solve(state, geometry, sighting, &linear, &pass);
    let too_much = |s: &Option<Solution>, mask: &[bool; 4]| {
        s.as_ref().is_none_or(|s| s.cost > gates.joint * JOINT_LIMIT[count(mask)])
    };
    if count(&pass) >= 2 && too_much(&best, &pass) {
        best = None;
        let mut chosen = [false; 4];
        // The largest subset that agrees; among equals the likeliest. A single one agrees with itself: not enough.
        for size in (2..count(&pass)).rev() {
            for bits in 1u8..16 {
                let mask: [bool; 4] = std::array::from_fn(|i| bits >> i & 1 == 1 && pass[i]);
                if bits.count_ones() as usize != size || count(&mask) != size {
                    continue;
                }
                let solution = solve(state, geometry, sighting, &linear, &mask);
                if !too_much(&solution, &mask)
                    && best.as_ref().is_none_or(|b| solution.as_ref().is_some_and(|s| s.cost < b.cost))
                {
                    best = solution;
                    chosen = mask;
                }
            }
            if best.is_some() {
                break;
            }
        }
        for i in 0..4 {
            if pass[i] && !chosen[i] {
                report.markers[i].verdict = Verdict::Inconsistent;
            }
        }
        pass = chosen;
    }
    let Some(solution) = best else { return report };
    if count(&pass) == 0 {
        return report;
    }
    report.used = count(&pass) as u32;
    report.nis = solution.nis;
    report.surprise = solution.cost + solution.log_determinant;
    if !frozen {
        let before = state.clone();
        state.add(&solution.step);
        let (tied, white) = (solution.by_offset, solution.white);
        state.tie.by_offset -= solution.root * tied;
        state.tie.learn(tied.norm_squared(), tied.dot(&white));
        state.by_pixel -= solution.root * solution.by_pixel;
        let clock = state.camera_clock - before.camera_clock;
        retime(state, &sighting.felt, clock, gates.gravity);
        subtract_square(&mut state.covariance, &solution.root);
        if !state.is_sound() {
            *state = before;
            report.used = 0;
        } else {
            state.unseen = 0.0;
        }
    }
    report
}

struct Solution {
    step: Error,
    /// W = P Hᵀ L⁻ᵀ.
    root: Gain,
    /// Squared deviation from prior and pixels at the solution, in units of their covariances.
    cost: f64,
    /// Normalised innovation squared at the prior.
    nis: f64,
    log_determinant: f64,
    /// L⁻¹ ν, and by how much it would differ per second of the climber's clock: L⁻¹ H V.
    white: Residual,
    by_offset: Residual,
    /// And per pixel of the markers' constant offsets: L⁻¹ (H V + E).
    by_pixel: Innovation,
}

fn solve(
    prior: &State,
    geometry: &Geometry,
    sighting: &Sighting,
    at_prior: &Linear,
    mask: &[bool; 4],
) -> Option<Solution> {
    let mut noise = Innovation::identity();
    for (i, pixel) in sighting.pixels.iter().enumerate() {
        if let (true, Some((_, covariance))) = (mask[i], pixel) {
            noise.fixed_view_mut::<2, 2>(2 * i, 2 * i).copy_from(covariance);
        }
    }
    let masked = |linear: &Linear| {
        let (mut r, mut h) = (linear.residual, linear.jacobian);
        for (i, kept) in mask.iter().enumerate() {
            if !kept {
                r.fixed_rows_mut::<2>(2 * i).fill(0.0);
                h.fixed_rows_mut::<2>(2 * i).fill(0.0);
            }
        }
        (r, h)
    };
    let (mut residual, mut jacobian) = masked(at_prior);
    let mut step = Error::zeros();
    let mut nis = f64::NAN;
    for iteration in 0..5 {
        let gain = covariance_times(&prior.covariance, &jacobian);
        let spread = jacobian_times(&jacobian, &gain);
        let innovation = spread + noise;
        let cholesky = Cholesky::<f64, Const<M>>::new(innovation)?;
        let seen = times_seen(&jacobian, &step);
        let target = residual + seen;
        let weighted = cholesky.solve(&target);
        if iteration == 0 {
            nis = target.dot(&weighted);
        }
        let next: Error = gain * weighted;
        let moved = times_seen(&jacobian, &next);
        let left = target - moved;
        let bends = (moved - seen).amax() > 2.0 || (next - step).fixed_rows::<3>(ATTITUDE).amax() > 0.01;
        step = next;
        if bends && iteration < 4 {
            let mut there = prior.clone();
            there.add(&step);
            let linear = linearise(&there, geometry, sighting);
            if (0..4).any(|i| mask[i] && !linear.valid[i]) {
                return None;
            }
            let (r, h) = masked(&linear);
            if (r - left).amax() > 0.01 {
                (residual, jacobian) = (r, h);
                continue;
            }
        }
        let prior_cost = weighted.dot(&(spread * weighted));
        let pixel_cost = left.dot(&Cholesky::<f64, Const<M>>::new(noise)?.solve(&left));
        let l = cholesky.l();
        let root = l.solve_lower_triangular(&gain.transpose())?.transpose();
        let log_determinant = (0..M).map(|i| 2.0 * l[(i, i)].ln()).sum();
        let cost = prior_cost + pixel_cost;
        let white = l.solve_lower_triangular(&target)?;
        let by_offset = l.solve_lower_triangular(&times_seen(&jacobian, &prior.tie.by_offset))?;
        let mut by_pixel = jacobian * SMatrix::<f64, 9, M>::from_fn(|k, j| prior.by_pixel[(SEEN[k], j)]);
        for (i, kept) in mask.iter().enumerate() {
            for row in 2 * i..2 * i + 2 {
                by_pixel[(row, row)] += f64::from(u8::from(*kept));
            }
        }
        let by_pixel = l.solve_lower_triangular(&by_pixel)?;
        return cost.is_finite().then_some(Solution {
            step,
            root,
            cost,
            nis,
            log_determinant,
            white,
            by_offset,
            by_pixel,
        });
    }
    None
}

/// Residuals and their derivative by the seen entries of the error. A marker that is absent or cannot be projected
/// has zero rows.
fn linearise(state: &State, geometry: &Geometry, sighting: &Sighting) -> Linear {
    let late = state.camera_clock - sighting.clock;
    let world_rate = state.attitude * (sighting.felt.rate - state.gyroscope_bias);
    let climber = state.climber + state.climber_rate * late;
    let position = state.position + state.velocity * late;
    let attitude = UnitQuaternion::from_scaled_axis(world_rate * late) * state.attitude;
    let world_from_climber = sighting.rest.join(&climber);
    let world_from_camera = world_from_climber * geometry.climber_from_camera;
    let world_from_imu = nalgebra::Isometry3::from_parts(position.into(), attitude);
    let world_from_volant = world_from_imu * geometry.imu_from_volant;
    let camera_from_volant = world_from_camera.inverse() * world_from_volant;
    let to_camera = world_from_camera.rotation.inverse().to_rotation_matrix();
    let to_camera = to_camera.matrix();
    let mut linear = Linear { residual: Residual::zeros(), jacobian: Jacobian::zeros(), valid: [false; 4] };
    for color in MarkerColor::ALL {
        let i = color.index();
        let Some((measured, _)) = &sighting.pixels[i] else { continue };
        let Some(predicted) =
            geometry.markers.projected_centroid(color, &geometry.camera, &camera_from_volant)
        else {
            continue;
        };
        linear.valid[i] = true;
        linear.residual.fixed_rows_mut::<2>(2 * i).copy_from(&(measured - predicted.pixel));
        let centre = world_from_volant * geometry.markers.centres[color];
        let by_centre: Matrix2x3<f64> = predicted.jacobian_by_centre * to_camera;
        let by_turn: Matrix2x3<f64> = predicted.jacobian_by_turn * to_camera;
        let arm = centre.coords - position;
        let by_attitude = by_turn - by_centre * arm.cross_matrix();
        let about_climber = centre.coords - world_from_climber.translation.vector;
        let turning = Vector3::z().cross(&about_climber);
        let by_climber_turn = -(by_centre * turning) - by_turn.column(2);
        let mut rows = linear.jacobian.fixed_rows_mut::<2>(2 * i);
        rows.fixed_columns_mut::<3>(0).copy_from(&by_centre);
        rows.fixed_columns_mut::<3>(3).copy_from(&by_attitude);
        rows.fixed_columns_mut::<2>(6).copy_from(&-by_centre.fixed_columns::<2>(0));
        rows.fixed_columns_mut::<1>(8).copy_from(&by_climber_turn);
    }
    linear
}

/// P Hᵀ, by the columns of P that H touches.
fn covariance_times(p: &Covariance, h: &Jacobian) -> Gain {
    let mut out = Gain::zeros();
    for row in 0..M {
        let mut column = out.column_mut(row);
        for (k, &index) in SEEN.iter().enumerate() {
            let weight = h[(row, k)];
            if weight != 0.0 {
                column.axpy(weight, &p.column(index), 1.0);
            }
        }
    }
    out
}

/// H (P Hᵀ).
fn jacobian_times(h: &Jacobian, gain: &Gain) -> Innovation {
    let mut rows = SMatrix::<f64, 9, M>::zeros();
    for (k, &index) in SEEN.iter().enumerate() {
        rows.row_mut(k).copy_from(&gain.row(index));
    }
    let s = h * rows;
    (s + s.transpose()) * 0.5
}

/// H dx.
fn times_seen(h: &Jacobian, step: &Error) -> Residual {
    h * SVector::<f64, 9>::from_fn(|k, _| step[SEEN[k]])
}

/// P − W Wᵀ.
fn subtract_square(p: &mut Covariance, root: &Gain) {
    for k in 0..M {
        let w = root.column(k);
        for j in 0..N {
            let scale = w[j];
            if scale != 0.0 {
                p.column_mut(j).axpy(-scale, &w, 1.0);
            }
        }
    }
}

/// Corrects `state` by one number: `residual = Σ h_i δ_i + noise`. Returns the normalised innovation squared.
pub fn scalar_update(state: &mut State, h: &[(usize, f64)], residual: f64, variance: f64) -> f64 {
    biased_update(state, h, 0.0, residual, variance)
}

/// The same by a number that the climber's clock biases: by `bias` per second of its offset.
pub fn biased_update(state: &mut State, h: &[(usize, f64)], bias: f64, residual: f64, variance: f64) -> f64 {
    let mut gain = Error::zeros();
    for &(i, weight) in h {
        gain.axpy(weight, &state.covariance.column(i), 1.0);
    }
    let spread: f64 = h.iter().map(|&(i, weight)| weight * gain[i]).sum();
    let innovation = spread + variance;
    if !(innovation > 0.0 && residual.is_finite()) {
        return 0.0;
    }
    let root = gain / innovation.sqrt();
    for j in 0..N {
        let scale = root[j];
        if scale != 0.0 {
            state.covariance.column_mut(j).axpy(-scale, &root, 1.0);
        }
    }
    state.add(&(gain * (residual / innovation)));
    let tied = bias + h.iter().map(|&(i, weight)| weight * state.tie.by_offset[i]).sum::<f64>();
    state.tie.by_offset.axpy(-tied / innovation, &gain, 1.0);
    for mut column in state.by_pixel.column_iter_mut() {
        let felt: f64 = h.iter().map(|&(i, weight)| weight * column[i]).sum();
        if felt != 0.0 {
            column.axpy(-felt / innovation, &gain, 1.0);
        }
    }
    residual * residual / innovation
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_model::{CameraModel, Distortion, Rig};

    const RIG: &str = include_str!("../../../test/src/rig/rig.yaml");

    fn example() -> (State, Geometry, Sighting) {
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
        state.camera_clock = 0.004;
        let rest = ClimberRest { height: 2.8, tilt: UnitQuaternion::identity() };
        let mut sighting = Sighting {
            pixels: [Some((Vector2::zeros(), Matrix2::identity() * 0.01)); 4],
            clock: 0.001,
            felt: Felt { force: Vector3::new(0.0, 0.0, 9.8), rate: Vector3::new(0.5, -0.8, 0.3) },
            rest,
        };
        let linear = linearise(&state, &geometry, &sighting);
        for i in 0..4 {
            let pixel = -linear.residual.fixed_rows::<2>(2 * i).into_owned();
            sighting.pixels[i] = Some((pixel, Matrix2::identity() * 0.01));
        }
        state.covariance = Covariance::identity() * 1e-4;
        (state, geometry, sighting)
    }

    #[test]
    fn the_jacobian_is_the_numerical_one() {
        let (state, geometry, sighting) = example();
        let linear = linearise(&state, &geometry, &sighting);
        assert!(linear.residual.amax() < 1e-9);
        let h = 1e-5;
        for (k, &index) in SEEN.iter().enumerate() {
            let at = |sign: f64| {
                let mut s = state.clone();
                let mut e = Error::zeros();
                e[index] = sign * h;
                s.add(&e);
                linearise(&s, &geometry, &sighting).residual
            };
            let numeric = -(at(1.0) - at(-1.0)) / (2.0 * h);
            let error = (numeric - linear.jacobian.column(k)).amax();
            let scale = numeric.amax();
            assert!(error < 0.006 * scale + 1e-3, "{k}: {error} of {scale}");
        }
    }

    #[test]
    fn the_corrected_covariance_is_joseph_s() {
        let (mut state, geometry, sighting) = example();
        let p = state.covariance;
        let linear = linearise(&state, &geometry, &sighting);
        let mut h = SMatrix::<f64, M, N>::zeros();
        for (k, &index) in SEEN.iter().enumerate() {
            h.set_column(index, &linear.jacobian.column(k));
        }
        let r = Innovation::identity() * 0.01;
        let s = h * p * h.transpose() + r;
        let k = p * h.transpose() * s.try_inverse().unwrap();
        let a = Covariance::identity() - k * h;
        let joseph = a * p * a.transpose() + k * r * k.transpose();
        let report = update(
            &mut state,
            &geometry,
            &sighting,
            &Gates { marker: 16.0, joint: 1.0, gravity: 9.81 },
            false,
        );
        assert_eq!(report.used, 4);
        assert!((state.covariance - joseph).amax() < 1e-12);
        assert_eq!(state.covariance, state.covariance.transpose());
    }

    #[test]
    fn beside_the_filter_runs_the_one_that_was_told_the_offsets() {
        let (mut knows_nothing, geometry, sighting) = example();
        for i in [3, 4, 5, 9, 10, 11, 12, 13, 14] {
            knows_nothing.covariance[(i, i)] = 1e-3;
        }
        // A nominal state moves with its clock, its error does not.
        knows_nothing.set_variance_of(24, 0.0);
        let mut told = knows_nothing.clone();
        let offsets = Residual::from_fn(|i, _| 0.002 * ((3 * i + 1) as f64).sin());
        let gates = Gates { marker: 16.0, joint: 1.0, gravity: 9.81 };
        let process = crate::tight::propagate::Process {
            gravity: 9.81,
            force: 1e-5,
            rate: 1e-6,
            jerk: Vector3::repeat(0.01),
            ..Default::default()
        };
        let felt =
            Felt { force: knows_nothing.attitude.inverse() * Vector3::z() * 9.81, rate: Vector3::zeros() };
        for step in 0..40 {
            // One marker is hidden for a while, and the encoders are read.
            let mut seen = sighting;
            (seen.felt, seen.clock) = (felt, knows_nothing.camera_clock);
            let true_pixels = linearise(&knows_nothing, &geometry, &seen).residual;
            for i in 0..4 {
                if (10..20).contains(&step) && i == 1 {
                    seen.pixels[i] = None;
                } else if let Some((pixel, _)) = &mut seen.pixels[i] {
                    // Near what is expected, so that nothing bends and both filters linearise alike.
                    *pixel -= true_pixels.fixed_rows::<2>(2 * i);
                }
            }
            let mut corrected = seen;
            for (i, pixel) in corrected.pixels.iter_mut().enumerate() {
                if let Some((pixel, _)) = pixel {
                    *pixel -= offsets.fixed_rows::<2>(2 * i);
                }
            }
            for (state, sighting) in [(&mut knows_nothing, &seen), (&mut told, &corrected)] {
                let report = update(state, &geometry, sighting, &gates, false);
                assert!(report.used >= 3, "{report:?}");
                let reading = 0.05 - state.climber.x;
                scalar_update(state, &[(CLIMBER, 1.0)], reading, 1e-6);
                crate::tight::propagate::propagate(state, &felt, &felt, 0.03, &process);
            }
        }
        let moved = told.minus(&knows_nothing);
        let claimed = knows_nothing.by_pixel * offsets;
        assert!(moved.fixed_rows::<3>(ATTITUDE).norm() > 1e-5, "{moved}");
        // The Jacobian is right to half a percent (above), which gathers where only the beginning tells: the climber's y and turn.
        for i in POSITION..POSITION + 9 {
            assert!(
                (moved[i] - claimed[i]).abs() < 0.1 * moved.fixed_rows::<9>(0).amax(),
                "{moved}{claimed}"
            );
        }
    }

    #[test]
    fn a_marker_that_contradicts_the_others_is_left_out_even_when_the_prior_is_too_wide_to_tell() {
        let (mut state, geometry, mut sighting) = example();
        let truth = state.clone();
        state.covariance *= 100.0;
        state.set_variance_of(24, 0.0);
        let mut off = Error::zeros();
        off[0] = 0.05;
        off[7] = 0.05;
        state.add(&off);
        if let Some((pixel, _)) = &mut sighting.pixels[2] {
            pixel.x += 12.0;
        }
        let report = update(
            &mut state,
            &geometry,
            &sighting,
            &Gates { marker: 16.0, joint: 1.0, gravity: 9.81 },
            false,
        );
        assert_eq!(report.markers[2].verdict, Verdict::Inconsistent, "{report:?}");
        assert_eq!(report.used, 3);
        // The climber is as uncertain: compare what the camera sees, the platform against the climber.
        let there = (state.position - truth.position) - (state.climber - truth.climber);
        assert!(there.xy().norm() < 0.05, "{there}");
    }
}
