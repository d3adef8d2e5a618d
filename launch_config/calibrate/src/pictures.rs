//! Pictures from a folder, a bag, a video file, a camera or a live topic, one after the other.

use anyhow::{Context, Result, bail, ensure};
use launch_config::{bag::BagReader, live::tap::Tap};
use opencv::{core, imgcodecs, imgproc, prelude::*};
use std::{
    io::{self, BufRead, BufReader, Read},
    os::unix::fs::FileTypeExt,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::mpsc::{RecvTimeoutError, sync_channel},
    time::Duration,
};
use volant_msgs::{Message, cdr, sensor_msgs::msg};

/// A picture in OpenCV's order (blue, green, red).
pub struct Picture {
    /// File name, or topic and number in the bag.
    pub name: String,
    /// Three channels of 8 bits.
    pub bgr: core::Mat,
}

/// Where pictures come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A folder of pictures, or one picture: chosen by hand.
    Files,
    /// A bag.
    Bag,
    /// A video file.
    Video,
    /// A camera that is a device of this computer: it goes on until it is enough.
    Device,
    /// A live image topic: as a camera.
    Topic,
}

impl Kind {
    /// Does it go on until it is told that it is enough?
    pub fn is_live(self) -> bool {
        matches!(self, Self::Device | Self::Topic)
    }

    /// What a path is, or the name of a topic where there is no such file.
    pub fn of(source: &Path) -> Self {
        let ending = source.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        let special = source.metadata().is_ok_and(|m| m.file_type().is_char_device());
        let name = source.to_string_lossy();
        let could_be_topic = name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '/');
        match ending.as_str() {
            _ if special => Self::Device,
            _ if could_be_topic && !source.exists() => Self::Topic,
            "mcap" | "zstd" => Self::Bag,
            _ if source.join("metadata.yaml").is_file() => Self::Bag,
            "mp4" | "avi" | "mkv" | "mov" | "webm" | "m4v" | "mpg" | "mpeg" | "ogv" => Self::Video,
            _ => Self::Files,
        }
    }
}

/// Calls `take` with each picture; it answers whether it wants more. Returns how many there were.
///
/// # Errors
/// Nothing at `source`, no picture in it, or one that cannot be read.
pub fn each(
    source: &Path,
    topic: Option<&str>,
    mut take: impl FnMut(Picture) -> Result<bool>,
) -> Result<usize> {
    let shown = source.display();
    let kind = Kind::of(source);
    ensure!(
        kind == Kind::Topic || source.exists(),
        "{shown}: there is nothing; name a folder with pictures, a picture, a bag, a video file, a device such as /dev/video0, or a \
         live topic"
    );
    let count = match kind {
        Kind::Files => from_files(source, &mut take)?,
        Kind::Bag => from_bag(source, topic, &mut take)?,
        Kind::Topic => from_topic(&shown.to_string(), &mut take)?,
        Kind::Video | Kind::Device => from_ffmpeg(source, kind == Kind::Device, &mut take)?,
    };
    ensure!(
        count > 0,
        "{shown}: no picture in it (jpg, png, bmp, tif, a video, or a bag with images); name another source"
    );
    Ok(count)
}

fn from_files(source: &Path, take: &mut impl FnMut(Picture) -> Result<bool>) -> Result<usize> {
    let files = if source.is_dir() {
        let mut files: Vec<PathBuf> = std::fs::read_dir(source)
            .with_context(|| format!("{} cannot be listed", source.display()))?
            .filter_map(|entry| entry.ok().map(|e| e.path()))
            .filter(|path| {
                path.extension().and_then(|e| e.to_str()).is_some_and(|e| {
                    ["jpg", "jpeg", "png", "bmp", "tif", "tiff"].contains(&e.to_ascii_lowercase().as_str())
                })
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
            "{}: not a picture that can be decoded; remove it or convert it to png",
            path.display()
        );
        let name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        if !take(Picture { name, bgr })? {
            return Ok(count + 1);
        }
    }
    Ok(files.len())
}

/// Ends the process when it is no longer read.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A video file or a V4L2 device, decoded by an `ffmpeg` process.
fn from_ffmpeg(source: &Path, device: bool, take: &mut impl FnMut(Picture) -> Result<bool>) -> Result<usize> {
    let shown = source.display();
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "error", "-nostdin"]);
    if device {
        command.args(["-f", "v4l2"]);
    }
    command.arg("-i").arg(source).args(["-f", "image2pipe", "-c:v", "ppm", "pipe:1"]);
    let child =
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().map_err(|e| {
            anyhow::anyhow!(
                "ffmpeg cannot be started ({e}); videos and cameras need it: apt-get install ffmpeg"
            )
        })?;
    let mut child = Killed(child);
    let Some(pipe) = child.0.stdout.take() else { bail!("ffmpeg has no output") };
    let mut pipe = BufReader::new(pipe);
    let mut count = 0;
    let name = source.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    while let Some((width, height, rgb)) =
        next_ppm(&mut pipe).with_context(|| format!("{shown}: what ffmpeg made of it cannot be read"))?
    {
        count += 1;
        let flat = core::Mat::from_slice(&rgb)?;
        let shaped = flat.reshape(3, height)?;
        ensure!(shaped.cols() == width, "{shown}: width and data contradict each other");
        let mut bgr = core::Mat::default();
        imgproc::cvt_color_def(&shaped, &mut bgr, imgproc::COLOR_RGB2BGR)?;
        if !take(Picture { name: format!("{name} #{count}"), bgr })? {
            return Ok(count);
        }
    }
    if count == 0 {
        let mut words = String::new();
        if let Some(mut said) = child.0.stderr.take() {
            let _ = said.read_to_string(&mut words);
        }
        let why = words.lines().last().unwrap_or("it gave no picture").trim().to_owned();
        bail!("{shown}: {why}; see that it is a video, or a camera that is plugged in and not in use");
    }
    Ok(count)
}

/// The next binary PPM: width, height, pixels; `None` at the end.
fn next_ppm(pipe: &mut impl BufRead) -> io::Result<Option<(i32, i32, Vec<u8>)>> {
    let wrong = || io::Error::new(io::ErrorKind::InvalidData, "not a PPM picture");
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
        // A stream that is cut off, such as by Ctrl-C, ends with the last whole picture.
        Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => Ok(None),
        Err(e) => Err(e),
    }
}

fn from_bag(
    source: &Path,
    topic: Option<&str>,
    take: &mut impl FnMut(Picture) -> Result<bool>,
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
        if !take(Picture { name, bgr })? {
            break;
        }
    }
    if count == 0
        && let Some(topic) = topic
    {
        bail!("{}: no image on the topic {topic}; `volant bag info` lists the topics", source.display());
    }
    Ok(count)
}

/// How long a topic may be silent, s: also the time in which its publisher must be found.
const PATIENCE: Duration = Duration::from_secs(5);

/// A live topic. While a picture is looked at, at most one waits: the next is always a recent one.
fn from_topic(name: &str, take: &mut impl FnMut(Picture) -> Result<bool>) -> Result<usize> {
    let name = if name.starts_with('/') { name.to_owned() } else { format!("/{name}") };
    let mut tap = Tap::join().with_context(|| format!("{name} cannot be listened to"))?;
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
        let mut images: Vec<String> =
            tap.offers().into_iter().map(|o| o.topic).filter(is_image).map(|t| t.name).collect();
        images.sort();
        let known = if images.is_empty() {
            "no images are published".to_owned()
        } else {
            format!("images are on {}", images.join(", "))
        };
        bail!(
            "{name}: nobody publishes it, nor is there a file of that name ({known}); is the camera's driver running?"
        );
    };
    ensure!(is_image(&offer.topic), "{name}: it carries {}, no images", offer.topic.type_name);
    let (sender, samples) = sync_channel(1);
    let _subscription = tap.subscribe(&offer, move |sample| {
        // Full: the one before is still looked at.
        let _ = sender.try_send(sample);
    })?;
    let mut count = 0;
    loop {
        let sample = match samples.recv_timeout(PATIENCE) {
            Ok(sample) => sample,
            Err(RecvTimeoutError::Timeout) if count == 0 => {
                bail!("{name}: it has a publisher, but nothing came within {} s", PATIENCE.as_secs())
            }
            // The camera was switched off: what was seen so far is used.
            Err(_) => return Ok(count),
        };
        count += 1;
        let bgr =
            decoded(&offer.topic.type_name, &sample.data).with_context(|| format!("{name}: an image"))?;
        if !take(Picture { name: format!("{name} #{count}"), bgr })? {
            return Ok(count);
        }
    }
}

const IMAGES: [&str; 2] = [msg::CompressedImage::TYPE_NAME, msg::Image::TYPE_NAME];

fn is_image(topic: &launch_config::bag::Topic) -> bool {
    IMAGES.contains(&topic.type_name.as_str())
}

/// A message of one of [`IMAGES`].
fn decoded(type_name: &str, data: &[u8]) -> Result<core::Mat> {
    if type_name != msg::CompressedImage::TYPE_NAME {
        return from_message(&cdr::from_bytes(data)?);
    }
    let image: msg::CompressedImage = cdr::from_bytes(data)?;
    let data = core::Vector::<u8>::from_slice(&image.data);
    let bgr = imgcodecs::imdecode(&data, imgcodecs::IMREAD_COLOR)?;
    ensure!(!bgr.empty(), "a {} picture that cannot be decoded", image.format);
    Ok(bgr)
}

fn from_message(image: &msg::Image) -> Result<core::Mat> {
    let (rows, cols, step) = (image.height as i32, image.width as i32, image.step as usize);
    let (channels, code) = match image.encoding.as_str() {
        "bgr8" => (3, None),
        "rgb8" => (3, Some(imgproc::COLOR_RGB2BGR)),
        "bgra8" => (4, Some(imgproc::COLOR_BGRA2BGR)),
        "rgba8" => (4, Some(imgproc::COLOR_RGBA2BGR)),
        "mono8" => (1, Some(imgproc::COLOR_GRAY2BGR)),
        other => {
            bail!("its encoding {other} is not taken here; record bgr8, rgb8, mono8 or compressed images")
        }
    };
    let row = image.width as usize * channels;
    ensure!(
        step >= row && row > 0 && image.data.len() >= step * (image.height as usize).saturating_sub(1) + row,
        "width, height, step and data contradict each other"
    );
    let mut tight = Vec::with_capacity(row * image.height as usize);
    for line in image.data.chunks(step).take(image.height as usize) {
        tight.extend_from_slice(&line[..row]);
    }
    let flat = core::Mat::from_slice(&tight)?;
    let shaped = flat.reshape(channels as i32, rows)?;
    ensure!(shaped.cols() == cols, "width and data contradict each other");
    let mut bgr = core::Mat::default();
    match code {
        Some(code) => imgproc::cvt_color_def(&shaped, &mut bgr, code)?,
        None => shaped.copy_to(&mut bgr)?,
    }
    Ok(bgr)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_of_a_stream_are_told_apart_and_nonsense_is_refused() {
        let mut stream = b"P6\n2 1\n255\nabcdefP6\n1 1\n255\nxyzP6\n9 9\n255\ncut".as_slice();
        assert_eq!(next_ppm(&mut stream).unwrap(), Some((2, 1, b"abcdef".to_vec())));
        assert_eq!(next_ppm(&mut stream).unwrap(), Some((1, 1, b"xyz".to_vec())));
        assert_eq!(next_ppm(&mut stream).unwrap(), None, "cut off");
        for nonsense in ["P5\n1 1\n255\n", "P6\n-1 1\n255\n", "P6\n1 1\n65535\n", "P6\n1", "P6\n1 1 255 4\n"]
        {
            assert!(next_ppm(&mut nonsense.as_bytes()).is_err(), "{nonsense:?}");
        }
    }

    #[test]
    fn a_source_is_known_by_what_it_is() {
        assert_eq!(Kind::of(Path::new("/dev/null")), Kind::Device);
        assert_eq!(Kind::of(Path::new("a/run.mcap")), Kind::Bag);
        assert_eq!(Kind::of(Path::new("boards.MP4")), Kind::Video);
        assert_eq!(Kind::of(Path::new("src")), Kind::Files);
        assert_eq!(Kind::of(Path::new("/climber/camera/image_raw")), Kind::Topic);
    }
}
