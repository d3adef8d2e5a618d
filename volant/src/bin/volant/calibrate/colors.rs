//! `volant calibrate colors`: initial marker colors for the rig file, from an image file, a bag or
//! a live topic.

use super::Output;
use crate::terminal;
use anyhow::{Context, anyhow, bail, ensure};
use marker_tracker::{ColorCalibration, OwnedImage, decode_compressed_into};
use nalgebra::Vector2;
use node_kit::out;
use rig_model::{MarkerColor, PerColor, Stamp, rig::check_colors};
use std::{
    fs,
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
};
use volant::{
    command_line::{self, number},
    parameter_update::{Setting, list},
    replay::{Counts, Fed, Feed, ImageTopic, TopicNames, summarize},
};
use volant_msgs::{Message, cdr, sensor_msgs::msg::CameraInfo};

/// Images of a bag or a topic that are evaluated.
const IMAGES: usize = 60;

/// Spread of a color over the images beyond which they do not show one paper, 0–255. Markers in
/// the recordings with ground truth have up to 2.5, a place on the floor or the platform 13 to 24.
const LARGEST_SPREAD: f64 = 8.0;

#[derive(clap::Args)]
pub struct Arguments {
    /// Image file (png, jpg), bag with images (an .mcap file or a rosbag2 folder), or live image
    /// topic
    pub source: String,
    /// Rig file to update; only patches in the layout of its markers count, instead of the largest
    /// of each color. Without it the lines for the rig file are printed
    #[arg(long, value_name = "FILE")]
    pub rig: Option<PathBuf>,
    /// Measure a marker's color at this pixel, such as red=312,140; repeatable
    #[arg(long, value_name = "COLOR=X,Y", value_parser = pick)]
    pub pick: Vec<(MarkerColor, Vector2<f64>)>,
    /// Image topic [default: the rig's, or the only one]
    #[arg(long, value_name = "TOPIC")]
    pub topic: Option<String>,
    /// Duration of recording from a live topic, s
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0, value_parser = number(0.1..=1e6))]
    pub duration: f64,
    #[command(flatten)]
    pub output: Output,
}

fn pick(text: &str) -> Result<(MarkerColor, Vector2<f64>), String> {
    let number = |text: &str| text.trim().parse().ok().filter(|x: &f64| x.is_finite());
    let parse = || {
        let (name, place) = text.split_once('=')?;
        let color = MarkerColor::ALL.into_iter().find(|c| c.name() == name)?;
        let (x, y) = place.split_once(',')?;
        Some((color, Vector2::new(number(x)?, number(y)?)))
    };
    parse().ok_or_else(|| {
        "write it as red=312,140 (red, green, blue or yellow; column, row)".to_owned()
    })
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let inputs = arguments.rig.as_deref().into_iter().chain([Path::new(&arguments.source)]);
    arguments.output.check(None, &inputs.collect::<Vec<_>>())?;
    let mut losses = vec![];
    let settings = terminal::with_losses(measure(arguments, &mut losses), &losses)?;
    match (&arguments.rig, &arguments.output.out) {
        (Some(rig), _) => arguments.output.update(rig, &settings, ""),
        (None, out) => {
            let text = settings.iter().try_fold(String::new(), |text, s| {
                ros_parameters::edit::set(&text, &s.node, &s.name, &s.value)
            })?;
            match out {
                Some(out) => {
                    node_kit::files::write(out, text.as_bytes(), arguments.output.overwrite)?;
                    terminal::line(&format!(
                        "{}: pass it as a second --params-file, or name the rig file with --rig",
                        out.display()
                    ));
                }
                None => out!("{text}")?,
            }
            Ok(())
        }
    }
}

/// Measures the colors; what the recording lost is appended to `losses`.
fn measure(arguments: &Arguments, losses: &mut Vec<String>) -> anyhow::Result<Vec<Setting>> {
    let rig = arguments.rig.as_deref().map(super::read_rig);
    let layout = rig.transpose()?.map(|rig| rig.markers);
    let with_layout = layout.is_some();
    let mut picks = PerColor([None; 4]);
    for (color, place) in &arguments.pick {
        picks[*color] = Some(*place);
    }
    let mut calibration = ColorCalibration::new(layout, picks);
    let path = Path::new(&arguments.source);
    let is_image_file = path
        .extension()
        .is_some_and(|e| ["png", "jpg", "jpeg"].iter().any(|known| e.eq_ignore_ascii_case(known)));
    if is_image_file {
        image_file(path, &mut calibration)?;
    } else if path.exists() {
        bag(path, arguments.topic.as_deref(), &mut calibration, losses)?;
    } else {
        topic(arguments, &mut calibration, losses)?;
    }
    let result = calibration.result();
    let (mut settings, mut notes, mut missing) = (vec![], vec![], vec![]);
    for (color, found) in result.iter() {
        match found {
            Some(c) => {
                let [r, g, b] = c.rgb;
                let tenths = c.rgb.map(|x| (10.0 * x).round() / 10.0);
                settings.push(Setting::rig(format!("markers.colors.{color}"), list(&tenths)));
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
            "no image shows the markers in the rig file's layout"
        } else {
            "no image has a square patch of that color"
        };
        bail!(
            "{}: {} not found ({how}); give an image with all four fully visible, or their places \
             with --pick {}=X,Y",
            arguments.source,
            missing.join(", "),
            missing[0]
        );
    }
    notes.iter().for_each(|note| terminal::line(note));
    let colors = PerColor::from_fn(|color| result[color].map(|found| found.rgb));
    check_colors(&colors).with_context(|| {
        format!("{}: not the markers' colors; {}", arguments.source, remedy(arguments))
    })?;
    for (color, found) in result.iter() {
        let spread = found.map_or(0.0, |found| found.spread);
        ensure!(
            spread <= LARGEST_SPREAD,
            "{}: {color}: not one color: it varies by {spread:.0} of 255 between the images \
             (usual: up to 3), so not all of them show the marker there; {}",
            arguments.source,
            remedy(arguments)
        );
    }
    Ok(settings)
}

/// What to do where other things than markers were measured.
fn remedy(arguments: &Arguments) -> &'static str {
    match (arguments.pick.as_slice(), &arguments.rig) {
        ([], None) => "give the rig file with --rig, or the markers' places with --pick",
        ([], Some(_)) => "give images with all four markers in good light",
        _ => "a --pick holds for all images, so give one image, and a place on the marker in it",
    }
}

fn image_file(path: &Path, calibration: &mut ColorCalibration) -> anyhow::Result<()> {
    let bytes = fs::read(path).with_context(|| format!("{}: not readable", path.display()))?;
    let format = if bytes.starts_with(b"\x89PNG") { "png" } else { "jpeg" };
    let mut image = OwnedImage::default();
    decode_compressed_into(format, &bytes, &mut image)
        .with_context(|| path.display().to_string())?;
    calibration.add(&image.view(Stamp::from_nanos(0))).with_context(|| path.display().to_string())
}

fn bag(
    path: &Path,
    topic: Option<&str>,
    calibration: &mut ColorCalibration,
    losses: &mut Vec<String>,
) -> anyhow::Result<()> {
    let shown = path.display();
    let summary = summarize(path, losses)?;
    let all = ImageTopic::all(&summary);
    let images = match topic {
        Some(name) => all.into_iter().find(|images| images.name() == name),
        None => ImageTopic::of(&summary, &TopicNames::default()).map_err(|_| {
            let names: Vec<&str> = all.iter().map(ImageTopic::name).collect();
            anyhow!("{shown}: images on {}; name one with --topic", names.join(", "))
        })?,
    };
    let images = images.ok_or_else(|| match topic {
        Some(name) => anyhow!("{shown}: no images on {name}; `volant bag info` lists the topics"),
        None => anyhow!("{shown}: no images; record them too, or give another source"),
    })?;
    let (beside, known) = (camera_info(images.name()), summary.topics_of(CameraInfo::TYPE_NAME));
    let camera = known.iter().find(|name| **name == beside).or(match known.as_slice() {
        [only] => Some(only),
        _ => None,
    });
    let camera = camera.map(|name| (*name).to_owned()).into_iter().collect();
    let mut feed = Feed::start(path, Some(images), camera, 1)?;
    let (mut used, mut counts) = (0, Counts::default());
    while let Some(fed) = feed.take()? {
        let result = match fed {
            Fed::Message(message) => {
                if let Ok(info) = cdr::from_bytes::<CameraInfo>(&message.data)
                    && let Ok(camera) = node_kit::convert::camera_model(&info)
                {
                    calibration.camera(camera);
                }
                continue;
            }
            Fed::Image(Ok((stamp, image))) => {
                calibration.add(&image.view(stamp)).map_err(|error| error.to_string())
            }
            Fed::Image(Err(reason)) => Err(reason),
        };
        match result {
            Ok(()) => used += 1,
            Err(reason) => counts.warn("image", || format!("an image is ignored: {reason}")),
        }
        if used == IMAGES {
            break;
        }
    }
    losses.extend_from_slice(feed.losses());
    losses.extend(counts.warning_lines());
    ensure!(used > 0, "{shown}: no usable image");
    Ok(())
}

/// Name of the camera_info beside an image topic.
pub fn camera_info(images: &str) -> String {
    let raw = images.strip_suffix("/compressed").unwrap_or(images);
    let camera = raw.rsplit_once('/').map_or("", |(camera, _)| camera);
    format!("{camera}/camera_info")
}

/// Records the topic for a short time and evaluates the recording. A signal ends the process.
fn topic(
    arguments: &Arguments,
    calibration: &mut ColorCalibration,
    losses: &mut Vec<String>,
) -> anyhow::Result<()> {
    let source = &arguments.source;
    // The dot of `run.mcap` is in no topic's name.
    let name = command_line::topic(source).map_err(|error| {
        anyhow!(
            "{source}: there is no such file, and it is no topic ({error}); correct the path or \
             the topic's name"
        )
    })?;
    let topics = vec![name.clone(), camera_info(&name)];
    let recorded = super::live::record(topics, arguments.duration, &AtomicBool::new(false))?;
    if recorded.unpublished.contains(&name) {
        bail!(
            "{source}: there is no such file, and no publisher of a topic {name}; correct the \
             path, or start the camera's driver"
        );
    }
    ensure!(recorded.messages > 0, "{name}: no message; check the camera's driver");
    bag(recorded.path(), Some(&name), calibration, losses)
}
