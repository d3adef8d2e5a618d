//! A long run: repetitions of one motion that begins and ends stationary at one place, with faults
//! of a rig.

use super::{scoring, simulated};
use pose_fusion::{Fusion, FusionConfig, Input, Status};
use rig_simulator::{inertial::SensorConfig, motion::MotionConfig, random::Random};

/// 0.9999 quantile of χ² with 3 degrees of freedom.
pub const BEYOND: f64 = 21.1;

/// The run.
#[derive(Clone, Debug)]
pub struct Laps {
    pub motion: MotionConfig,
    pub sensors: SensorConfig,
    /// How often.
    pub count: u32,
    /// Encoder faults: up to 3 s of silence, repeated or stuck readings, delays.
    pub broken_encoders: bool,
}

/// What came of it. A pair is position, rotation.
#[derive(Debug, Default)]
pub struct Found {
    pub hours: f64,
    pub mean_nees: [f64; 2],
    /// Share of the odometry beyond [`BEYOND`].
    pub beyond: [f64; 2],
    pub encoder_faults: u32,
    pub status: Status,
}

impl Laps {
    /// Of `count` laps of a minute: 15 s from rest to full motion, and as long back.
    pub fn minutes(seed: u64, count: u32) -> Self {
        let lap = 60.0;
        let motion = MotionConfig {
            duration: lap,
            still_until: 0.0,
            still_from: lap,
            ramp: lap / 4.0,
            ..MotionConfig::nominal(seed)
        };
        Self { motion, sensors: SensorConfig::nominal(seed), count, broken_encoders: false }
    }

    /// Through a filter that goes on from lap to lap.
    pub fn follow(&self) -> Found {
        let mut fusion = Fusion::new(simulated::rig(), FusionConfig::default());
        let mut random = Random::fork(self.sensors.seed, "encoder faults");
        let mut found = Found::default();
        let mut count = 0.0;
        for lap in 0..self.count {
            let begin = f64::from(lap) * self.motion.duration;
            // Other noise in each lap, and the same unit.
            let sensors = SensorConfig {
                seed: self.sensors.seed + 1000 * u64::from(lap),
                epoch: self.sensors.epoch.plus_seconds(begin),
                ..self.sensors.clone()
            };
            let run = simulated::run(self.motion.clone(), &sensors);
            let mut inputs = run.timed();
            if self.broken_encoders {
                found.encoder_faults += corrupt(&mut inputs, self.motion.duration, &mut random);
            }
            let outputs = scoring::run(&mut fusion, inputs.into_iter().map(|(_, input)| input));
            for (t, _, nees) in scoring::errors(&outputs.odometry, &run.truth) {
                if t <= 10.0 {
                    continue;
                }
                count += 1.0;
                for (k, nees) in nees.into_iter().enumerate() {
                    found.mean_nees[k] += nees;
                    found.beyond[k] += f64::from(u8::from(nees > BEYOND));
                }
            }
        }
        for k in 0..2 {
            found.mean_nees[k] /= count;
            found.beyond[k] /= count;
        }
        found.hours = f64::from(self.count) * self.motion.duration / 3600.0;
        found.status = fusion.status();
        found
    }
}

/// Applies occasional encoder faults to the inputs of a lap and returns their number.
fn corrupt(inputs: &mut Vec<(f64, Input)>, duration: f64, random: &mut Random) -> u32 {
    let mut faults = 0;
    let mut at = random.within(2.0, 12.0);
    while at < duration - 4.0 {
        let (kind, end) = (random.index(4), at + random.within(0.3, 3.0));
        faults += 1;
        let mut standing = None;
        let mut changed = Vec::with_capacity(inputs.len());
        for (arrival, input) in inputs.drain(..) {
            let Input::Climber(sample) = &input else {
                changed.push((arrival, input));
                continue;
            };
            if !(at..end).contains(&arrival) {
                changed.push((arrival, input));
                continue;
            }
            match kind {
                0 => {}
                1 => {
                    changed.push((arrival, input.clone()));
                    changed.push((arrival, input));
                }
                2 => {
                    // Every other reading repeats the one before, under its own stamp.
                    let repeated = standing.take();
                    let mut outputs = sample.clone();
                    match repeated {
                        Some(pose) => outputs.world_from_climber = pose,
                        None => standing = Some(sample.world_from_climber),
                    }
                    changed.push((arrival, Input::Climber(outputs)));
                }
                _ => changed.push((arrival + random.within(0.0, 0.3), input)),
            }
        }
        changed.sort_by(|a, b| a.0.total_cmp(&b.0));
        *inputs = changed;
        at = end + random.within(3.0, 15.0);
    }
    faults
}
