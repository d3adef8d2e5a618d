//! How memory and threads of processes go, life by life: a process that was killed and started again begins a new one.

use crate::live::Nodes;
use std::collections::{BTreeMap, VecDeque};

/// One process from its start to its end.
#[derive(Clone, Debug, PartialEq)]
pub struct Life {
    /// The node.
    pub node: String,
    /// Process id.
    pub id: u32,
    /// When it was first seen, s of the run.
    pub since: f64,
    /// When it was last seen, s of the run.
    pub until: f64,
    /// Resident memory at the end of its first minute, bytes.
    pub settled: Option<u64>,
    /// Resident memory at last, bytes.
    pub last: u64,
    /// Most threads in the first minute, and most in the last one.
    pub threads: [usize; 2],
    /// Threads as they were counted since a minute ago at least: when, and how many.
    recent: VecDeque<(f64, usize)>,
}

/// What counts as the first minute, s.
const FIRST_MINUTE: f64 = 60.0;

impl Life {
    /// Growth of the memory after the first minute, bytes; `None` for lives that were shorter than two.
    pub fn growth(&self) -> Option<i64> {
        (self.until - self.since >= 2.0 * FIRST_MINUTE)
            .then(|| self.settled.map(|settled| self.last as i64 - settled as i64))
            .flatten()
    }
}

/// All lives of a run.
#[derive(Clone, Debug, Default)]
pub struct Lives(BTreeMap<u32, Life>);

impl Lives {
    /// Looks at every process.
    pub fn look(&mut self, nodes: &Nodes, now: f64) {
        for node in nodes.iter() {
            self.note(&node.name, node.id(), node.resident_bytes(), node.threads(), now);
        }
    }

    fn note(&mut self, node: &str, id: u32, bytes: u64, threads: usize, now: f64) {
        // Of a process that is gone the system tells nothing.
        if bytes == 0 {
            return;
        }
        let life = self.0.entry(id).or_insert_with(|| Life {
            node: node.to_owned(),
            id,
            since: now,
            until: now,
            settled: None,
            last: bytes,
            threads: [0, threads],
            recent: VecDeque::new(),
        });
        (life.until, life.last) = (now, bytes);
        life.recent.push_back((now, threads));
        while life.recent.front().is_some_and(|(at, _)| now - at > FIRST_MINUTE) {
            life.recent.pop_front();
        }
        life.threads[1] = life.recent.iter().map(|(_, count)| *count).max().unwrap_or(0);
        if now - life.since < FIRST_MINUTE {
            life.threads[0] = life.threads[0].max(threads);
        } else {
            life.settled.get_or_insert(bytes);
        }
    }

    /// Each life.
    pub fn iter(&self) -> impl Iterator<Item = &Life> {
        self.0.values()
    }

    /// The life whose memory grew most after its first minute, and by how much, bytes.
    pub fn worst(&self) -> Option<(&Life, i64)> {
        self.iter().filter_map(|l| Some((l, l.growth()?))).max_by_key(|(_, growth)| *growth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_counts_from_the_end_of_the_first_minute_of_each_life() {
        let mut lives = Lives::default();
        for t in 0..300 {
            let bytes = if t < 50 { 1_000 * t } else { 50_000 + (t - 50) * 10 };
            lives.note("a", 1, bytes + 1, 9, t as f64);
            lives.note("b", 2 + (t / 100) as u32, 7, 3, t as f64);
        }
        lives.note("a", 1, 0, 0, 301.0);
        let (life, growth) = lives.worst().unwrap();
        assert_eq!((life.node.as_str(), growth), ("a", 239 * 10));
        assert!(lives.iter().filter(|l| l.node == "b").all(|l| l.growth().is_none()));
    }
}
