//! The adjustment itself: first with everything free under weak priors, to see what the motion determines; then with the
//! rest held.

use super::{
    arrow::{Arrow, STATE},
    problem::{
        PARAMETERS, Parameters, State, camera_from_volant, layout_gauge, motion, pixel_whitener, pixels,
    },
    recording::Recording,
};
use anyhow::{Context, Result, ensure};
use nalgebra::{DMatrix, DVector, Isometry3, SMatrix, UnitQuaternion, Vector3};
use rig_model::{PerColor, Rig, planar_pose};

/// One refined number.
#[derive(Clone, Debug)]
pub struct Row {
    /// What it is, with its axis.
    pub name: String,
    /// Change against the rig file: degrees or millimetres (milliseconds for clocks, SI for biases).
    pub change: f64,
    /// Standard deviation in the same unit.
    pub deviation: f64,
    /// The unit.
    pub unit: &'static str,
    /// False where the motion does not determine it, so that the rig file's value stays.
    pub determined: bool,
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The refined rig.
    pub rig: Rig,
    /// Every number.
    pub rows: Vec<Row>,
    /// Images used, and left out as outliers.
    pub images: (usize, usize),
    /// RMS of the pixel residuals per axis before and after, px.
    pub pixel_rms: (f64, f64),
    /// Whitened squared residual per degree of freedom (ideal 1).
    pub reduced: f64,
}

/// A number's name, unit, factor from SI to the unit, prior's deviation, and the deviation below which it counts as
/// determined (SI).
struct Trait {
    name: String,
    unit: &'static str,
    scale: f64,
    prior: f64,
    limit: f64,
}

fn traits() -> Vec<Trait> {
    let deg = 1f64.to_radians();
    let mut list = Vec::with_capacity(PARAMETERS);
    let mut three = |what: &str, unit, scale, prior, limit| {
        for axis in ["x", "y", "z"] {
            list.push(Trait { name: format!("{what} {axis}"), unit, scale, prior, limit });
        }
    };
    three("camera turn about climber", "deg", 1.0 / deg, 5.0 * deg, 0.3 * deg);
    three("camera place along climber", "mm", 1e3, 0.1, 0.005);
    three("imu turn about volant", "deg", 1.0 / deg, 10.0 * deg, 0.3 * deg);
    three("imu place along volant", "mm", 1e3, 0.05, 0.005);
    for color in ["red", "green", "blue", "yellow"] {
        three(&format!("marker {color}"), "mm", 1e3, 0.005, 0.001);
    }
    three("accelerometer bias", "m/s2", 1.0, 0.3, f64::INFINITY);
    three("gyroscope bias", "deg/s", 1.0 / deg, 0.02, f64::INFINITY);
    for clock in ["camera", "climber"] {
        list.push(Trait {
            name: format!("{clock} clock against imu"),
            unit: "ms",
            scale: 1e3,
            prior: 0.03,
            limit: f64::INFINITY,
        });
    }
    list
}

struct Adjustment<'a> {
    recording: &'a Recording,
    start: Parameters,
    /// Deviation of the prior of each number.
    priors: Vec<f64>,
    gauge: SMatrix<f64, 7, 12>,
    parameters: Parameters,
    states: Vec<State>,
    used: Vec<bool>,
}

impl Adjustment<'_> {
    fn prior(&self, p: &Parameters) -> (DVector<f64>, DMatrix<f64>) {
        let moved = p.minus(&self.start);
        let mut r = DVector::zeros(PARAMETERS + 7);
        let mut j = DMatrix::zeros(PARAMETERS + 7, PARAMETERS);
        for i in 0..PARAMETERS {
            r[i] = moved[i] / self.priors[i];
            j[(i, i)] = 1.0 / self.priors[i];
        }
        // A micrometre: held, and still well conditioned.
        let gauge = self.gauge * 1e6;
        r.fixed_rows_mut::<7>(PARAMETERS).copy_from(&(gauge * moved.fixed_rows::<12>(12)));
        j.fixed_view_mut::<7, 12>(PARAMETERS, 12).copy_from(&gauge);
        (r, j)
    }

    fn whiteners(&self) -> Option<Vec<SMatrix<f64, 8, 8>>> {
        self.recording
            .shots
            .iter()
            .zip(&self.states)
            .map(|(shot, state)| pixel_whitener(self.recording, shot, &self.parameters, state))
            .collect()
    }

    fn cost(&self, whiteners: &[SMatrix<f64, 8, 8>], p: &Parameters, states: &[State]) -> f64 {
        let shots = &self.recording.shots;
        let mut cost = self.prior(p).0.norm_squared();
        for k in 0..shots.len() {
            if self.used[k] {
                match pixels(self.recording, &shots[k], p, &states[k]) {
                    Some(r) => cost += (whiteners[k] * r).norm_squared(),
                    None => return f64::INFINITY,
                }
            }
            if k + 1 < shots.len() {
                let pair = (&shots[k], &shots[k + 1]);
                cost += motion(self.recording, pair, p, &states[k], &states[k + 1]).norm_squared();
            }
        }
        cost
    }

    /// The normal equations at the present estimate, by central differences.
    fn linearise(&self, whiteners: &[SMatrix<f64, 8, 8>]) -> Option<Arrow> {
        let shots = &self.recording.shots;
        let mut arrow = Arrow::new(shots.len(), PARAMETERS);
        let (r, j) = self.prior(&self.parameters);
        arrow.add_parameters(&j, &r);
        const H: f64 = 1e-6;
        let nudged: Vec<[Parameters; 2]> = (0..PARAMETERS)
            .map(|i| {
                [H, -H].map(|h| {
                    let mut step = [0.0; PARAMETERS];
                    step[i] = h;
                    self.parameters.moved(&step)
                })
            })
            .collect();
        let nudge = |state: &State, i: usize, h: f64| {
            let mut step = [0.0; STATE];
            step[i] = h;
            state.moved(&step)
        };
        for k in 0..shots.len() {
            let state = &self.states[k];
            if self.used[k] {
                let whitened = |p: &Parameters, s: &State| {
                    pixels(self.recording, &shots[k], p, s).map(|r| whiteners[k] * r)
                };
                let mut by_state = DMatrix::zeros(8, STATE);
                for i in 0..6 {
                    let d = whitened(&self.parameters, &nudge(state, i, H))?
                        - whitened(&self.parameters, &nudge(state, i, -H))?;
                    by_state.column_mut(i).copy_from(&(d / (2.0 * H)));
                }
                let mut by_parameters = DMatrix::zeros(8, PARAMETERS);
                for i in (0..6).chain(12..24).chain(30..32) {
                    let d = whitened(&nudged[i][0], state)? - whitened(&nudged[i][1], state)?;
                    by_parameters.column_mut(i).copy_from(&(d / (2.0 * H)));
                }
                let r = whitened(&self.parameters, state)?;
                arrow.add_one(k, &by_state, &by_parameters, &DVector::from_column_slice(r.as_slice()));
            }
            if k + 1 < shots.len() {
                let next = &self.states[k + 1];
                let pair = (&shots[k], &shots[k + 1]);
                let whitened = |p: &Parameters, a: &State, b: &State| motion(self.recording, pair, p, a, b);
                let p = &self.parameters;
                let (mut first, mut second) = (DMatrix::zeros(9, STATE), DMatrix::zeros(9, STATE));
                for i in 0..STATE {
                    let d = whitened(p, &nudge(state, i, H), next) - whitened(p, &nudge(state, i, -H), next);
                    first.column_mut(i).copy_from(&(d / (2.0 * H)));
                    let d = whitened(p, state, &nudge(next, i, H)) - whitened(p, state, &nudge(next, i, -H));
                    second.column_mut(i).copy_from(&(d / (2.0 * H)));
                }
                let mut by_parameters = DMatrix::zeros(9, PARAMETERS);
                for i in (6..12).chain(24..31) {
                    let d = whitened(&nudged[i][0], state, next) - whitened(&nudged[i][1], state, next);
                    by_parameters.column_mut(i).copy_from(&(d / (2.0 * H)));
                }
                let r = whitened(p, state, next);
                arrow.add_two(k, &first, &second, &by_parameters, &DVector::from_column_slice(r.as_slice()));
            }
        }
        Some(arrow)
    }

    /// Levenberg–Marquardt; returns the parameters' covariance and the cost.
    fn solve(&mut self) -> Result<(DMatrix<f64>, f64)> {
        let failed = "the adjustment does not converge; check the rig file (axes, signs) and the stamps of the recording";
        let mut damping = 1e-6;
        let mut whiteners = self.whiteners().context(failed)?;
        let mut cost = self.cost(&whiteners, &self.parameters, &self.states);
        ensure!(cost.is_finite(), failed);
        for iteration in 0..40 {
            let solution = self.linearise(&whiteners).and_then(|a| a.solve(damping)).context(failed)?;
            let parameters = self.parameters.moved(solution.parameters.as_slice());
            let states: Vec<State> =
                self.states.iter().zip(&solution.states).map(|(s, step)| s.moved(step.as_slice())).collect();
            let new = self.cost(&whiteners, &parameters, &states);
            if new < cost {
                let gain = (cost - new) / cost;
                (self.parameters, self.states, cost) = (parameters, states, new);
                damping = (damping * 0.1).max(1e-12);
                if iteration == 4 {
                    self.leave_out_outliers(&whiteners);
                }
                if gain < 1e-7 && iteration > 5 {
                    break;
                }
                whiteners = self.whiteners().context(failed)?;
                cost = self.cost(&whiteners, &self.parameters, &self.states);
            } else {
                damping *= 10.0;
                if damping > 1e6 {
                    break;
                }
            }
        }
        let solution = self.linearise(&whiteners).and_then(|a| a.solve(0.0)).context(failed)?;
        Ok((solution.covariance, cost))
    }

    fn leave_out_outliers(&mut self, whiteners: &[SMatrix<f64, 8, 8>]) {
        for k in 0..self.states.len() {
            let r = pixels(self.recording, &self.recording.shots[k], &self.parameters, &self.states[k]);
            // Eight numbers of variance one: 60 is beyond chance.
            self.used[k] = r.is_some_and(|r| (whiteners[k] * r).norm_squared() < 60.0);
        }
    }

    fn pixel_rms(&self) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for (k, shot) in self.recording.shots.iter().enumerate().filter(|(k, _)| self.used[*k]) {
            if let Some(r) = pixels(self.recording, shot, &self.parameters, &self.states[k]) {
                sum += r.norm_squared();
                count += 8.0;
            }
        }
        (sum / f64::max(count, 1.0)).sqrt()
    }
}

/// Refines a rig by a recording.
///
/// # Errors
/// A recording in which no pose can be found, or whose motion determines nothing.
pub fn refine_rig(recording: &Recording, rig: &Rig) -> Result<Estimate> {
    let traits = traits();
    let start = Parameters {
        rig: rig.clone(),
        force_bias: Vector3::zeros(),
        rate_bias: Vector3::zeros(),
        camera_clock: 0.0,
        climber_clock: 0.0,
    };
    let states = first_states(recording, &start)?;
    let mut work = Adjustment {
        recording,
        priors: traits.iter().map(|t| t.prior).collect(),
        gauge: layout_gauge(rig),
        parameters: start.clone(),
        used: vec![true; states.len()],
        states,
        start,
    };
    let before = work.pixel_rms();
    let (covariance, _) = work.solve()?;
    let determined: Vec<bool> = (0..PARAMETERS)
        .map(|i| {
            let deviation = covariance[(i, i)].sqrt();
            deviation < traits[i].limit && deviation < 0.5 * traits[i].prior || traits[i].limit.is_infinite()
        })
        .collect();
    ensure!(
        determined[..24].iter().enumerate().any(|(i, d)| *d && i < 12),
        "the motion determines neither the camera's nor the inertial unit's mounting; swing the platform about both \
         horizontal axes, turn it, and drive and turn the climber while recording"
    );
    // What is not determined is drawn back to the rig file little by little: all poses move along with it, and one stiff
    // step would leave the valley of the cost.
    let mut outcome = None;
    for stiffness in [0.1, 0.01, 1e-3, 1e-4, 1e-5] {
        for i in (0..PARAMETERS).filter(|i| !determined[*i]) {
            work.priors[i] = traits[i].prior * stiffness;
        }
        outcome = Some(work.solve()?);
    }
    let (covariance, cost) = outcome.context("nothing was solved")?;
    let used = work.used.iter().filter(|u| **u).count();
    // Per image 8 pixels and 9 motion residuals against 9 unknowns.
    let freedom = (8 * used) as f64 - determined.iter().filter(|d| **d).count() as f64;
    let reduced = cost / freedom.max(1.0);
    let inflation = reduced.max(1.0).sqrt();
    let change = work.parameters.minus(&work.start);
    let rows = traits
        .iter()
        .enumerate()
        .map(|(i, t)| Row {
            name: t.name.clone(),
            change: change[i] * t.scale,
            deviation: covariance[(i, i)].sqrt() * inflation * t.scale,
            unit: t.unit,
            determined: determined[i],
        })
        .collect();
    Ok(Estimate {
        rig: work.parameters.rig.clone(),
        rows,
        images: (used, work.used.len() - used),
        pixel_rms: (before, work.pixel_rms()),
        reduced,
    })
}

/// Poses of single images with "up" from the mean specific force around them, and velocities by differences.
fn first_states(recording: &Recording, p: &Parameters) -> Result<Vec<State>> {
    let mut poses: Vec<Isometry3<f64>> = Vec::with_capacity(recording.shots.len());
    let mounting = p.rig.imu.volant_from_imu.rotation;
    for shot in &recording.shots {
        let near = |t: f64| (t - shot.time).abs() < 0.02;
        let force: Vector3<f64> = recording.imu.iter().filter(|s| near(s.0)).map(|s| s.1).sum();
        let climber = recording.world_from_climber(shot.time);
        let world_from_camera = climber * p.rig.climber_from_camera;
        let tilt = force.try_normalize(1e-3).map(|up| planar_pose::TiltPrior {
            up_in_volant: mounting * up,
            up_in_camera: world_from_camera.rotation.inverse() * Vector3::z(),
            sigma: 0.15,
        });
        let measured = PerColor(std::array::from_fn(|i| Some((shot.pixels[i], shot.covariances[i]))));
        let found = planar_pose::candidates(&p.rig.markers, &recording.camera, &measured, tilt.as_ref());
        let pose = match found.first() {
            Some(best) => world_from_camera * best.camera_from_volant,
            None => {
                *poses.last().context("no pose fits the first image; check the markers in the rig file")?
            }
        };
        poses.push(pose);
    }
    let arm = p.rig.imu.volant_from_imu.translation.vector;
    let place = |k: usize| poses[k].translation.vector + poses[k].rotation * arm;
    let last = poses.len() - 1;
    let states: Vec<State> = (0..poses.len())
        .map(|k| {
            let (a, b) = (k.saturating_sub(1), (k + 1).min(last));
            let velocity = (place(b) - place(a)) / (recording.shots[b].time - recording.shots[a].time);
            State { pose: poses[k], velocity }
        })
        .collect();
    let upright = states.iter().zip(&recording.shots).filter(|(s, shot)| {
        let camera = camera_from_volant(recording, shot, p, s);
        camera.translation.vector.z > 0.0 && s.pose.rotation.angle_to(&UnitQuaternion::identity()) < 3.2
    });
    ensure!(
        upright.count() * 2 > states.len(),
        "most poses lie behind the camera; check the camera's mounting in the rig file"
    );
    Ok(states)
}
