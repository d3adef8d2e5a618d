//! Calibration of the camera on rendered boards with truth, and on real boards against OpenCV's
//! published result.

use bag::{BagWriter, Qos, Topic, WriteOptions};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use node_kit::{NodeContext, NodeError, Process, QosPreset, environment::Network};
use opencv::{core, imgcodecs, prelude::*};
use rig_model::{CameraModel, Distortion};
use std::{path::Path, process::Command, time::Duration};
use volant_msgs::sensor_msgs::msg::CompressedImage;

const SQUARE: f64 = 0.03;

/// Brightness of a board with 10×7 squares and a white border at a point of its plane (m from the
/// first inner corner).
fn board_light(x: f64, y: f64) -> f64 {
    let (column, row) = ((x / SQUARE).floor() as i64 + 1, (y / SQUARE).floor() as i64 + 1);
    if (0..10).contains(&column) && (0..7).contains(&row) {
        if (column + row) % 2 == 0 { 35.0 } else { 215.0 }
    } else if (-1..11).contains(&column) && (-1..8).contains(&row) {
        215.0
    } else {
        120.0
    }
}

/// Renders an image with 4×4 rays per pixel through the lens.
fn render(
    rays: &[Vector2<f64>],
    camera: &CameraModel,
    pose: &Isometry3<f64>,
    seed: u64,
) -> core::Mat {
    let (width, height) = (camera.size().0 as usize, camera.size().1 as usize);
    let board_from_camera = pose.inverse();
    let origin = board_from_camera * Point3::origin();
    let mut random = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut noise = || {
        // Sum of four uniforms: approximately normal with standard deviation 1.
        (0..4)
            .map(|_| {
                random ^= random << 13;
                random ^= random >> 7;
                random ^= random << 17;
                (random >> 11) as f64 / (1u64 << 53) as f64 - 0.5
            })
            .sum::<f64>()
            * 3f64.sqrt()
    };
    let mut data = vec![0u8; width * height];
    for (pixel, chunk) in data.iter_mut().zip(rays.chunks(16)) {
        let sum: f64 = chunk
            .iter()
            .map(|ray| {
                let direction = board_from_camera.rotation * Vector3::new(ray.x, ray.y, 1.0);
                let scale = -origin.z / direction.z;
                board_light(origin.x + scale * direction.x, origin.y + scale * direction.y)
            })
            .sum();
        *pixel = (sum / 16.0 + 2.0 * noise() + 0.5).clamp(0.0, 255.0) as u8;
    }
    let flat = core::Mat::from_slice(&data).unwrap();
    flat.reshape(1, height as i32).unwrap().try_clone().unwrap()
}

fn calibrate(folder: &Path, arguments: &[&str]) -> (bool, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_volant-calibrate"))
        .arg("camera")
        .arg(folder)
        .args(arguments)
        .env("ROS_DOMAIN_ID", DOMAIN.to_string())
        .output()
        .unwrap();
    (
        output.status.success(),
        String::from_utf8_lossy(&output.stdout).into_owned(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

/// Writes the images of a folder as messages of a topic.
fn write_bag(path: &Path, folder: &Path) {
    let mut bag = BagWriter::create(path, WriteOptions::default()).unwrap();
    let topic = |name: &str| Topic::of::<CompressedImage>(name, &Qos::SENSOR);
    let boards = bag.add_topic(topic("/camera/image_raw/compressed"));
    for i in 0..40u64 {
        let data = std::fs::read(folder.join(format!("board{i:02}.png"))).unwrap();
        let image = CompressedImage {
            format: "png".into(),
            data: data.into(),
            ..CompressedImage::default()
        };
        let time = (i + 1) * 100_000_000;
        bag.write_message(boards, time, &image).unwrap();
    }
    bag.finish().unwrap();
}

/// A DDS domain of this test.
const DOMAIN: u16 = 97;

/// Starts a camera driver that repeats the boards of a folder on `camera/image_raw/compressed`.
fn start_camera(process: &mut Process, boards: &Path) -> Result<(), NodeError> {
    let read = |i| std::fs::read(boards.join(format!("board{i:02}.png"))).unwrap();
    let frames: Vec<Vec<u8>> = (0..40).map(read).collect();
    process.start_closure("camera", move |context: &mut NodeContext<()>| {
        context.timer(Duration::from_millis(100), || ());
        let images = context.advertise("camera/image_raw/compressed", QosPreset::Image)?;
        let mut frames = frames.clone().into_iter().cycle();
        Ok(move |_: &mut NodeContext<()>, ()| {
            let data = frames.next().unwrap();
            images.publish(CompressedImage {
                format: "png".into(),
                data: data.into(),
                ..CompressedImage::default()
            });
        })
    })
}

/// The number after `name` at the start of a line.
fn value(text: &str, name: &str) -> f64 {
    let line =
        text.lines().find(|l| l.starts_with(name)).unwrap_or_else(|| panic!("no {name} in {text}"));
    line[name.len()..].split_whitespace().next().unwrap().parse().unwrap()
}

#[test]
fn rendered_boards_determine_their_camera() {
    let truth = CameraModel::new(
        640,
        480,
        [601.3, 598.2, 322.7, 236.4],
        Distortion::PlumbBob([-0.21, 0.09, 8e-4, -5e-4, -0.01]),
    )
    .unwrap();
    let rays: Vec<Vector2<f64>> = (0..480 * 640 * 16)
        .map(|i| {
            let (pixel, sub) = (i / 16, i % 16);
            let at = |k: usize| (k as f64 + 0.5) / 4.0 - 0.5;
            let (x, y) = ((pixel % 640) as f64 + at(sub % 4), (pixel / 640) as f64 + at(sub / 4));
            truth.undistort(&Vector2::new(x, y)).unwrap()
        })
        .collect();
    let folder = tempfile::tempdir().unwrap();
    for i in 0..40 {
        let angle = f64::from(i) * 2.399;
        let tilt = [0.1, 0.35, 0.55, 0.7][i as usize % 4];
        let rotation =
            UnitQuaternion::from_scaled_axis(Vector3::new(angle.cos(), angle.sin(), 0.0) * tilt)
                * UnitQuaternion::from_scaled_axis(
                    Vector3::z() * (0.4 * (1.7 * f64::from(i)).sin()),
                );
        let middle = rotation * Vector3::new(4.0 * SQUARE, 2.5 * SQUARE, 0.0);
        let range = 0.42 + 0.12 * f64::from(i % 5) / 4.0 + 0.06 * tilt;
        let aside =
            Vector3::new(0.16 * (1.1 * f64::from(i)).sin(), 0.1 * (1.9 * f64::from(i)).cos(), 0.0)
                * range;
        let pose = Isometry3::from_parts(
            Translation3::from(Vector3::new(0.0, 0.0, range) + aside - middle),
            rotation,
        );
        let path = folder.path().join(format!("board{i:02}.png"));
        imgcodecs::imwrite_def(&path, &render(&rays, &truth, &pose, i as u64 + 1)).unwrap();
    }
    let out = folder.path().join("camera.yaml");
    let options = ["--board", "9x6", "--square", "0.03", "--out", out.to_str().unwrap()];
    let (ok, text, error) = calibrate(folder.path(), &options);
    assert!(ok, "{error}");
    println!("{text}");
    let near = |text: &str, source: &str, tolerance: f64| {
        for (name, expected) in [("fx", 601.3), ("fy", 598.2), ("cx", 322.7), ("cy", 236.4)] {
            let found = value(text, name);
            let off = (found - expected).abs();
            assert!(off < tolerance, "{source}: {name}: {found} for {expected}");
        }
        // The paper's figure.
        assert!(value(text, "mean reprojection error:") <= 0.1741, "{source}");
    };
    near(&text, "folder", 0.6);
    assert!(text.contains("40 of 40 images"));
    let yaml = std::fs::read_to_string(&out).unwrap();
    assert!(yaml.contains("distortion_model: plumb_bob") && yaml.contains("image_width: 640"));

    // The same images from a bag and a video: only views that add information are used, with the
    // same result.
    let bag = folder.path().join("boards.mcap");
    write_bag(&bag, folder.path());
    let (ok, text, error) = calibrate(&bag, &options);
    assert!(ok, "{error}");
    near(&text, "bag", 1.0);
    let (ok, _, error) = calibrate(&bag, &[&options[..], &["--topic", "/missing"]].concat());
    assert!(!ok && error.contains("/missing"), "{error}");
    let video = folder.path().join("boards.mkv");
    match Command::new("ffmpeg")
        .args(["-v", "error", "-framerate", "5", "-i"])
        .arg(folder.path().join("board%02d.png"))
        .args(["-c:v", "ffv1"])
        .arg(&video)
        .status()
    {
        Ok(status) => {
            assert!(status.success());
            let (ok, text, error) = calibrate(&video, &options);
            assert!(ok, "{error}");
            near(&text, "video", 1.0);
        }
        Err(_) => test_support::skip("the part with a video: ffmpeg is not installed"),
    }

    // Live: it ends if nothing is missing, and otherwise at the given number of views.
    let network = Network { domain_id: DOMAIN, ..Network::from_environment().unwrap() };
    let mut process = Process::new(network).unwrap();
    start_camera(&mut process, folder.path()).unwrap();
    let (ok, text, error) = calibrate(
        Path::new("/camera/image_raw/compressed"),
        &[&options[..], &["--views", "40"]].concat(),
    );
    assert!(ok, "{error}");
    near(&text, "topic", 1.0);
    let (ok, _, error) = calibrate(Path::new("/camera/missing"), &options);
    assert!(!ok && error.contains("images are on /camera/image_raw/compressed"), "{error}");
    drop(process);

    // Three images are rejected with a message.
    let few = tempfile::tempdir().unwrap();
    for i in 0..3 {
        let name = format!("board{i:02}.png");
        std::fs::copy(folder.path().join(&name), few.path().join(&name)).unwrap();
    }
    let (ok, text, error) =
        calibrate(few.path(), &["--out", few.path().join("c.yaml").to_str().unwrap()]);
    assert!(!ok && error.lines().count() == 1 && error.contains("at least four"), "{error}");
    assert!(text.contains("missing: 37 more views"), "{text}");
}

#[test]
fn real_boards_agree_with_opencv_s_published_result() {
    let data = Path::new("/usr/share/doc/opencv-doc/examples/data");
    if !data.join("left01.jpg").is_file() {
        test_support::skip("Debian's opencv-doc is not installed");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for number in (1..=14).filter(|n| *n != 10) {
        let name = format!("left{number:02}.jpg");
        std::fs::copy(data.join(&name), folder.path().join(&name)).unwrap();
    }
    let out = folder.path().join("camera.yaml");
    let (ok, text, error) = calibrate(folder.path(), &["--out", out.to_str().unwrap()]);
    assert!(ok, "{error}");
    // left_intrinsics.yml of the same package.
    let published = 535.915_733_961_632;
    for name in ["fx", "fy"] {
        assert!(
            (value(&text, name) / published - 1.0).abs() < 1e-3,
            "{name}: {}",
            value(&text, name)
        );
    }
    // The second image has the largest error in OpenCV's result too, and is reported.
    assert!(text.contains("doubtful: left02.jpg"), "{text}");
}

#[test]
fn mistakes_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let (ok, _, error) = calibrate(&folder.path().join("nowhere"), &[]);
    assert!(!ok && error.contains("nowhere") && error.lines().count() == 1, "{error}");
    let (ok, _, error) = calibrate(folder.path(), &[]);
    assert!(!ok && error.contains("no image"), "{error}");
    // Neither a video nor a camera: ffmpeg's message, or that ffmpeg is missing.
    let text = folder.path().join("text.mp4");
    std::fs::write(&text, "no video").unwrap();
    for source in [&text, Path::new("/dev/null")] {
        let (ok, _, error) = calibrate(source, &[]);
        assert!(
            !ok && error.lines().count() == 1
                && error.contains("ffmpeg") | error.contains("check that it is"),
            "{error}"
        );
    }
    let status = Command::new(env!("CARGO_BIN_EXE_volant-calibrate"))
        .args(["camera", "x", "--board", "9by6"])
        .output()
        .unwrap()
        .status;
    assert_eq!(status.code(), Some(2));
}
