//! What an estimator makes of a recording.

use nalgebra::Vector3;
use pose_fusion::{Fusion, FusionConfig, Output, PoseStatus};
use rig_model::score::{Nees, PoseError, SpreadSum};
use rig_simulator::recording::Recording;

/// One published pose against the truth.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Time since the first truth, s.
    pub time: f64,
    /// Position error, world, m.
    pub position: Vector3<f64>,
    /// Rotation error about world axes, rad.
    pub rotation: Vector3<f64>,
    /// Normalized estimation error squared of position and rotation (3 degrees of freedom each).
    pub nees: [f64; 2],
    /// Standard deviation of the length of the error of position (m) and rotation (rad): the square
    /// root of the trace of its covariance.
    pub sigmas: [f64; 2],
    pub valid: bool,
}

#[derive(Clone, Debug, Default)]
pub struct Scored {
    /// Poses in the order of publication.
    pub samples: Vec<Sample>,
    /// A number that is not finite was published.
    pub non_finite: bool,
}

/// Runs the estimator over a recording.
pub fn run(recording: &Recording, config: &FusionConfig) -> Scored {
    let mut fusion = Fusion::new(recording.rig.clone(), config.clone());
    let mut scored = Scored::default();
    let start = recording.start();
    for (_, input) in &recording.inputs {
        fusion.handle(input.clone());
        while let Some(output) = fusion.poll() {
            match output {
                Output::Odometry(o) => {
                    let numbers = o.pose_covariance.iter().chain(o.twist_covariance.iter());
                    let pose = &o.world_from_volant;
                    scored.non_finite |= !numbers
                        .chain(pose.translation.vector.iter())
                        .chain(pose.rotation.coords.iter())
                        .chain(o.linear_velocity.iter())
                        .all(|x| x.is_finite());
                    let Some(truth) = recording.pose_at(o.stamp) else { continue };
                    let error = PoseError::new(pose, &truth);
                    let variances = o.pose_covariance.diagonal();
                    let sigma = |i: usize| variances.fixed_rows::<3>(i).sum().max(0.0).sqrt();
                    scored.samples.push(Sample {
                        time: o.stamp.seconds_since(start),
                        position: error.position,
                        rotation: error.rotation,
                        nees: Nees::pair(&error, &o.pose_covariance),
                        sigmas: [sigma(0), sigma(3)],
                        valid: true,
                    });
                }
                Output::Status(PoseStatus { stamp, valid, .. }) => {
                    let time = stamp.seconds_since(start);
                    if let Some(last) = scored.samples.last_mut().filter(|s| s.time == time) {
                        last.valid = valid;
                    }
                }
                _ => {}
            }
        }
    }
    scored
}

#[derive(Clone, Copy, Debug, Default)]
pub struct Figures {
    pub count: usize,
    /// Position RMSE and largest error, mm.
    pub position: [f64; 2],
    /// Rotation RMSE and largest error, degrees.
    pub rotation: [f64; 2],
    /// Mean NEES of position and rotation.
    pub nees: [f64; 2],
    /// Largest position error of a pose that was called valid, m.
    pub worst_valid: f64,
    /// Share of the valid poses whose position or rotation error exceeds three sigma.
    pub beyond: f64,
}

impl Scored {
    /// Returns the figures of the poses between two times, s.
    pub fn figures(&self, from: f64, to: f64) -> Figures {
        let mut f = Figures::default();
        let (mut valid, mut beyond) = (0usize, 0usize);
        let (mut position, mut rotation) = (SpreadSum::default(), SpreadSum::default());
        for s in self.samples.iter().filter(|s| (from..to).contains(&s.time)) {
            f.count += 1;
            let (p, r) = (s.position.norm(), s.rotation.norm());
            position.add(p);
            rotation.add(r);
            f.nees[0] += s.nees[0];
            f.nees[1] += s.nees[1];
            if s.valid {
                valid += 1;
                beyond += usize::from(p > 3.0 * s.sigmas[0] || r > 3.0 * s.sigmas[1]);
                f.worst_valid = f.worst_valid.max(p);
            }
        }
        let n = f.count.max(1) as f64;
        let pair = |sum: SpreadSum, scale| {
            let spread = sum.spread(scale);
            [spread.rmse, spread.max]
        };
        f.position = pair(position, 1e3);
        f.rotation = pair(rotation, 1f64.to_degrees());
        f.nees = f.nees.map(|x| x / n);
        f.beyond = beyond as f64 / valid.max(1) as f64;
        f
    }
}
