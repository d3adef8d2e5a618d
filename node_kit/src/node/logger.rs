//! The log: on standard error and in a file in rclcpp's format, and on `/rosout`.

use super::{clock::Clock, publisher::Publisher};
use crate::{convert, inbox::now, level::Level};
use parking_lot::Mutex;
use std::{
    collections::HashMap,
    fs::File,
    io::Write,
    panic::Location,
    sync::{Arc, OnceLock},
    time::{Duration, Instant},
};
use volant_msgs::rcl_interfaces::msg::Log;

/// Log of one node. Clones belong to the same node; any thread may write.
#[derive(Clone)]
pub struct Logger(Arc<State>);

/// Where a process's log goes besides `/rosout`. Clones share the file.
#[derive(Clone, Default)]
pub(crate) struct Sinks {
    /// Not on standard error.
    pub no_console: bool,
    /// The log file.
    pub file: Option<Arc<Mutex<File>>>,
}

struct State {
    name: String,
    sinks: Sinks,
    level: Level,
    clock: Clock,
    rosout: OnceLock<Publisher<Log>>,
    throttled: Mutex<HashMap<String, Instant>>,
}

impl Logger {
    pub(crate) fn new(name: String, level: Level, clock: Clock, sinks: Sinks) -> Self {
        Self(Arc::new(State {
            name,
            sinks,
            level,
            clock,
            rosout: OnceLock::new(),
            throttled: Mutex::default(),
        }))
    }

    pub(crate) fn connect(&self, rosout: Publisher<Log>) {
        let _ = self.0.rosout.set(rosout);
    }

    /// Writes a line if `level` is at least the node's level. On `/rosout`, file and line are the
    /// caller's; a function's name is not known at run time in Rust.
    #[track_caller]
    pub fn log(&self, level: Level, text: impl AsRef<str>) {
        let (state, text) = (&*self.0, text.as_ref());
        if level < state.level {
            return;
        }
        let stamp = state.clock.now();
        let line = format!("[{level}] [{stamp}] [{}]: {text}\n", state.name);
        // A closed standard error or a full disk does not end the node.
        if !state.sinks.no_console {
            let _ = std::io::stderr().write_all(line.as_bytes());
        }
        if let Some(file) = &state.sinks.file {
            let _ = file.lock().write_all(line.as_bytes());
        }
        if let Some(rosout) = state.rosout.get() {
            let caller = Location::caller();
            rosout.publish(Log {
                stamp: convert::time(stamp),
                level: level as u8,
                name: state.name.clone(),
                msg: text.to_owned(),
                file: caller.file().to_owned(),
                line: caller.line(),
                ..Log::default()
            });
        }
    }

    /// [`Logger::log`], at most once per `key` and `period`.
    #[track_caller]
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
}
