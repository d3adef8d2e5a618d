//! Services.

use super::{
    endpoints::{Endpoints, policies, with_type_hash},
    error::NodeError,
    logger::Logger,
    reply_budget::ReplyBudget,
    wire::Half,
};
use crate::{environment::ServiceFlavour, inbox::now, level::Level, qos::Qos};
use async_executor::Task;
use futures_lite::StreamExt;
use ros2_client::{MessageInfo, RmwRequestId, ServiceTypeName};
use rustdds::{RTPSEntity, SampleIdentity, SequenceNumber, Topic, TopicKind, WriteOptionsBuilder};
use serde::{Deserialize, Serialize};
use std::{fmt::Display, future::Future, time::Duration};
use volant_msgs::{Message, Service};

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
    /// of one service are answered one at a time. The service ends when the task drops.
    pub fn serve<S: Service, F: Future<Output = Option<S::Response>> + Send>(
        &mut self,
        name: &str,
        answer: impl Fn(S::Request) -> F + Send + Sync + 'static,
    ) -> Result<Task<()>, NodeError> {
        let name = self.resolve(name)?;
        let (package, type_name) = match S::TYPE_NAME.split_once("/srv/") {
            Some(parts) => parts,
            None => return Err(failed(&name, format!("{} is no service type", S::TYPE_NAME))),
        };
        let type_name = ServiceTypeName::new(package, type_name);
        match self.domain.network.services {
            ServiceFlavour::Enhanced => self.serve_enhanced::<S, F>(name, &type_name, answer),
            ServiceFlavour::Cyclone => self.serve_cyclone::<S, F>(name, &type_name, answer),
        }
    }

    /// Serves with a request's identity beside the payload: Fast DDS, Connext, RustDDS.
    fn serve_enhanced<S: Service, F: Future<Output = Option<S::Response>> + Send>(
        &mut self,
        name: String,
        type_name: &ServiceTypeName,
        answer: impl Fn(S::Request) -> F + Send + Sync + 'static,
    ) -> Result<Task<()>, NodeError> {
        let (requests, replies) = self.service_topics::<S>(&name, type_name)?;
        let requests = self
            .node
            .create_subscription::<S::Request>(&requests, None)
            .map_err(|e| failed(&name, e))?;
        let participant = self.domain.context.domain_participant();
        // ros2-client 0.12.1's Publisher cannot write which request a reply belongs to.
        let writer = participant
            .create_publisher(&policies(&REPLIES))
            .and_then(|p| {
                p.create_datawriter_no_key_cdr::<Half<S::Response>>(
                    &replies,
                    Some(policies(&REPLIES)),
                )
            })
            .map_err(|e| failed(&name, e))?;
        self.node.add_writer(writer.guid().into());
        let log = ServiceLog { logger: self.logger.clone(), name };
        let mut budget = ReplyBudget::new();
        Ok(self.reactor.spawn(async move {
            let mut stream = std::pin::pin!(requests.async_stream());
            while let Some(request) = stream.next().await {
                let (request, info) = match request {
                    Ok(request) => request,
                    Err(error) => {
                        log.unreadable(error);
                        continue;
                    }
                };
                let identity = identity_of(&info);
                let Some(response) = answer(request).await else { continue };
                if !budget.take(volant_msgs::cdr::to_bytes(&response).len(), now()) {
                    log.over_budget();
                    continue;
                }
                let options = WriteOptionsBuilder::new()
                    .source_timestamp(rustdds::Timestamp::now())
                    .related_sample_identity(identity)
                    .build();
                if let Err(error) = writer.write_with_options(Half(response), options) {
                    log.unsent(error.forget_data());
                }
            }
        }))
    }

    /// Serves with a request's identity in front of the payload: Cyclone DDS.
    fn serve_cyclone<S: Service, F: Future<Output = Option<S::Response>> + Send>(
        &mut self,
        name: String,
        type_name: &ServiceTypeName,
        answer: impl Fn(S::Request) -> F + Send + Sync + 'static,
    ) -> Result<Task<()>, NodeError> {
        let (requests, replies) = self.service_topics::<S>(&name, type_name)?;
        let requests = self
            .node
            .create_subscription::<WithIdentity<S::Request>>(&requests, None)
            .map_err(|e| failed(&name, e))?;
        let replies = self
            .node
            .create_publisher::<WithIdentity<S::Response>>(&replies, None)
            .map_err(|e| failed(&name, e))?;
        let log = ServiceLog { logger: self.logger.clone(), name };
        let mut budget = ReplyBudget::new();
        Ok(self.reactor.spawn(async move {
            let mut stream = std::pin::pin!(requests.async_stream());
            while let Some(request) = stream.next().await {
                let WithIdentity { client, number, half } = match request {
                    Ok((request, _)) => request,
                    Err(error) => {
                        log.unreadable(error);
                        continue;
                    }
                };
                let Some(half) = answer(half).await else { continue };
                if !budget.take(volant_msgs::cdr::to_bytes(&half).len(), now()) {
                    log.over_budget();
                } else if let Err(error) = replies.publish(WithIdentity { client, number, half }) {
                    log.unsent(error);
                }
            }
        }))
    }

    /// The DDS topics of requests and replies.
    fn service_topics<S: Service>(
        &self,
        name: &str,
        type_name: &ServiceTypeName,
    ) -> Result<(Topic, Topic), NodeError> {
        let topic = |dds_name: String, half: &str, qos: &Qos, hash: &str| {
            let dds_type = format!(
                "{}::srv::dds_::{}_{half}_",
                type_name.package_name(),
                type_name.type_name()
            );
            self.domain
                .context
                .domain_participant()
                .create_topic(
                    dds_name,
                    dds_type,
                    &with_type_hash(policies(qos), hash),
                    TopicKind::NoKey,
                )
                .map_err(|e| failed(name, e))
        };
        Ok((
            topic(format!("rq{name}Request"), "Request", &REQUESTS, S::Request::RIHS01_HASH)?,
            topic(format!("rr{name}Reply"), "Response", &REPLIES, S::Response::RIHS01_HASH)?,
        ))
    }
}

/// rmw's default for services, with a bound. RustDDS 0.15.1 keeps the newest `max_samples`
/// requests, read or not, until newer ones replace them; a request can have 64 kB and more.
const REQUESTS: Qos = Qos { reliable: true, transient_local: false, depth: 10, max_samples: 32 };
/// rmw's default for services; [`ReplyBudget`] bounds the bytes.
const REPLIES: Qos = Qos { reliable: true, transient_local: false, depth: 10, max_samples: 1000 };

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
    NodeError::Middleware { what: format!("the service {service}"), reason: reason.to_string() }
}

struct ServiceLog {
    logger: Logger,
    name: String,
}

impl ServiceLog {
    fn warn(&self, seconds: u64, text: String) {
        self.logger.throttled(Level::Warn, &self.name, Duration::from_secs(seconds), text);
    }

    /// Most likely a client whose middleware has another wire format for services.
    fn unreadable(&self, error: impl Display) {
        let name = &self.name;
        self.warn(
            60,
            format!(
                "a request for {name} cannot be read ({error}); is RMW_IMPLEMENTATION here the \
                 client's?"
            ),
        );
    }

    fn unsent(&self, error: impl Display) {
        self.warn(5, format!("an answer of {} cannot be sent: {error}", self.name));
    }

    fn over_budget(&self) {
        let name = &self.name;
        self.warn(
            5,
            format!("{name} gets more requests than it can answer; some replies are not sent"),
        );
    }
}
