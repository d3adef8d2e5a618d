//! Transforms: `/tf`, and `/tf_static` for late joiners.

use super::{error::NodeError, handle::NodeHandle, publisher::Publisher};
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

impl NodeHandle {
    /// Advertises `/tf` before the first transform, so that listeners know where it comes from.
    ///
    /// # Errors
    /// As [`NodeHandle::advertise`].
    pub fn advertise_transforms(&mut self) -> Result<(), NodeError> {
        if self.transforms.moving.is_none() {
            let publisher = self.advertise(topics::absolute::TF, QosPreset::State)?;
            self.transforms.moving = Some(publisher);
        }
        Ok(())
    }

    /// Publishes a transform on `/tf`.
    ///
    /// # Errors
    /// The first call advertises the topic, which can fail.
    pub fn send_transform(&mut self, transform: TransformStamped) -> Result<(), NodeError> {
        self.advertise_transforms()?;
        if let Some(publisher) = &self.transforms.moving {
            publisher.publish(TFMessage { transforms: vec![transform] });
        }
        Ok(())
    }

    /// Publishes a constant transform on `/tf_static`, for late joiners too. It replaces an earlier
    /// one with the same child frame.
    ///
    /// # Errors
    /// The first call advertises the topic, which can fail.
    pub fn send_static_transform(&mut self, transform: TransformStamped) -> Result<(), NodeError> {
        if self.transforms.fixed.is_none() {
            let publisher = self.advertise(topics::absolute::TF_STATIC, QosPreset::Latched)?;
            self.transforms.fixed = Some(publisher);
        }
        // A late joiner gets one message, so all of the node's transforms are in it.
        let Transforms { fixed, fixed_transforms, .. } = &mut self.transforms;
        fixed_transforms.retain(|t| t.child_frame_id != transform.child_frame_id);
        fixed_transforms.push(transform);
        if let Some(publisher) = fixed {
            publisher.publish(TFMessage { transforms: fixed_transforms.clone() });
        }
        Ok(())
    }
}
