//! Steps of the camera: images, exposure and colors; the lens.

use super::{Walk, dialog, inputs::CAMERA, setup};
use crate::calibrate::{self, Output};
use anyhow::{Context, Result};
use bag::BagReader;
use node_kit::{convert, outln};
use pose_fusion::FusionConfig;
use rig_model::{CameraModel, Stamp, median, topics};
use std::{path::Path, process::Command};
use volant::{
    parameter_update::{FOCAL_LENGTH_SIGMA, number},
    replay::{Fed, Feed, ImageTopic},
};
use volant_msgs::{
    Message, cdr,
    msg::MarkerObservations,
    sensor_msgs::msg::{CameraInfo, CompressedImage, Image},
};

/// Largest standard deviation of the focal length that a rig file accepts, relative.
const LARGEST_SHARE: f64 = 0.1;

/// Images of which exposure and color are measured.
const IMAGES: usize = 40;

/// What a recording holds of the camera.
#[derive(Default)]
struct Stream {
    /// Stamp and time of logging of each image (or of its markers), s.
    times: Vec<(f64, f64)>,
    camera: Option<CameraModel>,
    images: Option<ImageTopic>,
    size: Option<(u32, u32)>,
}

fn read(walk: &mut Walk, path: &Path) -> Result<Stream> {
    let (names, summary) = (walk.topics(path, CAMERA)?.names(), BagReader::summary(path)?);
    let only = |name, kind| -> Result<Option<String>> {
        Ok(names.choose(&summary, &[(name, kind)])?.map(|(_, name)| name))
    };
    let images = ImageTopic::of(&summary, &names)?;
    let timed = match &images {
        Some(images) => Some(images.name().to_owned()),
        None => only(topics::MARKERS, MarkerObservations::TYPE_NAME)?,
    };
    let camera = only(topics::CAMERA_INFO, CameraInfo::TYPE_NAME)?;
    let mut stream = Stream { images, ..Stream::default() };
    let mut bag = BagReader::open(path)?;
    let mut start = None;
    while let Some(message) = bag.next_message()? {
        let what = || format!("{}: a message on {}", path.display(), message.topic.name);
        let (kind, data) = (message.topic.type_name.as_str(), &message.data);
        if camera.as_ref() == Some(&message.topic.name) && stream.camera.is_none() {
            let info: CameraInfo = cdr::from_bytes(data).with_context(what)?;
            stream.camera = convert::camera_model(&info).ok();
        }
        if timed.as_ref() != Some(&message.topic.name) {
            continue;
        }
        let header = if kind == Image::TYPE_NAME {
            let image: Image = cdr::from_bytes(data).with_context(what)?;
            stream.size = Some((image.width, image.height));
            image.header
        } else if kind == CompressedImage::TYPE_NAME {
            cdr::from_bytes::<CompressedImage>(data).with_context(what)?.header
        } else {
            cdr::from_bytes::<MarkerObservations>(data).with_context(what)?.header
        };
        let logged = Stamp::from_nanos(i64::try_from(message.log_time).unwrap_or(0));
        let start = *start.get_or_insert(logged);
        let stamp = convert::stamp(&header.stamp).seconds_since(start);
        stream.times.push((stamp, logged.seconds_since(start)));
    }
    Ok(stream)
}

/// Rate, stamps, exposure, colors.
pub fn camera(walk: &mut Walk) -> Result<()> {
    outln!(
        "  Focus on the platform at its usual distance and lock the focus. Lock exposure (a few ms: \
         a moving square must not blur) and white balance. The driver stamps the middle of the \
         exposure. Record ten seconds of the visible platform, nothing moving."
    )?;
    let topics = [topics::COMPRESSED_IMAGE, topics::IMAGE, topics::CAMERA_INFO, topics::MARKERS];
    let bag = walk.recording("camera", &topics, 10.0)?;
    let stream = read(walk, &bag)?;
    let steps: Vec<f64> = stream.times.windows(2).map(|w| w[1].0 - w[0].0).collect();
    let delays = stream.times.iter().map(|(stamp, logged)| logged - stamp).collect();
    let (Some(usual), Some(delay)) = (median(steps.clone()), median(delays)) else {
        return walk.check(false, "images", "none in the recording; is the driver running?");
    };
    walk.check(steps.iter().all(|s| *s > 0.0), "order", "each stamp is after the one before")?;
    let rate = 1.0 / usual;
    walk.check(rate > 14.0, "rate", format!("{rate:.1} images/s (15 at least)"))?;
    let lost = steps.iter().filter(|s| **s > 1.5 * usual).count();
    let share = 100.0 * lost as f64 / steps.len() as f64;
    walk.check(
        share < 2.0,
        "gaps",
        format!("{lost} of {} ({share:.1} %; 2 at most)", steps.len()),
    )?;
    let delay = 1e3 * delay;
    walk.check(
        (-5.0..300.0).contains(&delay),
        "stamps",
        format!(
            "an image is logged {delay:.0} ms after its stamp (-5 to 300; beyond, the clocks or the \
             driver's stamps are wrong)"
        ),
    )?;
    let Some(images) = stream.images else {
        return walk.note("images", "only markers in the recording: exposure and colors unchecked");
    };
    let topic = Some(images.name().to_owned());
    exposure(walk, &bag, images)?;
    let found = calibrate::colors::run(&calibrate::colors::Arguments {
        source: bag.display().to_string(),
        rig: Some(walk.rig.clone()),
        pick: vec![],
        topic,
        duration: 3.0,
        output: Output::default(),
    });
    match found {
        Ok(()) => walk.check(true, "colors", "all four markers found and measured"),
        Err(error) => walk.check(false, "colors", format!("{error:#}")),
    }
}

fn exposure(walk: &mut Walk, bag: &Path, images: ImageTopic) -> Result<()> {
    let mut feed = Feed::start(bag, Some(images), vec![], 1)?;
    let (mut means, mut white, mut dark) = (Vec::<[f64; 3]>::new(), 0.0f64, 0.0f64);
    while let Some(fed) = feed.take()? {
        let Fed::Image(Ok((_, image))) = fed else { continue };
        // Three channels of eight bits; other formats are converted by the decoder.
        let pixels = image.data.len() / 3;
        if pixels == 0 || image.step != 3 * image.width {
            continue;
        }
        let mut sums = [0.0; 3];
        let (mut over, mut under) = (0usize, 0usize);
        for pixel in image.data.chunks_exact(3) {
            sums.iter_mut().zip(pixel).for_each(|(s, v)| *s += f64::from(*v));
            over += usize::from(pixel.iter().any(|v| *v >= 254));
            under += usize::from(pixel.iter().all(|v| *v <= 4));
        }
        means.push(sums.map(|s| s / pixels as f64));
        white = white.max(over as f64 / pixels as f64);
        dark = dark.max(under as f64 / pixels as f64);
        if means.len() == IMAGES {
            break;
        }
    }
    if means.is_empty() {
        return walk.note("exposure", "unchecked: no image of three channels");
    }
    let level = |values: &mut dyn Iterator<Item = f64>| {
        let (low, high) = values.fold((f64::INFINITY, 0.0f64), |(l, h), v| (l.min(v), h.max(v)));
        high / low.max(1.0) - 1.0
    };
    let brightness = level(&mut means.iter().map(|m| m.iter().sum::<f64>() / 3.0));
    let tint = [0, 2]
        .map(|i| level(&mut means.iter().map(|m| 100.0 * m[i] / m[1].max(1.0))))
        .into_iter()
        .fold(0.0, f64::max);
    walk.check(
        white < 0.02 && dark < 0.5,
        "exposure",
        format!(
            "{:.1} % of the pixels are saturated, {:.1} % black (2 and 50 at most)",
            100.0 * white,
            100.0 * dark
        ),
    )?;
    walk.check(
        brightness < 0.05,
        "exposure lock",
        format!("brightness varies by {:.1} % while nothing moves (5 at most)", 100.0 * brightness),
    )?;
    walk.check(
        tint < 0.03,
        "white balance lock",
        format!("the tint varies by {:.1} % while nothing moves (3 at most)", 100.0 * tint),
    )
}

/// The lens.
pub fn intrinsics(walk: &mut Walk) -> Result<()> {
    outln!(
        "  A chessboard in all parts of the image, tilted in all directions. Sources: a folder of \
         images, a bag, /dev/videoN, or an image topic."
    )?;
    let question = "  Source, or Enter if camera_info is calibrated already";
    let source = dialog::ask(question, "")?;
    if !source.is_empty() {
        let out = walk.file("camera.yaml");
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["calibrate", "camera", &source, "--out"]).arg(&out);
        let board = dialog::ask("  Inner corners of the board", "9x6")?;
        let square = dialog::ask("  Edge of its squares, m", "0.025")?;
        command.args(["--board", &board, "--square", &square]);
        let fine = command.status()?.success();
        if !fine {
            return walk.check(false, "calibration", "no result; see the messages above");
        }
        walk.wrote(&out);
        walk.check(true, "calibration", format!("{}: give it to the driver", out.display()))?;
        outln!("  Give the file to the camera's driver (camera_info_url) and restart it.")?;
    }
    let bag = walk.recording("camera_info", &[topics::CAMERA_INFO, topics::IMAGE], 3.0)?;
    let stream = read(walk, &bag)?;
    match stream.camera {
        Some(camera) => {
            let (f, (width, height)) = (camera.focal_lengths(), camera.size());
            let text = format!("{width}x{height}, f = {:.1} x {:.1} px", f.x, f.y);
            walk.check(true, "camera_info", text)?;
            if let Some(size) = stream.size {
                let same = size == (width, height);
                walk.check(same, "size", format!("images of {}x{} px", size.0, size.1))?;
            }
            let view = 2.0 * (f64::from(width) / 2.0 / f.x).atan().to_degrees();
            walk.check((10.0..170.0).contains(&view), "view", format!("{view:.0} deg wide"))?;
            focal_length(walk, f.x)
        }
        None => walk.check(false, "camera_info", "none, or not calibrated (k is zero)"),
    }
}

/// Asks how well a focal length (px) is known.
fn focal_length(walk: &mut Walk, f: f64) -> Result<()> {
    let known = setup::of_fusion(walk, FOCAL_LENGTH_SIGMA)?;
    let share = known.unwrap_or(FusionConfig::default().tight.calibration.focal_length);
    let question = "  standard deviation of fx, px: `calibrate camera` prints it; 1 % of fx where \
                    it is from a data sheet";
    let [deviation] = dialog::numbers(question, [f * share], |[deviation]| {
        let possible = f * LARGEST_SHARE;
        if (0.0..=possible).contains(deviation) {
            Ok(())
        } else {
            Err(format!("{deviation} px is not possible: 0 to {possible:.0}"))
        }
    })?;
    let share = deviation / f;
    if known.is_none_or(|known| (share - known).abs() > 1e-3 * known) {
        setup::set(walk, &[setup::fusion(FOCAL_LENGTH_SIGMA, number(share, 3))])?;
    }
    Ok(())
}
