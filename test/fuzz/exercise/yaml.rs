//! Text files: parameters and the rig, a camera's calibration, a bag folder's metadata.

use bag::{Qos, files_named_by, qos_from_yaml, qos_to_yaml};
use rig_model::{CameraModel, Rig};
use ros_parameters::{ParameterFile, ParameterValue, parse_value, yaml};

pub const WORDS: &[&[u8]] = &[
    b"/**:",
    b"ros__parameters:",
    b"&a ",
    b"*a",
    b"<<: ",
    b"!!str ",
    b"!t ",
    b"- ",
    b"? ",
    b": ",
    b"[",
    b"]",
    b"{",
    b"}",
    b"|\n",
    b">-\n",
    b"---\n",
    b"...\n",
    b"%YAML 1.1\n",
    b"~",
    b".nan",
    b"-.inf",
    b"1e999",
    b"0x7fffffffffffffff",
    b"18446744073709551616",
    b"\"\\x00\"",
    b"\xEF\xBB\xBF",
    b"\xC2\x85",
    b"#",
    b"orientation: [0, 0, 0, 1]",
];

fn texts(data: &[u8]) -> Option<&str> {
    std::str::from_utf8(data).ok()
}

/// A parameter file, as each node takes it, as the rig, and its lines as values of `-p
/// name:=value`.
pub fn parameters(data: &[u8]) {
    let Some(text) = texts(data) else { return };
    for line in text.lines().take(4) {
        if let Ok(ParameterValue::Double(x)) = parse_value("name", line) {
            let _ = x.to_string();
        }
    }
    // All readers go through this one.
    let Ok(value) = yaml::parse(text) else { return };
    assert!(size_of_tree(&value) <= 2 * text.len() + 64);
    if let Ok(file) = ParameterFile::parse(text) {
        for node in ["/pose_fusion", "/rig1/a/imu_driver"] {
            for (name, value) in file.for_node(node) {
                let shown = value.to_string();
                assert!(!shown.is_empty(), "{name}");
                let _ = (value.as_f64(), value.as_f64_array());
            }
        }
    }
    if let Ok(rig) = Rig::from_yaml(text) {
        assert!(rig.markers.side.is_finite() && rig.markers.side > 0.0);
        assert!((rig.climber_from_camera.rotation.norm() - 1.0).abs() < 1e-9);
        assert!(
            rig.markers
                .centers
                .0
                .iter()
                .flat_map(|c| c.coords.iter().copied().collect::<Vec<_>>())
                .all(f64::is_finite)
        );
    }
}

fn size_of_tree(value: &serde_yaml_ng::Value) -> usize {
    use serde_yaml_ng::Value as V;
    match value {
        V::String(s) => 1 + s.len(),
        V::Sequence(items) => 1 + items.iter().map(size_of_tree).sum::<usize>(),
        V::Mapping(map) => {
            1 + map.iter().map(|(k, v)| size_of_tree(k) + size_of_tree(v)).sum::<usize>()
        }
        V::Tagged(tagged) => 1 + size_of_tree(&tagged.value),
        _ => 1,
    }
}

const RIG: &str = "/**:
  ros__parameters:
    frames: {world: world, climber: climber, camera: camera_optical, imu: imu, volant: volant}
    camera:
      position: [0.0, 0.0, -0.10]
      orientation: [0.70710678, 0.70710678, 0.0, 0.0]
    imu:
      position: [0, 0, 0]
      orientation: [0.0, 0.0, 0.0, 1.0]
      accelerometer_noise_density: 0.002
    markers:
      size: 0.076
      red: [0.15, 0.15, 0.02]
      green: [-0.15, 0.15, 0.02]
      blue: [-0.15, -0.15, 0.02]
      yellow: [0.15, -0.15, 0.02]
";

pub fn parameter_seeds() -> Vec<Vec<u8>> {
    [
        RIG,
        "est: {ros__parameters: {a: {b: 2}}}\n/**: {ros__parameters: {a: {b: 1, c: [0, 0.5]}, d: \
         hello}}\nrig1: {est: {ros__parameters: {d: x}}}",
        "/**:\n  ros__parameters:\n    a: &x [1, 2, 3]\n    b: *x\n    c: !!float 3\n    d: \
         |\n      text\n    e: [true, false]\n    f: ['x', \"y\"]\n",
        "/ns/*:\n  node:\n    ros__parameters: ~\n",
    ]
    .map(|text| text.as_bytes().to_vec())
    .to_vec()
}

/// Parses a camera calibration and uses it for pixels near and far.
pub fn calibration(data: &[u8]) {
    let Some(text) = texts(data) else { return };
    if let Ok(camera) = CameraModel::from_calibration_file(text) {
        use_camera(&camera);
    }
}

/// Points through a lens and back: finite where there is an answer.
pub fn use_camera(camera: &CameraModel) {
    use nalgebra::{Point3, Vector2};
    for point in [
        [0.0, 0.0, 1.0],
        [0.3, -0.2, 1.5],
        [1e6, -1e6, 1e-3],
        [f64::NAN, 0.0, 1.0],
        [1.0, 1.0, -1.0],
    ] {
        if let Some((pixel, jacobian)) = camera.project_with_jacobian(&Point3::from(point)) {
            let _ = (pixel.norm(), jacobian.norm());
        }
    }
    let (width, height) = camera.size();
    for pixel in [
        [0.0, 0.0],
        [f64::from(width), f64::from(height)],
        [f64::from(width) / 2.0, 3.0],
        [-1e9, 1e9],
    ] {
        if let Some(ray) = camera.ray(&Vector2::from(pixel)) {
            assert!((ray.norm() - 1.0).abs() < 1e-6 && ray.z > 0.0, "{ray:?}");
        }
    }
}

pub fn calibration_seeds() -> Vec<Vec<u8>> {
    let file = |model: &str, d: &str| {
        format!(
            "image_width: 640\nimage_height: 480\ncamera_name: ceiling\ncamera_matrix: {{rows: 3, \
             cols: 3, data: [591.0, 0.0, 319.0, 0.0, 589.0, 235.0, 0.0, 0.0, 1.0]}}\n\
             distortion_model: {model}\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: \
             {d}\n"
        )
        .into_bytes()
    };
    vec![
        file("plumb_bob", "[-0.23, 0.08, 0.0007, -0.0004, -0.006]"),
        file("rational_polynomial", "[1.5, -0.3, 0.001, 0.002, 0.1, 1.8, 0.2, -0.1]"),
        file("equidistant", "[-0.01, 0.02, -0.003, 0.0004]"),
        file("\"\"", "[]"),
    ]
}

/// A rosbag2 folder's metadata, and the QoS profiles in bags.
pub fn metadata(data: &[u8]) {
    let Some(text) = texts(data) else { return };
    if let Ok(files) = files_named_by(text) {
        assert!(!files.is_empty());
        for name in files {
            assert!(
                !name.is_empty()
                    && !name.starts_with('/')
                    && !name.split('/').any(|part| part == ".."),
                "{name}"
            );
        }
    }
    let profile = qos_from_yaml(text);
    assert!((1..=1000).contains(&profile.depth));
    assert_eq!(qos_from_yaml(&qos_to_yaml(&profile)), profile);
}

pub fn metadata_seeds() -> Vec<Vec<u8>> {
    vec![
        b"rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: mcap\n  duration: \
          {nanoseconds: 5}\n  message_count: 1\n  topics_with_message_count: []\n  \
          compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n    - \
          run_0.mcap\n    - run_1.mcap\n"
            .to_vec(),
        b"rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: \
          [a/b.mcap.zstd], compression_format: zstd, compression_mode: FILE}"
            .to_vec(),
        b"rosbag2_bagfile_information: {storage_identifier: sqlite3, relative_file_paths: \
          [../x.db3]}"
            .to_vec(),
        qos_to_yaml(&Qos::LATCHED).into_bytes(),
        b"- history: 3\n  depth: 0\n  reliability: 2\n  durability: 1\n".to_vec(),
    ]
}
