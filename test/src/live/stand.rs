//! The hardware that is not there, live: a camera that plays its film on the image topic, an MTx on a pty, encoders on
//! `climber/joint_states`; and an ear for what the nodes say. It speaks to the nodes over DDS and the pty only.

use super::{
    film::Film,
    heard::Heard,
    messages::{compressed_image, joint_state},
    scenario::{EXPOSURE, IMAGE_RATE, Scenario},
    site::{ClockError, Ears, Host, Site},
};
use crate::rig::{inertial::Sensors, random::Random};
use imu_driver::fake_unit::{FakeSample, FakeUnitConfig, pty::PtyUnit};
use nalgebra::{UnitQuaternion, Vector3};
use node_kit::{
    RosArguments, convert,
    node::{Kit, NodeError, NodeShell, Process, Publisher},
    qos::QosPreset,
};
use rig_model::Stamp;
use std::{
    path::Path,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicI64, Ordering},
        mpsc::{SyncSender, sync_channel},
    },
    thread::JoinHandle,
    time::Duration,
};
use volant_msgs::{
    Message,
    sensor_msgs::msg::{CameraInfo, CompressedImage, JointState},
};

/// Something that the hardware is about to say, for a fault to spoil.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant, reason = "each one is handed on at once")]
pub enum Saying {
    /// A picture; its camera info follows it.
    Image(CompressedImage),
    /// The lens.
    CameraInfo(CameraInfo),
    /// The encoders.
    Joints(JointState),
}

/// What a fault makes of a saying: what is said instead, each after a delay.
pub type Spoiler = Box<dyn FnMut(Saying) -> Vec<(Duration, Saying)> + Send>;

/// A run's record begins so long before the scenario's zero, s: a filter may start at rest.
pub(super) const LEAD: f64 = 0.5;

/// What was said, with the instant at which it was.
#[derive(Clone, Debug, Default)]
pub struct Said {
    /// The pictures' stamps and when they were sent; they are frames of the film, counted from the run's first one.
    pub images: Vec<(Stamp, CompressedImage)>,
    /// The lens.
    pub camera_info: Vec<(Stamp, CameraInfo)>,
    /// The encoders.
    pub joints: Vec<(Stamp, JointState)>,
}

struct Shared {
    scenario: Scenario,
    /// Stamp of the scenario's zero, ns; `i64::MAX` while the rig is at rest and waits.
    epoch: AtomicI64,
    began: Stamp,
    /// How the clock of the climber's computer is off.
    clock: ClockError,
    /// By how much it was set, ns.
    clock_set_by: AtomicI64,
    /// The scenario begins anew when it is over, and what the hardware said is not kept.
    endless: bool,
    stop: AtomicBool,
    spoiler: Mutex<Option<Spoiler>>,
    said: Mutex<Said>,
    heard: Arc<Mutex<Heard>>,
}

impl Shared {
    /// Seconds of the scenario; at rest long before its beginning.
    fn seconds(&self, at: Stamp) -> f64 {
        match self.epoch.load(Ordering::Relaxed) {
            i64::MAX => -100.0,
            epoch => self.lap(at.seconds_since(Stamp::from_nanos(epoch))),
        }
    }

    /// In an endless run, the time of the lap.
    fn lap(&self, seconds: f64) -> f64 {
        if self.endless && seconds > 0.0 { seconds % self.scenario.duration() } else { seconds }
    }

    /// What the climber's clock shows at an instant.
    fn climber_clock(&self, at: Stamp) -> Stamp {
        let off = self.clock.offset + self.clock.ppm * 1e-6 * at.seconds_since(self.began);
        Stamp::from_nanos(at.as_nanos() + self.clock_set_by.load(Ordering::Relaxed)).plus_seconds(off)
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Sleeps until the instant, in parts so that a stop is heard.
    fn sleep_until(&self, at: Stamp) {
        while !self.stopped() {
            let left = at.seconds_since(imu_driver::fake_unit::pty::now());
            if left <= 0.0 {
                return;
            }
            std::thread::sleep(Duration::from_secs_f64(left.min(0.05)));
        }
    }
}

/// What the shell hands out, for the hardware's own threads.
#[derive(Clone)]
struct Outlets {
    image: Publisher<CompressedImage>,
    camera_info: Publisher<CameraInfo>,
    joints: Publisher<JointState>,
}

/// A shell is started by its type alone, so what it works with waits here for it.
static OUTLETS_WANTED: Mutex<Option<SyncSender<Outlets>>> = Mutex::new(None);
static EARS_WANTED: Mutex<Option<(Ears, Arc<Mutex<Heard>>)>> = Mutex::new(None);
/// Stands are made one after the other, because of the two above.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The climber's computer: camera and encoders.
struct Mouth;

impl NodeShell for Mouth {
    const NAME: &'static str = "rig_simulator";
    const ABOUT: &'static str = "the simulated rig's camera and encoders";
    type Parameters = ();
    type Input = ();

    fn start(kit: &mut Kit<()>, (): ()) -> Result<Self, NodeError> {
        let Some(sender) = lock(&OUTLETS_WANTED).take() else {
            return Err(NodeError::shell("the simulated rig is started by its stand alone"));
        };
        let outlets = Outlets {
            image: kit.advertise("climber/camera/image_raw/compressed", QosPreset::Image)?,
            camera_info: kit.advertise("climber/camera/camera_info", QosPreset::Image)?,
            joints: kit.advertise("climber/joint_states", QosPreset::State)?,
        };
        // The receiver waits as long as this start takes, and longer.
        let _ = sender.send(outlets);
        Ok(Self)
    }

    fn handle(&mut self, _: &mut Kit<()>, (): ()) {}
}

/// Somebody on the platform's computer who listens.
struct Ear;

impl NodeShell for Ear {
    const NAME: &'static str = "rig_listener";
    const ABOUT: &'static str = "hears what the simulated rig's nodes say";
    type Parameters = ();
    type Input = ();

    fn start(kit: &mut Kit<()>, (): ()) -> Result<Self, NodeError> {
        let Some((ears, heard)) = lock(&EARS_WANTED).take() else {
            return Err(NodeError::shell("the simulated rig is started by its stand alone"));
        };
        hear(kit, "volant/odometry", QosPreset::State, &heard, |h| &mut h.odometry)?;
        hear(kit, "volant/visual_pose", QosPreset::State, &heard, |h| &mut h.visual_pose)?;
        hear(kit, "volant/marker_updates", QosPreset::State, &heard, |h| &mut h.marker_updates)?;
        hear(kit, "/diagnostics", QosPreset::State, &heard, |h| &mut h.diagnostics)?;
        if ears == Ears::Few {
            return Ok(Self);
        }
        hear(kit, "volant/fused_pose", QosPreset::State, &heard, |h| &mut h.fused_pose)?;
        hear(kit, "volant/imu/data", QosPreset::Sensor, &heard, |h| &mut h.imu)?;
        hear(kit, "climber/markers", QosPreset::State, &heard, |h| &mut h.markers)?;
        hear(kit, "climber/transform", QosPreset::State, &heard, |h| &mut h.climber)?;
        hear(kit, "/tf", QosPreset::State, &heard, |h| &mut h.tf)?;
        hear(kit, "/tf_static", QosPreset::Latched, &heard, |h| &mut h.tf_static)?;
        Ok(Self)
    }

    fn handle(&mut self, _: &mut Kit<()>, (): ()) {}
}

/// Where the messages of a topic are kept.
type ListOf<M> = fn(&mut Heard) -> &mut Vec<(Stamp, Arc<M>)>;

/// Keeps every message of a topic with the instant of its receipt, taken on the thread that brought it.
fn hear<M: Message>(
    kit: &mut Kit<()>,
    topic: &str,
    preset: QosPreset,
    heard: &Arc<Mutex<Heard>>,
    list: ListOf<M>,
) -> Result<(), NodeError> {
    let heard = Arc::clone(heard);
    kit.subscribe_optional(topic, preset, move |message: Arc<M>| {
        let now = imu_driver::fake_unit::pty::now();
        list(&mut lock(&heard)).push((now, message));
        None
    })
}

/// The live hardware. It ends when dropped.
pub struct Stand {
    shared: Arc<Shared>,
    outlets: Outlets,
    unit: PtyUnit,
    threads: Vec<JoinHandle<()>>,
    processes: Vec<Process>,
}

/// Why the stand cannot be.
#[derive(Debug, thiserror::Error)]
pub enum StandError {
    /// The middleware.
    #[error(transparent)]
    Node(#[from] NodeError),
    /// A pty or a thread.
    #[error("the simulated rig: {0}")]
    Io(#[from] std::io::Error),
    /// The node did not come up.
    #[error("the simulated rig's node did not start")]
    NotStarted,
}

impl Stand {
    /// Brings the hardware up: at rest, camera and encoders running, the unit's port at `port`.
    ///
    /// # Errors
    /// No DDS, no pty, no thread, a network namespace that is not there.
    pub fn start(scenario: &Scenario, film: Arc<Film>, site: &Site, port: &Path) -> Result<Self, StandError> {
        let heard = Arc::new(Mutex::new(Heard::default()));
        let names = RosArguments::parse(site.ros_arguments()).map_err(NodeError::from)?.0;
        let one = lock(&ONE_AT_A_TIME);
        let (sender, receiver) = sync_channel(1);
        *lock(&OUTLETS_WANTED) = Some(sender);
        *lock(&EARS_WANTED) = Some((site.ears, Arc::clone(&heard)));
        let mut climber = site.join(Host::Climber)?;
        climber.start::<Mouth>(&names)?;
        let mut processes = vec![climber];
        if site.hosts.is_some() {
            processes.push(site.join(Host::Platform)?);
        }
        if let Some(platform) = processes.last_mut() {
            platform.start::<Ear>(&names)?;
        }
        let outlets = receiver.recv().map_err(|_| StandError::NotStarted)?;
        drop(one);
        let shared = Arc::new(Shared {
            scenario: scenario.clone(),
            epoch: AtomicI64::new(i64::MAX),
            began: imu_driver::fake_unit::pty::now(),
            clock: site.climber_clock,
            clock_set_by: AtomicI64::new(0),
            endless: site.endless,
            stop: AtomicBool::new(false),
            spoiler: Mutex::new(None),
            said: Mutex::default(),
            heard,
        });
        let unit = PtyUnit::start(FakeUnitConfig::default(), port, inertial_unit(Arc::clone(&shared)))?;
        let thread = |name: &str, work: Box<dyn FnOnce() + Send>| {
            std::thread::Builder::new().name(name.to_owned()).spawn(work)
        };
        let threads = vec![
            thread("camera", {
                let (shared, outlets) = (Arc::clone(&shared), outlets.clone());
                Box::new(move || camera(&shared, &outlets, &film))
            })?,
            thread("encoders", {
                let (shared, outlets) = (Arc::clone(&shared), outlets.clone());
                Box::new(move || encoders(&shared, &outlets))
            })?,
        ];
        Ok(Self { shared, outlets, unit, threads, processes })
    }

    /// Lets the scenario begin `seconds` from now; gives the stamp of its zero.
    pub fn begin_in(&self, seconds: f64) -> Stamp {
        let epoch = imu_driver::fake_unit::pty::now().plus_seconds(seconds);
        self.shared.epoch.store(epoch.as_nanos(), Ordering::Relaxed);
        epoch
    }

    /// Seconds of the scenario now (of all its laps, where it is endless).
    pub fn seconds(&self) -> f64 {
        match self.shared.epoch.load(Ordering::Relaxed) {
            i64::MAX => -100.0,
            epoch => imu_driver::fake_unit::pty::now().seconds_since(Stamp::from_nanos(epoch)),
        }
    }

    /// What was heard since the last call; it is forgotten here.
    pub fn take_heard(&self) -> Heard {
        std::mem::take(&mut *lock(&self.shared.heard))
    }

    /// What was heard so far; hold it briefly, the ear waits meanwhile.
    pub fn heard(&self) -> MutexGuard<'_, Heard> {
        lock(&self.shared.heard)
    }

    /// What the hardware said so far, from the scenario's zero on.
    pub fn said(&self) -> Said {
        lock(&self.shared.said).clone()
    }

    /// Has a fault spoil what camera and encoders say, or `None` to let them be.
    pub fn spoil(&self, spoiler: Option<Spoiler>) {
        *lock(&self.shared.spoiler) = spoiler;
    }

    /// Sets the clock by which camera and encoders stamp so many seconds ahead of the time.
    pub fn set_clock(&self, ahead: f64) {
        self.shared.clock_set_by.store((ahead * 1e9).round() as i64, Ordering::Relaxed);
    }

    /// The inertial unit, to unplug it.
    pub fn unit(&self) -> &PtyUnit {
        &self.unit
    }

    /// Has the stand's own middleware ended? Then what is heard tells nothing of the nodes.
    pub fn is_deaf(&self) -> bool {
        self.processes.iter().any(Process::middleware_ended)
    }

    /// How many nodes listen to camera, and encoders.
    pub fn listeners(&self) -> [usize; 2] {
        [self.outlets.image.subscribers(), self.outlets.joints.subscribers()]
    }
}

impl Drop for Stand {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Says it, or what a fault makes of it.
fn say(shared: &Shared, outlets: &Outlets, saying: Saying) {
    let sayings = match lock(&shared.spoiler).as_mut() {
        Some(spoiler) => spoiler(saying),
        None => vec![(Duration::ZERO, saying)],
    };
    for (delay, saying) in sayings {
        if delay.is_zero() {
            publish(shared, outlets, saying);
            continue;
        }
        // Kept for the run's record only when it is said; a late one has no thread to wait on but its own.
        let outlets = outlets.clone();
        let late = move || {
            std::thread::sleep(delay);
            match saying {
                Saying::Image(m) => outlets.image.publish(m),
                Saying::CameraInfo(m) => outlets.camera_info.publish(m),
                Saying::Joints(m) => outlets.joints.publish(m),
            }
        };
        let _ = std::thread::Builder::new().name("late".to_owned()).spawn(late);
    }
}

fn publish(shared: &Shared, outlets: &Outlets, saying: Saying) {
    let now = imu_driver::fake_unit::pty::now();
    let keep = !shared.endless && shared.seconds(now) >= -LEAD;
    let mut said = lock(&shared.said);
    match saying {
        Saying::Image(m) => {
            if keep {
                said.images.push((now, m.clone()));
            }
            outlets.image.publish(m);
        }
        Saying::CameraInfo(m) => {
            if keep {
                said.camera_info.push((now, m.clone()));
            }
            outlets.camera_info.publish(m);
        }
        Saying::Joints(m) => {
            if keep {
                said.joints.push((now, m.clone()));
            }
            outlets.joints.publish(m);
        }
    }
}

/// Shows the still frames over and over until the scenario begins, then its film, then nothing any more.
fn camera(shared: &Shared, outlets: &Outlets, film: &Film) {
    let frame_id = &shared.scenario.rig.frames.camera;
    let show = |stamp: Stamp, jpeg: &[u8]| {
        // The picture is there when the shutter has closed.
        shared.sleep_until(stamp.plus_seconds(EXPOSURE / 2.0));
        if shared.stopped() {
            return;
        }
        let shown = shared.climber_clock(stamp);
        say(shared, outlets, Saying::Image(compressed_image(shown, frame_id, jpeg.to_vec())));
        say(
            shared,
            outlets,
            Saying::CameraInfo(convert::camera_message(frame_id, shown, &shared.scenario.camera)),
        );
    };
    let mut stamp = imu_driver::fake_unit::pty::now();
    'still: loop {
        for frame in &film.still {
            if shared.stopped() {
                return;
            }
            stamp = stamp.plus_seconds(1.0 / IMAGE_RATE);
            if shared.seconds(stamp) > -0.5 / IMAGE_RATE {
                break 'still;
            }
            show(stamp, &frame.jpeg);
        }
        if film.still.is_empty() {
            shared.sleep_until(stamp.plus_seconds(0.1));
            stamp = stamp.plus_seconds(0.1);
            if shared.stopped() || shared.seconds(stamp) > 0.0 {
                break;
            }
        }
    }
    let mut epoch = Stamp::from_nanos(shared.epoch.load(Ordering::Relaxed));
    loop {
        for frame in &film.frames {
            if shared.stopped() {
                return;
            }
            show(epoch.plus_seconds(frame.seconds), &frame.jpeg);
        }
        if !shared.endless || film.frames.is_empty() {
            return;
        }
        epoch = epoch.plus_seconds(shared.scenario.duration());
    }
}

/// Reads the encoders at their rate until the end.
fn encoders(shared: &Shared, outlets: &Outlets) {
    let mut random = Random::fork(shared.scenario.sensors.seed, "live encoders");
    let mut stamp = imu_driver::fake_unit::pty::now();
    while !shared.stopped() {
        stamp = stamp.plus_seconds(1.0 / shared.scenario.sensors.climber_rate);
        shared.sleep_until(stamp);
        let shown = shared.climber_clock(stamp);
        let joints = joint_state(&shared.scenario, &mut random, shared.seconds(stamp), shown);
        say(shared, outlets, Saying::Joints(joints));
    }
}

/// What the inertial unit feels, with its noise, biases and wandering attitude.
fn inertial_unit(shared: Arc<Shared>) -> imu_driver::fake_unit::Source {
    let mut random = Random::fork(shared.scenario.sensors.seed, "live unit");
    let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), random.within(-3.0, 3.0));
    let mut wander = Vector3::zeros();
    Box::new(move |at| {
        let Shared { scenario, .. } = &*shared;
        let (c, imu) = (&scenario.sensors, &scenario.rig.imu);
        let t = shared.seconds(at);
        let (force, rate) = Sensors::new(&scenario.motion, &scenario.rig, &scenario.camera, c).ideal_imu(t);
        let mut white = |sigma: f64| {
            Vector3::new(random.normal(), random.normal(), random.normal()) * sigma * c.imu_noise_factor
        };
        let per_sample = c.imu_rate.sqrt();
        // The attitude error wanders with a time constant of ten seconds.
        let keep = (-1.0 / (10.0 * c.imu_rate)).exp();
        wander = wander * keep + white(c.attitude_error * (1.0 - keep * keep).sqrt());
        FakeSample {
            specific_force: force
                + c.accelerometer_bias
                + white(imu.accelerometer_noise_density * per_sample),
            angular_velocity: rate + c.gyroscope_bias + white(imu.gyroscope_noise_density * per_sample),
            enu_from_imu: UnitQuaternion::from_scaled_axis(wander)
                * heading
                * scenario.motion.world_from_volant(t).rotation
                * imu.volant_from_imu.rotation,
            ..FakeSample::at_rest()
        }
    })
}
