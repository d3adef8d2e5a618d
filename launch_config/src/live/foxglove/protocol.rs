//! The messages of Foxglove's WebSocket protocol that a server of live topics needs, as pure functions.

use serde::{Deserialize, Serialize};

/// Names of the protocol that clients ask for; both have these messages in common.
pub const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

const MESSAGE_DATA: u8 = 1;

/// A topic as a client sees it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Channel {
    /// The server's number for it; never given to another topic.
    pub id: u32,
    /// Absolute name.
    pub topic: String,
    /// `cdr`.
    pub encoding: &'static str,
    /// `package/msg/Type`.
    pub schema_name: String,
    /// The `.msg` text with all that it uses.
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

/// What a client asks.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
pub enum FromClient {
    /// Send these channels from now on.
    Subscribe {
        /// Which.
        subscriptions: Vec<Subscribe>,
    },
    /// And no longer.
    Unsubscribe {
        /// The client's numbers.
        subscription_ids: Vec<u32>,
    },
    /// Something that this server does not offer.
    #[serde(other)]
    Other,
}

/// One subscription.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Subscribe {
    /// The client's number for it.
    pub id: u32,
    /// The server's number of the channel.
    pub channel_id: u32,
}

fn text(message: &FromServer<'_>) -> String {
    // Strings and numbers only: nothing in it can fail to be JSON.
    serde_json::to_string(message).unwrap_or_default()
}

/// The first message to every client.
pub fn server_info(name: &str, session: &str) -> String {
    text(&FromServer::ServerInfo { name, capabilities: [], session_id: session })
}

/// New channels.
pub fn advertise(channels: &[Channel]) -> String {
    text(&FromServer::Advertise { channels })
}

/// Channels that are no more.
pub fn unadvertise(channel_ids: &[u32]) -> String {
    text(&FromServer::Unadvertise { channel_ids })
}

/// A warning that the client shows.
pub fn warning(message: &str) -> String {
    text(&FromServer::Status { level: 1, message })
}

/// A message of a subscription; `time` in ns.
pub fn message_data(subscription: u32, time: u64, data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(data.len() + 13);
    bytes.push(MESSAGE_DATA);
    bytes.extend_from_slice(&subscription.to_le_bytes());
    bytes.extend_from_slice(&time.to_le_bytes());
    bytes.extend_from_slice(data);
    bytes
}

/// A client's text.
///
/// # Errors
/// Why it is none of the protocol's.
pub fn from_client(text: &str) -> Result<FromClient, String> {
    serde_json::from_str(text).map_err(|e| e.to_string())
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
            r#"{"op":"advertise","channels":[{"id":3,"topic":"/tf","encoding":"cdr","schemaName":"tf2_msgs/msg/TFMessage","schema":"int8 x","schemaEncoding":"ros2msg"}]}"#
        );
        assert_eq!(unadvertise(&[3]), r#"{"op":"unadvertise","channelIds":[3]}"#);
        assert_eq!(warning("x"), r#"{"op":"status","level":1,"message":"x"}"#);
        assert_eq!(message_data(0x0102, 3, &[9]), [1, 2, 1, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0, 9]);
    }

    #[test]
    fn what_clients_say_is_understood_or_refused() {
        assert_eq!(
            from_client(
                r#"{"op":"subscribe","subscriptions":[{"id":0,"channelId":3},{"id":1,"channelId":5}]}"#
            ),
            Ok(FromClient::Subscribe {
                subscriptions: vec![Subscribe { id: 0, channel_id: 3 }, Subscribe { id: 1, channel_id: 5 }]
            })
        );
        assert_eq!(
            from_client(r#"{"op":"unsubscribe","subscriptionIds":[1]}"#),
            Ok(FromClient::Unsubscribe { subscription_ids: vec![1] })
        );
        assert_eq!(from_client(r#"{"op":"getParameters","parameterNames":[]}"#), Ok(FromClient::Other));
        for broken in
            ["", "[]", "{", r#"{"op":"subscribe"}"#, r#"{"op":"subscribe","subscriptions":[{"id":-1}]}"#]
        {
            assert!(from_client(broken).is_err(), "{broken}");
        }
    }
}
