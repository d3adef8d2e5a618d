//! Parameters of the node.

use crate::FusionConfig;

node_kit::parameters! {
    /// Parameters of the node: those of the core, and what only the node needs.
    pub struct FusionParameters {
        /// File to which ~/save_checkpoint writes the filter's state and covariance, and from
        /// which ~/load_checkpoint reads them; empty: none.
        checkpoint_file: String = "";
        /// Publish world -> volant on /tf.
        publish_tf: bool = true;
        /// Publish innovation, NIS and gating outcome of each marker on volant/marker_updates.
        publish_marker_updates: bool = true;
        /// Time without IMU samples or used images after which the diagnostics report it.
        silence_timeout: f64 = 0.5, unit("s"), range(0.01..=60.0);
        groups {
            /// Configuration of the core.
            core: FusionConfig;
        }
    }
}
