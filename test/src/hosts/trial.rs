//! Runs of the live rig on two computers with an impaired link or a failing side, and the resulting
//! pose errors.

use super::{Hosts, Impairment};
use crate::{
    accuracy::Errors,
    faults::outcome,
    live::{ClockError, Host, ImageSequence, Node, Run, Scenario, Site},
    report::Measured,
};
use anyhow::Result;
use node_kit::environment::Network;
use rig_model::Stamp;
use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

/// Length of a run, s.
pub const LENGTH: f64 = 13.0;
/// When a cut or the restart of a side begins, and the longest that it lasts, s.
const WINDOW: [f64; 2] = [3.0, 8.0];
/// How long a side that is restarted is gone, s.
const GONE: f64 = 1.0;

/// Rigs per link whose errors are compared. The error of one run is mostly due to its clock offsets
/// and constant marker errors: 0.25 to 0.5 mm.
pub const COMPARED: usize = 5;

/// A rig that swings, and what its camera sees.
pub struct Swing {
    scenario: Scenario,
    images: Arc<ImageSequence>,
}

impl Swing {
    /// The rig of this seed, no marker covered.
    pub fn new(seed: u64) -> Result<Self> {
        let mut scenario = Scenario::swing(seed, LENGTH)?;
        scenario.covers.clear();
        let images = Arc::new(ImageSequence::of(&scenario)?);
        Ok(Self { scenario, images })
    }
}

pub struct Place<'a> {
    pub hosts: &'a Hosts,
    pub network: &'a Network,
    /// For the nodes' logs.
    pub folder: PathBuf,
}

/// What happens to the link or to a side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trouble {
    /// The link is so from the start on.
    Link(Impairment),
    /// The link is cut for 5 s.
    Cut,
    /// The nodes of one computer are killed as by `kill -9`, and started again 1 s later.
    Restart(Host),
    /// The clock of the climber's computer is off.
    Clock(ClockError),
}

#[derive(Clone, Debug)]
pub struct Trial {
    pub name: &'static str,
    pub trouble: Trouble,
    /// The odometry must come with every IMU sample, all the time.
    pub unbroken: bool,
    /// Largest ratio of the position RMSE to that of the clean link.
    pub at_most: Option<f64>,
    /// Number of rigs whose errors are averaged, so that a comparison does not depend on one rig.
    pub rigs: usize,
    /// Largest time from the end of the trouble until fused poses are back, s.
    pub back_within: Option<f64>,
}

/// Every trial; the first one is the clean link that others are compared with.
pub fn trials() -> Vec<Trial> {
    let link = |name, impairment| Trial {
        name,
        trouble: Trouble::Link(impairment),
        unbroken: true,
        at_most: None,
        rigs: 1,
        back_within: None,
    };
    let clean = Impairment::default();
    let ending = |name, trouble| Trial { trouble, back_within: Some(2.0), ..link(name, clean) };
    let lossy = |loss| Impairment { loss, ..clean };
    let far = Impairment { delay: 0.05, spread: 0.02, ..clean };
    vec![
        Trial { rigs: COMPARED, ..link("clean", clean) },
        link("1 % lost", lossy(0.01)),
        link("5 % lost", lossy(0.05)),
        link("20 % lost", lossy(0.2)),
        link("50 ± 20 ms delay", far),
        link("3 of 10 frames overtaken", Impairment { reordered: 0.3, ..clean }),
        Trial {
            at_most: Some(1.3),
            rigs: COMPARED,
            ..link("5 % lost and 50 ± 20 ms delay", Impairment { loss: 0.05, ..far })
        },
        ending("cut for 5 s", Trouble::Cut),
        ending("climber's side killed, started 1 s later", Trouble::Restart(Host::Climber)),
        Trial {
            unbroken: false,
            ..ending("platform's side killed, started 1 s later", Trouble::Restart(Host::Platform))
        },
        Trial {
            trouble: Trouble::Clock(ClockError { offset: 0.02, ppm: 50.0 }),
            ..link("climber's clock 20 ms ahead and 50 ppm fast", clean)
        },
    ]
}

#[derive(Clone, Debug)]
pub struct Seen {
    /// From the start of the nodes to the first pose, s.
    pub first_pose: f64,
    /// Position error, mm (root of the mean square, after the first second).
    pub position: f64,
    /// Rotation error, degrees (the same).
    pub rotation: f64,
    /// Odometry per IMU sample that was due.
    pub rate: f64,
    /// Longest time without odometry, s.
    pub longest_gap: f64,
    /// From the trouble's end until the pose was back to stay, s.
    pub back_after: Option<f64>,
    /// Frames and share of them that the link lost.
    pub frames: [f64; 2],
    pub failures: Vec<String>,
}

impl Seen {
    /// Of several runs: errors as the root of their mean square, of all else the worst.
    fn of(runs: &[Self]) -> Self {
        let count = runs.len().max(1) as f64;
        let mean = |of: fn(&Self) -> f64| runs.iter().map(of).sum::<f64>() / count;
        let worst = |of: fn(&Self) -> f64| runs.iter().map(of).fold(0.0, f64::max);
        let frames = mean(|s| s.frames[0]);
        Self {
            first_pose: worst(|s| s.first_pose),
            position: mean(|s| s.position.powi(2)).sqrt(),
            rotation: mean(|s| s.rotation.powi(2)).sqrt(),
            rate: runs.iter().map(|s| s.rate).fold(f64::INFINITY, f64::min),
            longest_gap: worst(|s| s.longest_gap),
            back_after: runs.iter().filter_map(|s| s.back_after).reduce(f64::max),
            frames: [frames, mean(|s| s.frames[0] * s.frames[1]) / frames.max(1.0)],
            failures: runs.iter().flat_map(|s| s.failures.iter().cloned()).collect(),
        }
    }
}

impl Trial {
    /// Runs it with its number of rigs. `clean` is the position error over the clean link, mm.
    pub fn run(&self, swings: &[Swing], place: &Place<'_>, clean: Option<f64>) -> Result<Seen> {
        let mut seen = Vec::with_capacity(self.rigs);
        for (i, swing) in swings.iter().take(self.rigs).enumerate() {
            seen.push(self.once(swing, place, &place.folder.join(format!("rig{i}")))?);
        }
        let mut seen = Seen::of(&seen);
        if let (Some(most), Some(clean)) = (self.at_most, clean)
            && seen.position > most * clean
        {
            seen.failures
                .push(format!("{:.2} times the clean link's error", seen.position / clean));
        }
        Ok(seen)
    }

    #[allow(clippy::disallowed_methods, reason = "it measures how long a start takes")]
    fn once(&self, swing: &Swing, place: &Place<'_>, folder: &Path) -> Result<Seen> {
        let (Swing { scenario, images }, Place { hosts, network, .. }) = (swing, place);
        use std::sync::atomic::Ordering::Relaxed;
        let mut site = Site { hosts: Some(hosts.namespaces().clone()), ..Site::here(network) };
        hosts.link.set(Impairment::default());
        match self.trouble {
            Trouble::Link(impairment) => hosts.link.set(impairment),
            Trouble::Clock(error) => site.climber_clock = error,
            Trouble::Cut | Trouble::Restart(_) => {}
        }
        let traffic = hosts.link.traffic();
        let before = [traffic.frames.load(Relaxed), traffic.lost.load(Relaxed)];
        let started = std::time::Instant::now();
        let mut run = Run::start(scenario, Arc::clone(images), &site, folder)?;
        run.wait_for_pose(30.0)?;
        let first_pose = started.elapsed().as_secs_f64();
        let epoch = run.begin();
        let over = self.play(&mut run, hosts, LENGTH - 0.2)?;
        let ended = run.finish()?;
        hosts.link.set(Impairment::default());

        let at = |t: f64| epoch.plus_seconds(t);
        let truth = |s: Stamp| scenario.motion.world_from_volant(s.seconds_since(epoch));
        let received = &ended.received;
        let fused = received.fused();
        let end = at(LENGTH - 0.4);
        let errors = Errors::of(&fused, at(1.0), end, truth);
        let (rate, longest_gap) = outcome::flow(&fused, at(1.0), end);
        let back_after = over.map(|over| {
            outcome::back(&fused, at(over), end, truth)
                .map_or(f64::INFINITY, |s| s.seconds_since(at(over)))
        });
        let mut failures = Vec::new();
        if self.unbroken && (rate < 0.97 || longest_gap > 0.06) {
            failures.push(format!(
                "the odometry broke: {:.1} %, a gap of {:.0} ms",
                rate * 1e2,
                longest_gap * 1e3
            ));
        }
        if let (Some(within), Some(back)) = (self.back_within, back_after)
            && back > within
        {
            failures.push(format!("back after {back:.2} s instead of {within}"));
        }
        failures.extend(outcome::not_a_number(received));
        failures.extend(outcome::contradicted(received, at(0.5), end, truth));
        let killed = match self.trouble {
            Trouble::Restart(host) => Some(host),
            _ => None,
        };
        let ends = outcome::ends(&ended, folder);
        failures
            .extend(ends.into_iter().filter(|line| killed.is_none() || line.contains("panicked")));
        let count = |i: usize, now: u64| (now - before[i]) as f64;
        let frames = count(0, traffic.frames.load(Relaxed));
        let lost = count(1, traffic.lost.load(Relaxed));
        Ok(Seen {
            first_pose,
            position: errors.position_rmse,
            rotation: errors.rotation_rmse,
            rate,
            longest_gap,
            back_after,
            frames: [frames, lost / frames.max(1.0)],
            failures,
        })
    }

    /// Plays until `end`; when the trouble is over, s, where it has an end.
    fn play(&self, run: &mut Run, hosts: &Hosts, end: f64) -> Result<Option<f64>> {
        let over = match self.trouble {
            Trouble::Link(_) | Trouble::Clock(_) => None,
            Trouble::Cut => {
                run.play_until(WINDOW[0], |_, _| {})?;
                hosts.link.set(Impairment { cut: true, ..Impairment::default() });
                run.play_until(WINDOW[1], |_, _| {})?;
                hosts.link.set(Impairment::default());
                Some(run.hardware.seconds())
            }
            Trouble::Restart(host) => {
                run.play_until(WINDOW[0], |_, _| {})?;
                let on_host = |node: &&mut Node| Host::of(&node.name) == host;
                run.nodes.0.iter_mut().filter(on_host).try_for_each(Node::kill)?;
                run.wait_until(WINDOW[0] + GONE);
                run.nodes.0.iter_mut().filter(on_host).try_for_each(Node::restart)?;
                Some(run.hardware.seconds())
            }
        };
        run.play_until(end, |_, _| {})?;
        Ok(over)
    }
}

/// Column titles of the results.
pub const COLUMNS: &str = "between the hosts | first pose after | position, rotation RMSE | \
                           odometry | back after | frames, lost | verdict";

impl From<Seen> for Measured {
    fn from(s: Seen) -> Self {
        let back = match s.back_after {
            None => "–".to_owned(),
            Some(t) if t.is_finite() => format!("{t:.2} s"),
            Some(_) => "not".to_owned(),
        };
        let cells = vec![
            format!("{:.2} s", s.first_pose),
            format!("{:.2} mm, {:.3}°", s.position, s.rotation),
            format!("{:.1} %, longest gap {:.0} ms", s.rate * 100.0, s.longest_gap * 1e3),
            back,
            format!("{:.0}, {:.1} %", s.frames[0], s.frames[1] * 100.0),
        ];
        Self { cells, remark: format!(" ({:.2} mm)", s.position), failures: s.failures }
    }
}
