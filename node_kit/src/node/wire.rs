//! Newtypes that implement ros2-client's traits for foreign types.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::sync::Arc;

/// Shared message, serialized as the message itself.
#[derive(Debug)]
pub(crate) struct Shared<M>(pub Arc<M>);

impl<M: Serialize> Serialize for Shared<M> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(serializer)
    }
}

/// Request or response of a service.
#[derive(Clone, Debug)]
pub(crate) struct Half<M>(pub M);

impl<M: Serialize> Serialize for Half<M> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(serializer)
    }
}

impl<'de, M: Deserialize<'de>> Deserialize<'de> for Half<M> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        M::deserialize(deserializer).map(Half)
    }
}

impl<M: volant_msgs::Message> ros2_client::Message for Half<M> {}
