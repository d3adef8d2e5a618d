//! Services.

use super::{
    NodeError,
    kit::{Event, Kit, policies},
    logger::Logger,
    wire::Half,
};
use crate::{environment::ServiceFlavour, inbox::now, level::Level, qos::Qos};
use async_executor::Task;
use futures_lite::StreamExt;
use ros2_client::{
    Name, QosProfile, ServiceMapping, ServiceTypeName,
    qos::{History, WhenFull},
};
use rustdds::TopicKind;
use serde::{Deserialize, Serialize};
use std::{fmt::Display, future::Future, time::Duration};
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
        // rmw's default for services.
        let qos = QosProfile::publisher_default()
            .reliability_reliable(WhenFull::Fail)
            .history(History::KeepLast { depth: 10 });
        let parsed = Name::parse(&name).map_err(|e| failed(&name, e))?;
        let server = self
            .node
            .create_server::<Half<S::Request>, Half<S::Response>>(
                ServiceMapping::Enhanced,
                &parsed,
                type_name,
                qos.clone(),
                qos,
            )
            .map_err(|e| failed(&name, e))?;
        let log = ServiceLog { logger: self.logger(), name };
        Ok(self.reactor.spawn(async move {
            let mut requests = std::pin::pin!(server.receive_request_stream());
            while let Some(request) = requests.next().await {
                let (id, request) = match request {
                    Ok(request) => request,
                    Err(error) => {
                        log.unreadable(error);
                        continue;
                    }
                };
                let Some(response) = answer(request.0).await else { continue };
                let bytes = volant_msgs::cdr::to_bytes(&response).len();
                if bytes > LONGEST_ENHANCED_REPLY {
                    log.too_long(bytes);
                } else if let Err(error) = server.send_response(id, Half(response)) {
                    log.unsent(error);
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
        let topic = |dds_name: String, half: &str| {
            let dds_type =
                format!("{}::srv::dds_::{}_{half}_", type_name.package_name(), type_name.type_name());
            let qos = Qos { reliable: true, transient_local: false, depth: 10, max_samples: 1000 };
            self.domain
                .context
                .domain_participant()
                .create_topic(dds_name, dds_type, &policies(&qos), TopicKind::NoKey)
                .map_err(|e| failed(&name, e))
        };
        let requests = topic(format!("rq{name}Request"), "Request")?;
        let replies = topic(format!("rr{name}Reply"), "Response")?;
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
}

/// RustDDS 0.15.1 sends a fragmented sample with inline QoS (a reply with the identity of its request) malformed, and again and
/// again, because nobody can acknowledge it. This fits into a datagram of 1500 bytes with all headers.
const LONGEST_ENHANCED_REPLY: usize = 1300;

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
                "an answer of {name} has {bytes} bytes, more than RustDDS can send beside its identity; ask for less at \
                 a time, or use RMW_IMPLEMENTATION=rmw_cyclonedds_cpp"
            ),
        );
    }
}
