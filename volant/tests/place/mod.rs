//! A folder in which `volant` runs.

#![allow(dead_code, clippy::new_without_default)]

use bag::{BagMessage, BagReader, BagWriter, Qos, Topic, WriteOptions};
use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};
use tempfile::TempDir;
use test_support::process::{Running, in_domain};
use volant_msgs::Message;

/// A folder in which `volant` runs.
pub struct Place(TempDir);

/// How a command ended, and what it printed.
pub struct Ran {
    pub status: Option<i32>,
    pub out: String,
    pub err: String,
}

impl From<Output> for Ran {
    fn from(output: Output) -> Self {
        let [out, err] =
            [output.stdout, output.stderr].map(|b| String::from_utf8_lossy(&b).into_owned());
        Self { status: output.status.code(), out, err }
    }
}

impl Place {
    /// An empty folder.
    pub fn new() -> Self {
        Self(TempDir::new().unwrap())
    }

    /// A folder with a `rig.yaml`.
    pub fn with_rig(text: &str) -> Self {
        let place = Self::new();
        place.write("rig.yaml", text);
        place
    }

    pub fn folder(&self) -> &Path {
        self.0.path()
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        fs::write(self.path(name), bytes).unwrap();
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap()
    }

    pub fn text(&self, name: &str) -> String {
        String::from_utf8(self.read(name)).unwrap()
    }

    /// `volant` with these words, which are separated by spaces.
    pub fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_volant"));
        command.args(arguments.split_whitespace()).current_dir(self.folder());
        command
    }

    pub fn volant(&self, arguments: &str) -> Ran {
        self.command(arguments).output().unwrap().into()
    }

    /// Runs a command that succeeds; returns what it prints.
    pub fn done(&self, arguments: &str) -> String {
        let ran = self.volant(arguments);
        assert_eq!(ran.status, Some(0), "{arguments}: {}{}", ran.out, ran.err);
        ran.out + &ran.err
    }

    /// Runs a command that fails; returns its error.
    pub fn failed(&self, arguments: &str) -> String {
        let ran = self.volant(arguments);
        assert_eq!(ran.status, Some(1), "{arguments}: {}", ran.err);
        ran.err
    }

    /// Runs a command that fails with one line with these words.
    pub fn fails(&self, arguments: &str, words: &[&str]) {
        let line = self.failed(arguments);
        assert_eq!(line.trim_end().lines().count(), 1, "{line}");
        for word in words {
            assert!(line.contains(word), "`{word}` is not in: {line}");
        }
        assert!(!line.contains("panicked"), "{line}");
    }
}

/// `volant` in a DDS domain, with these words, which are separated by spaces.
pub fn live(domain: u16, arguments: &str) -> Command {
    let mut command = in_domain(domain, env!("CARGO_BIN_EXE_volant"));
    command.args(arguments.split_whitespace());
    command
}

/// Starts `volant` in a DDS domain, with these words, which are separated by spaces.
pub fn start(domain: u16, arguments: &str) -> Running {
    Running::start(&mut live(domain, arguments))
}

/// Writes a message that is published and logged `at`, ns.
pub fn put<M: Message>(bag: &mut BagWriter, topic: &str, qos: &Qos, at: u64, message: &M) {
    let topic = bag.add_topic(Topic::of::<M>(topic, qos));
    bag.write_message(topic, at, message).unwrap();
}

/// Copies a bag; `change` may change the topic and the message.
pub fn copy_bag(from: &Path, to: &Path, mut change: impl FnMut(&mut Topic, &mut BagMessage)) {
    let mut reader = BagReader::open(from).unwrap();
    let mut bag = BagWriter::create(to, WriteOptions::default()).unwrap();
    while let Some(mut message) = reader.next_message().unwrap() {
        let mut topic = (*message.topic).clone();
        change(&mut topic, &mut message);
        let id = bag.add_topic(topic);
        bag.write(id, message.log_time, message.log_time, &message.data).unwrap();
    }
    bag.finish().unwrap();
}
