//! Subscriptions: over DDS and inside of the process.

use super::{
    bare::AnnouncedReader,
    endpoints::Endpoints,
    error::NodeError,
    intra_process::{Deliver, SubscriberGuard},
};
use crate::{
    inbox::{SourceId, SourceKind, Sources, now},
    qos::{Endpoint, Qos},
};
use async_executor::Task;
use futures_lite::StreamExt;
use std::{collections::HashMap, sync::Arc};
use volant_msgs::Message;

/// A subscription; it ends when it drops.
pub(crate) struct Subscription {
    /// Absolute name.
    pub topic: String,
    sources: Arc<dyn Sources>,
    source: SourceId,
    // Dropped before the source is retired, so that nothing is put in any more.
    parts: Option<(SubscriberGuard, Task<()>, AnnouncedReader)>,
}

impl Drop for Subscription {
    fn drop(&mut self) {
        self.parts = None;
        self.sources.retire(self.source);
    }
}

impl Endpoints {
    /// Subscribes to a topic; `deliver` gets each message with its source and the topic's absolute
    /// name.
    pub fn subscribe<M: Message>(
        &mut self,
        topic: &str,
        qos: Qos,
        kind: SourceKind,
        deliver: impl Fn(SourceId, &str, &Arc<M>) + Send + Sync + 'static,
    ) -> Result<Subscription, NodeError> {
        let name = self.resolve(topic)?;
        let qos = self.overridden(&name, qos, Endpoint::Subscription)?;
        let channel = self.domain.transport.channel::<M>(&name)?;
        let dds_topic = self.dds_topic::<M>(&name, &qos)?;
        let subscription = self
            .node
            .lock()
            .create_subscription::<M>(&dds_topic, None)
            .map_err(|e| NodeError::middleware(format!("the subscription of {name}"), e))?;
        let announced = AnnouncedReader::of(&self.node, subscription.gid());
        let source = self.sources.add_source(&name, qos.depth, kind);
        let state = Arc::clone(&channel.state);
        let sources = Arc::clone(&self.sources);
        let deliver: Deliver<M> = {
            let name = name.clone();
            Arc::new(move |message| deliver(source, &name, message))
        };
        let task = self.reactor.spawn({
            let deliver = Arc::clone(&deliver);
            async move {
                let mut stream = std::pin::pin!(subscription.async_stream());
                let mut latest: HashMap<ros2_client::Gid, i64> = HashMap::new();
                while let Some(received) = stream.next().await {
                    let Ok((message, info)) = received else {
                        sources.refuse(source);
                        continue;
                    };
                    let writer = info.publisher_gid();
                    if state.own_writers.read().contains(&writer) {
                        continue;
                    }
                    if state.foreign_writers.read().contains(&writer) {
                        sources.refuse(source);
                        continue;
                    }
                    // Publishers come and go; the maps stay small.
                    if latest.len() > 64 {
                        latest.clear();
                        state.heard.lock().clear();
                    }
                    state.heard.lock().insert(writer, now());
                    let number = info.sequence_number();
                    if let Some(before) = latest.insert(writer, number)
                        && number > before + 1
                    {
                        sources.lose(source, u64::try_from(number - before - 1).unwrap_or(0));
                    }
                    deliver(&Arc::new(message));
                }
            }
        });
        let guard = channel.subscribe(deliver, qos.transient_local);
        self.domain.refresh();
        let sources = Arc::clone(&self.sources);
        Ok(Subscription { topic: name, sources, source, parts: Some((guard, task, announced)) })
    }
}
