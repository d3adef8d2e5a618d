//! The rig file: what was measured on the rig.
//!
//! A ROS 2 parameter file with the keys `frames`, `camera`, `imu` and `markers`; each node declares them among
//! its own parameters, the tools read them with [`Rig::from_yaml`]. An unknown key is an error, because it is a typing
//! mistake.

use crate::{
    marker::{MarkerColor, MarkerLayout, PerColor},
    parameters::{ParameterFile, ParameterFileError, ParameterMap, ParameterValue},
};
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector2};
use thiserror::Error;

/// Names of the frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frames {
    /// The initial point, z up.
    pub world: String,
    /// The climber unit on the ceiling.
    pub climber: String,
    /// The camera, z along the viewing direction.
    pub camera: String,
    /// The inertial unit's own axes.
    pub imu: String,
    /// The platform.
    pub volant: String,
}

impl Default for Frames {
    fn default() -> Self {
        Self {
            world: "world".into(),
            climber: "climber".into(),
            camera: "camera_optical".into(),
            imu: "imu".into(),
            volant: "volant".into(),
        }
    }
}

/// How the inertial unit sits on the platform, and how noisy it is.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuMounting {
    /// `volant` from `imu`.
    pub volant_from_imu: Isometry3<f64>,
    /// m/s²/√Hz.
    pub accelerometer_noise_density: f64,
    /// rad/s/√Hz.
    pub gyroscope_noise_density: f64,
}

/// The whole rig file.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    /// Names of the frames.
    pub frames: Frames,
    /// `climber` from `camera_optical`.
    pub climber_from_camera: Isometry3<f64>,
    /// The inertial unit.
    pub imu: ImuMounting,
    /// The markers on the platform.
    pub markers: MarkerLayout,
    /// What each marker's paper looks like to the camera: mean r, g, b of 0–255, where it was calibrated. Else a marker is told
    /// by the hue that its name says.
    pub colors: PerColor<Option<[f64; 3]>>,
}

/// What is wrong with a rig file.
#[derive(Debug, Error)]
pub enum RigError {
    /// Not a parameter file at all.
    #[error(transparent)]
    File(#[from] ParameterFileError),
    /// A key that must be there is not.
    #[error("the key `{key}` is missing; it must hold {expected}")]
    Missing {
        /// The flat key.
        key: String,
        /// What it must hold.
        expected: &'static str,
    },
    /// A key that nobody knows.
    #[error("the key `{key}` is not known{hint}; remove it or correct its spelling")]
    Unknown {
        /// The flat key.
        key: String,
        /// ` (did you mean ...?)` or nothing.
        hint: String,
    },
    /// A key with a value of another type.
    #[error("the key `{key}` is a {found}; it must hold {expected}")]
    Type {
        /// The flat key.
        key: String,
        /// The type found.
        found: &'static str,
        /// What it must hold.
        expected: &'static str,
    },
    /// A value that cannot be.
    #[error("the key `{key}` is {value}, but {requirement}")]
    Value {
        /// The flat key.
        key: String,
        /// The value found.
        value: String,
        /// What holds for such values.
        requirement: &'static str,
    },
}

/// A key of the rig file: its flat name, what it holds, its unit, and its default (`None`: must be given).
#[derive(Clone, Debug)]
pub struct RigKey {
    /// Flat name.
    pub name: &'static str,
    /// What it holds, with the unit.
    pub description: &'static str,
    /// The default, where there is one.
    pub default: Option<ParameterValue>,
}

const POSITION: &str = "three numbers x, y, z in metres";
const ORIENTATION: &str = "a unit quaternion x, y, z, w";
const FRAME: &str = "a frame id";
const NUMBER: &str = "a number";

/// Every key of the rig file, so that each node declares the same ones.
pub fn rig_keys() -> Vec<RigKey> {
    let text = |s: &str| Some(ParameterValue::String(s.to_owned()));
    let number = |x| Some(ParameterValue::Double(x));
    let numbers = |x: &[f64]| Some(ParameterValue::DoubleArray(x.to_vec()));
    let key = |name, description, default| RigKey { name, description, default };
    vec![
        key("frames.world", "frame id of the room", text("world")),
        key("frames.climber", "frame id of the climber unit", text("climber")),
        key("frames.camera", "frame id of the camera (optical axes)", text("camera_optical")),
        key("frames.imu", "frame id of the inertial unit", text("imu")),
        key("frames.volant", "frame id of the platform", text("volant")),
        key("camera.position", "climber_from_camera: x, y, z [m]", None),
        key("camera.orientation", "climber_from_camera: unit quaternion x, y, z, w", None),
        key("imu.position", "volant_from_imu: x, y, z [m]", numbers(&[0.0; 3])),
        key("imu.orientation", "volant_from_imu: unit quaternion x, y, z, w", numbers(&[0.0, 0.0, 0.0, 1.0])),
        key(
            "imu.accelerometer_noise_density",
            "white noise of the accelerometer [m/s^2/sqrt(Hz)]",
            number(0.002),
        ),
        key("imu.gyroscope_noise_density", "white noise of the gyroscope [rad/s/sqrt(Hz)]", number(0.00087)),
        key("markers.size", "side of each square [m]", None),
        key("markers.red", "centre of the red square in the volant frame: x, y, z [m]", None),
        key("markers.green", "centre of the green square in the volant frame: x, y, z [m]", None),
        key("markers.blue", "centre of the blue square in the volant frame: x, y, z [m]", None),
        key("markers.yellow", "centre of the yellow square in the volant frame: x, y, z [m]", None),
        key(
            "markers.colors.red",
            "the red paper as the camera sees it: r, g, b of 0 to 255; empty: not calibrated",
            numbers(&[]),
        ),
        key("markers.colors.green", "the same of the green paper", numbers(&[])),
        key("markers.colors.blue", "the same of the blue paper", numbers(&[])),
        key("markers.colors.yellow", "the same of the yellow paper", numbers(&[])),
    ]
}

impl Rig {
    /// From the text of a rig file. Blocks for all nodes (`/**`, `/*`) count; blocks of single nodes are left to those.
    ///
    /// # Errors
    /// What is wrong, with the key and what it must hold. The caller knows the file's name.
    pub fn from_yaml(text: &str) -> Result<Self, RigError> {
        // No node is called so: only the wildcard blocks match.
        let map = ParameterFile::parse(text)?.for_node("/_rig_file_");
        let known = rig_keys();
        if let Some(key) = map.keys().find(|k| !known.iter().any(|r| r.name == k.as_str())) {
            return Err(RigError::Unknown {
                key: key.clone(),
                hint: did_you_mean(key, known.iter().map(|r| r.name)),
            });
        }
        Self::from_parameters(&map)
    }

    /// From a node's flat parameters; keys of others in it are left alone.
    ///
    /// # Errors
    /// As [`Rig::from_yaml`].
    pub fn from_parameters(map: &ParameterMap) -> Result<Self, RigError> {
        let defaults = rig_keys();
        let r = Reader { map, defaults: &defaults };
        let centre = |name: &str| r.position(name).map(|t| Point3::from(t.vector));
        let rig = Self {
            frames: Frames {
                world: r.text("frames.world")?,
                climber: r.text("frames.climber")?,
                camera: r.text("frames.camera")?,
                imu: r.text("frames.imu")?,
                volant: r.text("frames.volant")?,
            },
            climber_from_camera: r.transform("camera")?,
            imu: ImuMounting {
                volant_from_imu: r.transform("imu")?,
                accelerometer_noise_density: r.positive("imu.accelerometer_noise_density")?,
                gyroscope_noise_density: r.positive("imu.gyroscope_noise_density")?,
            },
            markers: MarkerLayout {
                side: r.positive("markers.size")?,
                centres: PerColor([
                    centre("markers.red")?,
                    centre("markers.green")?,
                    centre("markers.blue")?,
                    centre("markers.yellow")?,
                ]),
            },
            colors: PerColor([
                r.color("markers.colors.red")?,
                r.color("markers.colors.green")?,
                r.color("markers.colors.blue")?,
                r.color("markers.colors.yellow")?,
            ]),
        };
        rig.check_markers()?;
        rig.check_colors()?;
        rig.check_frames()?;
        Ok(rig)
    }

    fn check_markers(&self) -> Result<(), RigError> {
        for (i, a) in MarkerColor::ALL.into_iter().enumerate() {
            for b in &MarkerColor::ALL[..i] {
                let distance = (self.markers.centres[a] - self.markers.centres[*b]).norm();
                if distance < self.markers.side {
                    return Err(RigError::Value {
                        key: format!("markers.{a}"),
                        value: format!("{:.4} m from the {b} one", distance),
                        requirement: "two markers are at least one side (markers.size) apart",
                    });
                }
            }
        }
        // A line of markers does not fix the turn about it.
        let c = &self.markers.centres.0;
        let spread = (1..4)
            .flat_map(|i| (1..4).map(move |j| (i, j)))
            .map(|(i, j)| (c[i] - c[0]).cross(&(c[j] - c[0])).norm())
            .fold(0.0, f64::max);
        if spread < self.markers.side * self.markers.side {
            return Err(RigError::Value {
                key: "markers".into(),
                value: "four centres on one line".into(),
                requirement: "the markers must span a plane, or the pose cannot be told",
            });
        }
        Ok(())
    }

    fn check_colors(&self) -> Result<(), RigError> {
        // The hue's direction in the plane across the grey axis, as a fraction of the brightness.
        let chroma = |[r, g, b]: [f64; 3]| {
            let v = Vector2::new(2.0 * r - g - b, 3f64.sqrt() * (g - b));
            v / (2.0 * r.max(g).max(b).max(1.0))
        };
        for (i, a) in MarkerColor::ALL.into_iter().enumerate() {
            let Some(rgb) = self.colors[a] else { continue };
            let key = || format!("markers.colors.{a}");
            let value = || format!("{rgb:?}");
            let own = chroma(rgb);
            if own.norm() < 0.15 {
                return Err(RigError::Value {
                    key: key(),
                    value: value(),
                    requirement: "a marker is told by its colour: it cannot be grey",
                });
            }
            for b in &MarkerColor::ALL[..i] {
                let Some(other) = self.colors[*b].map(chroma) else { continue };
                if own.angle(&other) < 15f64.to_radians() {
                    return Err(RigError::Value {
                        key: key(),
                        value: format!("{} (nearly the hue of markers.colors.{b})", value()),
                        requirement: "the four hues must differ by 15 degrees at least",
                    });
                }
            }
        }
        Ok(())
    }

    fn check_frames(&self) -> Result<(), RigError> {
        let f = &self.frames;
        let named = [
            ("frames.world", &f.world),
            ("frames.climber", &f.climber),
            ("frames.camera", &f.camera),
            ("frames.imu", &f.imu),
            ("frames.volant", &f.volant),
        ];
        for (i, (key, name)) in named.iter().enumerate() {
            let value = || format!("{name:?}");
            if name.is_empty() {
                return Err(RigError::Value {
                    key: (*key).into(),
                    value: value(),
                    requirement: "a frame id is not empty",
                });
            }
            if named[..i].iter().any(|(_, other)| other == name) {
                return Err(RigError::Value {
                    key: (*key).into(),
                    value: value(),
                    requirement: "two frames cannot bear one name",
                });
            }
        }
        Ok(())
    }
}

struct Reader<'a> {
    map: &'a ParameterMap,
    defaults: &'a [RigKey],
}

impl Reader<'_> {
    fn value(&self, key: &str, expected: &'static str) -> Result<&ParameterValue, RigError> {
        self.map
            .get(key)
            .or_else(|| self.defaults.iter().find(|d| d.name == key).and_then(|d| d.default.as_ref()))
            .ok_or_else(|| RigError::Missing { key: key.to_owned(), expected })
    }

    fn text(&self, key: &str) -> Result<String, RigError> {
        match self.value(key, FRAME)? {
            ParameterValue::String(s) => Ok(s.clone()),
            other => Err(RigError::Type { key: key.to_owned(), found: other.type_name(), expected: FRAME }),
        }
    }

    fn positive(&self, key: &str) -> Result<f64, RigError> {
        let value = self.value(key, NUMBER)?;
        let x = value.as_f64().ok_or(RigError::Type {
            key: key.to_owned(),
            found: value.type_name(),
            expected: NUMBER,
        })?;
        if x.is_finite() && x > 0.0 {
            Ok(x)
        } else {
            Err(RigError::Value {
                key: key.to_owned(),
                value: x.to_string(),
                requirement: "it must be greater than zero",
            })
        }
    }

    /// Three numbers of 0–255, or none at all.
    fn color(&self, key: &str) -> Result<Option<[f64; 3]>, RigError> {
        const COLOR: &str = "three numbers r, g, b of 0 to 255";
        let value = self.value(key, COLOR)?;
        let list = value.as_f64_array().ok_or(RigError::Type {
            key: key.to_owned(),
            found: value.type_name(),
            expected: COLOR,
        })?;
        match <[f64; 3]>::try_from(list.as_slice()) {
            _ if list.is_empty() => Ok(None),
            Ok(rgb) if rgb.iter().all(|v| (0.0..=255.0).contains(v)) => Ok(Some(rgb)),
            _ => Err(RigError::Value {
                key: key.to_owned(),
                value: format!("{list:?}"),
                requirement: "it takes three numbers r, g, b of 0 to 255",
            }),
        }
    }

    fn numbers<const N: usize>(&self, key: &str, expected: &'static str) -> Result<[f64; N], RigError> {
        let value = self.value(key, expected)?;
        let list = value.as_f64_array().ok_or(RigError::Type {
            key: key.to_owned(),
            found: value.type_name(),
            expected,
        })?;
        let numbers: [f64; N] = list.as_slice().try_into().map_err(|_| RigError::Value {
            key: key.to_owned(),
            value: format!("a list of {}", list.len()),
            requirement: if N == 3 {
                "it takes three numbers x, y, z in metres"
            } else {
                "it takes four numbers x, y, z, w"
            },
        })?;
        if numbers.iter().all(|x| x.is_finite()) {
            Ok(numbers)
        } else {
            Err(RigError::Value {
                key: key.to_owned(),
                value: format!("{numbers:?}"),
                requirement: "every number must be finite",
            })
        }
    }

    fn position(&self, key: &str) -> Result<Translation3<f64>, RigError> {
        let [x, y, z] = self.numbers(key, POSITION)?;
        if [x, y, z].iter().any(|v| v.abs() > 100.0) {
            return Err(RigError::Value {
                key: key.to_owned(),
                value: format!("{:?}", [x, y, z]),
                requirement: "positions on the rig are metres (not millimetres) and below 100 m",
            });
        }
        Ok(Translation3::new(x, y, z))
    }

    fn transform(&self, block: &str) -> Result<Isometry3<f64>, RigError> {
        let key = format!("{block}.orientation");
        let [x, y, z, w] = self.numbers(&key, ORIENTATION)?;
        let q = Quaternion::new(w, x, y, z);
        if (q.norm() - 1.0).abs() > 1e-3 {
            return Err(RigError::Value {
                key,
                value: format!("{:?} (length {:.4})", [x, y, z, w], q.norm()),
                requirement: "a unit quaternion x, y, z, w has length 1",
            });
        }
        Ok(Isometry3::from_parts(
            self.position(&format!("{block}.position"))?,
            UnitQuaternion::from_quaternion(q),
        ))
    }
}

/// ` (did you mean …?)` where a known name is near.
pub fn did_you_mean<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> String {
    let distance = |a: &str, b: &str| {
        let b: Vec<char> = b.chars().collect();
        let mut row: Vec<usize> = (0..=b.len()).collect();
        for (i, ca) in a.chars().enumerate() {
            let mut diagonal = row[0];
            row[0] = i + 1;
            for (j, cb) in b.iter().enumerate() {
                let cost = diagonal + usize::from(ca != *cb);
                diagonal = row[j + 1];
                row[j + 1] = cost.min(row[j] + 1).min(diagonal + 1);
            }
        }
        row[b.len()]
    };
    known
        .map(|k| (distance(name, k), k))
        .min()
        .filter(|(d, k)| *d <= (k.len() / 3).max(1))
        .map(|(_, k)| format!(" (did you mean `{k}`?)"))
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    const RIG: &str = "/**:
  ros__parameters:
    frames: {world: world, climber: climber, camera: camera_optical, imu: imu, volant: volant}
    camera:
      position: [0.0, 0.0, -0.10]
      orientation: [0.70710678, 0.70710678, 0.0, 0.0]
    imu:
      position: [0.0, 0.0, 0.0]
      orientation: [0.0, 0.0, 0.0, 1.0]
      accelerometer_noise_density: 0.002
      gyroscope_noise_density: 0.00087
    markers:
      size: 0.076
      red: [0.15, 0.15, 0.02]
      green: [-0.15, 0.15, 0.02]
      blue: [-0.15, -0.15, 0.02]
      yellow: [0.15, -0.15, 0.02]
";

    #[test]
    fn the_contract_s_example_is_read_and_looks_down_as_eq_6_says() {
        let rig = Rig::from_yaml(RIG).unwrap();
        let r = rig.climber_from_camera.rotation.to_rotation_matrix();
        let eq6 = nalgebra::Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0);
        assert!((r.matrix() - eq6).norm() < 1e-7);
        assert_eq!(rig.markers.centres[MarkerColor::Yellow], Point3::new(0.15, -0.15, 0.02));
        assert_eq!(rig.colors, PerColor([None; 4]));
    }

    #[test]
    fn calibrated_colours_are_read() {
        let text = RIG.replace(
            "size: 0.076",
            "size: 0.076\n      colors: {green: [30, 180, 60], blue: [20.5, 60, 190]}",
        );
        let colors = Rig::from_yaml(&text).unwrap().colors;
        assert_eq!(colors, PerColor([None, Some([30.0, 180.0, 60.0]), Some([20.5, 60.0, 190.0]), None]));
    }

    #[test]
    fn each_mistake_names_its_key() {
        for (from, to, key) in [
            ("size: 0.076", "sise: 0.076", "markers.sise"),
            ("size: 0.076", "", "markers.size"),
            ("size: 0.076", "size: big", "markers.size"),
            ("size: 0.076", "size: -1.0", "markers.size"),
            ("size: 0.076", "size: .nan", "markers.size"),
            ("red: [0.15, 0.15, 0.02]", "red: [0.15, 0.15]", "markers.red"),
            ("red: [0.15, 0.15, 0.02]", "red: [-0.15, 0.15, 0.02]", "markers.green"),
            ("red: [0.15, 0.15, 0.02]", "red: [150.0, 150.0, 20.0]", "markers.red"),
            ("red: [0.15, 0.15, 0.02]", "pink: [0.15, 0.15, 0.02]", "markers.pink"),
            ("[0.70710678, 0.70710678, 0.0, 0.0]", "[0.7, 0.7, 0.7, 0.0]", "camera.orientation"),
            ("[0.0, 0.0, 0.0, 1.0]", "[0.0, 0.0, 0.0]", "imu.orientation"),
            ("size: 0.076", "size: 0.076\n      colors: {red: [200, 40]}", "markers.colors.red"),
            ("size: 0.076", "size: 0.076\n      colors: {red: [90, 90, 95]}", "cannot be grey"),
            ("size: 0.076", "size: 0.076\n      colors: {red: [200, 40, 300]}", "0 to 255"),
            (
                "size: 0.076",
                "size: 0.076\n      colors: {red: [200, 40, 40], blue: [190, 45, 40]}",
                "nearly the hue of markers.colors.red",
            ),
            ("imu: imu", "imu: world", "frames.imu"),
            ("imu: imu", "imu: 3", "frames.imu"),
        ] {
            assert!(RIG.contains(from));
            let error = Rig::from_yaml(&RIG.replace(from, to)).unwrap_err().to_string();
            assert!(error.contains(key), "{to}: {error}");
        }
        let error = Rig::from_yaml(&RIG.replace("size:", "sise:")).unwrap_err().to_string();
        assert!(error.contains("did you mean `markers.size`"), "{error}");
    }
}
