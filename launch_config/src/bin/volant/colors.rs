//! `volant calibrate colors`: the markers' start colours for the rig file, from a picture, a bag or a live topic.

use crate::say;
use anyhow::{Context, anyhow, bail};
use launch_config::{
    bag::BagReader,
    replay::{Fed, Feed, ImageTopic},
};
use marker_tracker::{ColorCalibration, OwnedImage, decode_compressed_into};
use nalgebra::Vector2;
use rig_model::{MarkerColor, PerColor, Rig, Stamp};
use std::{
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
};
use volant_msgs::{cdr, sensor_msgs::msg::CameraInfo};

/// Images of a bag or a topic that are looked at.
const IMAGES: usize = 60;

/// The colours of the markers' paper as the camera sees them, for the rig file
#[derive(clap::Parser)]
#[command(name = "volant calibrate colors")]
pub struct Arguments {
    /// A picture (png, jpg), a bag with images (an .mcap file or a rosbag2 folder), or a live image topic
    source: String,
    /// The rig file: with it only patches that stand as its markers count, else the largest of each colour
    #[arg(long, value_name = "FILE")]
    rig: Option<PathBuf>,
    /// Takes a marker's colour at this place of the image, such as red=312,140; may be given for each marker
    #[arg(long, value_name = "COLOR=X,Y", value_parser = pick)]
    pick: Vec<(MarkerColor, Vector2<f64>)>,
    /// The image topic of a bag that has several
    #[arg(long, value_name = "TOPIC")]
    topic: Option<String>,
    /// For how long a live topic is listened to
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0)]
    duration: f64,
    /// Writes the parameter file there instead of standard output
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

fn pick(text: &str) -> Result<(MarkerColor, Vector2<f64>), String> {
    let parse = || {
        let (name, place) = text.split_once('=')?;
        let color = MarkerColor::ALL.into_iter().find(|c| c.name() == name)?;
        let (x, y) = place.split_once(',')?;
        Some((color, Vector2::new(x.trim().parse().ok()?, y.trim().parse().ok()?)))
    };
    parse().ok_or_else(|| "write it as red=312,140 (red, green, blue or yellow; column, row)".to_owned())
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let rig = arguments.rig.as_ref().map(|path| {
        fs::read_to_string(path)
            .map_err(anyhow::Error::from)
            .and_then(|text| Ok(Rig::from_yaml(&text)?))
            .with_context(|| format!("{}: not a usable rig file", path.display()))
    });
    let layout = rig.transpose()?.map(|rig| rig.markers);
    let with_layout = layout.is_some();
    let mut picks = PerColor([None; 4]);
    for (color, place) in &arguments.pick {
        picks[*color] = Some(*place);
    }
    let mut calibration = ColorCalibration::new(layout, picks);
    let path = Path::new(&arguments.source);
    let is_picture = path
        .extension()
        .is_some_and(|e| ["png", "jpg", "jpeg"].iter().any(|known| e.eq_ignore_ascii_case(known)));
    if is_picture {
        picture(path, &mut calibration)?;
    } else if path.exists() {
        bag(path, arguments.topic.as_deref(), &mut calibration)?;
    } else {
        topic(arguments, &mut calibration)?;
    }
    let mut text = String::from("/**:\n  ros__parameters:\n    markers:\n      colors:\n");
    let (mut missing, mut notes) = (vec![], vec![]);
    for (color, found) in calibration.result().iter() {
        match found {
            Some(c) => {
                let [r, g, b] = c.rgb;
                writeln!(text, "        {color}: [{r:.1}, {g:.1}, {b:.1}]")?;
                let (n, spread) = (c.images, c.spread);
                notes.push(format!(
                    "{color}: {r:.0} {g:.0} {b:.0} from {n} images, within {spread:.1} of 255"
                ));
            }
            None => missing.push(color.name()),
        }
    }
    if !missing.is_empty() {
        let how = if with_layout {
            "no image shows the markers as the rig file has them"
        } else {
            "no image has a square patch of that colour"
        };
        bail!(
            "{}: {} not found ({how}); give a picture in which all four are whole, or say where with --pick {}=X,Y",
            arguments.source,
            missing.join(", "),
            missing[0]
        );
    }
    notes.iter().for_each(|note| say::line(note));
    match &arguments.out {
        Some(out) => {
            fs::write(out, text).with_context(|| format!("{} cannot be written", out.display()))?;
            say::line(&format!(
                "{}: pass it as a second --params-file, or copy its lines into the rig file",
                out.display()
            ));
        }
        None => print!("{text}"),
    }
    Ok(())
}

fn picture(path: &Path, calibration: &mut ColorCalibration) -> anyhow::Result<()> {
    let bytes = fs::read(path).with_context(|| format!("{} cannot be read", path.display()))?;
    let format = if bytes.starts_with(b"\x89PNG") { "png" } else { "jpeg" };
    let mut image = OwnedImage::default();
    decode_compressed_into(format, &bytes, &mut image).with_context(|| path.display().to_string())?;
    calibration.add(&image.view(Stamp::from_nanos(0))).with_context(|| path.display().to_string())
}

fn bag(path: &Path, topic: Option<&str>, calibration: &mut ColorCalibration) -> anyhow::Result<()> {
    let summary = BagReader::summary(path)?;
    let named = |t: &&launch_config::bag::Topic| topic.is_none_or(|name| t.name == name);
    let images = |kind: &str| {
        summary
            .topics
            .iter()
            .map(|(t, _)| t)
            .filter(named)
            .find(|t| t.type_name == kind)
            .map(|t| t.name.clone())
    };
    let source = images("sensor_msgs/msg/Image")
        .map(ImageTopic::Raw)
        .or_else(|| images("sensor_msgs/msg/CompressedImage").map(ImageTopic::Compressed))
        .ok_or_else(|| match topic {
            Some(name) => anyhow!("{}: it holds no images on {name}", path.display()),
            None => anyhow!("{}: it holds no images", path.display()),
        })?;
    let cameras: Vec<String> = summary
        .topics
        .iter()
        .filter(|(t, _)| t.type_name == "sensor_msgs/msg/CameraInfo")
        .map(|(t, _)| t.name.clone())
        .collect();
    let mut feed = Feed::start(path, Some(source), cameras, 1)?;
    let mut count = 0;
    let mut refused = None;
    while let Some(fed) = feed.take()? {
        match fed {
            Fed::Message(message) => {
                if let Ok(info) = cdr::from_bytes::<CameraInfo>(&message.data)
                    && let Ok(camera) = node_kit::convert::camera_model(&info)
                {
                    calibration.camera(camera);
                }
            }
            Fed::Image(Ok((stamp, image))) => {
                calibration.add(&image.view(stamp))?;
                count += 1;
                if count == IMAGES {
                    break;
                }
            }
            Fed::Image(Err(reason)) => refused = Some(reason),
        }
    }
    match refused {
        Some(reason) if count == 0 => bail!("{}: no image can be used: {reason}", path.display()),
        _ => Ok(()),
    }
}

/// A short recording of the topic, and then as a bag.
#[cfg(feature = "nodes")]
fn topic(arguments: &Arguments, calibration: &mut ColorCalibration) -> anyhow::Result<()> {
    use launch_config::{
        bag::WriteOptions,
        live::record::{RecordOptions, record},
    };
    use std::time::Duration;
    let name = match arguments.source.strip_prefix('/') {
        Some(_) => arguments.source.clone(),
        None => format!("/{}", arguments.source),
    };
    let info = name.split("/image_raw").next().map(|camera| format!("{camera}/camera_info"));
    let output = std::env::temp_dir().join(format!("volant-colors-{}.mcap", std::process::id()));
    let options = RecordOptions {
        output: output.clone(),
        topics: std::iter::once(name.clone()).chain(info).collect(),
        exclude: vec![],
        write: WriteOptions::default(),
        duration: Some(Duration::try_from_secs_f64(arguments.duration)?),
    };
    let stop = crate::signals::stop_flag()?;
    say::line(&format!("listening to {name} for {} s", arguments.duration));
    let result = record(&options, &stop, |_| {}).map_err(anyhow::Error::from).and_then(|report| {
        if report.unseen.contains(&name) {
            bail!("{name}: nobody publishes it (nor is there a file of that name); is the camera's driver running?");
        }
        bag(&output, Some(&name), calibration)
    });
    // Whatever came of it: the recording was only for this.
    let _ = fs::remove_file(&output);
    result
}

#[cfg(not(feature = "nodes"))]
fn topic(arguments: &Arguments, _: &mut ColorCalibration) -> anyhow::Result<()> {
    bail!("{}: there is no such file, and this build cannot listen to topics", arguments.source)
}
