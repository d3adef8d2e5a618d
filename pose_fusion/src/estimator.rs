//! The estimators behind one interface.

use crate::{
    config::{FusionConfig, Model},
    filter::Filter,
    health::{pose_status::PoseStatus, status::Status},
    initialization::checkpoint::{Checkpoint, Refusal},
    output::{Odometry, Output, PoseEstimate, Warning, rate_limit::RateLimit},
    reference::{paper::Paper, single_image::SingleImagePose},
    timeline::arrival::Source,
};
/// One input, in the order of arrival.
pub use rig_model::Sample as Input;
use rig_model::{Rig, Stamp};
use std::collections::VecDeque;

/// Source and stamp of an input that has one.
fn stamp_of(input: &Input) -> Option<(Source, Stamp)> {
    Some(match input {
        Input::Imu(sample) => (Source::Imu, sample.stamp),
        Input::Markers(markers) => (Source::Image, markers.stamp),
        Input::Climber(sample) => (Source::Encoders, sample.stamp),
        Input::Camera(_) => return None,
    })
}

#[derive(Debug)]
#[allow(clippy::large_enum_variant)] // there is one
enum Estimator {
    TightlyCoupled(Filter),
    Paper(Paper),
}

/// Estimator of the platform's pose: inputs in the order of arrival in, estimates out.
#[derive(Debug)]
pub struct Fusion {
    estimator: Estimator,
    single_image: SingleImagePose,
    config: FusionConfig,
    outputs: VecDeque<Output>,
    rate_limit: RateLimit,
    /// Ages of the newest used image, IMU sample and used encoder reading at the newest status, s.
    ages: [f64; 3],
}

impl Fusion {
    /// Creates an estimator without an estimate.
    pub fn new(rig: Rig, config: FusionConfig) -> Self {
        Self {
            single_image: SingleImagePose::new(rig.clone(), &config),
            estimator: match config.model {
                Model::Tight => Estimator::TightlyCoupled(Filter::new(
                    rig,
                    config.tight.clone(),
                    config.status.clone(),
                )),
                Model::Paper => Estimator::Paper(Paper::new(&rig, &config)),
            },
            config,
            outputs: VecDeque::with_capacity(256),
            rate_limit: RateLimit::default(),
            ages: [f64::INFINITY; 3],
        }
    }

    /// Takes in one input.
    pub fn handle(&mut self, input: Input) {
        let stamp = stamp_of(&input);
        if let Some((from, _)) = stamp.filter(|(_, stamp)| stamp.is_unset()) {
            let why = Warning::NoStamp { from };
            match &mut self.estimator {
                Estimator::TightlyCoupled(filter) => filter.reject(why),
                Estimator::Paper(_) => self.outputs.push_back(Output::Warning(why)),
            }
            return self.take_outputs();
        }
        let visual = self.single_image.handle(&input);
        match &mut self.estimator {
            Estimator::TightlyCoupled(filter) => filter.handle(&input),
            Estimator::Paper(paper) => {
                if let Some(odometry) = paper.handle(&input, visual.as_ref()) {
                    let status = paper.pose_status(odometry.stamp);
                    self.outputs.extend([Output::Odometry(odometry), Output::Status(status)]);
                }
            }
        }
        self.take_outputs();
        self.outputs.extend(visual.map(|visual| Output::VisualPose(visual.pose)));
        let Some((from, stamp)) = stamp else { return };
        let status = match &mut self.estimator {
            Estimator::TightlyCoupled(filter) => filter.due_status(),
            Estimator::Paper(paper) => paper.due_status(from, stamp),
        };
        self.outputs.extend(status.map(Output::Status));
    }

    fn take_outputs(&mut self) {
        if let Estimator::TightlyCoupled(filter) = &mut self.estimator {
            // Encoder readings of former time would lie between those of the present one.
            let set_back = |o: &Output| {
                use Warning::{ClockStep, TimeJump};
                matches!(o, Output::Warning(TimeJump { .. } | ClockStep { .. }))
            };
            if filter.outputs().iter().any(set_back) {
                self.single_image.reset();
            }
            self.outputs.append(filter.outputs());
        }
    }

    /// Returns the next output, if any.
    pub fn poll(&mut self) -> Option<Output> {
        let rate = self.config.publish_rate;
        loop {
            let output = self.outputs.pop_front()?;
            if let Output::Status(status) = &output {
                self.ages = [status.image_age, status.imu_age, status.climber_age];
            }
            if self.rate_limit.passes(&output, rate) {
                return Some(output);
            }
        }
    }

    /// Discards the estimate; the next image initializes it. A frozen filter uses markers again.
    pub fn reset(&mut self) {
        self.single_image.reset();
        match &mut self.estimator {
            Estimator::TightlyCoupled(filter) => {
                filter.forget_clock_steps();
                filter.freeze(false);
                filter.reset();
            }
            Estimator::Paper(paper) => paper.reset(),
        }
    }

    /// Puts the platform at a pose `world_from_volant` with its covariance (error-state filter), at
    /// a stamp within the history.
    ///
    /// # Errors
    /// See [`Refusal`]; nothing is changed then.
    pub fn set_pose(&mut self, pose: &PoseEstimate) -> Result<(), Refusal> {
        self.tight()?.set_pose(pose)?;
        self.take_outputs();
        Ok(())
    }

    /// Returns the error-state filter.
    fn tight(&mut self) -> Result<&mut Filter, Refusal> {
        match &mut self.estimator {
            Estimator::TightlyCoupled(filter) => Ok(filter),
            Estimator::Paper(_) => Err(NOT_OF_THE_PAPER),
        }
    }

    /// Returns everything that the error-state filter knows now.
    ///
    /// # Errors
    /// There is no estimate, or the published filter runs.
    pub fn checkpoint(&self) -> Result<Checkpoint, Refusal> {
        match &self.estimator {
            Estimator::TightlyCoupled(filter) => filter.checkpoint(),
            Estimator::Paper(_) => Err(NOT_OF_THE_PAPER),
        }
    }

    /// Restores a checkpoint: all of it where the next IMU sample follows within 0.4 s, else time
    /// offset and biases, and the next image gives the pose.
    ///
    /// # Errors
    /// The checkpoint is invalid, or the published filter runs; nothing is changed then.
    pub fn restore(&mut self, checkpoint: &Checkpoint) -> Result<(), Refusal> {
        self.tight()?.restore(checkpoint)
    }

    /// Stops or resumes using markers (error-state filter): what is not used is still compared and
    /// recorded.
    ///
    /// # Errors
    /// The published filter runs.
    pub fn freeze(&mut self, frozen: bool) -> Result<(), Refusal> {
        self.tight()?.freeze(frozen);
        Ok(())
    }

    /// Keeps from now on what [`Fusion::smoothed`] needs.
    pub fn keep_for_smoothing(&mut self) {
        if let Ok(filter) = self.tight() {
            filter.keep_archive();
        }
    }

    /// Returns the smoothed odometry that later data no longer change (error-state filter); at the
    /// `end` of the run all of it.
    ///
    /// Smooths a minute at a time, with 20 s of later data, so that memory is bounded for runs of
    /// any length.
    pub fn smoothed(&mut self, end: bool) -> Vec<Odometry> {
        self.tight().map_or_else(|_| Vec::new(), |filter| filter.smoothed(end))
    }

    /// Returns why there is no estimate yet; empty where there is one.
    pub fn missing(&self) -> String {
        match &self.estimator {
            Estimator::TightlyCoupled(filter) => filter.missing(),
            Estimator::Paper(paper) => paper.missing().to_owned(),
        }
    }

    /// Whether the initialization waits for a topic without a usable message.
    pub fn waits_for_messages(&self) -> bool {
        matches!(&self.estimator, Estimator::TightlyCoupled(filter) if !filter.absent().is_empty())
    }

    /// Returns the status at `now` where no input has come for `silence` seconds.
    pub fn silent_status(&self, now: Stamp, silence: f64) -> PoseStatus {
        let time_offset = self.status().time_offset.offset;
        let reason = format!("no input for {silence:.1} s");
        PoseStatus::lost(now, self.ages(silence), time_offset, reason)
    }

    /// Returns the ages of the newest used image, IMU sample and used encoder reading, `silence`
    /// seconds after the newest status, s; infinite if none. They are measured on the sensors'
    /// clocks, which another clock need not agree with.
    pub fn ages(&self, silence: f64) -> [f64; 3] {
        self.ages.map(|age| age + silence)
    }

    /// Whether the published filter computes the attitude, which its IMU does not output.
    pub fn computes_attitude(&self) -> bool {
        matches!(&self.estimator, Estimator::Paper(paper) if paper.computes_attitude())
    }

    /// Returns counters and insights for diagnostics.
    pub fn status(&self) -> Status {
        match &self.estimator {
            Estimator::TightlyCoupled(filter) => filter.status(),
            Estimator::Paper(paper) => paper.status(),
        }
    }
}

const NOT_OF_THE_PAPER: Refusal = Refusal::Invalid {
    what: "the request",
    why: "the published filter has no such function; start the node with `model: tight`",
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PoseState;

    #[test]
    fn the_published_filter_is_not_frozen() {
        let rig = Rig::from_yaml(rig_simulator::RIG_YAML).unwrap();
        let config = FusionConfig { model: Model::Paper, ..FusionConfig::default() };
        let refusal = Fusion::new(rig, config).freeze(true).unwrap_err();
        assert!(refusal.to_string().contains("`model: tight`"), "{refusal}");
    }

    #[test]
    fn ages_grow_with_the_silence_whatever_the_clock_of_the_node() {
        let rig = Rig::from_yaml(rig_simulator::RIG_YAML).unwrap();
        let mut fusion = Fusion::new(rig, FusionConfig::default());
        assert_eq!(fusion.status().position_sigma, f64::INFINITY);
        let status = PoseStatus::lost(Stamp::default(), [0.25, 0.0, 0.5], 0.0, String::new());
        fusion.outputs.push_back(Output::Status(status));
        assert!(fusion.poll().is_some());
        let silent = fusion.silent_status(Stamp::from_nanos(-1_000_000_000), 1.0);
        let ages = [silent.image_age, silent.imu_age, silent.climber_age];
        assert_eq!((ages, silent.state), ([1.25, 1.0, 1.5], PoseState::Lost));
    }
}
