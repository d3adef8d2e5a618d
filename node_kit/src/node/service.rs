//! Services.

use super::{
    bare::AnnouncedReader,
    endpoints::{Endpoints, dds_type_name, policies, with_type_hash},
    error::NodeError,
    reply_budget::ReplyBudget,
};
use crate::{environment::ServiceFlavour, inbox::now, level::Level, qos::Qos};
use async_executor::Task;
use futures_lite::StreamExt;
use ros2_client::{MessageInfo, RmwRequestId, Subscription};
use rustdds::{RTPSEntity, SampleIdentity, SequenceNumber, Topic, TopicKind, WriteOptionsBuilder};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::{fmt::Display, future::Future, time::Duration};
use volant_msgs::{Message, Service};

/// A service with the announcement of its requests' subscription; it ends when this drops.
pub(crate) type OfferedService = (Task<()>, AnnouncedReader);

/// Replies to one request of a service. If it is dropped unused, the client gets no reply.
pub struct Responder<S: Service>(async_channel::Sender<S::Response>);

impl<S: Service> Responder<S> {
    pub(super) fn new() -> (Self, async_channel::Receiver<S::Response>) {
        let (sender, receiver) = async_channel::bounded(1);
        (Self(sender), receiver)
    }

    /// Sends the reply without waiting.
    pub fn respond(self, response: S::Response) {
        let _ = self.0.try_send(response);
    }
}

impl Endpoints {
    /// Offers a service; `answer` yields the reply to a request, or `None` for no reply. Requests
    /// of one service are answered one at a time.
    pub fn serve<S: Service, F: Future<Output = Option<S::Response>> + Send>(
        &mut self,
        name: &str,
        answer: impl Fn(S::Request) -> F + Send + Sync + 'static,
    ) -> Result<OfferedService, NodeError> {
        let name = self.resolve_service(name)?;
        let requests = self.service_topic::<S::Request>(&name, "rq", "Request", &REQUESTS)?;
        let replies = self.service_topic::<S::Response>(&name, "rr", "Reply", &REPLIES)?;
        match self.domain.network.services {
            ServiceFlavour::Enhanced => {
                let requests = self
                    .node
                    .lock()
                    .create_subscription::<S::Request>(&requests, None)
                    .map_err(|e| failed(&name, e))?;
                // ros2-client 0.12.1's Publisher cannot write which request a reply belongs to.
                let qos = policies(&REPLIES);
                let participant = self.domain.context.domain_participant();
                let writer = participant
                    .create_publisher(&qos)
                    .and_then(|p| {
                        p.create_datawriter_no_key_cdr::<S::Response>(&replies, Some(qos))
                    })
                    .map_err(|e| failed(&name, e))?;
                self.node.lock().add_writer(writer.guid().into());
                let reply = move |identity, response| {
                    let options = WriteOptionsBuilder::new()
                        .source_timestamp(rustdds::Timestamp::now())
                        .related_sample_identity(identity)
                        .build();
                    let sent = writer.write_with_options(response, options);
                    sent.map(drop).map_err(|error| error.forget_data().to_string())
                };
                let split = |request, info: &MessageInfo| (identity_of(info), request);
                Ok(self.answer_requests(name, requests, split, answer, reply))
            }
            ServiceFlavour::Cyclone => {
                let requests = self
                    .node
                    .lock()
                    .create_subscription::<WithIdentity<S::Request>>(&requests, None)
                    .map_err(|e| failed(&name, e))?;
                let replies = self
                    .node
                    .lock()
                    .create_publisher::<WithIdentity<S::Response>>(&replies, None)
                    .map_err(|e| failed(&name, e))?;
                let reply = move |(client, number), half| {
                    let sent = replies.publish(WithIdentity { client, number, half });
                    sent.map_err(|error| error.to_string())
                };
                let split = |WithIdentity { client, number, half }, _: &MessageInfo| {
                    ((client, number), half)
                };
                Ok(self.answer_requests(name, requests, split, answer, reply))
            }
        }
    }

    /// Answers requests, one at a time, within the service's [`ReplyBudget`]. `split` returns a
    /// request's identity and payload; `reply` sends the response to the client of an identity.
    fn answer_requests<R, I, Request, Response, F>(
        &self,
        name: String,
        requests: Subscription<R>,
        split: impl Fn(R, &MessageInfo) -> (I, Request) + Send + 'static,
        answer: impl Fn(Request) -> F + Send + Sync + 'static,
        reply: impl Fn(I, Response) -> Result<(), String> + Send + 'static,
    ) -> OfferedService
    where
        R: DeserializeOwned + Send + Sync + 'static,
        I: Send + 'static,
        Request: Message,
        Response: Message,
        F: Future<Output = Option<Response>> + Send,
    {
        let logger = self.logger.clone();
        let mut budget = ReplyBudget::new();
        let announced = AnnouncedReader::of(&self.node, requests.gid());
        let task = self.reactor.spawn(async move {
            let warn = |seconds: u64, text: String| {
                logger.throttled(Level::Warn, &name, Duration::from_secs(seconds), text);
            };
            let mut stream = std::pin::pin!(requests.async_stream());
            while let Some(received) = stream.next().await {
                let (identity, request) = match received {
                    Ok((request, info)) => split(request, &info),
                    Err(error) => {
                        // Most likely a client whose middleware has another wire format.
                        let text = format!(
                            "decoding a request for {name} failed ({error}); is \
                             RMW_IMPLEMENTATION here the client's?"
                        );
                        warn(60, text);
                        continue;
                    }
                };
                let Some(response) = answer(request).await else { continue };
                if !budget.take(volant_msgs::cdr::to_bytes(&response).len(), now()) {
                    let text = "gets more requests than it can answer; some replies are not sent";
                    warn(5, format!("{name} {text}"));
                } else if let Err(error) = reply(identity, response) {
                    warn(5, format!("sending a response of {name} failed: {error}"));
                }
            }
        });
        (task, announced)
    }

    /// The DDS topic of a service's requests or replies, named `<prefix><service><suffix>`.
    fn service_topic<M: Message>(
        &self,
        service: &str,
        prefix: &str,
        suffix: &str,
        qos: &Qos,
    ) -> Result<Topic, NodeError> {
        let name = format!("{prefix}{service}{suffix}");
        let policies = with_type_hash(policies(qos), M::RIHS01_HASH);
        let participant = self.domain.context.domain_participant();
        participant
            .create_topic(name, dds_type_name(M::TYPE_NAME), &policies, TopicKind::NoKey)
            .map_err(|e| failed(service, e))
    }
}

/// rmw's default for services, with a bound. RustDDS 0.15.1 keeps the newest `max_samples`
/// requests, read or not, until newer ones replace them; a request can have 64 kB and more.
const REQUESTS: Qos = Qos { max_samples: 32, ..Qos::RELIABLE };
/// rmw's default for services; [`ReplyBudget`] bounds the bytes.
const REPLIES: Qos = Qos { max_samples: 1000, ..Qos::RELIABLE };

/// Identity of a request, by which a client recognizes the reply.
fn identity_of(info: &MessageInfo) -> SampleIdentity {
    let own =
        RmwRequestId { writer_gid: info.publisher_gid(), sequence_number: info.sequence_number() };
    let mut id = info.related_request_id().unwrap_or(own);
    // Fast DDS names the reader that waits for the reply and omits the sequence number.
    if id.sequence_number == i64::from(SequenceNumber::UNKNOWN) {
        id.sequence_number = own.sequence_number;
    }
    SampleIdentity::from(id)
}

/// Request or reply with the header that rmw_cyclonedds puts before it.
#[derive(Serialize, Deserialize)]
struct WithIdentity<M> {
    client: u64,
    number: i64,
    half: M,
}

fn failed(service: &str, reason: impl Display) -> NodeError {
    NodeError::middleware(format!("the service {service}"), reason)
}
