//! Transforms: `/tf`, and `/tf_static` for late joiners.

use super::{NodeError, handle::NodeHandle, publisher::Publisher};
use crate::qos::QosPreset;
use volant_msgs::{geometry_msgs::msg::TransformStamped, tf2_msgs::msg::TFMessage};

/// The node's part of the tree of frames.
#[derive(Default)]
pub(crate) struct Tf {
    moving: Option<Publisher<TFMessage>>,
    fixed: Option<Publisher<TFMessage>>,
    fixed_transforms: Vec<TransformStamped>,
}

impl NodeHandle {
    /// Publishes a transform on `/tf`.
    ///
    /// # Errors
    /// The first call advertises the topic, which can fail.
    pub fn send_transform(&mut self, transform: TransformStamped) -> Result<(), NodeError> {
        let publisher = match &self.tf.moving {
            Some(publisher) => publisher,
            None => {
                let publisher = self.advertise("/tf", QosPreset::State)?;
                self.tf.moving.insert(publisher)
            }
        };
        publisher.publish(TFMessage { transforms: vec![transform] });
        Ok(())
    }

    /// Publishes a transform that never changes on `/tf_static`, for late joiners too. One for the same child frame
    /// replaces the earlier one.
    ///
    /// # Errors
    /// The first call advertises the topic, which can fail.
    pub fn send_static_transform(&mut self, transform: TransformStamped) -> Result<(), NodeError> {
        if self.tf.fixed.is_none() {
            self.tf.fixed = Some(self.advertise("/tf_static", QosPreset::Latched)?);
        }
        // A late joiner gets one message, so all of the node's transforms are in it.
        self.tf.fixed_transforms.retain(|t| t.child_frame_id != transform.child_frame_id);
        self.tf.fixed_transforms.push(transform);
        if let Some(publisher) = &self.tf.fixed {
            publisher.publish(TFMessage { transforms: self.tf.fixed_transforms.clone() });
        }
        Ok(())
    }
}
