//! Conversion between ROS messages and `rig_model`'s types: the one place with the order of a
//! quaternion, the layout of a covariance and the fields of a stamp.
//!
//! Conversions from messages reject malformed values (a quaternion of length zero); the cores check
//! whether numbers are finite and plausible.

mod camera;

pub use camera::{camera_message, camera_model};

use nalgebra::{
    Isometry3, Matrix2, Matrix3, Matrix6, Quaternion, Translation3, UnitQuaternion, Vector2,
    Vector3,
};
use rig_model::{
    ClimberSample, Frames, ImuSample, JointReading, MarkerColor, MarkerObservation,
    MarkerObservations, MarkerState, OrientationSample, PerColor, Rig, Stamp, topics,
};
use thiserror::Error;
use volant_msgs::{
    builtin_interfaces::msg::Time, geometry_msgs::msg as geometry, msg as volant,
    nav_msgs::msg::Odometry, sensor_msgs::msg as sensor, std_msgs::msg::Header,
    tf2_msgs::msg::TFMessage,
};

/// Why a message is rejected: the message or its field, and what is wrong with it.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{0}")]
pub struct ConvertError(String);

/// Stamp of a message.
pub fn stamp(time: &Time) -> Stamp {
    Stamp::from_sec_nanosec(time.sec, time.nanosec)
}

/// Stamp for a message.
pub fn time(stamp: Stamp) -> Time {
    let (sec, nanosec) = stamp.to_sec_nanosec();
    Time { sec, nanosec }
}

/// Header of a message.
pub fn header(frame_id: &str, at: Stamp) -> Header {
    Header { stamp: time(at), frame_id: frame_id.to_owned() }
}

/// Rotation of a quaternion message (x, y, z, w), normalized. `what` names the field in errors.
///
/// # Errors
/// The quaternion's length is below 10⁻³ or not finite.
pub fn rotation(
    q: &geometry::Quaternion,
    what: &'static str,
) -> Result<UnitQuaternion<f64>, ConvertError> {
    let quaternion = Quaternion::new(q.w, q.x, q.y, q.z);
    let length = quaternion.norm();
    if length.is_finite() && length > 1e-3 {
        Ok(UnitQuaternion::from_quaternion(quaternion))
    } else {
        Err(ConvertError(format!("{what}: a quaternion of length {length} is no rotation")))
    }
}

/// Quaternion message (x, y, z, w) of a rotation, with w ≥ 0.
pub fn quaternion(rotation: &UnitQuaternion<f64>) -> geometry::Quaternion {
    let q = rotation.quaternion();
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    geometry::Quaternion { x: sign * q.i, y: sign * q.j, z: sign * q.k, w: sign * q.w }
}

fn vector(v: &geometry::Vector3) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}

fn vector_message(v: &Vector3<f64>) -> geometry::Vector3 {
    geometry::Vector3 { x: v.x, y: v.y, z: v.z }
}

/// `parent_from_child` of a transform message, m. `what` names the message in errors.
///
/// # Errors
/// As [`rotation`].
pub fn isometry(
    t: &geometry::Transform,
    what: &'static str,
) -> Result<Isometry3<f64>, ConvertError> {
    let translation = Translation3::from(vector(&t.translation));
    Ok(Isometry3::from_parts(translation, rotation(&t.rotation, what)?))
}

/// `parent_from_child` of a pose message, m. `what` names the message in errors.
///
/// # Errors
/// As [`rotation`].
pub fn pose(p: &geometry::Pose, what: &'static str) -> Result<Isometry3<f64>, ConvertError> {
    let translation = Translation3::new(p.position.x, p.position.y, p.position.z);
    Ok(Isometry3::from_parts(translation, rotation(&p.orientation, what)?))
}

/// Pose message of `parent_from_child`, m.
pub fn pose_message(parent_from_child: &Isometry3<f64>) -> geometry::Pose {
    let t = &parent_from_child.translation;
    geometry::Pose {
        position: geometry::Point { x: t.x, y: t.y, z: t.z },
        orientation: quaternion(&parent_from_child.rotation),
    }
}

/// Twist message: m/s, rad/s.
pub fn twist_message(linear: &Vector3<f64>, angular: &Vector3<f64>) -> geometry::Twist {
    geometry::Twist { linear: vector_message(linear), angular: vector_message(angular) }
}

/// Stamped transform message of `parent_from_child`, m.
pub fn transform_message(
    parent: &str,
    child: &str,
    at: Stamp,
    parent_from_child: &Isometry3<f64>,
) -> geometry::TransformStamped {
    geometry::TransformStamped {
        header: header(parent, at),
        child_frame_id: child.to_owned(),
        transform: geometry::Transform {
            translation: vector_message(&parent_from_child.translation.vector),
            rotation: quaternion(&parent_from_child.rotation),
        },
    }
}

/// 6×6 covariance as a row-major array. The matrix is symmetric up to rounding.
pub fn covariance6_message(c: &Matrix6<f64>) -> [f64; 36] {
    std::array::from_fn(|i| c[(i / 6, i % 6)])
}

/// 6×6 covariance of a row-major array.
pub fn covariance6(c: &[f64; 36]) -> Matrix6<f64> {
    Matrix6::from_row_slice(c)
}

/// IMU sample of a message: specific force, m/s², and angular velocity, rad/s, in the IMU's frame.
/// It has an orientation if the message has one (REP-145: the first element of its covariance is
/// not −1) and the quaternion is valid.
pub fn imu_sample(message: &sensor::Imu) -> ImuSample {
    let covariance = Matrix3::from_row_slice(&message.orientation_covariance);
    let orientation = (message.orientation_covariance[0] >= 0.0)
        .then(|| rotation(&message.orientation, "orientation").ok())
        .flatten()
        .map(|enu_from_imu| OrientationSample {
            enu_from_imu,
            // All zeros: unknown.
            covariance: (covariance != Matrix3::zeros()).then_some(covariance),
        });
    ImuSample {
        stamp: stamp(&message.header.stamp),
        specific_force: vector(&message.linear_acceleration),
        angular_velocity: vector(&message.angular_velocity),
        orientation,
    }
}

/// Message of an IMU sample. The variances are those of one sample, (m/s²)² and (rad/s)²; `None` if
/// unknown.
pub fn imu_message(
    frame_id: &str,
    sample: &ImuSample,
    force_variance: Option<f64>,
    rate_variance: Option<f64>,
) -> sensor::Imu {
    let diagonal = |variance: Option<f64>| {
        let v = variance.unwrap_or(0.0);
        [v, 0.0, 0.0, 0.0, v, 0.0, 0.0, 0.0, v]
    };
    let (orientation, orientation_covariance) = match &sample.orientation {
        Some(o) => {
            let c = o.covariance.unwrap_or_default();
            (quaternion(&o.enu_from_imu), std::array::from_fn(|i| c[(i / 3, i % 3)]))
        }
        None => (geometry::Quaternion::default(), [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
    };
    sensor::Imu {
        header: header(frame_id, sample.stamp),
        orientation,
        orientation_covariance,
        angular_velocity: vector_message(&sample.angular_velocity),
        angular_velocity_covariance: diagonal(rate_variance),
        linear_acceleration: vector_message(&sample.specific_force),
        linear_acceleration_covariance: diagonal(force_variance),
    }
}

/// Readings of the climber's encoders.
pub fn joint_reading(message: &sensor::JointState) -> JointReading {
    JointReading {
        stamp: stamp(&message.header.stamp),
        names: message.name.clone(),
        positions: message.position.clone(),
    }
}

/// `world_from_climber` of a transform message.
///
/// # Errors
/// Frames other than the rig's, or an invalid rotation.
pub fn climber_sample(
    message: &geometry::TransformStamped,
    frames: &Frames,
) -> Result<ClimberSample, ConvertError> {
    // tf1 put a slash before a frame's name.
    let bare = |name: &str| name.trim_start_matches('/').to_owned();
    let (parent, child) = (bare(&message.header.frame_id), bare(&message.child_frame_id));
    let Frames { world, climber, .. } = frames;
    let what = topics::CLIMBER_TRANSFORM;
    if parent != *world || child != *climber {
        return Err(ConvertError(format!(
            "{what}: the frames are `{parent}` and `{child}`, expected `{world}` and `{climber}` \
             (see frames in the rig file)"
        )));
    }
    Ok(ClimberSample {
        stamp: stamp(&message.header.stamp),
        world_from_climber: isometry(&message.transform, what)?,
    })
}

/// Transform message of `world_from_climber`.
pub fn climber_message(sample: &ClimberSample, frames: &Frames) -> geometry::TransformStamped {
    transform_message(&frames.world, &frames.climber, sample.stamp, &sample.world_from_climber)
}

/// Observations of the markers of an image, px.
///
/// # Errors
/// Not four markers in order, or an undefined state.
pub fn marker_observations(
    message: &volant::MarkerObservations,
) -> Result<MarkerObservations, ConvertError> {
    let ordered = message
        .markers
        .iter()
        .zip(MarkerColor::ALL)
        .all(|(m, c)| usize::from(m.color) == c.index());
    let (true, Ok(markers)) = (ordered, <&[_; 4]>::try_from(message.markers.as_slice())) else {
        return Err(ConvertError(format!(
            "climber/markers: {} markers, expected red, green, blue and yellow in this order",
            message.markers.len()
        )));
    };
    let mut observations = [MarkerObservation::lost(MarkerObservation::NEVER); 4];
    for (to, from) in observations.iter_mut().zip(markers) {
        *to = MarkerObservation {
            state: match from.state {
                volant::MarkerObservation::DETECTED => MarkerState::Detected,
                volant::MarkerObservation::PREDICTED => MarkerState::Predicted,
                volant::MarkerObservation::LOST => MarkerState::Lost,
                state => {
                    let text = format!("a marker's state is {state}, expected 0, 1 or 2");
                    return Err(ConvertError(format!("climber/markers: {text}")));
                }
            },
            occluded_frames: from.occluded_frames,
            centroid: Vector2::new(from.x, from.y),
            covariance: Matrix2::from_row_slice(&from.covariance),
            area: from.area,
        };
    }
    Ok(MarkerObservations { stamp: stamp(&message.header.stamp), markers: PerColor(observations) })
}

/// Message of the observations of an image.
pub fn markers_message(
    frame_id: &str,
    observations: &MarkerObservations,
) -> volant::MarkerObservations {
    let markers = observations
        .markers
        .iter()
        .map(|(color, m)| volant::MarkerObservation {
            color: color.index() as u8,
            state: match m.state {
                MarkerState::Detected => volant::MarkerObservation::DETECTED,
                MarkerState::Predicted => volant::MarkerObservation::PREDICTED,
                MarkerState::Lost => volant::MarkerObservation::LOST,
            },
            occluded_frames: m.occluded_frames,
            x: m.centroid.x,
            y: m.centroid.y,
            covariance: covariance2_message(&m.covariance),
            area: m.area,
        })
        .collect();
    volant::MarkerObservations { header: header(frame_id, observations.stamp), markers }
}

/// 2×2 covariance as a row-major array.
pub fn covariance2_message(c: &Matrix2<f64>) -> [f64; 4] {
    std::array::from_fn(|i| c[(i / 2, i % 2)])
}

/// Message of a pose with its 6×6 covariance: x, y, z, m, and the rotation about the fixed axes of
/// `frame_id`, rad.
pub fn pose_with_covariance_message(
    frame_id: &str,
    at: Stamp,
    pose: &Isometry3<f64>,
    covariance: &Matrix6<f64>,
) -> geometry::PoseWithCovarianceStamped {
    geometry::PoseWithCovarianceStamped {
        header: header(frame_id, at),
        pose: geometry::PoseWithCovariance {
            pose: pose_message(pose),
            covariance: covariance6_message(covariance),
        },
    }
}

/// Odometry message of `child` in `parent`: the pose's covariance about the parent's fixed axes,
/// the twist (m/s, rad/s) and its covariance in the child's axes.
#[allow(clippy::too_many_arguments, reason = "the fields of the message, in its order")]
pub fn odometry_message(
    parent: &str,
    child: &str,
    at: Stamp,
    parent_from_child: &Isometry3<f64>,
    pose_covariance: &Matrix6<f64>,
    linear_velocity: &Vector3<f64>,
    angular_velocity: &Vector3<f64>,
    twist_covariance: &Matrix6<f64>,
) -> Odometry {
    Odometry {
        header: header(parent, at),
        child_frame_id: child.to_owned(),
        pose: geometry::PoseWithCovariance {
            pose: pose_message(parent_from_child),
            covariance: covariance6_message(pose_covariance),
        },
        twist: geometry::TwistWithCovariance {
            twist: twist_message(linear_velocity, angular_velocity),
            covariance: covariance6_message(twist_covariance),
        },
    }
}

/// `/tf_static` of the rig: climber → camera and volant → imu.
pub fn static_transforms(rig: &Rig, at: Stamp) -> TFMessage {
    let f = &rig.frames;
    TFMessage {
        transforms: vec![
            transform_message(&f.climber, &f.camera, at, &rig.climber_from_camera),
            transform_message(&f.volant, &f.imu, at, &rig.imu.volant_from_imu),
        ],
    }
}

#[cfg(test)]
mod tests;
