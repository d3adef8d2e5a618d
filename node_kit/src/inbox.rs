//! The one inbox of a node: messages and device events in order of arrival, bounded source by source.
//!
//! A source (a topic, a device, a timer) may have `depth` entries waiting; one more drops the oldest of the *same*
//! source and counts it, so a burst of images never costs an inertial sample, and nobody who puts in ever waits.

use std::{
    collections::VecDeque,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    time::Instant,
};

/// Index of a source in its inbox.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SourceId(usize);

/// What is known of a source.
#[derive(Clone, Debug)]
pub struct SourceCount {
    /// The topic's absolute name, or the device's.
    pub name: String,
    /// Put in, since the start.
    pub received: u64,
    /// Dropped because the node did not keep up.
    pub dropped: u64,
    /// Refused: not decodable, of another type, or not usable.
    pub refused: u64,
    /// Lost on the way, by the gaps in the publishers' numbering.
    pub lost: u64,
    /// When the latest was put in.
    pub latest: Option<Instant>,
    /// Is the source a topic that the node waits for?
    pub expected: bool,
    /// Entries pass even while the inbox does not accept: what steers the node itself.
    control: bool,
    retired: bool,
    depth: usize,
    queued: usize,
}

struct State<T> {
    queue: VecDeque<(usize, T)>,
    sources: Vec<SourceCount>,
    closed: bool,
    accepting: bool,
}

struct Shared<T> {
    state: Mutex<State<T>>,
    ready: Condvar,
}

/// The inbox; clones are handles to the same one.
pub(crate) struct Inbox<T>(Arc<Shared<T>>);

impl<T> Clone for Inbox<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

/// What [`Inbox::take`] gives.
#[derive(Debug, PartialEq)]
pub(crate) enum Taken<T> {
    /// An entry.
    Entry(T),
    /// Nothing came until the deadline.
    Deadline,
    /// The inbox was closed; what was queued is gone.
    Closed,
}

impl<T> Inbox<T> {
    pub(crate) fn new() -> Self {
        Self(Arc::new(Shared {
            state: Mutex::new(State {
                queue: VecDeque::new(),
                sources: Vec::new(),
                closed: false,
                accepting: true,
            }),
            ready: Condvar::new(),
        }))
    }

    fn lock(&self) -> MutexGuard<'_, State<T>> {
        // The state is whole between any two statements that could panic.
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A source of this name, with at most `depth` entries waiting.
    pub(crate) fn add_source(&self, name: &str, depth: usize, expected: bool) -> SourceId {
        let mut state = self.lock();
        state.sources.push(SourceCount {
            name: name.to_owned(),
            received: 0,
            dropped: 0,
            refused: 0,
            lost: 0,
            latest: None,
            expected,
            control: false,
            retired: false,
            depth: depth.max(1),
            queued: 0,
        });
        SourceId(state.sources.len() - 1)
    }

    /// A source that passes even while the inbox does not accept.
    pub(crate) fn add_control(&self, name: &str, depth: usize) -> SourceId {
        let SourceId(index) = self.add_source(name, depth, false);
        self.lock().sources[index].control = true;
        SourceId(index)
    }

    /// Puts one in; never waits. `now` is the time of arrival.
    pub(crate) fn put(&self, SourceId(source): SourceId, entry: T, now: Instant) {
        let mut state = self.lock();
        if state.closed || state.sources[source].retired {
            return;
        }
        let accepting = state.accepting;
        let count = &mut state.sources[source];
        count.received += 1;
        count.latest = Some(now);
        if !accepting && !count.control {
            return;
        }
        if count.queued == count.depth {
            count.dropped += 1;
            count.queued -= 1;
            if let Some(oldest) = state.queue.iter().position(|(s, _)| *s == source) {
                state.queue.remove(oldest);
            }
        }
        state.sources[source].queued += 1;
        state.queue.push_back((source, entry));
        drop(state);
        self.0.ready.notify_one();
    }

    /// Counts one that was received but could not be used.
    pub(crate) fn refuse(&self, SourceId(source): SourceId) {
        self.lock().sources[source].refused += 1;
    }

    /// Counts one that needs no handling.
    pub(crate) fn touch(&self, SourceId(source): SourceId, now: Instant) {
        let mut state = self.lock();
        state.sources[source].received += 1;
        state.sources[source].latest = Some(now);
    }

    /// Counts messages that never came.
    pub(crate) fn lose(&self, SourceId(source): SourceId, count: u64) {
        self.lock().sources[source].lost += count;
    }

    /// The source is no more: what it has queued is dropped, and it is counted no longer.
    pub(crate) fn retire(&self, SourceId(source): SourceId) {
        let mut state = self.lock();
        state.sources[source].retired = true;
        state.sources[source].queued = 0;
        let queue = std::mem::take(&mut state.queue);
        let (gone, kept) = queue.into_iter().partition(|(s, _)| *s == source);
        state.queue = kept;
        drop(state);
        drop::<VecDeque<_>>(gone);
    }

    /// Whether entries are kept at all; an inactive node counts them and lets them go.
    pub(crate) fn set_accepting(&self, accepting: bool) {
        self.lock().accepting = accepting;
    }

    /// Has the inbox been closed?
    pub(crate) fn is_closed(&self) -> bool {
        self.lock().closed
    }

    /// The next entry; waits for it until `deadline`.
    pub(crate) fn take(&self, deadline: Option<Instant>) -> Taken<T> {
        let mut state = self.lock();
        loop {
            if state.closed {
                return Taken::Closed;
            }
            if let Some((source, entry)) = state.queue.pop_front() {
                state.sources[source].queued -= 1;
                return Taken::Entry(entry);
            }
            state = match deadline {
                None => self.0.ready.wait(state).unwrap_or_else(PoisonError::into_inner),
                Some(deadline) => {
                    let left = deadline.saturating_duration_since(now());
                    if left.is_zero() {
                        return Taken::Deadline;
                    }
                    self.0.ready.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0
                }
            };
        }
    }

    /// Ends it: who waits is woken, what is queued is dropped, what comes later is ignored.
    pub(crate) fn close(&self) {
        let mut state = self.lock();
        state.closed = true;
        let queued = std::mem::take(&mut state.queue);
        drop(state);
        // Outside of the lock: an entry may own something whose drop puts in again.
        drop(queued);
        self.0.ready.notify_all();
    }

    /// The counts of all sources.
    pub(crate) fn counts(&self) -> Vec<SourceCount> {
        self.lock().sources.iter().filter(|s| !s.control && !s.retired).cloned().collect()
    }
}

/// The steady clock: for deadlines and rates, never for stamps.
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
        let images = inbox.add_source("/image", 2, true);
        let samples = inbox.add_source("/imu", 3, true);
        for i in 0..4 {
            inbox.put(images, ("image", i), now());
            inbox.put(samples, ("imu", i), now());
        }
        let mut taken = Vec::new();
        while let Taken::Entry(entry) = inbox.take(Some(now())) {
            taken.push(entry);
        }
        assert_eq!(taken, [("imu", 1), ("image", 2), ("imu", 2), ("image", 3), ("imu", 3)]);
        let counts = inbox.counts();
        assert_eq!((counts[0].received, counts[0].dropped), (4, 2));
        assert_eq!((counts[1].received, counts[1].dropped), (4, 1));
    }

    #[test]
    fn a_closed_inbox_wakes_its_reader_and_takes_nothing() {
        let inbox = Inbox::<u8>::new();
        let source = inbox.add_source("/x", 1, true);
        let reader = std::thread::spawn({
            let inbox = inbox.clone();
            move || inbox.take(None)
        });
        inbox.close();
        assert_eq!(reader.join().unwrap(), Taken::Closed);
        inbox.put(source, 1, now());
        assert_eq!(inbox.counts()[0].received, 0);
    }

    #[test]
    fn an_inbox_that_does_not_accept_still_counts() {
        let inbox = Inbox::new();
        let source = inbox.add_source("/x", 1, true);
        inbox.set_accepting(false);
        inbox.put(source, 1, now());
        assert_eq!(inbox.take(Some(now() + Duration::from_millis(1))), Taken::Deadline);
        assert_eq!(inbox.counts()[0].received, 1);
    }
}
