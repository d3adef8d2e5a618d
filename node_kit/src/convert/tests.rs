//! Tests of the conversions.

use super::*;
use proptest::prelude::*;
use rig_model::CameraModel;

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
    let q = quaternion(&UnitQuaternion::from_axis_angle(
        &Vector3::z_axis(),
        std::f64::consts::FRAC_PI_2,
    ));
    let half = std::f64::consts::FRAC_1_SQRT_2;
    assert!((q.z - half).abs() < 1e-15 && (q.w - half).abs() < 1e-15 && q.x == 0.0 && q.y == 0.0);
}

#[test]
fn a_quaternion_of_zero_length_is_rejected() {
    for bad in [0.0, f64::NAN, f64::INFINITY] {
        let q = geometry::Quaternion { x: bad, y: 0.0, z: 0.0, w: 0.0 };
        assert!(rotation(&q, "q").is_err(), "{bad}");
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
fn foreign_frames_and_markers_are_rejected_by_name() {
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
    let rejected = |message: &_, reason: &str| {
        let error = marker_observations(message).unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
    };
    message.markers.swap(0, 1);
    rejected(&message, "4 markers, expected");
    message.markers.swap(0, 1);
    message.markers[2].state = 9;
    rejected(&message, "state is 9");
    message.markers.pop();
    rejected(&message, "3 markers, expected");
}

#[test]
fn a_cropped_image_is_rejected() {
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
    let error = camera_model(&message).unwrap_err().to_string();
    assert!(error.contains("a region of interest is set"), "{error}");
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
        x in -1e4..1e4f64, y in -1e4..1e4f64, c in 0.0..9.0f64, area in 0.0..1e5f32,
        frames in any::<u16>(),
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
        let message = markers_message("c", &observations);
        prop_assert_eq!(marker_observations(&message).unwrap(), observations);
    }
}
