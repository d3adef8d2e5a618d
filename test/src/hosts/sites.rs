//! Several rigs and an operator on two sites: a DDS domain each, Zenoh bridges with the product's
//! configurations, and an impaired link between the sites.

use super::{Hosts, Impairment};
use crate::live::{Node, processes::executables, quantile};
use anyhow::{Result, ensure};
use bag::recording::map_messages;
use std::{
    path::Path,
    process::Command,
    sync::atomic::Ordering::Relaxed,
    time::{Duration, SystemTime, UNIX_EPOCH},
};
use volant::report::Table;
use volant_msgs::nav_msgs::msg::Odometry;

/// Domains: the operator's, and the first rig's.
const DOMAINS: [u16; 2] = [90, 91];
/// Address of the operator's site and Zenoh's port.
const OPERATOR: &str = "tcp/10.77.0.2:7447";
/// Length of a row, and what is left out at its start, s.
const ROW: f64 = 12.0;
const SETTLE: f64 = 2.0;
/// Rate of the odometry across the link (`bridge_rig.json5`), Hz.
const RATE: f64 = 10.0;
/// By how much the rigs swing longer, because one may be ready before the other, s.
const SPARE: f64 = 25.0;
/// Longest time for the rigs' images to be drawn.
const DRAWING: Duration = Duration::from_secs(600);
/// Time for a process to end: a rig that is killed would leave its nodes, a recorder an incomplete
/// bag.
const GRACE: Duration = Duration::from_secs(10);

pub struct Trial<'a> {
    pub hosts: &'a Hosts,
    /// The executable `zenoh-bridge-ros2dds`.
    pub bridge: &'a Path,
    /// Folder with `bridge_rig.json5` and `bridge_operator.json5`.
    pub config: &'a Path,
    /// For logs and bags.
    pub folder: &'a Path,
    pub rigs: usize,
    pub seed: u64,
}

/// State of the link by row; the first is the clean link.
pub fn rows() -> [(&'static str, Impairment); 7] {
    let clean = Impairment::default();
    let far = Impairment { delay: 0.05, spread: 0.02, ..clean };
    [
        ("clean", clean),
        ("1 % lost", Impairment { loss: 0.01, ..clean }),
        ("5 % lost", Impairment { loss: 0.05, ..clean }),
        ("50 ± 20 ms delay", far),
        ("5 % lost and 50 ± 20 ms delay", Impairment { loss: 0.05, ..far }),
        ("cut", Impairment { cut: true, ..clean }),
        ("clean again", clean),
    ]
}

/// A span of the system's time with one state of the link.
struct Span {
    name: &'static str,
    /// s since the epoch.
    from: f64,
    to: f64,
    bytes: u64,
}

/// Odometry of one rig at one place: stamp and reception, s since the epoch.
type Received = Vec<[f64; 2]>;

/// One row of the table, over all rigs.
#[derive(Clone, Debug)]
pub struct Row {
    /// State of the link.
    pub name: &'static str,
    /// Messages at the operator's site over those due.
    pub share: f64,
    /// From stamp to reception at the operator's site, median and p99, s.
    pub latency: [f64; 2],
    /// The same at the rig's site.
    pub at_rig: [f64; 2],
    /// Both directions, bytes/s of Ethernet frames.
    pub bytes_per_second: f64,
    /// Longest time without a message of a rig, s.
    pub longest_gap: f64,
}

/// Fails if a process has ended.
fn check(process: &mut Node) -> Result<()> {
    ensure!(process.ended().is_none(), "a process ended too early, see {}", process.log.display());
    Ok(())
}

impl Trial<'_> {
    fn command(&self, site: &str, domain: u16, program: &Path) -> Command {
        let mut command = Command::new("ip");
        command
            .args(["netns", "exec", site])
            .arg(program)
            .env("ROS_DOMAIN_ID", domain.to_string())
            .env("ROS_DISTRO", "jazzy")
            // DDS stays within the site: the link carries the bridges' connection only.
            .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
        command
    }

    fn start(&self, name: &str, command: Command) -> Result<Node> {
        Node::spawn(name, command, self.folder, GRACE)
    }

    /// Records topics in the bag of a name.
    fn record(&self, site: &str, domain: u16, name: &str, topics: &[String]) -> Result<Node> {
        let mut command = self.command(site, domain, &executables().join("volant"));
        command.arg("record").arg("-o").arg(self.folder.join(name)).args(topics);
        self.start(name, command)
    }

    /// Runs all rows one after the other.
    pub fn run(&self) -> Result<Vec<Row>> {
        let [rig_site, operator_site] =
            [&self.hosts.namespaces().climber, &self.hosts.namespaces().platform];
        let mut running = vec![];
        let mut command = self.command(operator_site, DOMAINS[0], self.bridge);
        command.arg("-c").arg(self.config.join("bridge_operator.json5"));
        command.args(["-d", &DOMAINS[0].to_string(), "-l", OPERATOR]);
        running.push(self.start("bridge_operator", command)?);
        let mut recorders = vec![];
        let odometry = |name: &str| format!("{name}/volant/odometry");
        let names: Vec<String> = (1..=self.rigs).map(|i| format!("/rig{i}")).collect();
        let topics: Vec<String> = names.iter().map(|n| odometry(n)).collect();
        recorders.push(self.record(operator_site, DOMAINS[0], "operator", &topics)?);
        let mut demos = vec![];
        for (i, name) in (0u16..).zip(&names) {
            let domain = DOMAINS[1] + i;
            let mut command = self.command(rig_site, domain, self.bridge);
            command.arg("-c").arg(self.config.join("bridge_rig.json5")).args(["-n", name]);
            command.args(["-d", &domain.to_string(), "-e", OPERATOR]);
            running.push(self.start(&format!("bridge_rig{i}"), command)?);
            recorders.push(self.record(rig_site, domain, &format!("rig{i}"), &[odometry("")])?);
            demos.push(self.start_rig(rig_site, domain, i)?);
        }
        demos.iter_mut().try_for_each(wait_for_rig)?;
        let spans = self.go_through_rows();
        let all = recorders.iter_mut().chain(&mut demos).chain(&mut running);
        all.into_iter().try_for_each(check)?;
        // The recorders first, so that they see no end of the rigs.
        drop((recorders, demos, running));
        let mut received = vec![];
        for (i, topic) in topics.iter().enumerate() {
            let rig = read(&self.folder.join(format!("rig{i}")), &odometry(""))?;
            received.push([read(&self.folder.join("operator"), topic)?, rig]);
        }
        Ok(spans.iter().map(|span| row(span, &received)).collect())
    }

    /// Starts a rig that swings for as long as all rows take.
    fn start_rig(&self, site: &str, domain: u16, number: u16) -> Result<Node> {
        let name = format!("demo{number}");
        let mut command = self.command(site, domain, &executables().join("volant-rig"));
        command
            .arg("demo")
            .args(["--seconds", &(ROW * rows().len() as f64 + SPARE).to_string()])
            .args(["--seed", &(self.seed + u64::from(number)).to_string()])
            .arg("--out")
            .arg(self.folder.join(&name));
        self.start(&name, command)
    }

    fn go_through_rows(&self) -> Vec<Span> {
        let traffic = self.hosts.link.traffic();
        let spans = rows().map(|(name, impairment)| {
            self.hosts.link.set(impairment);
            std::thread::sleep(Duration::from_secs_f64(SETTLE));
            let (from, before) = (system_seconds(), traffic.bytes.load(Relaxed));
            std::thread::sleep(Duration::from_secs_f64(ROW - SETTLE));
            Span { name, from, to: system_seconds(), bytes: traffic.bytes.load(Relaxed) - before }
        });
        self.hosts.link.set(Impairment::default());
        spans.into()
    }
}

/// Waits until the nodes of a rig run: its images are drawn before.
#[allow(clippy::disallowed_methods, reason = "it waits for another process")]
fn wait_for_rig(rig: &mut Node) -> Result<()> {
    let deadline = std::time::Instant::now() + DRAWING;
    while !std::fs::read_to_string(&rig.log)?.contains("four nodes") {
        check(rig)?;
        ensure!(std::time::Instant::now() < deadline, "{}: no rig", rig.log.display());
        std::thread::sleep(Duration::from_millis(100));
    }
    Ok(())
}

#[allow(clippy::disallowed_methods, reason = "it is compared with stamps of other processes")]
fn system_seconds() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64()
}

fn read(bag: &Path, topic: &str) -> Result<Received> {
    Ok(map_messages(bag, topic, |log_time, odometry: Odometry| {
        let stamp = odometry.header.stamp;
        [f64::from(stamp.sec) + f64::from(stamp.nanosec) * 1e-9, log_time as f64 * 1e-9]
    })?)
}

/// Figures of one span; `received` has each rig at the operator's site and at its own.
fn row(span: &Span, received: &[[Received; 2]]) -> Row {
    let within = |all: &Received| -> Received {
        all.iter().filter(|m| (span.from..span.to).contains(&m[1])).copied().collect()
    };
    let latency = |place: usize| {
        let all: Vec<f64> =
            received.iter().flat_map(|r| within(&r[place])).map(|[stamp, at]| at - stamp).collect();
        [quantile(&all, 0.5), quantile(&all, 0.99)]
    };
    let length = span.to - span.from;
    let (mut count, mut longest_gap) = (0, 0.0_f64);
    for [at_operator, _] in received {
        let mut before = span.from;
        for [_, at] in within(at_operator).into_iter().chain([[span.to; 2]]) {
            longest_gap = longest_gap.max(at - before);
            before = at;
        }
        count += within(at_operator).len();
    }
    Row {
        name: span.name,
        share: count as f64 / (RATE * length * received.len() as f64),
        latency: latency(0),
        at_rig: latency(1),
        bytes_per_second: span.bytes as f64 / length,
        longest_gap,
    }
}

pub fn markdown(rows: &[Row]) -> String {
    let head = "link | odometry of those due | stamp to operator, median / p99 | at the rig | \
                longest gap | both ways";
    let ms = |[median, p99]: [f64; 2]| match median.is_nan() {
        true => "–".to_owned(),
        false => format!("{:.1} / {:.1} ms", median * 1e3, p99 * 1e3),
    };
    let cells = |row: &Row| {
        [
            row.name.to_owned(),
            format!("{:.0} %", row.share * 1e2),
            ms(row.latency),
            ms(row.at_rig),
            format!("{:.2} s", row.longest_gap),
            format!("{:.1} kB/s", row.bytes_per_second * 1e-3),
        ]
    };
    Table::new(head, rows.iter().map(cells)).to_markdown()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_counts_what_arrives_within_it() {
        let span = Span { name: "x", from: 10.0, to: 12.0, bytes: 5000 };
        // 10 Hz, 20 ms old; from 11 s on nothing comes.
        let operator: Received =
            (0..20).map(|i| [9.0 + f64::from(i) * 0.1, 9.02 + f64::from(i) * 0.1]).collect();
        let row = row(&span, &[[operator, vec![]]]);
        assert!((row.share - 0.5).abs() < 0.06, "{row:?}");
        assert!((row.latency[0] - 0.02).abs() < 1e-9);
        assert!((row.longest_gap - 1.08).abs() < 1e-6, "{row:?}");
        assert_eq!(row.bytes_per_second, 2500.0);
        let text = markdown(&[row]);
        assert!(text.contains("20.0 / 20.0 ms") && text.contains("| – |"), "{text}");
    }
}
