//! Transforms: `/tf`, and `/tf_static` for late joiners.

use super::{endpoints::Endpoints, error::NodeError, publisher::Publisher};
use crate::qos::QosPreset;
use rig_model::topics;
use volant_msgs::{geometry_msgs::msg::TransformStamped, tf2_msgs::msg::TFMessage};

/// The node's part of the tree of frames.
#[derive(Default)]
pub(crate) struct Transforms {
    moving: Option<Publisher<TFMessage>>,
    fixed: Option<Publisher<TFMessage>>,
    fixed_transforms: Vec<TransformStamped>,
}

impl Transforms {
    /// Advertises `/tf` before the first transform, so that listeners know where it comes from.
    pub fn advertise(&mut self, endpoints: &mut Endpoints) -> Result<(), NodeError> {
        if self.moving.is_none() {
            self.moving = Some(endpoints.advertise(topics::absolute::TF, QosPreset::State)?);
        }
        Ok(())
    }

    /// Publishes on `/tf`, which the first call advertises.
    pub fn send(
        &mut self,
        endpoints: &mut Endpoints,
        transform: TransformStamped,
    ) -> Result<(), NodeError> {
        self.advertise(endpoints)?;
        if let Some(publisher) = &self.moving {
            publisher.publish(TFMessage { transforms: vec![transform] });
        }
        Ok(())
    }

    /// Publishes on `/tf_static`, which the first call advertises.
    pub fn send_static(
        &mut self,
        endpoints: &mut Endpoints,
        transform: TransformStamped,
    ) -> Result<(), NodeError> {
        let publisher = match &self.fixed {
            Some(publisher) => publisher,
            None => self
                .fixed
                .insert(endpoints.advertise(topics::absolute::TF_STATIC, QosPreset::Latched)?),
        };
        // A late joiner gets one message, so all of the node's transforms are in it.
        self.fixed_transforms.retain(|t| t.child_frame_id != transform.child_frame_id);
        self.fixed_transforms.push(transform);
        publisher.publish(TFMessage { transforms: self.fixed_transforms.clone() });
        Ok(())
    }
}
