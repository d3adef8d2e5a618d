//! Camera device by V4L2, with the driver's stamps and sequence numbers and mapped buffers.

use super::{Arrival, MarkerTrackerParameters, source::Frame};
use node_kit::{Clock, DeviceSender, Level, Logger};
use rig_model::Stamp;
use std::{io, time::Duration};
use v4l::{
    Device, Format, FourCC,
    buffer::{Flags, Type},
    io::{
        mmap::Stream,
        traits::{CaptureStream, Stream as _},
    },
    video::{Capture, capture::Parameters},
};

/// Supported pixel formats in order of preference, with the ROS encoding; `None` is a JPEG.
const FORMATS: [(&[u8; 4], Option<&str>); 9] = [
    (b"RGB3", Some("rgb8")),
    (b"BGR3", Some("bgr8")),
    (b"YUYV", Some("yuv422_yuy2")),
    (b"UYVY", Some("yuv422")),
    (b"RGGB", Some("bayer_rggb8")),
    (b"BA81", Some("bayer_bggr8")),
    (b"GBRG", Some("bayer_gbrg8")),
    (b"GRBG", Some("bayer_grbg8")),
    (b"MJPG", None),
];

/// Time between two checks of whether the node has ended while no image comes, ms, and their number
/// after which the device is reopened: 5 s.
const WAIT: i32 = 200;
const MAX_WAITS: u32 = 25;
/// The event "data can be read" of poll(2).
const POLLIN: i16 = 1;

/// An opened device and its image format.
struct Opened {
    device: Device,
    encoding: Option<&'static str>,
    format: Format,
}

fn open(parameters: &MarkerTrackerParameters) -> Result<Opened, String> {
    let path = &parameters.device_path;
    let failed = |what: &str, e: io::Error| {
        format!(
            "camera {path}: {what}: {e}; check that it is connected, readable (group video) and not \
             in use, or set device.path"
        )
    };
    let device = Device::with_path(path).map_err(|e| failed("opening failed", e))?;
    let wanted = parameters.device_format.as_bytes();
    for (code, encoding) in FORMATS {
        if !wanted.is_empty() && wanted != code {
            continue;
        }
        let mut format = device.format().map_err(|e| failed("reading its format failed", e))?;
        (format.width, format.height, format.fourcc) =
            (parameters.device_width, parameters.device_height, FourCC::new(code));
        let Ok(given) = device.set_format(&format) else { continue };
        if given.fourcc != FourCC::new(code) {
            continue;
        }
        let frames = parameters.device_rate.round().max(1.0) as u32;
        // A camera with a fixed rate rejects this and keeps its own.
        let _ = device.set_params(&Parameters::with_fps(frames));
        return Ok(Opened { device, encoding, format: given });
    }
    let names: Vec<_> =
        FORMATS.iter().map(|(code, _)| String::from_utf8_lossy(*code).into_owned()).collect();
    Err(format!(
        "camera {path} has none of the pixel formats {}; set device.format or use another camera",
        names.join(", ")
    ))
}

/// Checks that the camera is present and has a supported format; returns a description.
pub(crate) fn check(parameters: &MarkerTrackerParameters) -> Result<String, String> {
    let Opened { encoding, format, .. } = open(parameters)?;
    let (path, encoding) = (&parameters.device_path, encoding.unwrap_or("jpeg"));
    Ok(format!("camera {path}: {}x{}, {encoding}", format.width, format.height))
}

/// Thread of the device: sends frames until the node ends; reopens a failed camera every second.
pub(crate) fn run(
    parameters: &MarkerTrackerParameters,
    sender: &DeviceSender<Arrival>,
    clock: &Clock,
    log: &Logger,
) {
    while sender.is_open() {
        if let Err(reason) = stream(parameters, sender, clock) {
            log.log(Level::Error, format!("{reason}; retrying in 1 s"));
            for _ in 0..10 {
                if !sender.is_open() {
                    return;
                }
                std::thread::sleep(Duration::from_millis(100));
            }
        }
    }
}

fn stream(
    parameters: &MarkerTrackerParameters,
    sender: &DeviceSender<Arrival>,
    clock: &Clock,
) -> Result<(), String> {
    let opened = open(parameters)?;
    let failed = |e: io::Error| format!("camera {}: {e}", parameters.device_path);
    let mut stream = Stream::with_buffers(&opened.device, Type::VideoCapture, 5).map_err(failed)?;
    // `next` queues the buffer of the last image, the first time that of index 0, and waits for
    // another. It is only called where one is there: after a timeout it would queue the same buffer
    // again, which the kernel rejects. Queueing fails at the first index without a buffer.
    let mut index = 1;
    while stream.queue(index).is_ok() {
        index += 1;
    }
    stream.start().map_err(failed)?;
    let handle = opened.device.handle();
    let mut waits = 0;
    while sender.is_open() {
        if handle.poll(POLLIN, WAIT).map_err(failed)? == 0 {
            waits += 1;
            if waits == MAX_WAITS {
                return Err(format!(
                    "camera {}: no image for 5 s; check its trigger and its cable",
                    parameters.device_path
                ));
            }
            continue;
        }
        waits = 0;
        let (buffer, meta) = stream.next().map_err(failed)?;
        if meta.flags.contains(Flags::ERROR) {
            sender.refuse();
            continue;
        }
        let used = (meta.bytesused as usize).min(buffer.len());
        let stamp = driver_stamp(meta, clock).plus_seconds(parameters.device_stamp_offset);
        let frame = Frame {
            stamp,
            sequence: meta.sequence,
            encoding: opened.encoding,
            width: opened.format.width,
            height: opened.format.height,
            step: opened.format.stride,
            data: buffer[..if used > 0 { used } else { buffer.len() }].to_vec(),
        };
        if !sender.send(Arrival::Frame(Box::new(frame))) {
            break;
        }
    }
    Ok(())
}

/// The driver's stamp on the node's clock. Drivers stamp on the monotonic clock; for others the
/// time of arrival is as good.
fn driver_stamp(meta: &v4l::buffer::Metadata, clock: &Clock) -> Stamp {
    let now = clock.now();
    if !meta.flags.contains(Flags::TIMESTAMP_MONOTONIC) {
        return now;
    }
    let steady = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    let age = (steady.tv_sec - meta.timestamp.sec) as f64 + steady.tv_nsec as f64 * 1e-9
        - meta.timestamp.usec as f64 * 1e-6;
    if (0.0..5.0).contains(&age) { now.plus_seconds(-age) } else { now }
}
