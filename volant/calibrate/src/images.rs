//! Images from a folder, a bag, a video file, a camera or a live topic, one after the other.

use anyhow::{Context, Error, Result, anyhow, bail, ensure};
use bag::BagReader;
use marker_tracker::{ImageError, OwnedImage, from_encoding, node::video::Frames};
use opencv::{core, imgcodecs, imgproc, prelude::*};
use rig_model::Stamp;
use std::{
    io::{self, BufRead, BufReader},
    os::unix::fs::FileTypeExt,
    path::{Path, PathBuf},
    process::Command,
    sync::mpsc::{RecvTimeoutError, sync_channel},
    time::Duration,
};
use volant::live::tap::Tap;
use volant_msgs::{Message, cdr, sensor_msgs::msg};

/// Image in OpenCV's channel order (blue, green, red).
pub struct Frame {
    /// File name, or topic and number in the bag.
    pub name: String,
    /// Three channels of 8 bits.
    pub bgr: core::Mat,
}

/// Kind of image source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Folder of images, or one image: chosen by hand.
    Files,
    /// A bag.
    Bag,
    /// A video file.
    Video,
    /// Camera device; endless.
    Device,
    /// Live image topic; endless.
    Topic,
}

impl Kind {
    /// Whether the source is endless.
    pub fn is_live(self) -> bool {
        matches!(self, Self::Device | Self::Topic)
    }

    /// Kind of a path; a topic where no such file exists.
    pub fn of(source: &Path) -> Self {
        let ending = source.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        let special = source.metadata().is_ok_and(|m| m.file_type().is_char_device());
        let name = source.to_string_lossy();
        let is_topic = name.chars().all(|c| c.is_ascii_alphanumeric() || "_/".contains(c));
        match ending.as_str() {
            _ if special => Self::Device,
            _ if is_topic && !source.exists() => Self::Topic,
            "mcap" | "zst" | "zstd" => Self::Bag,
            _ if source.join("metadata.yaml").is_file() => Self::Bag,
            "mp4" | "avi" | "mkv" | "mov" | "webm" | "m4v" | "mpg" | "mpeg" | "ogv" => Self::Video,
            _ => Self::Files,
        }
    }
}

/// Calls `take` with each image until it returns false, and returns the number of images.
///
/// # Errors
/// No such `source`, no image in it, or an undecodable one.
pub fn each(
    source: &Path,
    topic: Option<&str>,
    mut take: impl FnMut(Frame) -> Result<bool>,
) -> Result<usize> {
    let shown = source.display();
    let kind = Kind::of(source);
    ensure!(
        kind == Kind::Topic || source.exists(),
        "{shown}: no such source; name a folder with images, an image, a bag, a video file, \
         a device such as /dev/video0, or a live topic"
    );
    let count = match kind {
        Kind::Files => from_files(source, &mut take)?,
        Kind::Bag => from_bag(source, topic, &mut take)?,
        Kind::Topic => from_topic(&shown.to_string(), &mut take)?,
        Kind::Video | Kind::Device => from_ffmpeg(source, kind == Kind::Device, &mut take)?,
    };
    ensure!(
        count > 0,
        "{shown}: no image in it (jpg, png, bmp, tif, a video, or a bag with images); name \
         another source"
    );
    Ok(count)
}

fn from_files(source: &Path, take: &mut impl FnMut(Frame) -> Result<bool>) -> Result<usize> {
    let files = if source.is_dir() {
        let mut files: Vec<PathBuf> = std::fs::read_dir(source)
            .with_context(|| format!("{}: not readable", source.display()))?
            .filter_map(|entry| entry.ok().map(|e| e.path()))
            .filter(|path| {
                let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
                ["jpg", "jpeg", "png", "bmp", "tif", "tiff"].iter().any(|e| ending == *e)
            })
            .collect();
        files.sort();
        files
    } else {
        vec![source.to_owned()]
    };
    for (count, path) in files.iter().enumerate() {
        let bgr = imgcodecs::imread(path, imgcodecs::IMREAD_COLOR)?;
        ensure!(
            !bgr.empty(),
            "{}: not a decodable image; remove it or convert it to png",
            path.display()
        );
        let name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        if !take(Frame { name, bgr })? {
            return Ok(count + 1);
        }
    }
    Ok(files.len())
}

/// A video file or a V4L2 device, decoded by an `ffmpeg` process.
fn from_ffmpeg(
    source: &Path,
    device: bool,
    take: &mut impl FnMut(Frame) -> Result<bool>,
) -> Result<usize> {
    let shown = source.display();
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "error", "-nostdin"]);
    if device {
        command.args(["-f", "v4l2"]);
    }
    command.arg("-i").arg(source).args(["-f", "image2pipe", "-c:v", "ppm", "pipe:1"]);
    let mut frames = Frames::start(&mut command).map_err(Error::msg)?;
    let mut pipe = BufReader::new(&mut frames.pipe);
    let mut count = 0;
    let name = source.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    while let Some((_, height, rgb)) = next_ppm(&mut pipe)
        .with_context(|| format!("{shown}: the output of ffmpeg is not readable"))?
    {
        count += 1;
        let bgr = from_rgb(&rgb, height)?;
        if !take(Frame { name: format!("{name} #{count}"), bgr })? {
            return Ok(count);
        }
    }
    if count == 0 {
        let why = frames.reason().unwrap_or_else(|| "it has no image".to_owned());
        bail!("{shown}: {why}; check that it is a video, or a connected camera that is not in use");
    }
    Ok(count)
}

/// Reads the next binary PPM: width, height, pixels; `None` at the end.
fn next_ppm(pipe: &mut impl BufRead) -> io::Result<Option<(i32, i32, Vec<u8>)>> {
    let wrong = || io::Error::new(io::ErrorKind::InvalidData, "not a PPM image");
    let mut numbers = [0i32; 3];
    let mut line = Vec::new();
    if pipe.read_until(b'\n', &mut line)? == 0 {
        return Ok(None);
    }
    if line.trim_ascii() != b"P6" {
        return Err(wrong());
    }
    let mut found = 0;
    while found < 3 {
        line.clear();
        if pipe.read_until(b'\n', &mut line)? == 0 {
            return Err(wrong());
        }
        for word in String::from_utf8_lossy(&line).split_ascii_whitespace() {
            let slot = numbers.get_mut(found).ok_or_else(wrong)?;
            *slot = word.parse().map_err(|_| wrong())?;
            found += 1;
        }
    }
    let [width, height, most] = numbers;
    if !(1..=20_000).contains(&width) || !(1..=20_000).contains(&height) || most != 255 {
        return Err(wrong());
    }
    let mut rgb = vec![0; 3 * width as usize * height as usize];
    match pipe.read_exact(&mut rgb) {
        Ok(()) => Ok(Some((width, height, rgb))),
        // A stream that is cut off, such as by Ctrl-C, ends with the last complete image.
        Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => Ok(None),
        Err(e) => Err(e),
    }
}

fn from_bag(
    source: &Path,
    topic: Option<&str>,
    take: &mut impl FnMut(Frame) -> Result<bool>,
) -> Result<usize> {
    let mut bag = BagReader::open(source)?;
    let mut chosen: Option<String> = topic.map(str::to_owned);
    let mut count = 0;
    while let Some(message) = bag.next_message()? {
        let kind = message.topic.type_name.as_str();
        if !IMAGES.contains(&kind) {
            continue;
        }
        let wanted = chosen.get_or_insert_with(|| message.topic.name.clone());
        if *wanted != message.topic.name {
            continue;
        }
        count += 1;
        let name = format!("{} #{count}", message.topic.name);
        let what = || format!("{}: {name}", source.display());
        let bgr = decoded(kind, &message.data).with_context(what)?;
        if !take(Frame { name, bgr })? {
            break;
        }
    }
    if count == 0
        && let Some(topic) = topic
    {
        bail!(
            "{}: no image on the topic {topic}; `volant bag info` lists the topics",
            source.display()
        );
    }
    Ok(count)
}

/// Time limit for discovery of the publisher and between two images, s.
const PATIENCE: Duration = Duration::from_secs(5);

/// Reads a live topic. At most one image waits, so that the next one is always recent.
fn from_topic(source: &str, take: &mut impl FnMut(Frame) -> Result<bool>) -> Result<usize> {
    let name = if source.starts_with('/') { source.to_owned() } else { format!("/{source}") };
    let mut tap =
        Tap::join("_volant_calibrate").with_context(|| format!("{name}: subscribing fails"))?;
    let mut found = None;
    for _ in 0..50 {
        let offers = tap.offers();
        found = offers.into_iter().find(|o| o.topic.name == name);
        if found.is_some() {
            break;
        }
        std::thread::sleep(PATIENCE / 50);
    }
    let Some(offer) = found else {
        let images: Vec<String> =
            tap.offers().into_iter().map(|o| o.topic).filter(is_image).map(|t| t.name).collect();
        let known = if images.is_empty() {
            "no images are published".to_owned()
        } else {
            format!("images are on {}", images.join(", "))
        };
        bail!(
            "{source}: there is no such file or folder, and no topic {name} ({known}); correct \
             the path, or start the camera's driver"
        );
    };
    ensure!(
        is_image(&offer.topic),
        "{name}: the topic has the type {}, not images",
        offer.topic.type_name
    );
    let (sender, samples) = sync_channel(1);
    let _subscription = tap.subscribe(&offer, move |sample| {
        // Full: the previous image is still being processed.
        let _ = sender.try_send(sample);
    })?;
    let mut count = 0;
    loop {
        let sample = match samples.recv_timeout(PATIENCE) {
            Ok(sample) => sample,
            Err(RecvTimeoutError::Timeout) if count == 0 => {
                bail!("{name}: it has a publisher, but no message within {} s", PATIENCE.as_secs())
            }
            // The camera was switched off: the images so far are used.
            Err(_) => return Ok(count),
        };
        count += 1;
        let bgr = decoded(&offer.topic.type_name, &sample.data)
            .with_context(|| format!("{name}: an image"))?;
        if !take(Frame { name: format!("{name} #{count}"), bgr })? {
            return Ok(count);
        }
    }
}

const IMAGES: [&str; 2] = [msg::CompressedImage::TYPE_NAME, msg::Image::TYPE_NAME];

fn is_image(topic: &bag::Topic) -> bool {
    IMAGES.contains(&topic.type_name.as_str())
}

/// Decodes a message of one of the types in [`IMAGES`].
fn decoded(type_name: &str, data: &[u8]) -> Result<core::Mat> {
    if type_name != msg::CompressedImage::TYPE_NAME {
        return from_message(&cdr::from_bytes(data)?);
    }
    let image: msg::CompressedImage = cdr::from_bytes(data)?;
    let data = core::Vector::<u8>::from_slice(&image.data);
    let bgr = imgcodecs::imdecode(&data, imgcodecs::IMREAD_COLOR)?;
    ensure!(!bgr.empty(), "an undecodable {} image", image.format);
    Ok(bgr)
}

fn from_message(image: &msg::Image) -> Result<core::Mat> {
    let (width, height, step) = (image.width as usize, image.height as usize, image.step as usize);
    let tripled: Vec<u8>;
    let (encoding, step, data) = match image.encoding.as_str() {
        "mono8" => {
            tripled = image.data.iter().flat_map(|light| [*light; 3]).collect();
            ("rgb8", 3 * step, &tripled)
        }
        encoding => (encoding, step, &image.data),
    };
    let (at, big_endian, mut scratch) = (Stamp::default(), false, OwnedImage::default());
    let view = from_encoding(at, width, height, encoding, big_endian, step, data, &mut scratch);
    let view = view.map_err(|error| match error {
        ImageError::Size { .. } => anyhow!("width, height, step and data are inconsistent"),
        _ => anyhow!(
            "its encoding {encoding} is not supported; record bgr8, rgb8, mono8 or compressed \
             images"
        ),
    })?;
    from_rgb(&view.to_rgb(), height as i32)
}

/// Converts pixels of red, green and blue.
fn from_rgb(rgb: &[u8], height: i32) -> Result<core::Mat> {
    let flat = core::Mat::from_slice(rgb)?;
    let mut bgr = core::Mat::default();
    imgproc::cvt_color_def(&flat.reshape(3, height)?, &mut bgr, imgproc::COLOR_RGB2BGR)?;
    Ok(bgr)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_model::topics;

    #[test]
    fn images_of_a_stream_are_separated_and_invalid_ones_are_rejected() {
        let mut stream = b"P6\n2 1\n255\nabcdefP6\n1 1\n255\nxyzP6\n9 9\n255\ncut".as_slice();
        assert_eq!(next_ppm(&mut stream).unwrap(), Some((2, 1, b"abcdef".to_vec())));
        assert_eq!(next_ppm(&mut stream).unwrap(), Some((1, 1, b"xyz".to_vec())));
        assert_eq!(next_ppm(&mut stream).unwrap(), None, "cut off");
        for nonsense in
            ["P5\n1 1\n255\n", "P6\n-1 1\n255\n", "P6\n1 1\n65535\n", "P6\n1", "P6\n1 1 255 4\n"]
        {
            assert!(next_ppm(&mut nonsense.as_bytes()).is_err(), "{nonsense:?}");
        }
    }

    #[test]
    fn kinds_of_sources_are_detected() {
        let kind = |source: &str| Kind::of(Path::new(source));
        assert_eq!(kind("/dev/null"), Kind::Device);
        assert_eq!([kind("a/run.mcap"), kind("a/run.mcap.zst")], [Kind::Bag; 2]);
        assert_eq!((kind("boards.MP4"), kind("src")), (Kind::Video, Kind::Files));
        assert_eq!(kind(topics::absolute::IMAGE), Kind::Topic);
    }
}
