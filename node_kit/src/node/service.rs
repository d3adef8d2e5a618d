//! Services.

use super::{
    NodeError,
    kit::{Event, Kit},
    wire::Half,
};
use crate::{environment::ServiceFlavour, inbox::now, level::Level};
use async_executor::Task;
use futures_lite::StreamExt;
use ros2_client::{
    Name, QosProfile, ServiceMapping, ServiceTypeName,
    qos::{History, WhenFull},
};
use std::{future::Future, time::Duration};
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
        let failed = |reason: String| NodeError::Middleware { what: format!("the service {name}"), reason };
        let mapping = match self.domain.network.services {
            ServiceFlavour::Enhanced => ServiceMapping::Enhanced,
            ServiceFlavour::Cyclone => ServiceMapping::Cyclone,
        };
        let parsed = Name::parse(&name).map_err(|e| failed(e.to_string()))?;
        let (package, type_name) = match S::TYPE_NAME.split_once("/srv/") {
            Some(parts) => parts,
            None => return Err(failed(format!("{} is no service type", S::TYPE_NAME))),
        };
        // rmw's default for services.
        let qos = QosProfile::publisher_default()
            .reliability_reliable(WhenFull::Fail)
            .history(History::KeepLast { depth: 10 });
        let server = self
            .node
            .create_server::<Half<S::Request>, Half<S::Response>>(
                mapping,
                &parsed,
                &ServiceTypeName::new(package, type_name),
                qos.clone(),
                qos,
            )
            .map_err(|e| failed(e.to_string()))?;
        let logger = self.logger();
        Ok(self.reactor.spawn(async move {
            let mut requests = std::pin::pin!(server.receive_request_stream());
            while let Some(request) = requests.next().await {
                let (id, request) = match request {
                    Ok(request) => request,
                    Err(error) => {
                        // Most likely a client whose middleware maps services another way.
                        logger.throttled(
                            Level::Warn,
                            &name,
                            Duration::from_secs(60),
                            format!(
                                "a request for {name} cannot be read ({error}); is RMW_IMPLEMENTATION here the client's?"
                            ),
                        );
                        continue;
                    }
                };
                if let Some(response) = answer(request.0).await
                    && let Err(error) = server.send_response(id, Half(response))
                {
                    logger.throttled(
                        Level::Warn,
                        &name,
                        Duration::from_secs(5),
                        format!("an answer of {name} cannot be sent: {error}"),
                    );
                }
            }
        }))
    }
}
