//! Node: markers, IMU samples and the climber's transform in; odometry, poses, status, tf, marker
//! records and diagnostics out.

mod diagnostics;
mod rejections;

use crate::{
    Fusion, Input, Model, Output, PoseState, PoseStatus, RigCheck, Warning,
    health::pose_status::STATUS_PERIOD,
    messages,
    parameters::FusionParameters,
    services::{self, Request},
};
use node_kit::{
    Level, convert,
    node::{CameraChanges, Health, IfChanged, NodeContext, NodeError, NodeShell, Publisher},
    qos::QosPreset,
};
use rejections::Rejections;
use rig_model::{Frames, topics};
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};
use volant_msgs::{
    geometry_msgs::msg::{PoseWithCovarianceStamped, TransformStamped},
    msg::{self, MarkerObservations, MarkerUpdates},
    nav_msgs, sensor_msgs,
};

/// Beside two periods of `publish_rate`, time without a status after which inputs have ended, s.
const ENDED: f64 = 0.35;

/// Publishers of the estimate.
struct Publishers {
    odometry: Publisher<nav_msgs::msg::Odometry>,
    fused_pose: Publisher<PoseWithCovarianceStamped>,
    pose: Publisher<PoseWithCovarianceStamped>,
    visual_pose: Publisher<PoseWithCovarianceStamped>,
    status: Publisher<msg::PoseStatus>,
    predicted: Option<Publisher<nav_msgs::msg::Odometry>>,
    swing: Option<Publisher<msg::Swing>>,
    updates: Option<Publisher<MarkerUpdates>>,
}

/// Node of the estimator.
pub struct FusionNode {
    fusion: Fusion,
    frames: Frames,
    parameters: FusionParameters,
    publishers: Publishers,
    gated_before: u64,
    images_before: u64,
    rejections: Rejections,
    rig_check: RigCheck,
    /// What is wrong with the frame of the IMU samples.
    imu_frame: Option<String>,
    /// Whether a sample in another frame has come since the last diagnostics.
    in_other_frame: Arc<AtomicBool>,
    /// Periods since the estimator's newest status.
    quiet: u32,
}

/// Input of the node.
pub enum Event {
    /// Input of the estimator.
    Input(Box<Input>),
    /// First IMU sample since the last diagnostics in a frame that is not the rig file's, with it.
    OtherFrame(Box<Input>, String),
    /// Request of an operator.
    Request(Request),
    /// Unusable message: its topic, and why.
    Rejected(&'static str, String),
    /// The status is due where there is no pose.
    StatusDue,
}

fn input(input: Input) -> Option<Event> {
    Some(Event::Input(Box::new(input)))
}

impl NodeShell for FusionNode {
    const NAME: &'static str = "pose_fusion";
    const ABOUT: &'static str =
        "markers, IMU samples and the climber's transform in, the platform's pose out";
    type Parameters = FusionParameters;
    type Input = Event;

    fn start(
        context: &mut NodeContext<Event>,
        parameters: FusionParameters,
    ) -> Result<Self, NodeError> {
        let rig = context.rig()?;
        let frames = rig.frames.clone();
        let is_tight = parameters.core.model == Model::Tight;
        let publishers = Publishers {
            odometry: context.advertise(topics::ODOMETRY, QosPreset::State)?,
            fused_pose: context.advertise(topics::FUSED_POSE, QosPreset::State)?,
            pose: context.advertise(topics::POSE, QosPreset::State)?,
            visual_pose: context.advertise(topics::VISUAL_POSE, QosPreset::State)?,
            status: context.advertise(topics::STATUS, QosPreset::State)?,
            predicted: (is_tight && parameters.core.tight.prediction_horizon > 0.0)
                .then(|| context.advertise(topics::PREDICTED_ODOMETRY, QosPreset::State))
                .transpose()?,
            swing: (is_tight && parameters.core.tight.swing)
                .then(|| context.advertise(topics::SWING, QosPreset::State))
                .transpose()?,
            updates: (parameters.publish_marker_updates)
                .then(|| context.advertise(topics::MARKER_UPDATES, QosPreset::State))
                .transpose()?,
        };
        if parameters.publish_tf {
            context.advertise_transforms()?;
        }
        context.timer(Duration::from_secs_f64(STATUS_PERIOD), || Event::StatusDue);
        let (imu_frame, in_other_frame) = (frames.imu.clone(), Arc::new(AtomicBool::new(false)));
        let reported = in_other_frame.clone();
        context.subscribe(
            topics::IMU,
            QosPreset::Sensor,
            move |m: Arc<sensor_msgs::msg::Imu>| {
                let sample = Input::Imu(convert::imu_sample(&m));
                if m.header.frame_id == imu_frame || reported.swap(true, Ordering::Relaxed) {
                    return input(sample);
                }
                Some(Event::OtherFrame(Box::new(sample), m.header.frame_id.clone()))
            },
        )?;
        context.subscribe(
            topics::MARKERS,
            QosPreset::Measurement,
            |m: Arc<MarkerObservations>| match convert::marker_observations(&m) {
                Ok(markers) => input(Input::Markers(markers)),
                Err(error) => Some(Event::Rejected(topics::MARKERS, error.to_string())),
            },
        )?;
        let names = frames.clone();
        context.subscribe(
            topics::CLIMBER_TRANSFORM,
            QosPreset::Measurement,
            move |m: Arc<TransformStamped>| match convert::climber_sample(&m, &names) {
                Ok(sample) => input(Input::Climber(sample)),
                Err(error) => Some(Event::Rejected(topics::CLIMBER_TRANSFORM, error.to_string())),
            },
        )?;
        let cameras = CameraChanges::default();
        context.subscribe(
            topics::CAMERA_INFO,
            QosPreset::CameraInfo,
            move |m: Arc<sensor_msgs::msg::CameraInfo>| {
                IfChanged(cameras.model(m).map(|camera| match camera {
                    Ok(camera) => input(Input::Camera(camera)),
                    Err(error) => Some(Event::Rejected(topics::CAMERA_INFO, error.to_string())),
                }))
            },
        )?;
        services::offer(context, &frames)?;
        Ok(Self {
            fusion: Fusion::new(rig, parameters.core.clone()),
            frames,
            parameters,
            publishers,
            gated_before: 0,
            images_before: 0,
            rejections: Rejections::default(),
            rig_check: RigCheck::default(),
            imu_frame: None,
            in_other_frame,
            quiet: 0,
        })
    }

    fn handle(&mut self, context: &mut NodeContext<Event>, event: Event) {
        match event {
            Event::Input(input) => {
                if matches!(*input, Input::Camera(_)) {
                    self.rig_check.note_camera();
                    self.rejections.camera = None;
                }
                self.fusion.handle(*input);
            }
            Event::OtherFrame(input, frame) => {
                let why = format!(
                    "{} is in the frame `{frame}`, and frames.imu of the rig file is `{}`: its \
                     mounting is used; make the two agree",
                    topics::IMU,
                    self.frames.imu
                );
                if self.imu_frame.as_ref() != Some(&why) {
                    context.log(Level::Warn, &why);
                    self.imu_frame = Some(why);
                }
                self.fusion.handle(*input);
            }
            Event::StatusDue => {
                self.quiet = self.quiet.saturating_add(1);
                let (now, missing) = (context.now(), self.missing());
                let status = if !missing.is_empty() {
                    let time_offset = self.fusion.status().time_offset.offset;
                    PoseStatus::initializing(now, time_offset, missing)
                } else if let Some(silence) = self.ended() {
                    self.fusion.silent_status(now, silence)
                } else {
                    return;
                };
                self.publishers.status.publish(messages::status(&status, &self.frames));
            }
            Event::Request(request) => {
                let done =
                    services::answer(&mut self.fusion, request, &self.parameters.checkpoint_file);
                if let Err(why) = done {
                    context.log_throttled(Level::Warn, topics::SET_POSE, &why);
                    self.rejections.note_message(topics::SET_POSE, why);
                }
            }
            Event::Rejected(topic, why) => {
                context.log_throttled(Level::Warn, topic, &why);
                self.rejections.note_message(topic, why);
            }
        }
        while let Some(output) = self.fusion.poll() {
            self.publish(context, output);
        }
    }

    fn tick(&mut self, context: &mut NodeContext<Event>) {
        let s = self.fusion.status();
        let [image_age, imu_age, _] = self.fusion.ages(self.ended().unwrap_or(0.0));
        let gated = s.counts.gated_markers - self.gated_before.min(s.counts.gated_markers);
        self.gated_before = s.counts.gated_markers;
        let published = self.parameters.core.model == Model::Paper;
        let starved = s.counts.inputs.images == self.images_before;
        self.images_before = s.counts.inputs.images;
        let limit = self.parameters.silence_timeout;
        self.rejections.end_second();
        let (health, message) = if let Some(why) = &self.rejections.camera {
            (Health::Error, why.clone())
        } else if !s.initialized {
            (Health::Warn, format!("not initialized: {}", self.missing()))
        } else if imu_age > limit {
            let why = self.rejections.unusable().map(str::to_owned);
            let text = if imu_age.is_finite() {
                format!("no usable IMU sample for {imu_age:.1} s")
            } else {
                format!("no message on {}", topics::IMU)
            };
            (Health::Error, why.unwrap_or(text))
        } else if self.silence() > limit + 2.0 * self.period() {
            // With simulated time no age grows once the clock has ended, too.
            (Health::Error, format!("no input for {:.1} s", self.silence()))
        } else if published && image_age > limit {
            let what = if starved {
                "no messages on climber/markers; the published filter outputs no pose without images"
            } else {
                "coasting on doubly integrated accelerations: no image with three detected \
                 markers and a climber/transform beside it"
            };
            (Health::Error, format!("{what}, for {image_age:.1} s"))
        } else if image_age > limit {
            let (sigma, limit) =
                (s.position_sigma, self.parameters.core.status.lost_position_sigma);
            let health = if sigma > limit { Health::Error } else { Health::Warn };
            let ages = format!("no marker used for {image_age:.1} s");
            (health, format!("{ages}, position within {sigma:.3} m"))
        } else if s.encoders.suspended {
            (Health::Error, "the encoders contradict images and IMU and are not used".to_owned())
        } else if gated > 0 {
            (Health::Warn, format!("{gated} markers rejected in the last second"))
        } else {
            let what = match (published, self.fusion.computes_attitude()) {
                (true, true) => {
                    "the published filter runs; the IMU outputs no attitude, so it is computed \
                     from its samples"
                }
                (true, false) => "the published filter runs",
                _ => "fusing",
            };
            (Health::Ok, what.to_owned())
        };
        // Without a pose, a rejection is the message. Without IMU samples everything else is ahead
        // of them, which is no fault of the clocks.
        let (health, message) = if !s.initialized || imu_age > limit {
            self.rejections.drop_report();
            (health, message)
        } else {
            self.rejections.report(health, message)
        };
        let mut values = diagnostics::values(&s);
        if published {
            // The published filter identifies none of the values after the first.
            values.truncate(1);
        }
        context.diagnose("filter", health, &message, &values);
        if self.parameters.core.model == Model::Tight {
            // Markers are not used either while other inputs are missing.
            let starved = !s.initialized && self.fusion.waits_for_messages();
            let mut findings = if starved { vec![] } else { self.rig_check.findings(&s) };
            if !findings.is_empty() {
                findings.push("find the cause with `volant check` in a recording".to_owned());
            }
            if !self.in_other_frame.swap(false, Ordering::Relaxed) {
                self.imu_frame = None;
            }
            findings.extend(self.imu_frame.clone());
            let (health, message) = if findings.is_empty() {
                (Health::Ok, "nothing contradicts the rig file".to_owned())
            } else {
                (Health::Warn, findings.join("; "))
            };
            context.diagnose("rig file", health, &message, &[]);
        }
    }
}

impl FusionNode {
    /// What the filter waits for, or why its inputs are rejected; empty where there is a pose.
    fn missing(&self) -> String {
        let missing = self.fusion.missing();
        match self.rejections.camera.as_deref().or_else(|| self.rejections.unusable()) {
            Some(why) if !missing.is_empty() => why.to_owned(),
            _ => missing,
        }
    }

    /// Time between two odometry messages of a limited rate, s.
    fn period(&self) -> f64 {
        let rate = self.parameters.core.publish_rate;
        if rate > 0.0 { 1.0 / rate } else { 0.0 }
    }

    /// Time since the estimator's newest status, s.
    fn silence(&self) -> f64 {
        f64::from(self.quiet) * STATUS_PERIOD
    }

    /// Time since the estimator's newest status where its inputs have ended, s.
    fn ended(&self) -> Option<f64> {
        let silence = self.silence();
        (silence > ENDED + 2.0 * self.period()).then_some(silence)
    }

    fn publish(&mut self, context: &mut NodeContext<Event>, output: Output) {
        let (frames, publishers) = (&self.frames, &self.publishers);
        match output {
            Output::Odometry(o) => {
                if self.parameters.publish_tf
                    && let Err(error) = context.send_transform(messages::transform(&o, frames))
                {
                    context.log_throttled(Level::Error, "tf", error.to_string());
                }
                publishers.odometry.publish(messages::odometry(&o, frames));
                publishers.fused_pose.publish(messages::fused_pose(&o, frames));
                publishers.pose.publish(messages::pose(&o, frames));
            }
            // Without a pose the timer publishes the status.
            Output::Status(s)
                if s.state == PoseState::Initializing && s.position_sigma.is_infinite() => {}
            Output::Status(s) => {
                self.quiet = 0;
                publishers.status.publish(messages::status(&s, frames));
            }
            Output::Predicted(o) => {
                if let Some(predicted) = &publishers.predicted {
                    predicted.publish(messages::odometry(&o, frames));
                }
            }
            Output::Swing(s) => {
                if let Some(swing) = &publishers.swing {
                    swing.publish(messages::swing(&s, frames));
                }
            }
            Output::VisualPose(p) => {
                publishers.visual_pose.publish(messages::visual_pose(&p, frames))
            }
            Output::MarkerUpdates(image) => {
                self.rig_check.note(&image);
                if let Some(updates) = &publishers.updates {
                    updates.publish(messages::marker_updates(&image, frames));
                }
            }
            Output::Warning(warning) => {
                self.rejections.note(&warning);
                let level = match warning {
                    Warning::Initialized { .. }
                    | Warning::TimeOffset { .. }
                    | Warning::EncodersResumed { .. } => Level::Info,
                    Warning::Diverged { .. } | Warning::ImuLost { .. } => Level::Error,
                    _ => Level::Warn,
                };
                // A source must not hide another one's warnings.
                let source = warning.origin().map_or_else(String::new, |s| s.to_string());
                let key = format!("{:?} {source}", std::mem::discriminant(&warning));
                context.log_throttled(level, &key, warning.to_string());
            }
        }
    }
}
