//! Newtypes that let ros2-client carry what it did not define.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::sync::Arc;

/// A shared message, serialised as itself.
#[derive(Debug)]
pub(crate) struct Shared<M>(pub Arc<M>);

impl<M: Serialize> Serialize for Shared<M> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(serializer)
    }
}

/// Half of a service.
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
