//! Messages of Foxglove's WebSocket protocol that a server of live topics needs, as pure functions.

use serde::{Deserialize, Serialize};

/// Supported subprotocols; these messages are the same in both.
pub const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

const MESSAGE_DATA: u8 = 1;

/// A channel: a topic as clients see it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Channel {
    /// Identifier, never reused for another topic.
    pub id: u32,
    /// Absolute name.
    pub topic: String,
    /// `cdr`.
    pub encoding: &'static str,
    /// `package/msg/Type`.
    pub schema_name: String,
    /// `.msg` text of the type and of all types in it.
    pub schema: String,
    /// `ros2msg`.
    pub schema_encoding: &'static str,
}

#[derive(Serialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
enum FromServer<'a> {
    ServerInfo { name: &'a str, capabilities: [&'a str; 0], session_id: &'a str },
    Advertise { channels: &'a [Channel] },
    Unadvertise { channel_ids: &'a [u32] },
    Status { level: u8, message: &'a str },
}

/// Request of a client, from its JSON.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
pub enum FromClient {
    /// Subscribe to channels.
    Subscribe {
        /// The subscriptions.
        subscriptions: Vec<Subscribe>,
    },
    /// End subscriptions.
    Unsubscribe {
        /// Identifiers of the subscriptions.
        subscription_ids: Vec<u32>,
    },
    /// A request that this server does not support.
    #[serde(other)]
    Other,
}

/// A subscription.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Subscribe {
    /// Identifier chosen by the client.
    pub id: u32,
    /// Identifier of the channel.
    pub channel_id: u32,
}

fn text(message: &FromServer<'_>) -> String {
    // Strings and numbers only: serialization cannot fail.
    serde_json::to_string(message).unwrap_or_default()
}

/// Formats the first message to every client.
pub fn server_info(name: &str, session: &str) -> String {
    text(&FromServer::ServerInfo { name, capabilities: [], session_id: session })
}

/// Formats the advertisement of new channels.
pub fn advertise(channels: &[Channel]) -> String {
    text(&FromServer::Advertise { channels })
}

/// Formats the removal of channels.
pub fn unadvertise(channel_ids: &[u32]) -> String {
    text(&FromServer::Unadvertise { channel_ids })
}

/// Formats a warning that the client shows.
pub fn warning(message: &str) -> String {
    text(&FromServer::Status { level: 1, message })
}

/// Encodes a message of a subscription; `time` in ns.
pub fn message_data(subscription: u32, time: u64, data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(data.len() + 13);
    bytes.push(MESSAGE_DATA);
    bytes.extend_from_slice(&subscription.to_le_bytes());
    bytes.extend_from_slice(&time.to_le_bytes());
    bytes.extend_from_slice(data);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_those_of_the_specification() {
        assert_eq!(
            server_info("volant", "7"),
            r#"{"op":"serverInfo","name":"volant","capabilities":[],"sessionId":"7"}"#
        );
        let channel = Channel {
            id: 3,
            topic: "/tf".into(),
            encoding: "cdr",
            schema_name: "tf2_msgs/msg/TFMessage".into(),
            schema: "int8 x".into(),
            schema_encoding: "ros2msg",
        };
        assert_eq!(
            advertise(&[channel]),
            concat!(
                r#"{"op":"advertise","channels":[{"id":3,"topic":"/tf","encoding":"cdr","#,
                r#""schemaName":"tf2_msgs/msg/TFMessage","schema":"int8 x","#,
                r#""schemaEncoding":"ros2msg"}]}"#
            )
        );
        assert_eq!(unadvertise(&[3]), r#"{"op":"unadvertise","channelIds":[3]}"#);
        assert_eq!(warning("x"), r#"{"op":"status","level":1,"message":"x"}"#);
        assert_eq!(message_data(0x0102, 3, &[9]), [1, 2, 1, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0, 9]);
    }

    #[test]
    fn client_messages_are_parsed_or_rejected() {
        let parsed = |text| serde_json::from_str::<FromClient>(text).ok();
        let [first, second] = [(0, 3), (1, 5)].map(|(id, channel_id)| Subscribe { id, channel_id });
        let subscribe = r#"{"op":"subscribe","subscriptions":[{"id":0,"channelId":3},
            {"id":1,"channelId":5}]}"#;
        for (text, expected) in [
            (subscribe, FromClient::Subscribe { subscriptions: vec![first, second] }),
            (
                r#"{"op":"unsubscribe","subscriptionIds":[1]}"#,
                FromClient::Unsubscribe { subscription_ids: vec![1] },
            ),
            (r#"{"op":"getParameters","parameterNames":[]}"#, FromClient::Other),
        ] {
            assert_eq!(parsed(text), Some(expected), "{text}");
        }
        for broken in [
            "",
            "[]",
            "{",
            r#"{"op":"subscribe"}"#,
            r#"{"op":"subscribe","subscriptions":[{"id":-1}]}"#,
        ] {
            assert_eq!(parsed(broken), None, "{broken}");
        }
    }
}
