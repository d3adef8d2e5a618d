//! The long run: laps of a live rig with faults at random from a seed; memory and threads must stay
//! flat, nothing may panic, no number may be none, and the covariance must stay true.
//!
//! [`Plan`] draws which row of the fault table comes when; [`live`] runs it in real time on the
//! four processes.

pub mod live;
mod memory;

pub use memory::{Instance, Instances};

use rig_simulator::random::Random;

/// One fault of the long run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Planned {
    /// Which one, of those that there are.
    pub which: usize,
    /// Time from the end of the one before to its beginning, s.
    pub calm: f64,
    /// Duration, s.
    pub lasts: f64,
}

/// Draws faults from a seed.
#[derive(Clone, Debug)]
pub struct Plan {
    random: Random,
    count: usize,
}

impl Plan {
    /// A plan over `count` faults.
    pub fn new(seed: u64, count: usize) -> Self {
        Self { random: Random::fork(seed, "long run"), count: count.max(1) }
    }
}

impl Iterator for Plan {
    type Item = Planned;

    fn next(&mut self) -> Option<Planned> {
        let which = (self.random.within(0.0, self.count as f64) as usize).min(self.count - 1);
        Some(Planned {
            which,
            calm: self.random.within(4.0, 9.0),
            lasts: self.random.within(0.5, 4.0),
        })
    }
}

/// Seconds after a fault during which the pose may still be off before it must be back.
pub const BACK_WITHIN: f64 = 3.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_is_a_plan_and_every_fault_comes() {
        let plan = |seed| Plan::new(seed, 7).take(200).collect::<Vec<_>>();
        assert_eq!(plan(1), plan(1));
        assert_ne!(plan(1), plan(2));
        for which in 0..7 {
            assert!(plan(1).iter().any(|p| p.which == which));
        }
        assert!(plan(1).iter().all(|p| p.which < 7 && p.calm >= 4.0 && p.lasts <= 4.0));
    }
}
