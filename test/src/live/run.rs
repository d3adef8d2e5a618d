//! A run from start to clean end: hardware up, four nodes up, wait for the first fused pose, play, end all.

use super::{
    Film, Heard, Host, Node, Nodes, ProcessError, Said, Scenario, SettableClock, Site, Stand, StandError,
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
    Stand(#[from] StandError),
    /// A node's process.
    #[error(transparent)]
    Process(#[from] ProcessError),
    /// A file.
    #[error("{}: {error}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// What is to be tried cannot be had here.
    #[error("{what}: {reason}")]
    NotPossible {
        /// What is needed.
        what: &'static str,
        /// Why it is not there.
        reason: String,
    },
    /// The stand heard nothing any more.
    #[error("the test's own DDS participant was interrupted and ended (RustDDS does that); run it again")]
    Deaf,
    /// Nothing came.
    #[error(
        "no fused pose within {seconds:.0} s (heard: {heard}); the nodes' own words are in {}",
        folder.display()
    )]
    NoPose {
        /// How long it was waited.
        seconds: f64,
        /// What was heard instead.
        heard: String,
        /// Where the logs are.
        folder: PathBuf,
    },
}

/// The nodes with what each is told beside the rig file.
pub const NODES: [&str; 4] = ["climber_driver", "imu_driver", "marker_tracker", "pose_fusion"];

/// A running rig.
pub struct Run {
    /// The hardware.
    pub stand: Stand,
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
    /// What the nodes said.
    pub heard: Heard,
    /// What the hardware said.
    pub said: Said,
    /// How each node ended.
    pub ends: Vec<(String, ExitStatus)>,
}

impl Run {
    /// Brings up hardware and nodes at `site`, with logs, rig file and port in `folder` (made where it is not there).
    ///
    /// # Errors
    /// What is missing, by name.
    pub fn start(scenario: &Scenario, film: Arc<Film>, site: &Site, folder: &Path) -> Result<Self, RunError> {
        let io = |path: &Path| {
            let path = path.to_owned();
            move |error| RunError::Io { path, error }
        };
        std::fs::create_dir_all(folder).map_err(io(folder))?;
        let rig_file = folder.join("rig.yaml");
        std::fs::write(&rig_file, &scenario.rig_yaml).map_err(io(&rig_file))?;
        let port = folder.join("mtx");
        let clock = site.settable_clock.then(|| SettableClock::new(folder)).transpose()?;
        let stand = Stand::start(scenario, film, site, &port)?;
        let mut nodes = Nodes::default();
        for name in NODES {
            let mut arguments =
                vec!["--ros-args".into(), "--params-file".into(), rig_file.display().to_string()];
            let own = match name {
                "climber_driver" => Some(format!("height:={}", scenario.motion.config().climber_height)),
                "imu_driver" => Some(format!("port:={}", port.display())),
                "marker_tracker" => Some("image_transport:=compressed".to_owned()),
                _ => None,
            };
            if let Some(own) = own {
                arguments.extend(["-p".into(), own]);
            }
            if !site.namespace.is_empty() {
                arguments.extend(["-r".into(), format!("__ns:={}", site.namespace)]);
            }
            let mut environment = vec![("ROS_DOMAIN_ID".to_owned(), site.network.domain_id.to_string())];
            environment.extend(clock.iter().flat_map(SettableClock::environment));
            let place = site.namespace_of(Host::of(name));
            nodes.push(Node::start_in(place, name, &arguments, &environment, folder)?);
        }
        let domain = site.network.domain_id;
        Ok(Self { stand, nodes, folder: folder.to_owned(), domain, epoch: None, clock })
    }

    /// Sets the clock of the computer on which the nodes are, and its camera and encoders, so many seconds ahead of the time.
    ///
    /// # Errors
    /// The site has no clock that can be set.
    pub fn set_clock(&self, ahead: f64) -> Result<(), RunError> {
        let clock = self.clock.as_ref().ok_or_else(|| RunError::NotPossible {
            what: "a clock that can be set",
            reason: "the site was not asked for one".to_owned(),
        })?;
        self.stand.set_clock(ahead);
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
                let heard = self.stand.heard();
                heard.odometry.len() > 20 && heard.visual_pose.len() > 5
            };
            if ready {
                return Ok(());
            }
            if start.elapsed().as_secs_f64() > seconds {
                let h = self.stand.heard();
                return Err(RunError::NoPose {
                    seconds,
                    heard: format!(
                        "{} inertial samples, {} climber transforms, {} marker observations, {} fused and {} visual poses",
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
        *self.epoch.insert(self.stand.begin_in(1.0))
    }

    /// Waits until `seconds` of the scenario are over; `progress` is called with its time about ten times a second.
    ///
    /// # Errors
    /// A node ended.
    pub fn play_until(
        &mut self,
        seconds: f64,
        mut progress: impl FnMut(f64, &Stand),
    ) -> Result<(), RunError> {
        loop {
            self.nodes.check()?;
            let now = self.stand.seconds();
            progress(now, &self.stand);
            if now >= seconds {
                return Ok(());
            }
            std::thread::sleep(Duration::from_secs_f64((seconds - now).clamp(0.001, 0.1)));
        }
    }

    /// Ends the nodes as a person would and gives what was said.
    ///
    /// # Errors
    /// A node that hangs.
    pub fn finish(self) -> Result<Ended, RunError> {
        if self.stand.is_deaf() {
            return Err(RunError::Deaf);
        }
        let ends = self.nodes.stop()?;
        let heard = self.stand.heard().clone();
        let said = self.stand.said();
        let first = heard.odometry.first().map_or(Stamp::default(), |(_, m)| stamp(&m.header.stamp));
        Ok(Ended { epoch: self.epoch.unwrap_or(first), heard, said, ends })
    }
}
