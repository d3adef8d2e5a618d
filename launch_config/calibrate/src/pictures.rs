//! Pictures from a folder or from a bag, one after the other.

use anyhow::{Context, Result, bail, ensure};
use launch_config::bag::BagReader;
use opencv::{core, imgcodecs, imgproc, prelude::*};
use std::path::{Path, PathBuf};
use volant_msgs::{Message, cdr, sensor_msgs::msg};

/// A picture in OpenCV's order (blue, green, red).
pub struct Picture {
    /// File name, or topic and number in the bag.
    pub name: String,
    /// Three channels of 8 bits.
    pub bgr: core::Mat,
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
    ensure!(source.exists(), "{shown}: there is nothing; name a folder with pictures, a picture or a bag");
    let is_bag = source.extension().is_some_and(|e| e == "mcap" || e == "zstd")
        || source.join("metadata.yaml").is_file();
    let count = if is_bag { from_bag(source, topic, &mut take)? } else { from_files(source, &mut take)? };
    ensure!(
        count > 0,
        "{shown}: no picture in it (jpg, png, bmp, tif, or a bag with images); name another source"
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
        let compressed = kind == msg::CompressedImage::TYPE_NAME;
        if !compressed && kind != msg::Image::TYPE_NAME {
            continue;
        }
        let wanted = chosen.get_or_insert_with(|| message.topic.name.clone());
        if *wanted != message.topic.name {
            continue;
        }
        count += 1;
        let name = format!("{} #{count}", message.topic.name);
        let what = || format!("{}: {name}", source.display());
        let bgr = if compressed {
            let image: msg::CompressedImage = cdr::from_bytes(&message.data).with_context(what)?;
            let data = core::Vector::<u8>::from_slice(&image.data);
            let bgr = imgcodecs::imdecode(&data, imgcodecs::IMREAD_COLOR)?;
            ensure!(!bgr.empty(), "{}: a {} picture that cannot be decoded", what(), image.format);
            bgr
        } else {
            from_message(&cdr::from_bytes(&message.data).with_context(what)?).with_context(what)?
        };
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
