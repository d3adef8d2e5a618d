//! Memory and threads of processes; a process that was killed and restarted is a new instance.

use crate::live::Nodes;
use std::collections::{BTreeMap, VecDeque};

/// One process from its start to its end.
#[derive(Clone, Debug, PartialEq)]
pub struct Instance {
    pub node: String,
    pub id: u32,
    /// When it was first seen, s of the run.
    pub since: f64,
    /// When it was last seen, s of the run.
    pub until: f64,
    /// Resident memory at the end of its first minute, bytes.
    pub settled: Option<u64>,
    /// Resident memory a minute after the start or after another node was killed, whichever came
    /// later, bytes; and when that was, s of the run. A reliable publisher keeps its samples for a
    /// killed reader until that one's lease is over, and the memory for them from then on.
    pub undisturbed: Option<(f64, u64)>,
    /// Resident memory at last, bytes.
    pub last: u64,
    /// Most threads in the first minute, and most in the last one.
    pub threads: [usize; 2],
    /// Threads as they were counted since a minute ago at least: when, and how many.
    recent: VecDeque<(f64, usize)>,
}

/// What counts as the first minute, s.
const FIRST_MINUTE: f64 = 60.0;

impl Instance {
    /// Growth of the memory after the first minute, bytes; `None` for instances that were shorter
    /// than two.
    pub fn growth(&self) -> Option<i64> {
        (self.until - self.since >= 2.0 * FIRST_MINUTE)
            .then(|| self.settled.map(|settled| self.last as i64 - settled as i64))
            .flatten()
    }

    /// Growth of the memory since a minute after the last kill, bytes; `None` where less than a
    /// minute was left.
    pub fn undisturbed_growth(&self) -> Option<i64> {
        let (at, bytes) = self.undisturbed?;
        (self.until - at >= FIRST_MINUTE).then(|| self.last as i64 - bytes as i64)
    }
}

#[derive(Clone, Debug, Default)]
pub struct Instances {
    instances: BTreeMap<u32, Instance>,
    last_kill: f64,
}

impl Instances {
    pub fn sample(&mut self, nodes: &Nodes, now: f64) {
        for node in &nodes.0 {
            self.note(&node.name, node.id(), node.resident_bytes(), node.threads(), now);
        }
    }

    fn note(&mut self, node: &str, id: u32, bytes: u64, threads: usize, now: f64) {
        // A process that has ended has no figures.
        if bytes == 0 {
            return;
        }
        let instance = self.instances.entry(id).or_insert_with(|| Instance {
            node: node.to_owned(),
            id,
            since: now,
            until: now,
            settled: None,
            undisturbed: None,
            last: bytes,
            threads: [0, threads],
            recent: VecDeque::new(),
        });
        (instance.until, instance.last) = (now, bytes);
        instance.recent.push_back((now, threads));
        while instance.recent.front().is_some_and(|(at, _)| now - at > FIRST_MINUTE) {
            instance.recent.pop_front();
        }
        instance.threads[1] = instance.recent.iter().map(|(_, count)| *count).max().unwrap_or(0);
        if now - instance.since < FIRST_MINUTE {
            instance.threads[0] = instance.threads[0].max(threads);
        } else {
            instance.settled.get_or_insert(bytes);
        }
        if now - instance.since.max(self.last_kill) >= FIRST_MINUTE {
            instance.undisturbed.get_or_insert((now, bytes));
        }
    }

    pub fn killed(&mut self, now: f64) {
        self.last_kill = now;
        self.instances.values_mut().for_each(|instance| instance.undisturbed = None);
    }

    pub fn iter(&self) -> impl Iterator<Item = &Instance> {
        self.instances.values()
    }

    /// Instance whose memory grew most after its first minute, and its growth, bytes.
    pub fn worst(&self) -> Option<(&Instance, i64)> {
        self.most(Instance::growth)
    }

    /// Instance whose memory grew most while no node was killed, and its growth, bytes.
    pub fn worst_undisturbed(&self) -> Option<(&Instance, i64)> {
        self.most(Instance::undisturbed_growth)
    }

    fn most(&self, growth: impl Fn(&Instance) -> Option<i64>) -> Option<(&Instance, i64)> {
        self.iter().filter_map(|l| Some((l, growth(l)?))).max_by_key(|(_, growth)| *growth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_counts_from_the_end_of_the_first_minute_of_each_instance() {
        let mut instances = Instances::default();
        for t in 0..300 {
            let bytes = if t < 50 { 1_000 * t } else { 50_000 + (t - 50) * 10 };
            instances.note("a", 1, bytes + 1, 9, t as f64);
            instances.note("b", 2 + (t / 100) as u32, 7, 3, t as f64);
        }
        instances.note("a", 1, 0, 0, 301.0);
        let (instance, growth) = instances.worst().unwrap();
        assert_eq!((instance.node.as_str(), growth), ("a", 239 * 10));
        assert!(instances.iter().filter(|l| l.node == "b").all(|l| l.growth().is_none()));
    }

    #[test]
    fn samples_for_a_killed_reader_are_no_leak() {
        let mut instances = Instances::default();
        for t in 0..400_u64 {
            if t == 150 {
                instances.killed(150.0);
            }
            instances.note("a", 1, 1000 + if t < 150 { 0 } else { 500 }, 9, t as f64);
        }
        assert_eq!(instances.worst().unwrap().1, 500);
        assert_eq!(instances.worst_undisturbed().unwrap().1, 0);
    }
}
