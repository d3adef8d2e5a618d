//! Keys of the rig file: declaration, defaults and reading.

use super::RigError;
use crate::topics::frames;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use ros_parameters::{Descriptor, ParameterKind, ParameterMap, ParameterValue};

const COLOR: &str = "three numbers r, g, b of 0 to 255";
/// Largest coordinate of a position, m: rejects values in millimeters.
const LARGEST_POSITION: f64 = 100.0;

/// Limits of the markers' size, m: reject one in millimeters or centimeters, and meters at a prompt
/// for millimeters.
const MARKER_SIZES: std::ops::RangeInclusive<f64> = 0.005..=0.5;

/// All keys of the rig file, which each node declares among its parameters.
pub fn rig_keys() -> Vec<Descriptor> {
    let key = |name: &str, description: &str, kind, default| {
        Descriptor::new(name, kind, default, format!("Rig file: {description}."))
    };
    let required = |name, description| key(name, description, ParameterKind::DoubleArray, None);
    let text = |name, description, s: &str| {
        key(name, description, ParameterKind::String, Some(ParameterValue::String(s.to_owned())))
    };
    let number = |name, description, x| {
        key(name, description, ParameterKind::Double, Some(ParameterValue::Double(x)))
    };
    let numbers = |name, description, x: &[f64]| {
        let default = Some(ParameterValue::DoubleArray(x.to_vec()));
        key(name, description, ParameterKind::DoubleArray, default)
    };
    vec![
        text("frames.world", "frame id of the world", frames::WORLD),
        text("frames.climber", "frame id of the climber unit", frames::CLIMBER),
        text("frames.camera", "frame id of the camera (optical axes)", frames::CAMERA),
        text("frames.imu", "frame id of the IMU", frames::IMU),
        text("frames.volant", "frame id of the platform", frames::VOLANT),
        required("camera.position", "climber_from_camera: x, y, z [m]"),
        required("camera.orientation", "climber_from_camera: unit quaternion x, y, z, w"),
        numbers("imu.position", "volant_from_imu: x, y, z [m]", &[0.0; 3]),
        numbers(
            "imu.orientation",
            "volant_from_imu: unit quaternion x, y, z, w",
            &[0.0, 0.0, 0.0, 1.0],
        ),
        number(
            "imu.accelerometer_noise_density",
            "white noise of the accelerometer [m/s^2/sqrt(Hz)]",
            0.002,
        ),
        number(
            "imu.gyroscope_noise_density",
            "white noise of the gyroscope [rad/s/sqrt(Hz)]",
            0.00087,
        ),
        key("markers.size", "side of each square [m]", ParameterKind::Double, None),
        required("markers.red", "center of the red square in the volant frame: x, y, z [m]"),
        required("markers.green", "center of the green square in the volant frame: x, y, z [m]"),
        required("markers.blue", "center of the blue square in the volant frame: x, y, z [m]"),
        required("markers.yellow", "center of the yellow square in the volant frame: x, y, z [m]"),
        numbers(
            "markers.colors.red",
            "the red paper as the camera sees it: r, g, b of 0 to 255; empty: not calibrated",
            &[],
        ),
        numbers("markers.colors.green", "the same of the green paper", &[]),
        numbers("markers.colors.blue", "the same of the blue paper", &[]),
        numbers("markers.colors.yellow", "the same of the yellow paper", &[]),
    ]
}

/// Reads values of the rig file from flat parameters, with the defaults of [`rig_keys`].
pub(super) struct Reader(ParameterMap);

impl Reader {
    pub(super) fn new(map: &ParameterMap) -> Self {
        let defaults = rig_keys().into_iter().filter_map(|k| Some((k.name, k.default?)));
        Self(defaults.chain(map.clone()).collect())
    }

    /// Value of `key`, converted by `convert`.
    fn get<T>(
        &self,
        key: &str,
        expected: &str,
        convert: impl Fn(&ParameterValue) -> Option<T>,
    ) -> Result<T, RigError> {
        let invalid =
            |found: &str| RigError(format!("the key `{key}` is {found}; it must hold {expected}"));
        let value = self.0.get(key).ok_or_else(|| invalid("missing"))?;
        convert(value).ok_or_else(|| invalid(&format!("a {}", ParameterKind::of(value).name())))
    }

    pub(super) fn text(&self, key: &str) -> Result<String, RigError> {
        self.get(key, "a frame id", |value| match value {
            ParameterValue::String(text) => Some(text.clone()),
            _ => None,
        })
    }

    pub(super) fn positive(&self, key: &str) -> Result<f64, RigError> {
        let x = self.get(key, "a number", ParameterValue::as_f64)?;
        if x.is_finite() && x > 0.0 {
            return Ok(x);
        }
        Err(RigError::value(key, x, "it must be greater than zero"))
    }

    /// `markers.size`.
    pub(super) fn marker_size(&self) -> Result<f64, RigError> {
        let key = "markers.size";
        let size = self.positive(key)?;
        if MARKER_SIZES.contains(&size) {
            return Ok(size);
        }
        let requirement = "0.005 to 0.5 m; the size is in meters, not millimeters";
        Err(RigError::value(key, format!("{size} m"), requirement))
    }

    /// Three numbers of 0–255; `None` for an empty list.
    pub(super) fn color(&self, key: &str) -> Result<Option<[f64; 3]>, RigError> {
        let list = self.get(key, COLOR, ParameterValue::as_f64_array)?;
        match <[f64; 3]>::try_from(list.as_slice()) {
            _ if list.is_empty() => Ok(None),
            Ok(rgb) if rgb.iter().all(|v| (0.0..=255.0).contains(v)) => Ok(Some(rgb)),
            _ => Err(RigError::value(key, format!("{list:?}"), COLOR)),
        }
    }

    fn numbers<const N: usize>(&self, key: &str, expected: &str) -> Result<[f64; N], RigError> {
        let list = self.get(key, expected, ParameterValue::as_f64_array)?;
        let numbers: [f64; N] = list.as_slice().try_into().map_err(|_| {
            RigError::value(key, format!("a list of {} numbers", list.len()), expected)
        })?;
        if numbers.iter().all(|x| x.is_finite()) {
            return Ok(numbers);
        }
        Err(RigError::value(key, format!("{numbers:?}"), "every number must be finite"))
    }

    pub(super) fn position(&self, key: &str) -> Result<Translation3<f64>, RigError> {
        let position: [f64; 3] = self.numbers(key, "three numbers x, y, z in meters")?;
        if position.iter().any(|v| v.abs() > LARGEST_POSITION) {
            let requirement =
                "positions are in meters (not millimeters or centimeters) and within ±100 m";
            return Err(RigError::value(key, format!("{position:?}"), requirement));
        }
        Ok(Translation3::from(position))
    }

    /// The transform `block.position`, `block.orientation`.
    pub(super) fn transform(&self, block: &str) -> Result<Isometry3<f64>, RigError> {
        let key = format!("{block}.orientation");
        let [x, y, z, w] = self.numbers(&key, "a unit quaternion x, y, z, w")?;
        let q = Quaternion::new(w, x, y, z);
        if (q.norm() - 1.0).abs() > 1e-3 {
            let value = format!("{:?} (length {:.4})", [x, y, z, w], q.norm());
            let requirement = "a unit quaternion x, y, z, w has length 1";
            return Err(RigError::value(&key, value, requirement));
        }
        let position = self.position(&format!("{block}.position"))?;
        Ok(Isometry3::from_parts(position, UnitQuaternion::from_quaternion(q)))
    }
}
