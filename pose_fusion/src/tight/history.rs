//! What was measured, in the order of its own time, with the state after each of it.
//!
//! A late measurement goes to its place, and everything behind is run again from there. The memory is bounded: at most
//! [`CAPACITY`] entries of about 7.5 kB (1.9 MB) for each filter, in a store that grows to what the configured length asks for
//! (0.6 s at 100 Hz, 50 Hz and 30 Hz: 108 entries, 0.8 MB) and is never given back. Besides it a filter remembers 64 stamps,
//! readings and attitudes. As many as 23 filters run side by side until the camera's clock is known, one afterwards.

use super::{
    climber::Reading,
    markers::Sighting,
    propagate::{Felt, Process},
    state::State,
};
use nalgebra::Vector3;
use rig_model::Stamp;
use std::collections::VecDeque;

/// Largest number of entries.
pub const CAPACITY: usize = 256;

/// What happened at an instant.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The state was set (start, reset by hand).
    Set,
    /// An inertial sample.
    Imu {
        /// The unit stood still over the last half second.
        still: Option<Vector3<f64>>,
    },
    /// An image.
    Markers {
        /// What it shows.
        sighting: Sighting,
        /// Its own stamp.
        image: Stamp,
        /// It was not run yet: its record is still to be said.
        fresh: bool,
    },
    /// The climber.
    Climber(Reading),
}

/// An event with what the unit felt and the state after it.
#[derive(Clone, Debug)]
pub struct Node {
    /// When, on the inertial unit's clock.
    pub stamp: Stamp,
    /// What.
    pub event: Event,
    /// What the unit felt then; interpolated unless it is an inertial sample.
    pub felt: Felt,
    /// What drove the state on the way here; only where it was run.
    pub process: Process,
    /// The state after the event; only where it was run.
    pub state: State,
}

/// The events in order of time, from a fixed store.
#[derive(Clone, Debug)]
pub struct History {
    store: Vec<Node>,
    free: Vec<usize>,
    order: VecDeque<usize>,
    /// So many of the first entries hold a valid state.
    run: usize,
}

impl Default for History {
    fn default() -> Self {
        // The store grows to what the configured length asks for, and stays.
        Self { store: Vec::new(), free: Vec::new(), order: VecDeque::with_capacity(CAPACITY), run: 0 }
    }
}

impl History {
    /// Every entry that was run goes through `change`.
    pub fn each_node(&mut self, mut change: impl FnMut(&mut Node)) {
        for &slot in self.order.iter().take(self.run) {
            if let Some(node) = self.store.get_mut(slot) {
                change(node);
            }
        }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.free.extend(self.order.drain(..));
        self.run = 0;
    }

    /// How many entries there are.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// Is there none?
    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// So many of the first entries hold a valid state.
    pub fn run(&self) -> usize {
        self.run
    }

    /// Sets how many of the first entries hold a valid state.
    pub fn set_run(&mut self, run: usize) {
        self.run = run.min(self.order.len());
    }

    /// The entry at a place.
    pub fn get(&self, place: usize) -> Option<&Node> {
        self.order.get(place).and_then(|&i| self.store.get(i))
    }

    /// The entry at a place, to be changed.
    pub fn get_mut(&mut self, place: usize) -> Option<&mut Node> {
        self.order.get(place).and_then(|&i| self.store.get_mut(i))
    }

    /// Where an event of this stamp goes: behind all that are not later.
    pub fn place_of(&self, stamp: Stamp) -> usize {
        let mut place = self.order.len();
        while place > 0 && self.get(place - 1).is_some_and(|n| n.stamp > stamp) {
            place -= 1;
        }
        place
    }

    /// Puts an event in its place, dropping the oldest where the store is full; everything from there on must be run
    /// (again). Returns the place.
    pub fn insert(&mut self, stamp: Stamp, event: Event, felt: Felt) -> usize {
        if self.free.is_empty() {
            if self.store.len() < CAPACITY {
                self.free.push(self.store.len());
                self.store.push(Node {
                    stamp,
                    event: Event::Set,
                    felt,
                    process: Process::default(),
                    state: State::zero(),
                });
            } else {
                self.drop_first();
            }
        }
        let place = self.place_of(stamp);
        if let Some(slot) = self.free.pop() {
            if let Some(node) = self.store.get_mut(slot) {
                node.stamp = stamp;
                node.event = event;
                node.felt = felt;
            }
            self.order.insert(place, slot);
            self.run = self.run.min(place);
        }
        place
    }

    /// Drops the oldest entry.
    pub fn drop_first(&mut self) {
        if let Some(slot) = self.order.pop_front() {
            self.free.push(slot);
            self.run = self.run.saturating_sub(1);
        }
    }

    /// The state after the entry at `place - 1` and the entry at `place`, for a step from one to the other.
    pub fn step(&mut self, place: usize) -> Option<(&Node, &mut Node)> {
        let from = *self.order.get(place.checked_sub(1)?)?;
        let to = *self.order.get(place)?;
        let [from, to] = self.store.get_disjoint_mut([from, to]).ok()?;
        Some((from, to))
    }

    /// Place and stamp of the reading of the climber that is the `count`-th before a place; of the oldest where there are fewer.
    pub fn reading_before(&self, place: usize, count: usize) -> Option<(usize, Stamp)> {
        (0..place)
            .rev()
            .filter_map(|p| self.get(p).map(|node| (p, node)))
            .filter(|(_, node)| matches!(node.event, Event::Climber(_)))
            .take(count)
            .last()
            .map(|(p, node)| (p, node.stamp))
    }

    /// The next inertial sample at or behind a place.
    pub fn next_imu(&self, place: usize) -> Option<&Node> {
        (place..self.order.len()).filter_map(|i| self.get(i)).find(|n| matches!(n.event, Event::Imu { .. }))
    }
}
