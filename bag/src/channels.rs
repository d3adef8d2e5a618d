//! Schemas and channels of an MCAP file, and the messages that refer to them.

use crate::{
    BagMessage, Topic,
    records::{self, Channel, Message, Schema},
};
use mcap::records::op;
use std::{collections::HashMap, sync::Arc};

/// Schemas and channels that the file has announced, by identifier.
#[derive(Default)]
pub(crate) struct Channels {
    /// Name of the type and its `.msg` text, which is empty for another encoding.
    schemas: HashMap<u16, (String, String)>,
    topics: HashMap<u16, Arc<Topic>>,
}

impl Channels {
    /// Applies the records of a chunk; damaged ones and messages of unknown channels are skipped.
    ///
    /// # Errors
    /// The first damage.
    pub fn records(&mut self, mut rest: &[u8], group: &mut Vec<BagMessage>) -> Result<(), String> {
        let mut outcome = Ok(());
        while !rest.is_empty() {
            let Some((opcode, record, next)) = records::split_first(rest) else {
                return outcome.and(Err("a record in it is longer than the chunk".to_owned()));
            };
            outcome = outcome.and(self.record(opcode, record, group));
            rest = next;
        }
        outcome
    }

    /// Adds the schemas and channels that are not known.
    pub fn supplement(&mut self, found: Self) {
        for (id, schema) in found.schemas {
            self.schemas.entry(id).or_insert(schema);
        }
        for (id, topic) in found.topics {
            self.topics.entry(id).or_insert(topic);
        }
    }

    /// Applies a schema, channel or message record; a message is appended to `group`.
    ///
    /// # Errors
    /// The record is damaged, or its channel is unknown.
    pub fn record(
        &mut self,
        opcode: u8,
        data: &[u8],
        group: &mut Vec<BagMessage>,
    ) -> Result<(), String> {
        let damaged = || "a length in it is wrong, or a text is not UTF-8".to_owned();
        match opcode {
            op::SCHEMA => {
                let schema = Schema::parse(data).ok_or_else(damaged)?;
                let definition = match schema.encoding {
                    "ros2msg" => String::from_utf8_lossy(schema.data).into_owned(),
                    _ => String::new(),
                };
                self.schemas.insert(schema.id, (schema.name.to_owned(), definition));
            }
            op::CHANNEL => {
                let channel = Channel::parse(data).ok_or_else(damaged)?;
                let topic = self.topic_of(&channel);
                // Writers repeat a channel in each chunk.
                if self.topics.get(&channel.id).is_none_or(|known| **known != topic) {
                    self.topics.insert(channel.id, Arc::new(topic));
                }
            }
            op::MESSAGE => {
                let message = Message::parse(data).ok_or_else(damaged)?;
                let topic = self.topics.get(&message.channel).ok_or_else(|| {
                    format!("a message of the unknown channel {}", message.channel)
                })?;
                group.push(BagMessage {
                    topic: topic.clone(),
                    log_time: message.log_time,
                    publish_time: message.publish_time,
                    data: message.data.to_vec(),
                });
            }
            _ => {}
        }
        Ok(())
    }

    /// The topic of a channel record.
    pub fn topic_of(&self, channel: &Channel<'_>) -> Topic {
        let (type_name, definition) =
            self.schemas.get(&channel.schema).cloned().unwrap_or_default();
        Topic {
            type_name,
            definition,
            type_hash: channel.entry("topic_type_hash"),
            offered_qos_profiles: channel.entry("offered_qos_profiles"),
            name: channel.topic.to_owned(),
            message_encoding: channel.message_encoding.to_owned(),
        }
    }
}
