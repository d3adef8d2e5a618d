//! How far the work is, for a caller that shows a bar.

/// Writes progress or nothing.
pub struct Progress(pub bool);

impl Progress {
    /// A line `progress 0.25` on standard error.
    pub fn report(&self, share: f64) {
        if self.0 {
            eprintln!("progress {share:.3}");
        }
    }
}
