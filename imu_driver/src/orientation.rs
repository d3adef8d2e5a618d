//! Orientation of the device → rotation from the sensor frame to east-north-up (REP-103, REP-145).

use crate::protocol::{Attitude, GlobalFrame, Orientation};
use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion};
use std::f64::consts::FRAC_1_SQRT_2;

/// Rotation from a global frame of the device to east-north-up.
pub fn enu_from_global(frame: GlobalFrame) -> UnitQuaternion<f64> {
    let q = match frame {
        GlobalFrame::EastNorthUp => Quaternion::identity(),
        // 90° about up: north (x) is the second axis, west (y) the negative first one.
        GlobalFrame::NorthWestUp => Quaternion::new(FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2),
        // 180° about the bisector of north and east.
        GlobalFrame::NorthEastDown => Quaternion::new(0.0, FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0),
    };
    UnitQuaternion::new_unchecked(q)
}

/// Rotation of the quaternion w, x, y, z; `None` if its norm differs from 1 by more than 5 %.
pub fn rotation_of([w, x, y, z]: [f64; 4]) -> Option<UnitQuaternion<f64>> {
    let q = Quaternion::new(w, x, y, z);
    let norm = q.norm();
    ((norm - 1.0).abs() <= 0.05).then(|| UnitQuaternion::new_unchecked(q / norm))
}

/// Rotation from the sensor frame to east-north-up.
///
/// `None` if the orientation is not finite, or differs from a unit quaternion or orthonormal matrix
/// by more than 5 %.
pub fn enu_from_imu(orientation: &Orientation) -> Option<UnitQuaternion<f64>> {
    let global_from_imu = match orientation.attitude {
        Attitude::Quaternion(q) => rotation_of(q)?,
        Attitude::Euler(degrees) => {
            if degrees.iter().any(|d| !d.is_finite() || d.abs() > 720.0) {
                return None;
            }
            let [roll, pitch, yaw] = degrees.map(f64::to_radians);
            UnitQuaternion::from_euler_angles(roll, pitch, yaw)
        }
        Attitude::Matrix(columns) => {
            let m = Matrix3::from_column_slice(&columns);
            let defect = (m.transpose() * m - Matrix3::identity()).norm();
            if defect.is_nan() || defect > 0.05 || m.determinant() <= 0.0 {
                return None;
            }
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(m))
        }
    };
    Some(enu_from_global(orientation.frame) * global_from_imu)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn axes_of_all_global_frames_map_to_east_north_up() {
        let nwu = enu_from_global(GlobalFrame::NorthWestUp);
        assert!((nwu * Vector3::x() - Vector3::y()).norm() < 1e-12);
        assert!((nwu * Vector3::y() + Vector3::x()).norm() < 1e-12);
        let ned = enu_from_global(GlobalFrame::NorthEastDown);
        assert!((ned * Vector3::x() - Vector3::y()).norm() < 1e-12);
        assert!((ned * Vector3::y() - Vector3::x()).norm() < 1e-12);
        assert!((ned * Vector3::z() + Vector3::z()).norm() < 1e-12);
    }

    #[test]
    fn three_forms_of_a_recorded_orientation_are_equal() {
        // Matrix and quaternion of one recorded message (east-north-up).
        let frame = GlobalFrame::EastNorthUp;
        let from_matrix = enu_from_imu(&Orientation {
            attitude: Attitude::Matrix([
                -0.9999539256095886,
                0.009366998448967934,
                0.0020883751567453146,
                -0.000489559955894947,
                0.16753709316253662,
                -0.985865592956543,
                -0.009584481827914715,
                -0.9858212471008301,
                -0.1675248146057129,
            ]),
            frame,
        })
        .unwrap();
        let from_quaternion = enu_from_imu(&Orientation {
            attitude: Attitude::Quaternion([
                0.0038194628432393074,
                -0.002904776716604829,
                -0.7640379071235657,
                0.6451534628868103,
            ]),
            frame,
        })
        .unwrap();
        assert!(from_matrix.angle_to(&from_quaternion) < 1e-4);
        let (roll, pitch, yaw) = from_quaternion.euler_angles();
        let degrees = [roll, pitch, yaw].map(f64::to_degrees);
        let from_euler =
            enu_from_imu(&Orientation { attitude: Attitude::Euler(degrees), frame }).unwrap();
        assert!(from_euler.angle_to(&from_quaternion) < 1e-9);
    }

    #[test]
    fn invalid_orientations_are_rejected() {
        let frame = GlobalFrame::NorthWestUp;
        for attitude in [
            Attitude::Quaternion([0.0; 4]),
            Attitude::Quaternion([f64::NAN, 0.0, 0.0, 1.0]),
            Attitude::Euler([f64::INFINITY, 0.0, 0.0]),
            Attitude::Matrix([0.0; 9]),
            Attitude::Matrix([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0]),
        ] {
            assert_eq!(enu_from_imu(&Orientation { attitude, frame }), None);
        }
    }
}
