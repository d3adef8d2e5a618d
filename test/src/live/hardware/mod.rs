//! Simulated hardware, live: a camera on the image topic, an MTx on a pty, encoders on
//! `climber/joint_states`, and a subscriber to the nodes' topics. DDS and the pty are its only
//! connections to the nodes.

mod devices;
mod topics;

use super::{
    images::ImageSequence,
    received::Received,
    scenario::Scenario,
    site::{ClockError, Host, Site},
};
use anyhow::{Context, Result, anyhow};
use imu_driver::simulated_imu::{
    SimulatedImuConfig,
    pty::{PtyImu, now},
};
use node_kit::node::Process;
use rig_model::Stamp;
use std::{
    path::Path,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicI64, Ordering},
        mpsc::sync_channel,
    },
    thread::JoinHandle,
    time::Duration,
};
use topics::{Publishers, start_subscriber};
use volant_msgs::sensor_msgs::msg::{CompressedImage, JointState};

/// Replaces a message before its publication by others, each with a delay.
pub type Replace<M> = Box<dyn FnMut(M) -> Vec<(Duration, M)> + Send>;

/// A fault of the camera or the encoders.
pub enum FaultInjector {
    Images(Replace<CompressedImage>),
    Joints(Replace<JointState>),
}

/// Time before the scenario's zero at which a record begins, s: a filter may start stationary.
pub(super) const LEAD: f64 = 0.5;

struct Shared {
    scenario: Scenario,
    /// Stamp of the scenario's zero, ns; `i64::MAX` while the rig is stationary and waits.
    epoch: AtomicI64,
    began: Stamp,
    /// How the clock of the climber's computer is off.
    clock: ClockError,
    /// By how much it was set, ns.
    clock_set_by: AtomicI64,
    /// The scenario repeats, and published messages are not kept.
    endless: bool,
    stop: AtomicBool,
    injector: Mutex<Option<FaultInjector>>,
    received: Arc<Mutex<Received>>,
}

impl Shared {
    /// Seconds since the scenario's zero; far below zero before it starts.
    fn elapsed(&self, at: Stamp) -> f64 {
        match self.epoch.load(Ordering::Relaxed) {
            i64::MAX => -100.0,
            epoch => at.seconds_since(Stamp::from_nanos(epoch)),
        }
    }

    /// Seconds of the scenario; in an endless run, of its lap.
    fn seconds(&self, at: Stamp) -> f64 {
        let seconds = self.elapsed(at);
        if self.endless && seconds > 0.0 { seconds % self.scenario.duration() } else { seconds }
    }

    /// What the climber's clock shows at an instant.
    fn climber_clock(&self, at: Stamp) -> Stamp {
        let off = self.clock.offset + self.clock.ppm * 1e-6 * at.seconds_since(self.began);
        Stamp::from_nanos(at.as_nanos() + self.clock_set_by.load(Ordering::Relaxed))
            .plus_seconds(off)
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Sleeps until the instant, in parts so that a stop takes effect soon.
    fn sleep_until(&self, at: Stamp) {
        while !self.stopped() {
            let left = at.seconds_since(now());
            if left <= 0.0 {
                return;
            }
            std::thread::sleep(Duration::from_secs_f64(left.min(0.05)));
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The live hardware. It ends when dropped.
pub struct SimulatedHardware {
    shared: Arc<Shared>,
    imu: PtyImu,
    threads: Vec<JoinHandle<()>>,
    processes: Vec<Process>,
}

impl SimulatedHardware {
    /// Starts the hardware: stationary, camera and encoders running, the IMU's port at `port`.
    pub fn start(
        scenario: &Scenario,
        images: Arc<ImageSequence>,
        site: &Site,
        port: &Path,
    ) -> Result<Self> {
        let failed = |error: std::io::Error| anyhow!("the simulated rig: {error}");
        let received = Arc::new(Mutex::new(Received::default()));
        let (sender, receiver) = sync_channel(1);
        let mut climber = site.join(Host::Climber)?;
        Publishers::start(&mut climber, sender)?;
        let mut processes = vec![climber];
        if site.hosts.is_some() {
            processes.push(site.join(Host::Platform)?);
        }
        if let Some(platform) = processes.last_mut() {
            start_subscriber(platform, Arc::clone(&received))?;
        }
        let publishers = receiver.recv().context("the simulated rig's node did not start")?;
        let shared = Arc::new(Shared {
            scenario: scenario.clone(),
            epoch: AtomicI64::new(i64::MAX),
            began: now(),
            clock: site.climber_clock,
            clock_set_by: AtomicI64::new(0),
            endless: site.endless,
            stop: AtomicBool::new(false),
            injector: Mutex::new(None),
            received,
        });
        let imu =
            PtyImu::start(SimulatedImuConfig::default(), port, devices::imu(Arc::clone(&shared)))
                .map_err(failed)?;
        let thread = |name: &str, work: Box<dyn FnOnce() + Send>| {
            std::thread::Builder::new().name(name.to_owned()).spawn(work).map_err(failed)
        };
        let threads = vec![
            thread("camera", {
                let (shared, publishers) = (Arc::clone(&shared), publishers.clone());
                Box::new(move || devices::camera(&shared, &publishers, &images))
            })?,
            thread("encoders", {
                let shared = Arc::clone(&shared);
                Box::new(move || devices::encoders(&shared, &publishers))
            })?,
        ];
        Ok(Self { shared, imu, threads, processes })
    }

    /// Lets the scenario begin `seconds` from now; gives the stamp of its zero.
    pub fn begin_in(&self, seconds: f64) -> Stamp {
        let epoch = now().plus_seconds(seconds);
        self.shared.epoch.store(epoch.as_nanos(), Ordering::Relaxed);
        epoch
    }

    /// Seconds of the scenario now (of all its laps, where it is endless).
    pub fn seconds(&self) -> f64 {
        self.shared.elapsed(now())
    }

    /// What was received since the last call; it is forgotten here.
    pub fn take_received(&self) -> Received {
        std::mem::take(&mut *lock(&self.shared.received))
    }

    /// Messages received so far. Hold the guard briefly: the subscriber waits meanwhile.
    pub fn received(&self) -> MutexGuard<'_, Received> {
        lock(&self.shared.received)
    }

    /// Sets the fault injector for camera and encoders; `None` removes it.
    pub fn inject(&self, injector: Option<FaultInjector>) {
        *lock(&self.shared.injector) = injector;
    }

    /// Sets the clock that stamps camera and encoder messages `ahead` seconds ahead of the true
    /// time.
    pub fn set_clock(&self, ahead: f64) {
        self.shared.clock_set_by.store((ahead * 1e9).round() as i64, Ordering::Relaxed);
    }

    /// The IMU, for faults such as unplugging.
    pub fn imu(&self) -> &PtyImu {
        &self.imu
    }

    /// Whether the hardware's own middleware has ended: then missing messages are not the nodes'
    /// fault.
    pub fn middleware_ended(&self) -> bool {
        self.processes.iter().any(Process::middleware_ended)
    }
}

impl Drop for SimulatedHardware {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}
