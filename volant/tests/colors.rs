//! `volant calibrate colors` without a rig file: from an image file or a bag, and its errors.
#![allow(clippy::unwrap_used, clippy::panic)]

use bag::{BagWriter, Qos, Topic, WriteOptions};
use rig_model::{MarkerColor, Rig, topics};
use std::{
    fs,
    path::Path,
    process::{Command, Output},
};
use volant_msgs::sensor_msgs::msg::CompressedImage;

fn calibrate(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_volant"))
        .args(["calibrate", "colors"])
        .args(arguments)
        .output()
        .unwrap()
}

/// Writes a PNG with four squares on gray; `None` leaves a square out.
fn write_image(path: &Path, papers: [Option<[u8; 3]>; 4]) {
    const SIDE: usize = 200;
    let mut data = vec![110u8; 3 * SIDE * SIDE];
    for (i, paper) in papers.iter().enumerate() {
        let Some(paper) = paper else { continue };
        let (x0, y0) = (30 + 90 * (i % 2), 30 + 90 * (i / 2));
        for y in y0..y0 + 30 {
            for x in x0..x0 + 30 {
                data[3 * (y * SIDE + x)..][..3].copy_from_slice(paper);
            }
        }
    }
    let mut encoder = png::Encoder::new(fs::File::create(path).unwrap(), SIDE as u32, SIDE as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().unwrap().write_image_data(&data).unwrap();
}

const PAPERS: [[u8; 3]; 4] = [[190, 40, 50], [60, 150, 80], [40, 90, 170], [200, 180, 60]];

/// Reads the rig file with the calibrated lines.
fn rig_with(colors: &str) -> Rig {
    let rig = include_str!("../../launch_config/config/rig.yaml");
    let lines: String = colors.lines().skip(3).map(|line| format!("{line}\n")).collect();
    let (before, after) =
        rig.split_at(rig.find("    markers:\n").unwrap() + "    markers:\n".len());
    Rig::from_yaml(&format!("{before}{lines}{after}")).unwrap_or_else(|e| panic!("{e}: {colors}"))
}

#[test]
fn an_image_files_colors_become_lines_of_the_rig_file() {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("papers.png");
    write_image(&path, PAPERS.map(Some));
    let output = calibrate(&[path.to_str().unwrap()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let rig = rig_with(&String::from_utf8(output.stdout).unwrap());
    for (color, paper) in MarkerColor::ALL.into_iter().zip(PAPERS) {
        let found = rig.colors[color].unwrap();
        for (a, b) in found.iter().zip(paper) {
            assert!((a - f64::from(b)).abs() < 6.0, "{color}: {found:?} for {paper:?}");
        }
    }
}

/// A bag with another camera, whose topic is the first by name.
#[test]
fn a_bags_colors_are_those_of_the_rigs_camera() {
    let folder = tempfile::TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let image = |papers| {
        write_image(&path("image.png"), papers);
        let data = fs::read(path("image.png")).unwrap();
        CompressedImage { format: "png".into(), data, ..CompressedImage::default() }
    };
    let (ours, others) = (image(PAPERS.map(Some)), image([None; 4]));
    let write = |name: &str, ours_on: &str| {
        let mut bag = BagWriter::create(&path(name), WriteOptions::default()).unwrap();
        for (topic, image) in [("/a_room/image/compressed", &others), (ours_on, &ours)] {
            let topic = bag.add_topic(Topic::of::<CompressedImage>(topic, &Qos::SENSOR));
            bag.write_message(topic, 1, image).unwrap();
        }
        bag.finish().unwrap();
        path(name).into_os_string().into_string().unwrap()
    };
    let bag = write("ours.mcap", topics::absolute::COMPRESSED_IMAGE);
    let output = calibrate(&[&bag]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // None of two cameras has the rig's name.
    let bag = write("another.mcap", "/b_room/image/compressed");
    let output = calibrate(&[&bag]);
    let printed = String::from_utf8_lossy(&output.stderr);
    assert!(printed.contains("/b_room/image/compressed; name one with --topic"), "{printed}");
    assert!(calibrate(&[&bag, "--topic", "/b_room/image/compressed"]).status.success());
}

#[test]
fn missing_colors_are_named_in_one_line_and_a_pick_finds_them() {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("papers.png");
    // Turquoise in blue's place is classified as green.
    let papers = [PAPERS[0], PAPERS[1], [40, 160, 150], PAPERS[3]];
    write_image(&path, papers.map(Some));
    let output = calibrate(&[path.to_str().unwrap()]);
    let printed = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{printed}");
    assert_eq!(printed.trim_end().lines().count(), 1, "{printed}");
    assert!(printed.contains("blue") && printed.contains("--pick"), "{printed}");
    let output = calibrate(&[path.to_str().unwrap(), "--pick", "blue=45,135"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let rig = rig_with(&String::from_utf8(output.stdout).unwrap());
    assert_eq!(rig.colors[MarkerColor::Blue], Some([40.0, 160.0, 150.0]));
    for pick in ["pink=1,1", "blue=nan,135", "blue=45,inf"] {
        let output = calibrate(&[path.to_str().unwrap(), "--pick", pick]);
        assert_eq!(output.status.code(), Some(2), "{pick}");
    }
    let output = calibrate(&["no_such_file.png"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("no_such_file.png"));
}
