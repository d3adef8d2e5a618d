//! A run from start to clean end: hardware, four nodes, first fused pose, scenario, exit.

use super::{
    HardwareError, Host, ImageSequence, Node, Nodes, ProcessError, Received, Scenario, Sent,
    SettableClock, SimulatedHardware, Site,
};
use node_kit::convert::stamp;
use rig_model::Stamp;
use std::{
    io,
    path::{Path, PathBuf},
    process::ExitStatus,
    sync::Arc,
    time::{Duration, Instant},
};

/// Why a run did not come to its end.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The hardware.
    #[error(transparent)]
    Hardware(#[from] HardwareError),
    /// A node's process.
    #[error(transparent)]
    Process(#[from] ProcessError),
    /// A file.
    #[error("{}: {error}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// Error of the system call.
        error: io::Error,
    },
    /// The machine lacks a requirement of the run.
    #[error("{what}: {reason}")]
    NotPossible {
        /// What is needed.
        what: &'static str,
        /// Why it is not there.
        reason: String,
    },
    /// The run's own DDS participant ended.
    #[error(
        "the test's own DDS participant was interrupted and ended (RustDDS does that); run it again"
    )]
    Interrupted,
    /// Nothing came.
    #[error(
        "no fused pose within {seconds:.0} s (received: {received}); the logs of the nodes are in \
         {}",
        folder.display()
    )]
    NoPose {
        /// How long it was waited.
        seconds: f64,
        /// What was received instead.
        received: String,
        /// Where the logs are.
        folder: PathBuf,
    },
}

/// The nodes.
pub const NODES: [&str; 4] = ["climber_driver", "imu_driver", "marker_tracker", "pose_fusion"];

/// A running rig.
pub struct Run {
    /// The hardware.
    pub hardware: SimulatedHardware,
    /// The processes.
    pub nodes: Nodes,
    /// Where logs, rig file and port are.
    pub folder: PathBuf,
    domain: u16,
    epoch: Option<Stamp>,
    clock: Option<SettableClock>,
}

/// What is left of a run.
#[derive(Debug)]
pub struct Ended {
    /// Stamp of the scenario's zero.
    pub epoch: Stamp,
    /// Messages of the nodes.
    pub received: Received,
    /// Messages of the hardware.
    pub sent: Sent,
    /// How each node ended.
    pub ends: Vec<(String, ExitStatus)>,
}

impl Run {
    /// Starts hardware and nodes at `site`, with logs, rig file and port in `folder` (created if
    /// missing).
    ///
    /// # Errors
    /// What is missing, by name.
    pub fn start(
        scenario: &Scenario,
        images: Arc<ImageSequence>,
        site: &Site,
        folder: &Path,
    ) -> Result<Self, RunError> {
        let io = |path: &Path| {
            let path = path.to_owned();
            move |error| RunError::Io { path, error }
        };
        std::fs::create_dir_all(folder).map_err(io(folder))?;
        let rig_file = folder.join("rig.yaml");
        std::fs::write(&rig_file, scenario.rig_file()).map_err(io(&rig_file))?;
        let port = folder.join("mtx");
        let clock = site.settable_clock.then(|| SettableClock::new(folder)).transpose()?;
        let hardware = SimulatedHardware::start(scenario, images, site, &port)?;
        let mut nodes = Nodes::default();
        for name in NODES {
            let rig = rig_file.display().to_string();
            let mut arguments = vec!["--ros-args".to_owned(), "--params-file".to_owned(), rig];
            let own = match name {
                "imu_driver" => Some(format!("port:={}", port.display())),
                "marker_tracker" => Some("image_transport:=compressed".to_owned()),
                _ => None,
            };
            if let Some(own) = own {
                arguments.extend(["-p".into(), own]);
            }
            let mut environment =
                vec![("ROS_DOMAIN_ID".to_owned(), site.network.domain_id.to_string())];
            environment.extend(clock.iter().flat_map(SettableClock::environment));
            let place = site.namespace_of(Host::of(name));
            nodes.push(Node::start(place, name, &arguments, &environment, folder)?);
        }
        let domain = site.network.domain_id;
        Ok(Self { hardware, nodes, folder: folder.to_owned(), domain, epoch: None, clock })
    }

    /// Sets the clock of the nodes, camera and encoders `ahead` seconds ahead of the true time.
    ///
    /// # Errors
    /// The site has no clock that can be set.
    pub fn set_clock(&self, ahead: f64) -> Result<(), RunError> {
        let clock = self.clock.as_ref().ok_or_else(|| RunError::NotPossible {
            what: "a clock that can be set",
            reason: "the site was not asked for one".to_owned(),
        })?;
        self.hardware.set_clock(ahead);
        clock.set(ahead)
    }

    /// The DDS domain that it is in.
    pub fn domain(&self) -> u16 {
        self.domain
    }

    /// Waits until fused poses come, at most `seconds`.
    ///
    /// # Errors
    /// None came, or a node ended.
    #[allow(clippy::disallowed_methods)] // a shell: it waits
    pub fn wait_for_pose(&mut self, seconds: f64) -> Result<(), RunError> {
        let start = Instant::now();
        loop {
            self.nodes.check()?;
            // The visual pose as well: then all four nodes are at work.
            let ready = {
                let received = self.hardware.received();
                received.odometry.len() > 20 && received.visual_pose.len() > 5
            };
            if ready {
                return Ok(());
            }
            if start.elapsed().as_secs_f64() > seconds {
                let h = self.hardware.received();
                return Err(RunError::NoPose {
                    seconds,
                    received: format!(
                        "{} IMU samples, {} climber transforms, {} marker observations, \
                        {} fused and {} visual poses",
                        h.imu.len(),
                        h.climber.len(),
                        h.markers.len(),
                        h.odometry.len(),
                        h.visual_pose.len()
                    ),
                    folder: self.folder.clone(),
                });
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Lets the scenario begin a second from now.
    pub fn begin(&mut self) -> Stamp {
        *self.epoch.insert(self.hardware.begin_in(1.0))
    }

    /// Waits until `seconds` of the scenario are over; calls `progress` with its time about ten
    /// times a second.
    ///
    /// # Errors
    /// A node ended.
    pub fn play_until(
        &mut self,
        seconds: f64,
        mut progress: impl FnMut(f64, &SimulatedHardware),
    ) -> Result<(), RunError> {
        loop {
            self.nodes.check()?;
            let now = self.hardware.seconds();
            progress(now, &self.hardware);
            if now >= seconds {
                return Ok(());
            }
            std::thread::sleep(Duration::from_secs_f64((seconds - now).clamp(0.001, 0.1)));
        }
    }

    /// Ends the nodes by SIGINT and returns all messages.
    ///
    /// # Errors
    /// A node that hangs.
    pub fn finish(self) -> Result<Ended, RunError> {
        if self.hardware.middleware_ended() {
            return Err(RunError::Interrupted);
        }
        let ends = self.nodes.stop()?;
        let received = self.hardware.received().clone();
        let sent = self.hardware.sent();
        let first =
            received.odometry.first().map_or(Stamp::default(), |(_, m)| stamp(&m.header.stamp));
        Ok(Ended { epoch: self.epoch.unwrap_or(first), received, sent, ends })
    }
}
