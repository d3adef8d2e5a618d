//! `volant` in a folder and in a DDS domain, and bags for it.

#![allow(dead_code, unused_imports)]

use bag::{BagMessage, BagReader, BagWriter, Qos, Topic, WriteOptions};
use std::{path::Path, process::Command};
pub use test_support::place::{Place, Ran};
use test_support::process::{Running, in_domain};
use volant_msgs::Message;

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
