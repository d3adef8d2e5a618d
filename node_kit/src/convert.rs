//! ROS messages and the cores' types, both ways: the one place that knows the order of a quaternion, the layout of a
//! covariance and the fields of a stamp.
//!
//! Whatever comes from a message is checked here for what makes it unusable as such (a quaternion of length zero);
//! whether numbers are finite and plausible is for the core that takes them.

use nalgebra::{
    Isometry3, Matrix2, Matrix3, Matrix6, Quaternion, Translation3, UnitQuaternion, Vector2, Vector3,
};
use rig_model::{
    CameraModel, CameraModelError, ClimberSample, Frames, ImuSample, MarkerColor, MarkerObservation,
    MarkerObservations, MarkerState, OrientationSample, PerColor, Rig, Stamp,
};
use thiserror::Error;
use volant_msgs::{
    builtin_interfaces::msg::Time, geometry_msgs::msg as geometry, msg as volant, nav_msgs::msg::Odometry,
    sensor_msgs::msg as sensor, std_msgs::msg::Header, tf2_msgs::msg::TFMessage,
};

/// Why a message cannot be used.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ConvertError {
    /// A quaternion without a direction.
    #[error("{what}: a quaternion of length {length} is no rotation")]
    Quaternion {
        /// Which field.
        what: &'static str,
        /// Its length.
        length: f64,
    },
    /// Frames that are not those of the rig.
    #[error(
        "{what}: the frames are `{found_parent}` and `{found_child}`, expected `{parent}` and `{child}` (see frames in the rig file)"
    )]
    Frames {
        /// Which message.
        what: &'static str,
        /// `header.frame_id`.
        found_parent: String,
        /// `child_frame_id`.
        found_child: String,
        /// As the rig file has it.
        parent: String,
        /// As the rig file has it.
        child: String,
    },
    /// Not one observation for each marker.
    #[error("climber/markers: {found} markers, expected red, green, blue and yellow in this order")]
    Markers {
        /// How many there were.
        found: usize,
    },
    /// A state that does not exist.
    #[error("climber/markers: a marker's state is {found}, expected 0, 1 or 2")]
    MarkerState {
        /// What it was.
        found: u8,
    },
}

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

/// From x, y, z, w.
///
/// # Errors
/// [`ConvertError::Quaternion`] where it has no direction (zeros, NaN, infinite).
pub fn rotation(q: &geometry::Quaternion, what: &'static str) -> Result<UnitQuaternion<f64>, ConvertError> {
    let quaternion = Quaternion::new(q.w, q.x, q.y, q.z);
    let length = quaternion.norm();
    if length.is_finite() && length > 1e-3 {
        Ok(UnitQuaternion::from_quaternion(quaternion))
    } else {
        Err(ConvertError::Quaternion { what, length })
    }
}

/// As x, y, z, w, with w not negative.
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

/// `parent_from_child`.
///
/// # Errors
/// As [`rotation`].
pub fn isometry(t: &geometry::Transform, what: &'static str) -> Result<Isometry3<f64>, ConvertError> {
    let translation = Translation3::from(vector(&t.translation));
    Ok(Isometry3::from_parts(translation, rotation(&t.rotation, what)?))
}

/// `parent_from_child` of a pose.
///
/// # Errors
/// As [`rotation`].
pub fn pose(p: &geometry::Pose, what: &'static str) -> Result<Isometry3<f64>, ConvertError> {
    let translation = Translation3::new(p.position.x, p.position.y, p.position.z);
    Ok(Isometry3::from_parts(translation, rotation(&p.orientation, what)?))
}

/// A pose's message.
pub fn pose_message(parent_from_child: &Isometry3<f64>) -> geometry::Pose {
    let t = &parent_from_child.translation;
    geometry::Pose {
        position: geometry::Point { x: t.x, y: t.y, z: t.z },
        orientation: quaternion(&parent_from_child.rotation),
    }
}

/// A stamped transform's message.
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

/// Row-major, as messages have it. The matrix is symmetric, but for the last bit.
pub fn covariance6_message(c: &Matrix6<f64>) -> [f64; 36] {
    std::array::from_fn(|i| c[(i / 6, i % 6)])
}

/// From row-major.
pub fn covariance6(c: &[f64; 36]) -> Matrix6<f64> {
    Matrix6::from_row_slice(c)
}

/// An inertial sample. An orientation is taken where the message says that it has one (REP-145: the first element of its
/// covariance is not −1) and its quaternion has a direction.
pub fn imu_sample(message: &sensor::Imu) -> ImuSample {
    let covariance = Matrix3::from_row_slice(&message.orientation_covariance);
    let orientation = (message.orientation_covariance[0] >= 0.0)
        .then(|| rotation(&message.orientation, "orientation").ok())
        .flatten()
        .map(|enu_from_imu| OrientationSample {
            enu_from_imu,
            // All zeros: not known.
            covariance: (covariance != Matrix3::zeros()).then_some(covariance),
        });
    ImuSample {
        stamp: stamp(&message.header.stamp),
        specific_force: vector(&message.linear_acceleration),
        angular_velocity: vector(&message.angular_velocity),
        orientation,
    }
}

/// An inertial sample's message. The variances are those of one sample, (m/s²)² and (rad/s)²; `None`: not known.
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

/// The climber's pose.
///
/// # Errors
/// Other frames than the rig's, or a rotation that is none.
pub fn climber_sample(
    message: &geometry::TransformStamped,
    frames: &Frames,
) -> Result<ClimberSample, ConvertError> {
    // Old writers put a slash before a frame's name.
    let bare = |name: &str| name.trim_start_matches('/').to_owned();
    let (parent, child) = (bare(&message.header.frame_id), bare(&message.child_frame_id));
    if parent != frames.world || child != frames.climber {
        return Err(ConvertError::Frames {
            what: "climber/transform",
            found_parent: parent,
            found_child: child,
            parent: frames.world.clone(),
            child: frames.climber.clone(),
        });
    }
    Ok(ClimberSample {
        stamp: stamp(&message.header.stamp),
        world_from_climber: isometry(&message.transform, "climber/transform")?,
    })
}

/// The climber's pose as a message.
pub fn climber_message(sample: &ClimberSample, frames: &Frames) -> geometry::TransformStamped {
    transform_message(&frames.world, &frames.climber, sample.stamp, &sample.world_from_climber)
}

/// The camera's model.
///
/// # Errors
/// As [`CameraModel::from_camera_info`], and [`CameraModelError::Cropped`] for a part of the image.
pub fn camera_model(message: &sensor::CameraInfo) -> Result<CameraModel, CameraModelError> {
    let roi = &message.roi;
    let whole = (roi.width == 0 || roi.width == message.width)
        && (roi.height == 0 || roi.height == message.height)
        && roi.x_offset == 0
        && roi.y_offset == 0;
    if message.binning_x > 1 || message.binning_y > 1 || !whole {
        return Err(CameraModelError::Cropped { binning_x: message.binning_x, binning_y: message.binning_y });
    }
    CameraModel::from_camera_info(
        message.width,
        message.height,
        &message.distortion_model,
        &message.d,
        &message.k,
    )
}

/// A camera model's message, with p and r of a camera that is not rectified.
pub fn camera_message(frame_id: &str, at: Stamp, camera: &CameraModel) -> sensor::CameraInfo {
    use rig_model::Distortion;
    let (width, height) = camera.size();
    let (f, c) = (camera.focal_lengths(), camera.principal_point());
    let (name, d) = match camera.distortion() {
        Distortion::PlumbBob(d) => ("plumb_bob", d.to_vec()),
        Distortion::RationalPolynomial(d) => ("rational_polynomial", d.to_vec()),
        Distortion::Equidistant(d) => ("equidistant", d.to_vec()),
    };
    sensor::CameraInfo {
        header: header(frame_id, at),
        width,
        height,
        distortion_model: name.to_owned(),
        d,
        k: [f.x, 0.0, c.x, 0.0, f.y, c.y, 0.0, 0.0, 1.0],
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: [f.x, 0.0, c.x, 0.0, 0.0, f.y, c.y, 0.0, 0.0, 0.0, 1.0, 0.0],
        ..sensor::CameraInfo::default()
    }
}

/// The markers of an image.
///
/// # Errors
/// Not four markers in the right order, or a state that does not exist.
pub fn marker_observations(message: &volant::MarkerObservations) -> Result<MarkerObservations, ConvertError> {
    let found = message.markers.len();
    let ordered =
        message.markers.iter().zip(MarkerColor::ALL).all(|(m, c)| usize::from(m.color) == c.index());
    let (true, Ok(markers)) = (ordered, <&[_; 4]>::try_from(message.markers.as_slice())) else {
        return Err(ConvertError::Markers { found });
    };
    let mut observations = [MarkerObservation::lost(MarkerObservation::NEVER); 4];
    for (to, from) in observations.iter_mut().zip(markers) {
        *to = MarkerObservation {
            state: match from.state {
                volant::MarkerObservation::DETECTED => MarkerState::Detected,
                volant::MarkerObservation::PREDICTED => MarkerState::Predicted,
                volant::MarkerObservation::LOST => MarkerState::Lost,
                found => return Err(ConvertError::MarkerState { found }),
            },
            occluded_frames: from.occluded_frames,
            centroid: Vector2::new(from.x, from.y),
            covariance: Matrix2::from_row_slice(&from.covariance),
            area: from.area,
        };
    }
    Ok(MarkerObservations { stamp: stamp(&message.header.stamp), markers: PerColor(observations) })
}

/// The markers of an image as a message.
pub fn markers_message(frame_id: &str, observations: &MarkerObservations) -> volant::MarkerObservations {
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

/// Row-major, as messages have it.
pub fn covariance2_message(c: &Matrix2<f64>) -> [f64; 4] {
    std::array::from_fn(|i| c[(i / 2, i % 2)])
}

/// A pose with covariance. The covariance is of (x, y, z, rotation about the fixed axes of `frame_id`), as the message
/// has it.
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

/// Pose and twist of `child` in `parent`: the pose's covariance about the parent's fixed axes, the twist and its
/// covariance in the child's axes.
#[allow(clippy::too_many_arguments)] // the fields of the message, in its order
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
            twist: geometry::Twist {
                linear: vector_message(linear_velocity),
                angular: vector_message(angular_velocity),
            },
            covariance: covariance6_message(twist_covariance),
        },
    }
}

/// What `/tf_static` says of the rig: climber → camera and volant → imu.
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
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn some_isometry() -> impl Strategy<Value = Isometry3<f64>> {
        (prop::array::uniform3(-3.0..3.0f64), prop::array::uniform3(-3.0..3.0f64))
            .prop_map(|(t, r)| Isometry3::new(Vector3::from(t), Vector3::from(r)))
    }

    fn near(a: &Isometry3<f64>, b: &Isometry3<f64>) -> bool {
        (a.translation.vector - b.translation.vector).norm() < 1e-12
            && a.rotation.angle_to(&b.rotation) < 1e-7
    }

    #[test]
    fn a_quarter_turn_about_z_is_z_and_w() {
        let q = quaternion(&UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2));
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!((q.z - half).abs() < 1e-15 && (q.w - half).abs() < 1e-15 && q.x == 0.0 && q.y == 0.0);
    }

    #[test]
    fn a_quaternion_without_a_direction_is_refused() {
        for bad in [0.0, f64::NAN, f64::INFINITY] {
            let q = geometry::Quaternion { x: bad, y: 0.0, z: 0.0, w: 0.0 };
            assert!(matches!(rotation(&q, "q"), Err(ConvertError::Quaternion { .. })), "{bad}");
        }
    }

    #[test]
    fn covariances_are_row_major() {
        let mut c = Matrix6::zeros();
        c[(0, 5)] = 7.0;
        assert_eq!(covariance6_message(&c)[5], 7.0);
        assert_eq!(covariance6(&covariance6_message(&c)), c);
        assert_eq!(covariance2_message(&Matrix2::new(1.0, 2.0, 3.0, 4.0)), [1.0, 2.0, 3.0, 4.0]);
    }

    #[test]
    fn an_imu_without_orientation_says_so_in_rep_145s_way() {
        let mut sample = ImuSample {
            stamp: Stamp::from_nanos(1_500_000_000),
            specific_force: Vector3::new(0.1, 0.2, 9.8),
            angular_velocity: Vector3::new(1.0, 2.0, 3.0),
            orientation: None,
        };
        let message = imu_message("imu", &sample, Some(4e-4), None);
        assert_eq!(message.orientation_covariance[0], -1.0);
        assert_eq!(message.linear_acceleration_covariance[8], 4e-4);
        assert_eq!(imu_sample(&message), sample);
        sample.orientation = Some(OrientationSample {
            enu_from_imu: UnitQuaternion::identity(),
            covariance: Some(Matrix3::from_diagonal(&Vector3::new(1.0, 2.0, 3.0))),
        });
        assert_eq!(imu_sample(&imu_message("imu", &sample, None, None)), sample);
    }

    #[test]
    fn foreign_frames_and_markers_are_refused_by_name() {
        let frames = Frames::default();
        let at = Stamp::from_nanos(0);
        let message = transform_message("map", &frames.climber, at, &Isometry3::identity());
        let error = climber_sample(&message, &frames).unwrap_err().to_string();
        assert!(error.contains("`map`") && error.contains("rig file"), "{error}");

        let lost = MarkerObservations {
            stamp: at,
            markers: PerColor([MarkerObservation::lost(MarkerObservation::NEVER); 4]),
        };
        let mut message = markers_message("camera_optical", &lost);
        message.markers.swap(0, 1);
        assert_eq!(marker_observations(&message), Err(ConvertError::Markers { found: 4 }));
        message.markers.swap(0, 1);
        message.markers[2].state = 9;
        assert_eq!(marker_observations(&message), Err(ConvertError::MarkerState { found: 9 }));
        message.markers.pop();
        assert_eq!(marker_observations(&message), Err(ConvertError::Markers { found: 3 }));
    }

    #[test]
    fn a_part_of_an_image_is_refused() {
        let camera = CameraModel::new(
            640,
            480,
            [600.0, 601.0, 320.0, 240.0],
            rig_model::Distortion::PlumbBob([0.1; 5]),
        )
        .unwrap();
        let mut message = camera_message("camera_optical", Stamp::from_nanos(0), &camera);
        assert_eq!(camera_model(&message), Ok(camera));
        message.roi.width = 320;
        assert!(matches!(camera_model(&message), Err(CameraModelError::Cropped { .. })));
    }

    proptest! {
        #[test]
        fn poses_come_back(t in some_isometry(), nanos in 0..i64::from(i32::MAX) * 1_000_000_000) {
            let frames = Frames::default();
            let sample = ClimberSample { stamp: Stamp::from_nanos(nanos), world_from_climber: t };
            let back = climber_sample(&climber_message(&sample, &frames), &frames).unwrap();
            prop_assert_eq!(back.stamp, sample.stamp);
            prop_assert!(near(&back.world_from_climber, &t));
            prop_assert!(near(&pose(&pose_message(&t), "p").unwrap(), &t));
        }

        #[test]
        fn markers_come_back(
            x in -1e4..1e4f64, y in -1e4..1e4f64, c in 0.0..9.0f64, area in 0.0..1e5f32, frames in any::<u16>(),
        ) {
            let marker = |state| MarkerObservation {
                state, occluded_frames: frames, centroid: Vector2::new(x, y),
                covariance: Matrix2::new(c, 0.1, 0.1, c), area,
            };
            let observations = MarkerObservations {
                stamp: Stamp::from_nanos(5),
                markers: PerColor([
                    marker(MarkerState::Detected), marker(MarkerState::Predicted),
                    marker(MarkerState::Lost), marker(MarkerState::Detected),
                ]),
            };
            prop_assert_eq!(marker_observations(&markers_message("c", &observations)).unwrap(), observations);
        }
    }
}
