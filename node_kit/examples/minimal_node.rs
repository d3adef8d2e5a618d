//! A minimal node: republishes the poses that it receives, and publishes a beat.
//!
//! Run `minimal_node --beat 2.0 --ros-args -r pose:=/robot/pose -r __ns:=/demo`, then
//! `ros2 topic echo /demo/echo`.

use node_kit::{
    Level, NodeContext, NodeError, NodeShell, Publisher, QosPreset, convert, parameters, run_node,
};
use std::{process::ExitCode, sync::Arc, time::Duration};
use volant_msgs::{
    geometry_msgs::msg::{PoseWithCovarianceStamped, TransformStamped},
    sensor_msgs::msg::Imu,
    std_msgs::msg::Header,
};

#[global_allocator]
static ALLOCATOR: node_kit::Allocator = node_kit::Allocator;

parameters! {
    /// Parameters of the example.
    pub struct Parameters {
        /// Beats per second.
        beat: f64 = 10.0, unit("Hz"), range(0.1..=1000.0);
        /// Log each received pose.
        talk: bool = false, live;
    }
}

enum Input {
    Pose(Arc<PoseWithCovarianceStamped>),
    Imu(Arc<Imu>),
    Beat,
}

struct Minimal {
    parameters: Parameters,
    echo: Publisher<PoseWithCovarianceStamped>,
    imu_echo: Publisher<Imu>,
    beats: Publisher<PoseWithCovarianceStamped>,
}

impl NodeShell for Minimal {
    const NAME: &'static str = "minimal";
    const ABOUT: &'static str = "republishes poses and beats";
    type Parameters = Parameters;
    type Input = Input;

    fn start(context: &mut NodeContext<Input>, parameters: Parameters) -> Result<Self, NodeError> {
        context.subscribe("pose", QosPreset::State, |m| Some(Input::Pose(m)))?;
        context.subscribe_optional("imu", QosPreset::Sensor, |m: Arc<Imu>| {
            if m.angular_velocity.x.is_nan() {
                Err("the rate of turn is not a number")
            } else {
                Ok(Input::Imu(m))
            }
        })?;
        context.timer(Duration::from_secs_f64(1.0 / parameters.beat), || Input::Beat);
        context.send_static_transform(TransformStamped {
            header: Header { frame_id: "world".into(), ..Header::default() },
            child_frame_id: "minimal".into(),
            ..TransformStamped::default()
        })?;
        Ok(Self {
            echo: context.advertise("echo", QosPreset::State)?,
            imu_echo: context.advertise("imu_echo", QosPreset::Sensor)?,
            beats: context.advertise("~/beats", QosPreset::State)?,
            parameters,
        })
    }

    fn handle(&mut self, context: &mut NodeContext<Input>, input: Input) {
        match input {
            Input::Pose(pose) => {
                if self.parameters.talk {
                    context.log(Level::Info, format!("a pose in {}", pose.header.frame_id));
                }
                self.echo.publish_shared(pose);
            }
            Input::Imu(imu) => self.imu_echo.publish_shared(imu),
            Input::Beat => {
                let mut beat = PoseWithCovarianceStamped::default();
                beat.header.stamp = convert::time(context.now());
                self.beats.publish(beat);
            }
        }
    }

    fn parameters_changed(
        &mut self,
        _: &mut NodeContext<Input>,
        parameters: &Parameters,
    ) -> Result<(), String> {
        self.parameters = parameters.clone();
        Ok(())
    }
}

fn main() -> ExitCode {
    run_node::<Minimal>()
}
