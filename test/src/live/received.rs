//! Messages of a run: of the nodes, each with its time of receipt, and of the simulated hardware.

use nalgebra::Isometry3;
use node_kit::convert::{self, covariance6, pose, stamp};
use rig_model::{
    ImuSample, Stamp,
    score::{Nees, PoseError},
};
use std::sync::Arc;
use volant::report::Track;
use volant_msgs::{
    diagnostic_msgs::msg::DiagnosticArray,
    geometry_msgs::msg::{PoseWithCovariance, PoseWithCovarianceStamped, TransformStamped},
    msg::{MarkerObservations, MarkerUpdate, MarkerUpdates, PoseStatus},
    nav_msgs::msg::Odometry,
    sensor_msgs::msg::{CameraInfo, CompressedImage, Imu, JointState},
    std_msgs::msg::Header,
    tf2_msgs::msg::TFMessage,
};

/// Messages of one topic with their times of receipt.
pub type TopicLog<M> = Vec<(Stamp, Arc<M>)>;

/// Everything that was received, in order of receipt per topic, each under the topic's name, and
/// what the hardware sent.
#[derive(Clone, Debug, Default)]
pub struct Received {
    pub odometry: TopicLog<Odometry>,
    pub pose: TopicLog<PoseWithCovarianceStamped>,
    pub status: TopicLog<PoseStatus>,
    pub fused_pose: TopicLog<PoseWithCovarianceStamped>,
    pub visual_pose: TopicLog<PoseWithCovarianceStamped>,
    /// `volant/imu/data`.
    pub imu: TopicLog<Imu>,
    pub markers: TopicLog<MarkerObservations>,
    pub marker_updates: TopicLog<MarkerUpdates>,
    /// `climber/transform`.
    pub climber: TopicLog<TransformStamped>,
    pub tf: TopicLog<TFMessage>,
    pub tf_static: TopicLog<TFMessage>,
    pub diagnostics: TopicLog<DiagnosticArray>,
    /// What the hardware sent without a delay, with the times of its publication; nothing in an
    /// endless run.
    pub images: TopicLog<CompressedImage>,
    pub camera_info: TopicLog<CameraInfo>,
    pub joints: TopicLog<JointState>,
}

impl Received {
    pub fn fused(&self) -> Track {
        track(self.odometry.iter().map(|(_, m)| (&m.header, &m.pose)))
    }

    /// The poses from one image each.
    pub fn visual(&self) -> Track {
        track(self.visual_pose.iter().map(|(_, m)| (&m.header, &m.pose)))
    }

    /// Odometry with true stamps after a run in which the clock was `ahead` seconds ahead for a
    /// while: a stamp that is nearer to its time of receipt without these seconds is corrected.
    /// Other topics are unchanged.
    pub fn by_the_time_as_it_is(&self, ahead: f64) -> Self {
        let as_it_is = |(received, message): &(Stamp, Arc<Odometry>)| {
            let stamp = stamp(&message.header.stamp);
            let less = stamp.plus_seconds(-ahead);
            if less.seconds_since(*received).abs() >= stamp.seconds_since(*received).abs() {
                return (*received, Arc::clone(message));
            }
            let mut message = Odometry::clone(message);
            message.header.stamp = convert::time(less);
            (*received, Arc::new(message))
        };
        Self { odometry: self.odometry.iter().map(as_it_is).collect(), ..self.clone() }
    }

    pub fn inertial(&self) -> Vec<ImuSample> {
        self.imu.iter().map(|(_, m)| convert::imu_sample(m)).collect()
    }

    /// Latencies, s, one per image stamped in `from ..= to`: from the middle of its exposure to the
    /// receipt of the first odometry after the filter has used it.
    pub fn latencies(&self, from: Stamp, to: Stamp) -> Vec<f64> {
        let mut odometry = self.odometry.iter().peekable();
        let mut latencies = Vec::new();
        for (taken_in, update) in &self.marker_updates {
            let image = stamp(&update.header.stamp);
            // An image of which nothing was used is not contained in anything.
            let used = update.markers.iter().any(|m| m.outcome == MarkerUpdate::USED);
            if !used || image < from || image > to {
                continue;
            }
            while odometry.next_if(|(received, _)| received < taken_in).is_some() {}
            if let Some((received, _)) = odometry.peek() {
                latencies.push(received.seconds_since(image));
            }
        }
        latencies
    }

    /// NEES of position and of rotation (3 degrees of freedom each) of the fused poses stamped in
    /// `from ..= to`, with their stamps, against the truth; infinite where a covariance is not
    /// positive definite.
    pub fn nees(
        &self,
        from: Stamp,
        to: Stamp,
        truth: impl Fn(Stamp) -> Isometry3<f64>,
    ) -> Vec<(Stamp, [f64; 2])> {
        self.odometry
            .iter()
            .map(|(_, m)| (stamp(&m.header.stamp), m))
            .filter(|(at, _)| *at >= from && *at <= to)
            .filter_map(|(at, m)| {
                let error = PoseError::new(&pose(&m.pose.pose, "pose").ok()?, &truth(at));
                Some((at, Nees::pair(&error, &covariance6(&m.pose.covariance))))
            })
            .collect()
    }
}

fn track<'m>(messages: impl Iterator<Item = (&'m Header, &'m PoseWithCovariance)>) -> Track {
    messages.filter_map(|(at, m)| Some((stamp(&at.stamp), pose(&m.pose, "pose").ok()?))).collect()
}

/// The value below which the share `share` of the values lies; NaN of none.
pub fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let index = (share * sorted.len() as f64).ceil() as usize;
    sorted
        .get(index.saturating_sub(1).min(sorted.len().saturating_sub(1)))
        .copied()
        .unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_latency_counts_from_the_image_to_the_first_odometry_with_it() {
        let at = |ms: i64| Stamp::from_nanos(1_000_000_000 + ms * 1_000_000);
        let odometry = |ms| (at(ms), Arc::new(Odometry::default()));
        let update = |image, taken_in| {
            let markers =
                vec![MarkerUpdate { outcome: MarkerUpdate::USED, ..MarkerUpdate::default() }];
            let m = MarkerUpdates { header: convert::header("", at(image)), markers };
            (at(taken_in), Arc::new(m))
        };
        let received = Received {
            odometry: [2, 12, 22, 32, 42].map(odometry).to_vec(),
            marker_updates: vec![update(0, 15), update(20, 32), update(40, 99)],
            ..Received::default()
        };
        let latencies = received.latencies(at(0), at(100));
        assert_eq!(latencies.len(), 2);
        assert!(
            (latencies[0] - 0.022).abs() < 1e-9 && (latencies[1] - 0.012).abs() < 1e-9,
            "{latencies:?}"
        );
    }

    #[test]
    fn quantiles_are_of_the_sorted_values() {
        let values: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        assert_eq!(
            (quantile(&values, 0.99), quantile(&values, 0.5), quantile(&values, 1.0)),
            (99.0, 50.0, 100.0)
        );
        assert!(quantile(&[], 0.5).is_nan());
    }
}
