//! The real node, a process of its own, between a pseudo-terminal and DDS.
#![cfg(all(feature = "node", feature = "fake"))]
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

use imu_driver::{
    fake_unit::{FakeSample, FakeUnitConfig, SentSample, pty::PtyUnit, pty::now},
    protocol::{MessageId, frame},
};
use nalgebra::{UnitQuaternion, Vector3};
use node_kit::{
    RosArguments, convert,
    environment::Network,
    node::{Kit, NodeError, NodeShell, Process},
    qos::QosPreset,
};
use rig_model::Stamp;
use std::{
    io::Read,
    path::PathBuf,
    process::{Child, Command, Stdio},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};
use volant_msgs::{
    diagnostic_msgs::msg::DiagnosticArray,
    sensor_msgs::msg::{Imu, MagneticField},
    tf2_msgs::msg::TFMessage,
};

const RIG: &str = "/**:
  ros__parameters:
    camera: {position: [0.0, 0.0, -0.10], orientation: [0.70710678, 0.70710678, 0.0, 0.0]}
    imu:
      position: [0.01, 0.02, 0.03]
      orientation: [0.0, 0.0, 0.0, 1.0]
      accelerometer_noise_density: 0.002
      gyroscope_noise_density: 0.00087
    markers:
      size: 0.076
      red: [0.15, 0.15, 0.02]
      green: [-0.15, 0.15, 0.02]
      blue: [-0.15, -0.15, 0.02]
      yellow: [0.15, -0.15, 0.02]
";

#[derive(Default)]
struct Heard {
    imu: Vec<(Stamp, Arc<Imu>)>,
    field: Vec<Arc<MagneticField>>,
    tf: Vec<Arc<TFMessage>>,
    diagnostics: Vec<Arc<DiagnosticArray>>,
}

static HEARD: Mutex<Option<Heard>> = Mutex::new(None);
/// One DDS domain, one test at a time.
static TURN: Mutex<()> = Mutex::new(());

fn with_heard<T>(f: impl FnOnce(&mut Heard) -> T) -> T {
    let mut heard = HEARD.lock().unwrap_or_else(PoisonError::into_inner);
    f(heard.get_or_insert_default())
}

struct Ear;

impl NodeShell for Ear {
    const NAME: &'static str = "ear";
    type Parameters = ();
    type Input = ();

    fn start(kit: &mut Kit<()>, (): ()) -> Result<Self, NodeError> {
        kit.subscribe("volant/imu/data", QosPreset::Sensor, |m: Arc<Imu>| -> Option<()> {
            let at = now();
            with_heard(|h| h.imu.push((at, m)));
            None
        })?;
        kit.subscribe("imu/mag", QosPreset::Sensor, |m: Arc<MagneticField>| -> Option<()> {
            with_heard(|h| h.field.push(m));
            None
        })?;
        kit.subscribe("/tf_static", QosPreset::Latched, |m: Arc<TFMessage>| -> Option<()> {
            with_heard(|h| h.tf.push(m));
            None
        })?;
        kit.subscribe("/diagnostics", QosPreset::State, |m: Arc<DiagnosticArray>| -> Option<()> {
            with_heard(|h| h.diagnostics.push(m));
            None
        })?;
        Ok(Self)
    }

    fn handle(&mut self, _: &mut Kit<()>, (): ()) {}
}

fn sample(at: Stamp) -> FakeSample {
    let t = (at.as_nanos() % 100_000_000_000) as f64 * 1e-9;
    FakeSample {
        specific_force: Vector3::new(t.sin(), t.cos(), 9.81),
        angular_velocity: Vector3::new(0.1 * t.cos(), 0.2, -0.3),
        enu_from_imu: UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3 * t),
        ..FakeSample::at_rest()
    }
}

/// Unit, node and ear; all end when dropped.
struct Stand {
    unit: PtyUnit,
    node: Child,
    _ear: Process,
    folder: PathBuf,
    _turn: MutexGuard<'static, ()>,
}

impl Stand {
    fn start(name: &str, domain: u16, unit: FakeUnitConfig, arguments: &[&str]) -> Self {
        let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        with_heard(|h| *h = Heard::default());
        let folder = std::env::temp_dir().join(format!("volant-imu-node-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let rig = folder.join("rig.yaml");
        std::fs::write(&rig, RIG).unwrap();
        let port = folder.join("tty");
        let unit = PtyUnit::start(unit, &port, Box::new(sample)).unwrap();
        let network = Network { domain_id: domain, ..Network::default() };
        let mut ear = Process::new(network).unwrap();
        ear.start::<Ear>(&RosArguments::default()).unwrap();
        let node = Command::new(env!("CARGO_BIN_EXE_imu_driver"))
            .args(["--ros-args", "--params-file", rig.to_str().unwrap()])
            .args(["-p", &format!("port:={}", port.display())])
            .args(arguments)
            .env("ROS_DOMAIN_ID", domain.to_string())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        Self { unit, node, _ear: ear, folder, _turn: turn }
    }

    /// Waits until so many samples have been heard.
    fn hear(&self, samples: usize, seconds: f64) -> usize {
        let end = now().plus_seconds(seconds);
        loop {
            let heard = with_heard(|h| h.imu.len());
            if heard >= samples || now() > end {
                return heard;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn wait(&self, seconds: f64, done: impl Fn(&Heard) -> bool) -> bool {
        let end = now().plus_seconds(seconds);
        while now() < end {
            if with_heard(|h| done(h)) {
                return true;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        false
    }
}

impl Drop for Stand {
    fn drop(&mut self) {
        let _ = self.node.kill();
        let _ = self.node.wait();
        let mut said = String::new();
        if let Some(stderr) = &mut self.node.stderr {
            let _ = stderr.read_to_string(&mut said);
        }
        println!("{said}");
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// Every message equals what the unit measured at that time.
fn check_truth(heard: &[(Stamp, Arc<Imu>)], tolerance: f64) {
    for pair in heard.windows(2) {
        assert!(convert::stamp(&pair[1].1.header.stamp) > convert::stamp(&pair[0].1.header.stamp));
    }
    for (_, message) in heard {
        let imu = convert::imu_sample(message);
        // The motion is slow: a stamp that is off by milliseconds would show.
        let expected = sample(imu.stamp);
        assert!((imu.specific_force - expected.specific_force).norm() < tolerance);
        assert!((imu.angular_velocity - expected.angular_velocity).norm() < tolerance);
        let orientation = imu.orientation.unwrap();
        assert!(orientation.enu_from_imu.angle_to(&expected.enu_from_imu) < tolerance);
    }
}

fn percentile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).round() as usize]
}

/// From the unit to a subscriber, ms.
struct Latencies {
    /// From the instant at which the last byte was really on the pseudo-terminal, in the order of the samples.
    beyond_write: Vec<f64>,
    /// From the nominal end of the wire time: the fake unit's own lateness is in it.
    beyond_wire: Vec<f64>,
    stamps_rms: f64,
}

impl Latencies {
    fn of(heard: &[(Stamp, Arc<Imu>)], sent: &[SentSample]) -> Self {
        let (mut beyond_write, mut beyond_wire, mut squares) = (Vec::new(), Vec::new(), 0.0);
        for (at, message) in heard {
            let stamp = convert::stamp(&message.header.stamp);
            let truth = sent.iter().min_by_key(|s| (s.measured.as_nanos() - stamp.as_nanos()).abs()).unwrap();
            beyond_wire.push(at.seconds_since(truth.sent) * 1e3);
            beyond_write.push(at.seconds_since(truth.written.unwrap()) * 1e3);
            squares += (stamp.seconds_since(truth.measured) * 1e3).powi(2);
        }
        let stamps_rms = (squares / heard.len() as f64).sqrt();
        Self { beyond_write, beyond_wire, stamps_rms }
    }

    /// p50 and p99 from the write, p99 from the end of the wire time.
    fn print(&self) -> [f64; 3] {
        let [write, wire] = [&self.beyond_write, &self.beyond_wire].map(|v| {
            let mut v = v.clone();
            [0.5, 0.99].map(|share| percentile(&mut v, share))
        });
        println!(
            "last byte on the pty → message received over DDS, {} samples: p50 {:.3} ms, p99 {:.3} ms; from the nominal end of \
             the wire time p99 {:.3} ms; stamps {:.3} ms RMS",
            self.beyond_write.len(),
            write[0],
            write[1],
            wire[1],
            self.stamps_rms
        );
        [write[0], write[1], wire[1]]
    }
}

/// The median of the calmest ten in a row: what the machine's other work did not delay.
fn calmest(latencies: &[f64]) -> f64 {
    latencies.windows(10).map(|w| percentile(&mut w.to_vec(), 0.5)).fold(f64::INFINITY, f64::min)
}

/// The figure: p99 <= 2 ms beyond the wire time. It needs a quiet machine.
#[test]
#[ignore = "quiet machine: cargo test --release -p imu_driver --features fake --test node p99 -- --ignored --nocapture"]
fn p99_from_the_last_byte_to_the_message_is_two_milliseconds() {
    let stand = Stand::start("p99", 75, FakeUnitConfig::default(), &[]);
    assert!(stand.hear(3200, 60.0) >= 3200);
    let sent = stand.unit.take_sent();
    let heard = with_heard(|h| std::mem::take(&mut h.imu));
    let [_, p99, beyond_wire] = Latencies::of(&heard[200..], &sent).print();
    assert!(p99 <= 2.0 && beyond_wire <= 2.0, "{p99} {beyond_wire}");
}

#[test]
fn bytes_become_messages_soon_and_with_the_right_stamps() {
    let stand = Stand::start("latency", 71, FakeUnitConfig::default(), &[]);
    assert!(stand.hear(200, 30.0) >= 200);
    assert!(stand.hear(900, 30.0) >= 900);
    let sent: Vec<SentSample> = stand.unit.take_sent();
    let heard = with_heard(|h| std::mem::take(&mut h.imu));
    // The first ones came while DDS was still discovering.
    let latencies = Latencies::of(&heard[200..], &sent);
    latencies.print();
    check_truth(&heard, 5e-3);
    let message = &heard[250].1;
    assert_eq!(message.header.frame_id, "imu");
    // Variances, not standard deviations: 0.002² · 100 Hz.
    assert!((message.linear_acceleration_covariance[0] - 4e-4).abs() < 1e-9);
    assert!((message.orientation_covariance[8] - 0.087 * 0.087).abs() < 1e-9);
    with_heard(|h| {
        let field = &h.field[10].magnetic_field;
        assert!((field.x - 0.4 * 5e-5).abs() < 1e-9 && (field.z + 0.9 * 5e-5).abs() < 1e-9);
        let transform = &h.tf[0].transforms[0];
        assert_eq!(
            (transform.header.frame_id.as_str(), transform.child_frame_id.as_str()),
            ("volant", "imu")
        );
        assert!((transform.transform.translation.z - 0.03).abs() < 1e-12);
    });
    // 100 Hz without a hole, as DDS delivered them.
    let intervals = heard[200..]
        .windows(2)
        .map(|w| convert::stamp(&w[1].1.header.stamp).seconds_since(convert::stamp(&w[0].1.header.stamp)));
    let holes = intervals.clone().filter(|i| *i > 0.015).count();
    assert!(holes <= 5, "{holes}");
    assert!(intervals.clone().all(|i| (i / 0.01 - (i / 0.01).round()).abs() < 0.1));
    // On a machine that does other work whole stretches are late by time slices (192 ms, on one), so percentiles over all have
    // their own test, which wants a quiet machine. A wait in the driver or the node would be in the calmest stretch as well.
    let calm = calmest(&latencies.beyond_write);
    println!("{calm:.3} ms in the calmest tenth of a second");
    assert!(calm <= 2.0, "{calm} {:?}", latencies.beyond_write);
    assert!(latencies.stamps_rms < 1.0, "{}", latencies.stamps_rms);
}

#[test]
fn unplugged_replugged_slow_and_garbled_it_comes_back_by_itself() {
    let config = FakeUnitConfig { ack_delay: 0.02, ..FakeUnitConfig::default() };
    let stand = Stand::start("replug", 72, config, &[]);
    assert!(stand.hear(100, 20.0) >= 100);
    for outage in [0.2, 1.2] {
        stand.unit.unplug();
        std::thread::sleep(Duration::from_secs_f64(outage));
        let before = with_heard(|h| h.imu.len());
        stand.unit.replug();
        let plugged = now();
        assert!(stand.hear(before + 1, 10.0) > before);
        let back = with_heard(|h| h.imu[before].0).seconds_since(plugged);
        println!("plugged in again after {outage} s: first sample after {back:.2} s");
        // Up to one pause (1 s) until the port is tried, 0.1 s to settle, then within a second.
        assert!(back < 3.0, "{back}");
        assert!(stand.hear(before + 100, 10.0) >= before + 100);
    }
    stand.unit.with(|unit, at| {
        for k in 0..200_u8 {
            unit.inject(&[0xFA, 0xFF, 0x32, k, 0xFA, k.wrapping_mul(37)], at);
        }
        unit.inject(&frame(MessageId::GO_TO_CONFIG.ack(), &[]), at);
        unit.inject(&frame(MessageId::MT_DATA, &[0; 54])[..40], at);
    });
    let before = with_heard(|h| h.imu.len());
    assert!(stand.hear(before + 200, 10.0) >= before + 200);
    stand.unit.with(|unit, at| unit.power_cycle(at));
    let before = with_heard(|h| h.imu.len());
    assert!(stand.hear(before + 200, 10.0) >= before + 200);
    let heard = with_heard(|h| h.imu.clone());
    check_truth(&heard, 30e-3);
    // Only the factory's missing counter was ever written.
    assert_eq!(stand.unit.with(|unit, _| unit.flash_writes()), Some(1));
    assert!(stand.wait(5.0, |h| {
        h.diagnostics.iter().flat_map(|d| &d.status).any(|s| {
            s.name == "imu_driver: unit" && s.values.iter().any(|v| v.key == "connections" && v.value == "4")
        })
    }));
}

#[test]
fn a_port_that_is_not_there_ends_the_node_with_one_line_or_is_waited_for() {
    let folder = std::env::temp_dir().join(format!("volant-imu-node-missing-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let rig = folder.join("rig.yaml");
    std::fs::write(&rig, RIG).unwrap();
    let node = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_imu_driver"));
        command.args(["--ros-args", "--params-file", rig.to_str().unwrap()]).args(arguments);
        command.env("ROS_DOMAIN_ID", "73").stderr(Stdio::piped());
        command
    };
    for (arguments, code, expected) in [
        (["-p", "port:=/nowhere/tty0"], 1, "/nowhere/tty0"),
        (["-p", "port:=/dev/null"], 1, "/dev/null"),
        (["-p", "baud:=12345"], 1, "12345"),
        (["-p", "rate:=400.0"], 1, "baud"),
    ] {
        let done = node(&arguments).output().unwrap();
        let text = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(code), "{text}");
        assert_eq!(text.lines().count(), 1, "{text}");
        assert!(text.contains(expected), "{text}");
    }
    let mut waiting =
        node(&["-p", &format!("port:={}", folder.join("tty").display()), "-p", "wait_for_device:=true"])
            .spawn()
            .unwrap();
    std::thread::sleep(Duration::from_secs(1));
    assert!(waiting.try_wait().unwrap().is_none());
    waiting.kill().unwrap();
    waiting.wait().unwrap();
    let _ = std::fs::remove_dir_all(folder);
}

/// Resident memory of a process, KiB.
fn resident(pid: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find(|l| l.starts_with("VmRSS")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[test]
#[ignore = "ten minutes: cargo test --release -p imu_driver --features fake --test node -- --ignored --nocapture"]
fn ten_minutes_at_400_hz_lose_nothing_and_the_memory_stays_flat() {
    let config = FakeUnitConfig { baud: 460_800, first_counter: 50_000, ..FakeUnitConfig::default() };
    let stand = Stand::start("soak", 74, config, &["-p", "baud:=460800", "-p", "rate:=400.0"]);
    let seconds = std::env::var("VOLANT_SOAK").ok().and_then(|s| s.parse().ok()).unwrap_or(600.0);
    assert!(stand.hear(400, 20.0) >= 400);
    stand.unit.take_sent();
    with_heard(|h| *h = Heard::default());
    let start = now();
    let mut memory = Vec::new();
    let (mut sent, mut heard, mut gaps) = (0, 0, 0);
    let mut last: Option<Stamp> = None;
    while now().seconds_since(start) < seconds {
        std::thread::sleep(Duration::from_secs(1));
        memory.push(resident(stand.node.id()));
        sent += stand.unit.take_sent().len();
        let messages = with_heard(|h| std::mem::take(&mut h.imu));
        heard += messages.len();
        for (_, message) in messages {
            let stamp = convert::stamp(&message.header.stamp);
            gaps += usize::from(last.is_some_and(|l| stamp.seconds_since(l) > 0.004));
            last = Some(stamp);
        }
    }
    std::thread::sleep(Duration::from_secs(2));
    let value = |h: &Heard, key: &str| {
        let unit =
            h.diagnostics.iter().flat_map(|d| &d.status).rfind(|s| s.name == "imu_driver: unit").unwrap();
        unit.values.iter().find(|v| v.key == key).unwrap().value.clone()
    };
    let [lost, checksums, connections, samples] = with_heard(|h| {
        ["lost samples", "checksum errors", "connections", "samples"].map(|key| value(h, key))
    });
    let settled = memory.len() / 5;
    let (early, late) = (memory[settled], memory[memory.len() - 1]);
    println!(
        "{seconds:.0} s at 400 Hz: {sent} samples sent, {samples} taken in all, {lost} lost by the counter, {checksums} checksum \
         errors, {heard} heard over DDS (best effort) with {gaps} gaps; resident {early} KiB after {settled} s, {late} KiB at the end"
    );
    assert_eq!((lost.as_str(), checksums.as_str(), connections.as_str()), ("0", "0", "1"));
    assert!(late < early + 2048, "{early} {late}");
}
