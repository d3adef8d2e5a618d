//! A run from start to clean end: hardware, four nodes, first fused pose, scenario, exit.

use super::{
    Host, ImageSequence, Node, Nodes, Received, Scenario, SettableClock, SimulatedHardware, Site,
};
use anyhow::{Context, Result, anyhow, bail, ensure};
use rig_model::Stamp;
use std::{
    io,
    path::{Path, PathBuf},
    process::ExitStatus,
    sync::Arc,
    time::{Duration, Instant},
};

const NODES: [&str; 4] = ["climber_driver", "imu_driver", "marker_tracker", "pose_fusion"];

/// A running rig.
pub struct Run {
    pub hardware: SimulatedHardware,
    pub nodes: Nodes,
    /// Where logs, rig file and port are.
    pub folder: PathBuf,
    pub domain: u16,
    clock: Option<SettableClock>,
}

/// What is left of a run.
#[derive(Debug)]
pub struct Ended {
    pub received: Received,
    pub ends: Vec<(String, ExitStatus)>,
}

impl Run {
    /// Starts hardware and nodes at `site`, with logs, rig file and port in `folder` (created if
    /// missing).
    pub fn start(
        scenario: &Scenario,
        images: Arc<ImageSequence>,
        site: &Site,
        folder: &Path,
    ) -> Result<Self> {
        let failed = |path: &Path, error: &io::Error| anyhow!("{}: {error}", path.display());
        std::fs::create_dir_all(folder).map_err(|e| failed(folder, &e))?;
        let rig_file = folder.join("rig.yaml");
        std::fs::write(&rig_file, scenario.rig_file()).map_err(|e| failed(&rig_file, &e))?;
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
            nodes.0.push(Node::start(place, name, &arguments, &environment, folder)?);
        }
        let domain = site.network.domain_id;
        Ok(Self { hardware, nodes, folder: folder.to_owned(), domain, clock })
    }

    /// Sets the clock of the nodes, camera and encoders `ahead` seconds ahead of the true time.
    pub fn set_clock(&self, ahead: f64) -> Result<()> {
        let clock = self.clock.as_ref().context("the site has no clock that can be set")?;
        self.hardware.set_clock(ahead);
        clock.set(ahead)
    }

    /// Waits until fused poses come, at most `seconds`.
    #[allow(clippy::disallowed_methods)] // a shell: it waits
    pub fn wait_for_pose(&mut self, seconds: f64) -> Result<()> {
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
                bail!(
                    "no fused pose within {seconds:.0} s (received: {} IMU samples, {} climber \
                     transforms, {} marker observations, {} fused and {} visual poses); the logs \
                     of the nodes are in {}",
                    h.imu.len(),
                    h.climber.len(),
                    h.markers.len(),
                    h.odometry.len(),
                    h.visual_pose.len(),
                    self.folder.display()
                );
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Lets the scenario begin a second from now; gives the stamp of its zero.
    pub fn begin(&self) -> Stamp {
        self.hardware.begin_in(1.0)
    }

    /// Waits until `seconds` of the scenario are over; calls `progress` with its time about ten
    /// times a second.
    pub fn play_until(
        &mut self,
        seconds: f64,
        mut progress: impl FnMut(f64, &SimulatedHardware),
    ) -> Result<()> {
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

    /// Waits until `seconds` of the scenario are over; nodes may end meanwhile.
    pub fn wait_until(&self, seconds: f64) {
        while self.hardware.seconds() < seconds {
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Ends the nodes by SIGINT and returns all messages.
    pub fn finish(self) -> Result<Ended> {
        ensure!(
            !self.hardware.middleware_ended(),
            "the test's own DDS participant was interrupted and ended (RustDDS does that); run it \
             again"
        );
        let ends = self.nodes.stop()?;
        let received = self.hardware.take_received();
        Ok(Ended { received, ends })
    }
}
