//! `volant calibrate colors` without a rig file: from an image file or a bag, and its errors.
#![allow(clippy::unwrap_used, clippy::panic)]

mod place;

use bag::{BagWriter, Qos, WriteOptions};
use place::{Place, Ran, put};
use rig_model::{MarkerColor, Rig, topics};
use std::{fs, path::Path};
use volant_msgs::sensor_msgs::msg::CompressedImage;

const RIG: &str = include_str!("../../launch_config/config/rig.yaml");

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

/// Reads the rig file with the lines that a command prints.
fn rig_with(place: &Place, arguments: &str) -> Rig {
    let Ran { status, out: colors, err } = place.volant(arguments);
    assert_eq!(status, Some(0), "{err}");
    let lines: String = colors.lines().skip(3).map(|line| format!("{line}\n")).collect();
    let (before, after) =
        RIG.split_at(RIG.find("    markers:\n").unwrap() + "    markers:\n".len());
    Rig::from_yaml(&format!("{before}{lines}{after}")).unwrap_or_else(|e| panic!("{e}: {colors}"))
}

#[test]
fn an_image_files_colors_become_lines_of_the_rig_file() {
    let place = Place::with_rig(RIG);
    write_image(&place.path("papers.png"), PAPERS.map(Some));
    let rig = rig_with(&place, "calibrate colors papers.png");
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
    let place = Place::with_rig(RIG);
    let image = |papers| {
        write_image(&place.path("image.png"), papers);
        let data = place.read("image.png");
        CompressedImage { format: "png".into(), data, ..CompressedImage::default() }
    };
    let (ours, others) = (image(PAPERS.map(Some)), image([None; 4]));
    let write = |name: &str, ours_on: &str| {
        let mut bag = BagWriter::create(&place.path(name), WriteOptions::default()).unwrap();
        for (topic, image) in [("/a_room/image/compressed", &others), (ours_on, &ours)] {
            put(&mut bag, topic, &Qos::SENSOR, 1, image);
        }
        bag.finish().unwrap();
    };
    write("ours.mcap", topics::absolute::COMPRESSED_IMAGE);
    place.done("calibrate colors ours.mcap");
    // None of two cameras has the rig's name.
    write("another.mcap", "/b_room/image/compressed");
    let printed = place.failed("calibrate colors another.mcap");
    assert!(printed.contains("/b_room/image/compressed; name one with --topic"), "{printed}");
    place.done("calibrate colors another.mcap --topic /b_room/image/compressed");
}

#[test]
fn missing_colors_are_named_in_one_line_and_a_pick_finds_them() {
    let place = Place::with_rig(RIG);
    // Turquoise in blue's place is classified as green.
    let papers = [PAPERS[0], PAPERS[1], [40, 160, 150], PAPERS[3]];
    write_image(&place.path("papers.png"), papers.map(Some));
    place.fails("calibrate colors papers.png", &["blue", "--pick"]);
    let rig = rig_with(&place, "calibrate colors papers.png --pick blue=45,135");
    assert_eq!(rig.colors[MarkerColor::Blue], Some([40.0, 160.0, 150.0]));
    for pick in ["pink=1,1", "blue=nan,135", "blue=45,inf"] {
        let ran = place.volant(&format!("calibrate colors papers.png --pick {pick}"));
        assert_eq!(ran.status, Some(2), "{pick}");
    }
    place.fails("calibrate colors no_such_file.png", &["no_such_file.png"]);
    // Neither a file nor a topic.
    for source in ["nominl/in.mcap", "bad topic"] {
        let mut command = place.command("calibrate colors");
        let ran: Ran = command.arg(source).output().unwrap().into();
        ran.failed_with(&[source, "there is no such file, and it is no topic", "correct"]);
    }
}

#[test]
fn what_is_no_marker_is_named_with_the_remedy() {
    let place = Place::with_rig(RIG);
    write_image(&place.path("papers.png"), PAPERS.map(Some));
    // Gray between the squares.
    let printed = place.failed("calibrate colors papers.png --pick red=100,100");
    for word in ["papers.png: not the markers' colors", "--pick", "`markers.colors.red`", "gray"] {
        assert!(printed.contains(word), "{printed}");
    }
    // The largest red patch is another one from image to image.
    let mut bag = BagWriter::create(&place.path("in.mcap"), WriteOptions::default()).unwrap();
    for (stamp, red) in [(1, PAPERS[0]), (2, [130, 60, 60]), (3, [220, 60, 90])] {
        write_image(
            &place.path("image.png"),
            [Some(red), Some(PAPERS[1]), Some(PAPERS[2]), Some(PAPERS[3])],
        );
        let data = place.read("image.png");
        let image = CompressedImage { format: "png".into(), data, ..CompressedImage::default() };
        put(&mut bag, topics::absolute::COMPRESSED_IMAGE, &Qos::SENSOR, stamp, &image);
    }
    bag.finish().unwrap();
    let printed = place.failed("calibrate colors in.mcap");
    assert!(printed.contains("red: not one color"), "{printed}");
    assert!(printed.contains("--rig") && !printed.contains("green: not one"), "{printed}");
}
