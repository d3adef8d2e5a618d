//! Parameters of the node.

use crate::FusionConfig;

node_kit::parameters! {
    /// Parameters of the node: those of the core, and what only the node needs.
    pub struct FusionParameters {
        /// Where ~/save_checkpoint writes what the filter knows and ~/load_checkpoint reads it;
        /// empty: nowhere.
        checkpoint_file: String = "";
        /// Publish world -> volant on /tf.
        publish_tf: bool = true;
        /// Publish what became of each marker on volant/marker_updates.
        publish_marker_updates: bool = true;
        /// Without IMU samples or used images for this long the diagnostics say so.
        silence_timeout: f64 = 0.5, unit("s"), range(0.01..=60.0);
        groups {
            /// Configuration of the core.
            core: FusionConfig;
        }
    }
}
