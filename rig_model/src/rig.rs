//! The rig file: frames, mounting of camera and IMU, IMU noise, markers.
//!
//! A ROS 2 parameter file with the keys `frames`, `camera`, `imu` and `markers`. Each node declares
//! them among its parameters ([`rig_keys`]); tools read the file with [`Rig::from_yaml`]. An
//! unknown key is an error, because it is a typing mistake; parameters of every node
//! (`use_sim_time`, …) are ignored.

mod keys;

pub use keys::rig_keys;

use crate::{
    marker::{MarkerColor, MarkerLayout, PerColor},
    topics::frames,
};
use keys::Reader;
use nalgebra::{Isometry3, Point3, Vector2};
use ros_parameters::{ParameterFile, ParameterMap};
use std::fmt;
use thiserror::Error;

/// Frame ids.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frames {
    /// Initial point, z up.
    pub world: String,
    /// Climber on the ceiling.
    pub climber: String,
    /// Camera, z along the viewing direction, x right, y down.
    pub camera: String,
    /// Axes of the IMU.
    pub imu: String,
    /// Platform.
    pub volant: String,
}

impl Default for Frames {
    fn default() -> Self {
        Self {
            world: frames::WORLD.into(),
            climber: frames::CLIMBER.into(),
            camera: frames::CAMERA.into(),
            imu: frames::IMU.into(),
            volant: frames::VOLANT.into(),
        }
    }
}

/// Mounting and noise of the IMU.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuMounting {
    /// Transform from `imu` to `volant`.
    pub volant_from_imu: Isometry3<f64>,
    /// White noise of the accelerometer, m/s²/√Hz.
    pub accelerometer_noise_density: f64,
    /// White noise of the gyroscope, rad/s/√Hz.
    pub gyroscope_noise_density: f64,
}

/// Content of the rig file.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    /// Frame ids.
    pub frames: Frames,
    /// Transform from `camera_optical` to `climber`.
    pub climber_from_camera: Isometry3<f64>,
    /// Mounting and noise of the IMU.
    pub imu: ImuMounting,
    /// Markers on the platform.
    pub markers: MarkerLayout,
    /// Mean r, g, b (0–255) of each marker in camera images; `None` if not calibrated.
    ///
    /// Without calibration a marker is detected by the hue of its name.
    pub colors: PerColor<Option<[f64; 3]>>,
}

/// Invalid rig file: why it is not a parameter file, or which flat key is missing, unknown or has
/// an invalid value, and what is valid.
#[derive(Debug, Error)]
#[error("{0}")]
pub struct RigError(String);

impl Rig {
    /// Parses the text of a rig file: its blocks for all nodes (`/**`, `/*`).
    ///
    /// # Errors
    /// [`RigError`] with the key and its valid values, without the name of the file.
    pub fn from_yaml(text: &str) -> Result<Self, RigError> {
        // No node has this name: only the wildcard blocks match.
        let file = ParameterFile::parse(text).map_err(|e| RigError(e.to_string()))?;
        let map = file.for_node("/_rig_file_");
        let known = rig_keys();
        let is_known = |key: &str| is_of_every_node(key) || known.iter().any(|r| r.name == key);
        if let Some(key) = map.keys().find(|key| !is_known(key)) {
            let hint = did_you_mean(key, known.iter().map(|r| r.name.as_str()));
            return Err(RigError(format!(
                "the key `{key}` is unknown{hint}; remove it, correct its spelling, or move it to \
                 the block of its node (`/**/pose_fusion`)"
            )));
        }
        Self::from_parameters(&map)
    }

    /// Reads the rig from the flat parameters of a node; other keys are ignored.
    ///
    /// # Errors
    /// As [`Rig::from_yaml`].
    pub fn from_parameters(map: &ParameterMap) -> Result<Self, RigError> {
        let r = Reader::new(map);
        let center = |name: &str| r.position(name).map(|t| Point3::from(t.vector));
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
                side: r.marker_size()?,
                centers: PerColor([
                    center("markers.red")?,
                    center("markers.green")?,
                    center("markers.blue")?,
                    center("markers.yellow")?,
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
        check_colors(&rig.colors)?;
        rig.check_frames()?;
        Ok(rig)
    }

    fn check_markers(&self) -> Result<(), RigError> {
        for (i, a) in MarkerColor::ALL.into_iter().enumerate() {
            for b in &MarkerColor::ALL[..i] {
                let distance = (self.markers.centers[a] - self.markers.centers[*b]).norm();
                if distance < self.markers.side {
                    return Err(RigError::value(
                        &format!("markers.{a}"),
                        format!("{distance:.4} m from markers.{b}"),
                        "markers are at least one side (markers.size) apart",
                    ));
                }
            }
        }
        // Collinear markers do not determine the rotation about their line.
        let c = &self.markers.centers.0;
        let spread = (1..4)
            .flat_map(|i| (1..4).map(move |j| (i, j)))
            .map(|(i, j)| (c[i] - c[0]).cross(&(c[j] - c[0])).norm())
            .fold(0.0, f64::max);
        if spread < self.markers.side * self.markers.side {
            return Err(RigError::value(
                "markers",
                "four centers on one line",
                "the markers span a plane; otherwise the pose is not observable",
            ));
        }
        Ok(())
    }

    fn check_frames(&self) -> Result<(), RigError> {
        let f = &self.frames;
        let names = [&f.world, &f.climber, &f.camera, &f.imu, &f.volant];
        let keys = ["world", "climber", "camera", "imu", "volant"];
        for (i, (name, key)) in names.into_iter().zip(keys).enumerate() {
            let requirement = if name.is_empty() {
                "a frame id that is not empty"
            } else if names[..i].contains(&name) {
                "a different frame id for each frame"
            } else {
                continue;
            };
            let key = format!("frames.{key}");
            return Err(RigError::value(&key, format!("{name:?}"), requirement));
        }
        Ok(())
    }
}

impl RigError {
    fn value(key: &str, value: impl fmt::Display, requirement: &str) -> Self {
        Self(format!("the key `{key}` is {value}; valid: {requirement}"))
    }
}

/// Checks that colors distinguish the markers: each has a hue, different from the others'.
///
/// # Errors
/// [`RigError`] with the key of a color that does not.
pub fn check_colors(colors: &PerColor<Option<[f64; 3]>>) -> Result<(), RigError> {
    // Direction of the hue in the plane normal to the gray axis, relative to the brightness.
    let chroma = |[r, g, b]: [f64; 3]| {
        let v = Vector2::new(2.0 * r - g - b, 3f64.sqrt() * (g - b));
        v / (2.0 * r.max(g).max(b).max(1.0))
    };
    for (i, a) in MarkerColor::ALL.into_iter().enumerate() {
        let Some(rgb) = colors[a] else { continue };
        let key = format!("markers.colors.{a}");
        let own = chroma(rgb);
        if own.norm() < 0.15 {
            let requirement = "a color with a hue: gray does not identify a marker";
            return Err(RigError::value(&key, format!("{rgb:?}"), requirement));
        }
        for b in &MarkerColor::ALL[..i] {
            let Some(other) = colors[*b].map(chroma) else { continue };
            if own.angle(&other) < 15f64.to_radians() {
                return Err(RigError::value(
                    &key,
                    format!("{rgb:?} (nearly the hue of markers.colors.{b})"),
                    "the hues differ by at least 15 degrees",
                ));
            }
        }
    }
    Ok(())
}

/// Whether a parameter is one that every node has beside the rig: a block for all nodes may set it.
fn is_of_every_node(key: &str) -> bool {
    let names = ["use_sim_time", "autostart", "start_type_description_service"];
    names.contains(&key) || key.starts_with("qos_overrides.")
}

/// Number of characters to insert, remove or replace to get from `a` to `b`.
pub fn edit_distance(a: &str, b: &str) -> usize {
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
}

/// Returns ` (did you mean …?)` with the known name of the smallest edit distance, if it is small.
pub fn did_you_mean<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> String {
    known
        .map(|k| (edit_distance(name, k), k))
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
    fn the_documented_example_is_read_and_looks_down_as_in_eq_6() {
        let rig = Rig::from_yaml(RIG).unwrap();
        let r = rig.climber_from_camera.rotation.to_rotation_matrix();
        let eq6 = nalgebra::Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0);
        assert!((r.matrix() - eq6).norm() < 1e-7);
        assert_eq!(rig.markers.centers[MarkerColor::Yellow], Point3::new(0.15, -0.15, 0.02));
        assert_eq!(rig.colors, PerColor([None; 4]));
    }

    #[test]
    fn calibrated_colors_are_read() {
        let text = RIG.replace(
            "size: 0.076",
            "size: 0.076\n      colors: {green: [30, 180, 60], blue: [20.5, 60, 190]}",
        );
        let colors = Rig::from_yaml(&text).unwrap().colors;
        assert_eq!(
            colors,
            PerColor([None, Some([30.0, 180.0, 60.0]), Some([20.5, 60.0, 190.0]), None])
        );
    }

    #[test]
    fn parameters_of_every_node_are_ignored() {
        let more = "    use_sim_time: true
    autostart: false
    start_type_description_service: false
    qos_overrides: {/volant/imu/data: {publisher: {depth: 20}}}
";
        let rig = Rig::from_yaml(&format!("{RIG}{more}")).unwrap();
        assert_eq!(rig, Rig::from_yaml(RIG).unwrap());
        let error = Rig::from_yaml(&format!("{RIG}    use_sim_tim: true\n")).unwrap_err();
        assert!(error.to_string().contains("`use_sim_tim` is unknown"), "{error}");
    }

    #[test]
    fn each_error_names_its_key() {
        for (from, to, key) in [
            ("size: 0.076", "sise: 0.076", "markers.sise"),
            ("size: 0.076", "", "markers.size"),
            ("size: 0.076", "size: big", "markers.size"),
            ("size: 0.076", "size: -1.0", "markers.size"),
            ("size: 0.076", "size: .nan", "markers.size"),
            ("size: 0.076", "size: 76.0", "`markers.size` is 76 m; valid: 0.005 to 0.5 m"),
            ("size: 0.076", "size: 0.000076", "`markers.size` is 0.000076 m"),
            ("red: [0.15, 0.15, 0.02]", "red: [0.15, 0.15]", "markers.red"),
            ("red: [0.15, 0.15, 0.02]", "red: [-0.15, 0.15, 0.02]", "markers.green"),
            ("red: [0.15, 0.15, 0.02]", "red: [150.0, 150.0, 20.0]", "markers.red"),
            ("red: [0.15, 0.15, 0.02]", "pink: [0.15, 0.15, 0.02]", "markers.pink"),
            ("[0.70710678, 0.70710678, 0.0, 0.0]", "[0.7, 0.7, 0.7, 0.0]", "camera.orientation"),
            ("[0.0, 0.0, 0.0, 1.0]", "[0.0, 0.0, 0.0]", "imu.orientation"),
            ("size: 0.076", "size: 0.076\n      colors: {red: [200, 40]}", "markers.colors.red"),
            (
                "size: 0.076",
                "size: 0.076\n      colors: {red: [90, 90, 95]}",
                "does not identify a marker",
            ),
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
