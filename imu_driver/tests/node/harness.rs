//! Simulated IMU on a pseudo-terminal, the node as a process, and a node that receives its topics.

use imu_driver::simulated_imu::{SimulatedImuConfig, SimulatedSample, pty::PtyImu, pty::now};
use nalgebra::{UnitQuaternion, Vector3};
use node_kit::{
    convert,
    environment::Network,
    node::{NodeContext, NodeError, Process},
    qos::QosPreset,
};
use rig_model::{Stamp, topics};
use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};
use test_support::{
    place::Place,
    process::{Running, in_domain, wait_until},
};
use volant_msgs::{
    Message,
    diagnostic_msgs::msg::DiagnosticArray,
    sensor_msgs::msg::{Imu, MagneticField},
    tf2_msgs::msg::TFMessage,
};

/// The rig file of the nodes.
pub const RIG: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../rig_simulator/rig.yaml");

/// Messages received, samples with their time of receipt.
#[derive(Default)]
pub struct Received {
    pub imu: Vec<(Stamp, Arc<Imu>)>,
    pub field: Vec<Arc<MagneticField>>,
    pub tf: Vec<Arc<TFMessage>>,
    pub diagnostics: Vec<Arc<DiagnosticArray>>,
}

impl Received {
    /// Newest value in the diagnostics of the IMU.
    pub fn value(&self, key: &str) -> Option<&str> {
        let mut statuses = self.diagnostics.iter().flat_map(|d| &d.status);
        let status = statuses.rfind(|s| s.name == "imu_driver: imu")?;
        status.values.iter().find(|v| v.key == key).map(|v| v.value.as_str())
    }
}

static RECEIVED: Mutex<Option<Received>> = Mutex::new(None);
/// One test at a time: they share the received messages.
static TURN: Mutex<()> = Mutex::new(());

/// Accesses the received messages.
pub fn received<T>(f: impl FnOnce(&mut Received) -> T) -> T {
    let mut received = RECEIVED.lock().unwrap_or_else(PoisonError::into_inner);
    f(received.get_or_insert_default())
}

/// Subscribes to a topic, whose messages `keep` receives with their time of receipt.
fn subscribe<M: Message>(
    context: &mut NodeContext<()>,
    topic: &str,
    qos: QosPreset,
    keep: fn(&mut Received, Stamp, Arc<M>),
) -> Result<(), NodeError> {
    context.subscribe(topic, qos, move |message: Arc<M>| -> Option<()> {
        let at = now();
        received(|r| keep(r, at, message));
        None
    })
}

/// Starts a node that keeps the messages of the driver.
fn start_subscriber(process: &mut Process) -> Result<(), NodeError> {
    process.start_closure("subscriber", |context: &mut NodeContext<()>| {
        let [tf, diagnostics] = [topics::absolute::TF_STATIC, topics::absolute::DIAGNOSTICS];
        subscribe(context, topics::IMU, QosPreset::Sensor, |r, at, m| r.imu.push((at, m)))?;
        subscribe(context, "imu/mag", QosPreset::Sensor, |r, _, m| r.field.push(m))?;
        subscribe(context, tf, QosPreset::Latched, |r, _, m| r.tf.push(m))?;
        subscribe(context, diagnostics, QosPreset::State, |r, _, m| r.diagnostics.push(m))?;
        Ok(|_: &mut NodeContext<()>, ()| ())
    })
}

/// True motion at `at`.
fn motion(at: Stamp) -> SimulatedSample {
    let t = (at.as_nanos() % 100_000_000_000) as f64 * 1e-9;
    SimulatedSample {
        specific_force: Vector3::new(t.sin(), t.cos(), 9.81),
        angular_velocity: Vector3::new(0.1 * t.cos(), 0.2, -0.3),
        enu_from_imu: UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3 * t),
        ..SimulatedSample::stationary()
    }
}

/// Simulated IMU, node and subscriber; all end on drop.
pub struct Harness {
    pub node: Running,
    pub imu: PtyImu,
    _subscriber: Process,
    _folder: Place,
    _turn: MutexGuard<'static, ()>,
}

impl Harness {
    pub fn start(domain: u16, imu: SimulatedImuConfig, arguments: &[&str]) -> Self {
        let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        received(|r| *r = Received::default());
        let folder = Place::new();
        let port = folder.path("tty");
        let imu = PtyImu::start(imu, &port, Box::new(motion)).unwrap();
        let network = Network { domain_id: domain, ..Network::default() };
        let mut subscriber = Process::new(network).unwrap();
        start_subscriber(&mut subscriber).unwrap();
        let node = Running::start(
            in_domain(domain, env!("CARGO_BIN_EXE_imu_driver"))
                .env_remove("ROS_AUTOMATIC_DISCOVERY_RANGE")
                .args(["--ros-args", "--params-file", RIG])
                .args(["-p", &format!("port:={}", port.display())])
                .args(arguments),
        );
        Self { node, imu, _subscriber: subscriber, _folder: folder, _turn: turn }
    }

    /// Waits until `samples` were received, for at most `seconds`; returns whether they were.
    pub fn wait_for_samples(&self, samples: usize, seconds: f64) -> bool {
        self.wait(seconds, |r| r.imu.len() >= samples)
    }

    /// Waits for `done`, for at most `seconds`; returns whether it was reached.
    pub fn wait(&self, seconds: f64, done: impl Fn(&Received) -> bool) -> bool {
        wait_until(Duration::from_secs_f64(seconds), || received(|r| done(r)))
    }
}

/// Asserts that every message equals the truth at its stamp, and that stamps increase.
pub fn check_truth(messages: &[(Stamp, Arc<Imu>)], tolerance: f64) {
    for pair in messages.windows(2) {
        assert!(convert::stamp(&pair[1].1.header.stamp) > convert::stamp(&pair[0].1.header.stamp));
    }
    for (_, message) in messages {
        let imu = convert::imu_sample(message);
        let expected = motion(imu.stamp);
        assert!((imu.specific_force - expected.specific_force).norm() < tolerance);
        assert!((imu.angular_velocity - expected.angular_velocity).norm() < tolerance);
        let orientation = imu.orientation.unwrap();
        assert!(orientation.enu_from_imu.angle_to(&expected.enu_from_imu) < tolerance);
    }
}
