//! The log: on standard error in rclcpp's format, and on `/rosout`.

use super::{clock::Clock, publisher::Publisher};
use crate::{inbox::now, level::Level};
use parking_lot::Mutex;
use std::{
    collections::HashMap,
    io::Write,
    sync::{Arc, OnceLock},
    time::{Duration, Instant},
};
use volant_msgs::{builtin_interfaces::msg::Time, rcl_interfaces::msg::Log};

/// Log of one node. Clones belong to the same node; any thread may write.
#[derive(Clone)]
pub struct Logger(Arc<State>);

struct State {
    name: String,
    level: Level,
    clock: Clock,
    rosout: OnceLock<Publisher<Log>>,
    throttled: Mutex<HashMap<String, Instant>>,
}

impl Logger {
    pub(crate) fn new(name: String, level: Level, clock: Clock) -> Self {
        Self(Arc::new(State {
            name,
            level,
            clock,
            rosout: OnceLock::new(),
            throttled: Mutex::default(),
        }))
    }

    pub(crate) fn connect(&self, rosout: Publisher<Log>) {
        let _ = self.0.rosout.set(rosout);
    }

    /// Writes a line if `level` is at least the node's level.
    pub fn log(&self, level: Level, text: impl AsRef<str>) {
        let (state, text) = (&*self.0, text.as_ref());
        if level < state.level {
            return;
        }
        let stamp = state.clock.now();
        // A closed standard error does not end the node.
        let _ = writeln!(std::io::stderr(), "[{level}] [{stamp}] [{}]: {text}", state.name);
        if let Some(rosout) = state.rosout.get() {
            let (sec, nanosec) = stamp.to_sec_nanosec();
            rosout.publish(Log {
                stamp: Time { sec, nanosec },
                level: level as u8,
                name: state.name.clone(),
                msg: text.to_owned(),
                ..Log::default()
            });
        }
    }

    /// [`Logger::log`], at most once per `key` and `period`.
    pub fn throttled(&self, level: Level, key: &str, period: Duration, text: impl AsRef<str>) {
        let now = now();
        {
            let mut logged = self.0.throttled.lock();
            if logged.get(key).is_some_and(|at| now.duration_since(*at) < period) {
                return;
            }
            // Keys are few (one per kind of warning); the bound is a safeguard.
            if logged.len() >= 256 {
                logged.clear();
            }
            logged.insert(key.to_owned(), now);
        }
        self.log(level, text);
    }

    /// Name in each line: `rig1.pose_fusion`.
    pub fn name(&self) -> &str {
        &self.0.name
    }
}
