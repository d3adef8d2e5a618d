//! Services.

use super::{
    NodeError,
    handle::NodeHandle,
    kit::{Event, Kit},
    large_reply::{self, LargeReply},
    logger::Logger,
    topics::policies,
    wire::Half,
};
use crate::{environment::ServiceFlavour, inbox::now, level::Level, qos::Qos};
use async_executor::Task;
use futures_lite::StreamExt;
use ros2_client::{MessageInfo, RmwRequestId, ServiceTypeName};
use rustdds::{SampleIdentity, SequenceNumber, Topic, TopicKind, WriteOptionsBuilder};
use serde::{Deserialize, Serialize};
use std::{fmt::Display, future::Future, sync::Arc, time::Duration};
use volant_msgs::Service;

/// Answers one request of a service. Dropped without an answer, the client gets none.
pub struct Responder<S: Service>(async_channel::Sender<S::Response>);

impl<S: Service> Responder<S> {
    /// Answers; returns at once.
    pub fn respond(self, response: S::Response) {
        let _ = self.0.try_send(response);
    }
}

impl<I: Send + 'static> Kit<I> {
    /// Offers a service. `make` turns a request, and what answers it, into an input of the node; a request that the node
    /// does not come to within the inbox's bound (16) is dropped.
    ///
    /// # Errors
    /// A name that cannot be, or DDS's refusal.
    pub fn serve<S: Service>(
        &mut self,
        name: &str,
        make: impl Fn(S::Request, Responder<S>) -> I + Send + Sync + 'static,
    ) -> Result<(), NodeError> {
        let (inbox, source) = (self.inbox.clone(), self.inbox.add_source(&self.resolve(name)?, 16, false));
        let task = self.serve_with::<S, _>(name, move |request| {
            let (sender, receiver) = async_channel::bounded(1);
            inbox.put(source, Event::Input(make(request, Responder(sender))), now());
            async move { receiver.recv().await.ok() }
        })?;
        self.shell_services.push(task);
        Ok(())
    }
}

impl NodeHandle {
    /// Offers a service that the kit itself answers.
    pub(crate) fn serve_with<S: Service, F: Future<Output = Option<S::Response>> + Send>(
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

    /// The identity of a request travels beside the payload: Fast DDS, Connext, RustDDS.
    fn serve_enhanced<S: Service, F: Future<Output = Option<S::Response>> + Send>(
        &mut self,
        name: String,
        type_name: &ServiceTypeName,
        answer: impl Fn(S::Request) -> F + Send + Sync + 'static,
    ) -> Result<Task<()>, NodeError> {
        let (requests, replies) = self.service_topics(&name, type_name)?;
        let requests =
            self.node.create_subscription::<S::Request>(&requests, None).map_err(|e| failed(&name, e))?;
        let participant = self.domain.context.domain_participant();
        // Not ros2-client's Publisher, which has no way to write what a reply answers.
        let writer = participant
            .create_publisher(&policies(&SERVICE))
            .and_then(|p| {
                p.create_datawriter_no_key_cdr::<Half<S::Response>>(&replies, Some(policies(&SERVICE)))
            })
            .map_err(|e| failed(&name, e))?;
        let writer = Arc::new(writer);
        let log = ServiceLog { logger: self.logger(), name: name.clone() };
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
                let payload = volant_msgs::cdr::to_bytes(&response);
                if payload.len() > large_reply::LONGEST {
                    log.too_long(payload.len());
                    continue;
                }
                let options = WriteOptionsBuilder::new()
                    .source_timestamp(rustdds::Timestamp::now())
                    .related_sample_identity(identity)
                    .build();
                let sample = match writer.write_with_options(Half(response), options) {
                    Ok(sample) => sample,
                    Err(error) => {
                        log.unsent(error.forget_data());
                        continue;
                    }
                };
                if payload.len() > large_reply::FITS {
                    let topic = format!("rr{name}Reply");
                    match LargeReply::new(&participant, &topic, &sample, &identity, &payload) {
                        Ok(reply) => send_until_acknowledged(reply, Arc::clone(&writer)),
                        Err(error) => log.unsent(error),
                    }
                }
            }
        }))
    }

    /// The identity of a request travels in front of the payload: Cyclone DDS. Two plain topics do it.
    fn serve_cyclone<S: Service, F: Future<Output = Option<S::Response>> + Send>(
        &mut self,
        name: String,
        type_name: &ServiceTypeName,
        answer: impl Fn(S::Request) -> F + Send + Sync + 'static,
    ) -> Result<Task<()>, NodeError> {
        let (requests, replies) = self.service_topics(&name, type_name)?;
        let requests = self
            .node
            .create_subscription::<WithIdentity<S::Request>>(&requests, None)
            .map_err(|e| failed(&name, e))?;
        let replies = self
            .node
            .create_publisher::<WithIdentity<S::Response>>(&replies, None)
            .map_err(|e| failed(&name, e))?;
        let log = ServiceLog { logger: self.logger(), name };
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
                if let Some(half) = answer(half).await
                    && let Err(error) = replies.publish(WithIdentity { client, number, half })
                {
                    log.unsent(error);
                }
            }
        }))
    }

    /// The DDS topics of requests and replies.
    fn service_topics(&self, name: &str, type_name: &ServiceTypeName) -> Result<(Topic, Topic), NodeError> {
        let topic = |dds_name: String, half: &str| {
            let dds_type =
                format!("{}::srv::dds_::{}_{half}_", type_name.package_name(), type_name.type_name());
            self.domain
                .context
                .domain_participant()
                .create_topic(dds_name, dds_type, &policies(&SERVICE), TopicKind::NoKey)
                .map_err(|e| failed(name, e))
        };
        Ok((topic(format!("rq{name}Request"), "Request")?, topic(format!("rr{name}Reply"), "Response")?))
    }
}

/// rmw's default for services, but for the bound.
const SERVICE: Qos = Qos { reliable: true, transient_local: false, depth: 10, max_samples: 1000 };

/// What a reply must bear so that the client knows it for its own.
fn identity_of(info: &MessageInfo) -> SampleIdentity {
    let own = RmwRequestId { writer_gid: info.publisher_gid(), sequence_number: info.sequence_number() };
    let mut id = info.related_request_id().unwrap_or(own);
    // Fast DDS names the reader that waits for the reply, and leaves the number to the request's own.
    if id.sequence_number == i64::from(SequenceNumber::UNKNOWN) {
        id.sequence_number = own.sequence_number;
    }
    SampleIdentity::from(id)
}

/// Sends from a thread of its own, because the acknowledgment is waited for; again if there is none.
fn send_until_acknowledged<M: Serialize + Send + Sync + 'static>(
    reply: LargeReply,
    writer: Arc<ReplyWriter<M>>,
) {
    reply.send();
    // Without a thread it was sent once.
    let _ = std::thread::Builder::new().name("large_reply".into()).spawn(move || {
        for _ in 0..4 {
            if let Ok(true) = writer.wait_for_acknowledgments(Duration::from_millis(50)) {
                return;
            }
            reply.send();
        }
    });
}

type ReplyWriter<M> = rustdds::no_key::DataWriter<Half<M>, rustdds::CDRSerializerAdapter<Half<M>>>;

/// A request or reply with the header that rmw_cyclonedds puts before it.
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

    /// Most likely a client whose middleware maps services another way.
    fn unreadable(&self, error: impl Display) {
        let name = &self.name;
        self.warn(
            60,
            format!(
                "a request for {name} cannot be read ({error}); is RMW_IMPLEMENTATION here the client's?"
            ),
        );
    }

    fn unsent(&self, error: impl Display) {
        self.warn(5, format!("an answer of {} cannot be sent: {error}", self.name));
    }

    fn too_long(&self, bytes: usize) {
        let name = &self.name;
        self.warn(
            5,
            format!(
                "an answer of {name} has {bytes} bytes, more than a datagram holds; ask for less at a time, or use \
                 RMW_IMPLEMENTATION=rmw_cyclonedds_cpp"
            ),
        );
    }
}
