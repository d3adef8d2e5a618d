//! Many rigs on one machine: what one costs, where it ends, and why.
//!
//! Each rig has its own hardware, its own four processes and a ROS namespace; all of them are in
//! one DDS domain or, on request, each in its own. They repeat the same lap.

use crate::{
    accuracy::Errors,
    faults::outcome,
    live::{ImageSequence, NODES, Run, RunError, Scenario, Site, Subscriptions, quantile},
};
use node_kit::environment::Network;
use rig_model::Stamp;
use std::{fmt::Write, path::Path, sync::Arc, time::Duration};

/// How a load is run.
#[derive(Clone, Copy, Debug)]
pub struct LoadConfig {
    /// Until all is in flow, s.
    pub settle: f64,
    /// Duration of the measurement, s.
    pub measure: f64,
    /// Each rig in a DDS domain of its own, from this one on; `None`: all in the one that the
    /// environment names.
    pub first_domain: Option<u16>,
}

/// What was seen of `rigs` rigs.
#[derive(Clone, Debug)]
pub struct Load {
    /// How many.
    pub rigs: usize,
    /// Processor share of each node, in the order of [`NODES`], mean over the rigs (1 = a core).
    pub cpu: [f64; 4],
    /// Processor share of the simulation: all hardware and the listeners.
    pub simulation_cpu: f64,
    /// Share of the machine's cores that is busy.
    pub busy: f64,
    /// Memory of each node of its own (proportional set), mean over the rigs, MiB.
    pub memory: [f64; 4],
    /// Bytes per second and rig on the wire.
    pub wire: f64,
    /// Odometry per IMU sample that was due: of the worst rig.
    pub rate: f64,
    /// From an image's stamp to the odometry that contains it, 50 % and 99 %: of the worst rig, ms.
    pub latency: [f64; 2],
    /// Position RMSE of the worst rig, mm.
    pub position: f64,
    /// From the start of the last rig's processes until every rig fused, s.
    pub start: f64,
    /// Why this many are too many, where they are.
    pub full: Option<String>,
}

/// A rig that is slower than this is one too many.
const LATENCY: f64 = 0.033;

impl Load {
    /// Runs `rigs` rigs with logs in `folder`.
    ///
    /// # Errors
    /// A rig that did not come up; that ends the row of loads too.
    #[allow(clippy::disallowed_methods, reason = "it measures real time")]
    pub fn run(
        rigs: usize,
        scenario: &Scenario,
        images: &Arc<ImageSequence>,
        config: &LoadConfig,
        network: &Network,
        folder: &Path,
    ) -> Result<Self, RunError> {
        let mut runs = Vec::with_capacity(rigs);
        let started = std::time::Instant::now();
        for i in 0..rigs {
            let mut site = Site {
                namespace: format!("/rig{}", i + 1),
                subscriptions: Subscriptions::Few,
                endless: true,
                ..Site::here(network)
            };
            if let Some(first) = config.first_domain {
                site.network.domain_id = first + u16::try_from(i).unwrap_or(0);
            }
            runs.push(Run::start(
                scenario,
                Arc::clone(images),
                &site,
                &folder.join(format!("rig{}", i + 1)),
            )?);
        }
        for run in &mut runs {
            run.wait_for_pose(60.0)?;
        }
        let start = started.elapsed().as_secs_f64();
        let epochs: Vec<Stamp> = runs.iter_mut().map(Run::begin).collect();
        std::thread::sleep(Duration::from_secs_f64(1.0 + config.settle));
        for run in &runs {
            drop(run.hardware.take_received());
        }
        let nodes = |runs: &[Run]| -> Vec<[f64; 4]> {
            let of = |run: &Run| {
                let mut seconds = [0.0; 4];
                for node in run.nodes.iter() {
                    if let Some(i) = NODES.iter().position(|n| *n == node.name) {
                        seconds[i] = node.processor_seconds();
                    }
                }
                seconds
            };
            runs.iter().map(of).collect()
        };
        let before = (nodes(&runs), own_seconds(), busy_seconds(), wire_bytes());
        let began = std::time::Instant::now();
        std::thread::sleep(Duration::from_secs_f64(config.measure));
        let seconds = began.elapsed().as_secs_f64();
        let after = (nodes(&runs), own_seconds(), busy_seconds(), wire_bytes());
        let mean = |i: usize| {
            after.0.iter().zip(&before.0).map(|(a, b)| a[i] - b[i]).sum::<f64>()
                / seconds
                / rigs as f64
        };
        let cores = std::thread::available_parallelism().map_or(1.0, |n| n.get() as f64);
        let mut load = Self {
            rigs,
            cpu: [0, 1, 2, 3].map(mean),
            simulation_cpu: (after.1 - before.1) / seconds,
            busy: (after.2 - before.2) / seconds / cores,
            memory: [0.0; 4],
            wire: (after.3 - before.3) / seconds / rigs as f64,
            rate: f64::INFINITY,
            latency: [0.0; 2],
            position: 0.0,
            start,
            full: None,
        };
        let lap = scenario.duration();
        for (run, epoch) in runs.iter().zip(&epochs) {
            let received = run.hardware.take_received();
            let truth = |s: Stamp| {
                scenario.motion.world_from_volant(s.seconds_since(*epoch).rem_euclid(lap))
            };
            let fused = received.fused();
            let (Some(first), Some(last)) = (fused.first(), fused.last()) else {
                load.rate = 0.0;
                continue;
            };
            load.rate = load.rate.min(fused.len() as f64 / (100.0 * seconds));
            let latencies = received.latencies(first.0, last.0);
            for (worst, share) in load.latency.iter_mut().zip([0.5, 0.99]) {
                *worst = worst.max(quantile(&latencies, share) * 1e3);
            }
            let errors = Errors::of(&fused, first.0, last.0, truth);
            load.position = load.position.max(errors.position_rmse);
            if let Some(reason) = outcome::not_a_number(&received) {
                load.full = Some(reason);
            }
            for node in run.nodes.iter() {
                if let Some(i) = NODES.iter().position(|n| *n == node.name) {
                    load.memory[i] += proportional_mebibytes(node.id()) / rigs as f64;
                }
            }
        }
        load.full = load.full.take().or_else(|| load.reason());
        for run in runs {
            run.finish()?;
        }
        Ok(load)
    }

    fn reason(&self) -> Option<String> {
        let busy = format!("{:.0} % of the processor's time is used", self.busy * 100.0);
        if self.rate < 0.97 {
            Some(format!("{:.0} % of the odometry came; {busy}", self.rate * 100.0))
        } else if self.latency[1].is_nan() || self.latency[1] > LATENCY * 1e3 {
            Some(format!("p99 of the latency is {:.0} ms; {busy}", self.latency[1]))
        } else {
            None
        }
    }
}

/// The table as Markdown.
pub fn markdown(loads: &[Load]) -> String {
    let mut text = format!(
        "| rigs | cores per rig: {} | simulation, cores | processor busy | MiB per rig: the same | \
         wire per rig | odometry (worst rig) | latency p50, p99 (worst) | position RMSE (worst) | \
         all fused after | |\n\
         | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n",
        NODES.join(", ")
    );
    for c in loads {
        let four = |v: [f64; 4], digits: usize| {
            let parts: Vec<String> = v.iter().map(|x| format!("{x:.digits$}")).collect();
            format!("{}; sum {:.digits$}", parts.join(", "), v.iter().sum::<f64>())
        };
        let _ = writeln!(
            text,
            "| {} | {} | {:.2} | {:.0} % | {} | {:.2} MB/s | {:.1} % | {:.1}, {:.1} ms | {:.2} mm \
             | {:.1} s | {} |",
            c.rigs,
            four(c.cpu, 3),
            c.simulation_cpu,
            c.busy * 100.0,
            four(c.memory, 1),
            c.wire / 1e6,
            c.rate * 100.0,
            c.latency[0],
            c.latency[1],
            c.position,
            c.start,
            c.full.as_ref().map_or("holds".to_owned(), |why| format!("**full**: {why}")),
        );
    }
    text
}

fn first_numbers(path: &str, line: impl Fn(&str) -> bool) -> Vec<f64> {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let line = text.lines().find(|l| line(l)).unwrap_or_default();
    line.split_whitespace().filter_map(|w| w.parse().ok()).collect()
}

/// Processor time of this process, s.
fn own_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> =
        stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |i: usize| fields.get(i).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

/// Processor time of the machine that was not idle, s.
fn busy_seconds() -> f64 {
    let numbers = first_numbers("/proc/stat", |l| l.starts_with("cpu "));
    let sum: f64 = numbers.iter().take(8).sum();
    let idle: f64 = numbers.iter().skip(3).take(2).sum();
    (sum - idle) / 100.0
}

/// Bytes that the interfaces of this thread's network namespace have sent.
fn wire_bytes() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/net/dev").unwrap_or_default();
    let sent = |line: &str| {
        let (_, counts) = line.split_once(':')?;
        counts.split_whitespace().nth(8)?.parse::<f64>().ok()
    };
    text.lines().filter_map(sent).sum()
}

/// Proportional set size of a process, MiB: shared memory is divided among its users.
fn proportional_mebibytes(id: u32) -> f64 {
    let path = format!("/proc/{id}/smaps_rollup");
    first_numbers(&path, |l| l.starts_with("Pss:")).first().copied().unwrap_or(0.0) / 1024.0
}
