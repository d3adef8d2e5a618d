//! Inbox of a node: messages and device events in order of arrival, bounded source by source.
//!
//! At most `depth` entries of a source (a topic, a device) wait. One more drops the oldest of the
//! *same* source and is counted, so that a burst of images never costs an IMU sample and a
//! producer never waits.

use crate::parameters::ParameterValue;
use async_channel::Sender;
use parking_lot::{Condvar, Mutex, MutexGuard};
use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
    time::Instant,
};

/// Entry of a node's inbox.
pub(crate) enum Event<I> {
    /// For the shell.
    Input(I),
    /// For the node's runner.
    Control(Control),
}

/// Request that the node's own thread answers.
pub(crate) enum Control {
    /// Sets all of the parameters or none.
    Set { changes: Vec<(String, ParameterValue)>, reply: Sender<Result<(), String>> },
    /// Changes the lifecycle state.
    Transition { id: u8, label: String, reply: Sender<bool> },
    /// Time has moved: due timers run.
    Wake,
}

/// Number of a source of an inbox.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SourceId(usize);

/// What a source of an inbox is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SourceKind {
    /// A topic that the diagnostics report while it is missing.
    Expected,
    /// Another topic, or a device.
    Optional,
    /// Requests of a service. They pass even while the inbox does not accept: a client waits for
    /// the reply.
    Service,
    /// Control of the node itself; passes like a service, and is not among the counts.
    Control,
}

impl SourceKind {
    fn always_passes(self) -> bool {
        matches!(self, Self::Service | Self::Control)
    }
}

/// Counts of a source.
#[derive(Clone, Debug)]
pub struct SourceCount {
    /// The topic's absolute name, or the device's.
    pub name: String,
    /// Entries received since the start.
    pub received: u64,
    /// Entries dropped because the node did not keep up.
    pub dropped: u64,
    /// Messages refused: not decodable, of another type, or unusable.
    pub refused: u64,
    /// Messages lost in transport, by the gaps in the publishers' sequence numbers.
    pub lost: u64,
    /// Time of the latest entry.
    pub latest: Option<Instant>,
    /// What it is.
    pub kind: SourceKind,
    depth: usize,
    queued: usize,
}

struct State<I> {
    queue: VecDeque<(usize, Event<I>)>,
    sources: BTreeMap<usize, SourceCount>,
    /// Number of the next source.
    next: usize,
    closed: bool,
    accepting: bool,
}

impl<I> State<I> {
    /// Takes entries out of the queue by their source. They are dropped outside of the lock,
    /// because that may put in another one.
    fn remove(&mut self, which: impl Fn(usize) -> bool) -> VecDeque<(usize, Event<I>)> {
        let queue = std::mem::take(&mut self.queue);
        let (gone, kept) = queue.into_iter().partition(|(s, _)| which(*s));
        self.queue = kept;
        gone
    }
}

/// Inbox of a node whose inputs are `I`.
pub(crate) struct Inbox<I> {
    state: Mutex<State<I>>,
    ready: Condvar,
}

/// Result of [`Inbox::take`].
pub(crate) enum Taken<I> {
    /// An entry.
    Entry(Event<I>),
    /// The deadline passed without an entry.
    Deadline,
    /// The inbox was closed; its entries are dropped.
    Closed,
}

impl<I> Inbox<I> {
    pub(crate) fn new() -> Arc<Self> {
        let state = State {
            queue: VecDeque::new(),
            sources: BTreeMap::new(),
            next: 0,
            closed: false,
            accepting: true,
        };
        Arc::new(Self { state: Mutex::new(state), ready: Condvar::new() })
    }

    fn lock(&self) -> MutexGuard<'_, State<I>> {
        self.state.lock()
    }

    /// Puts an entry in without waiting. `now` is the time of arrival.
    pub(crate) fn put(&self, SourceId(source): SourceId, entry: Event<I>, now: Instant) {
        let mut state = self.lock();
        let State { queue, sources, accepting, closed, .. } = &mut *state;
        let Some(count) = sources.get_mut(&source).filter(|_| !*closed) else { return };
        count.received += 1;
        count.latest = Some(now);
        if !*accepting && !count.kind.always_passes() {
            return;
        }
        let mut oldest = None;
        if count.queued == count.depth {
            count.dropped += 1;
            count.queued -= 1;
            let position = queue.iter().position(|(s, _)| *s == source);
            oldest = position.and_then(|position| queue.remove(position));
        }
        count.queued += 1;
        queue.push_back((source, entry));
        drop(state);
        // Outside of the lock, because that may put in another one.
        drop(oldest);
        self.ready.notify_one();
    }

    /// Changes the counts of a source, unless it has been retired.
    fn count(&self, SourceId(source): SourceId, change: impl FnOnce(&mut SourceCount)) {
        if let Some(count) = self.lock().sources.get_mut(&source) {
            change(count);
        }
    }

    /// Returns whether the inbox has been closed.
    pub(crate) fn is_closed(&self) -> bool {
        self.lock().closed
    }

    /// Takes the next entry, waiting for it until `deadline`.
    pub(crate) fn take(&self, deadline: Instant) -> Taken<I> {
        let mut state = self.lock();
        loop {
            if state.closed {
                return Taken::Closed;
            }
            if let Some((source, entry)) = state.queue.pop_front() {
                if let Some(count) = state.sources.get_mut(&source) {
                    count.queued -= 1;
                }
                return Taken::Entry(entry);
            }
            if now() >= deadline {
                return Taken::Deadline;
            }
            self.ready.wait_until(&mut state, deadline);
        }
    }
}

/// A node's inbox, whatever its inputs are.
pub(crate) trait Sources: Send + Sync {
    /// Adds a source of which at most `depth` entries wait.
    fn add_source(&self, name: &str, depth: usize, kind: SourceKind) -> SourceId;
    /// Puts in a request for the node's runner.
    fn put_control(&self, source: SourceId, control: Control);
    /// Counts a message that could not be used.
    fn refuse(&self, source: SourceId);
    /// Counts a message that needs no handling.
    fn touch(&self, source: SourceId);
    /// Counts messages that were lost in transport.
    fn lose(&self, source: SourceId, count: u64);
    /// Ends a source: drops its entries and removes it from the counts.
    fn retire(&self, source: SourceId);
    /// Sets whether entries are kept; an inactive node counts and drops them, those that wait too.
    fn set_accepting(&self, accepting: bool);
    /// Counts of all sources.
    fn counts(&self) -> Vec<SourceCount>;
    /// Closes the inbox: wakes the reader, drops all entries and ignores later ones.
    fn close(&self);
}

impl<I: Send + 'static> Sources for Inbox<I> {
    fn add_source(&self, name: &str, depth: usize, kind: SourceKind) -> SourceId {
        let mut state = self.lock();
        let number = state.next;
        state.next += 1;
        let count = SourceCount {
            name: name.to_owned(),
            received: 0,
            dropped: 0,
            refused: 0,
            lost: 0,
            latest: None,
            kind,
            depth: depth.max(1),
            queued: 0,
        };
        state.sources.insert(number, count);
        SourceId(number)
    }

    fn put_control(&self, source: SourceId, control: Control) {
        self.put(source, Event::Control(control), now());
    }

    fn refuse(&self, source: SourceId) {
        self.count(source, |count| count.refused += 1);
    }

    fn touch(&self, source: SourceId) {
        self.count(source, |count| {
            count.received += 1;
            count.latest = Some(now());
        });
    }

    fn lose(&self, source: SourceId, lost: u64) {
        self.count(source, |count| count.lost += lost);
    }

    fn retire(&self, SourceId(source): SourceId) {
        let mut state = self.lock();
        state.sources.remove(&source);
        let gone = state.remove(|s| s == source);
        drop(state);
        drop(gone);
    }

    fn set_accepting(&self, accepting: bool) {
        let mut state = self.lock();
        state.accepting = accepting;
        if !accepting {
            let mut dropped = Vec::new();
            for (number, count) in &mut state.sources {
                if !count.kind.always_passes() {
                    count.queued = 0;
                    dropped.push(*number);
                }
            }
            let gone = state.remove(|s| dropped.contains(&s));
            drop(state);
            drop(gone);
        }
    }

    fn counts(&self) -> Vec<SourceCount> {
        let state = self.lock();
        state.sources.values().filter(|s| s.kind != SourceKind::Control).cloned().collect()
    }

    fn close(&self) {
        let mut state = self.lock();
        state.closed = true;
        let queued = std::mem::take(&mut state.queue);
        drop(state);
        // Outside of the lock, because dropping an entry may put in another one.
        drop(queued);
        self.ready.notify_all();
    }
}

/// Time of the steady clock, for deadlines and rates, never for stamps.
#[allow(clippy::disallowed_methods, reason = "a shell's clock")]
pub(crate) fn now() -> Instant {
    Instant::now()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn order_is_that_of_arrival_and_a_full_source_drops_only_its_own_oldest() {
        let inbox = Inbox::new();
        let images = inbox.add_source("/image", 2, SourceKind::Expected);
        let samples = inbox.add_source("/imu", 3, SourceKind::Expected);
        for i in 0..4 {
            inbox.put(images, Event::Input(("image", i)), now());
            inbox.put(samples, Event::Input(("imu", i)), now());
        }
        let mut taken = Vec::new();
        while let Taken::Entry(Event::Input(entry)) = inbox.take(now()) {
            taken.push(entry);
        }
        assert_eq!(taken, [("imu", 1), ("image", 2), ("imu", 2), ("image", 3), ("imu", 3)]);
        let counts = inbox.counts();
        assert_eq!((counts[0].received, counts[0].dropped), (4, 2));
        assert_eq!((counts[1].received, counts[1].dropped), (4, 1));
    }

    /// An input whose end is reported to its own node.
    struct Reported(Arc<Inbox<Self>>, Option<SourceId>);

    impl Drop for Reported {
        fn drop(&mut self) {
            if let Some(source) = self.1 {
                self.0.put(source, Event::Input(Self(self.0.clone(), None)), now());
            }
        }
    }

    #[test]
    fn a_dropped_input_may_put_in_another_one() {
        let inbox = Inbox::new();
        let topic = |name| inbox.add_source(name, 1, SourceKind::Expected);
        let (source, ends) = (topic("/x"), topic("ends"));
        for _ in 0..2 {
            inbox.put(source, Event::Input(Reported(inbox.clone(), Some(ends))), now());
        }
        assert_eq!(inbox.counts()[1].received, 1);
    }

    #[test]
    fn a_closed_inbox_wakes_its_reader_and_takes_nothing() {
        let inbox = Inbox::<u8>::new();
        let source = inbox.add_source("/x", 1, SourceKind::Expected);
        let read = inbox.clone();
        let reader = std::thread::spawn(move || read.take(now() + Duration::from_secs(60)));
        inbox.close();
        assert!(matches!(reader.join().unwrap(), Taken::Closed));
        inbox.put(source, Event::Input(1), now());
        assert_eq!(inbox.counts()[0].received, 0);
    }

    /// A subscription that is renewed again and again.
    #[test]
    fn a_retired_source_is_forgotten_and_gets_nothing() {
        let inbox = Inbox::new();
        let first = inbox.add_source("/x", 1, SourceKind::Expected);
        inbox.put(first, Event::Input(1), now());
        for _ in 0..100 {
            let source = inbox.add_source("/x", 1, SourceKind::Expected);
            inbox.retire(source);
            inbox.put(source, Event::Input(2), now());
            inbox.refuse(source);
        }
        let held = || {
            let state = inbox.lock();
            (state.sources.len(), state.queue.len())
        };
        assert_eq!(held(), (1, 1));
        inbox.retire(first);
        assert_eq!(held(), (0, 0));
    }

    #[test]
    fn an_inbox_that_does_not_accept_still_counts_and_serves() {
        let inbox = Inbox::new();
        let source = inbox.add_source("/x", 1, SourceKind::Expected);
        let service = inbox.add_source("/reset", 16, SourceKind::Service);
        inbox.put(source, Event::Input(1), now());
        inbox.put(service, Event::Input(2), now());
        inbox.set_accepting(false);
        inbox.put(source, Event::Input(3), now());
        inbox.put(service, Event::Input(4), now());
        for expected in [2, 4] {
            let taken = inbox.take(now());
            assert!(matches!(taken, Taken::Entry(Event::Input(i)) if i == expected));
        }
        let deadline = now() + Duration::from_millis(1);
        assert!(matches!(inbox.take(deadline), Taken::Deadline));
        let counts = inbox.counts();
        assert_eq!((counts[0].received, counts[0].dropped), (2, 0));
        // The queue of the topic is empty.
        inbox.set_accepting(true);
        inbox.put(source, Event::Input(5), now());
        assert!(matches!(inbox.take(now()), Taken::Entry(Event::Input(5))));
        assert_eq!(inbox.counts()[0].dropped, 0);
    }
}
