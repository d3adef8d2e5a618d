//! Video file, decoded by an `ffmpeg` process.

use super::{Arrival, MarkerTrackerParameters, source::Frame};
use node_kit::{Clock, DeviceSender};
use std::{
    io::{self, Read},
    process::{Child, Command, Stdio},
    time::Duration,
};

/// Size (px) and rate (Hz) of a video.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Video {
    width: u32,
    height: u32,
    rate: f64,
}

/// Reads size and rate with `ffprobe`.
///
/// # Errors
/// One line with the file and the reason.
pub(crate) fn probe(path: &str) -> Result<Video, String> {
    if !std::path::Path::new(path).is_file() {
        return Err(format!("video file {path} does not exist; set file.path"));
    }
    let output = Command::new("ffprobe")
        .args([
            "-v",
            "error",
            "-select_streams",
            "v:0",
            "-show_entries",
            "stream=width,height,r_frame_rate",
        ])
        .args(["-of", "csv=p=0", path])
        .output()
        .map_err(|e| not_installed("ffprobe", &e))?;
    let text = String::from_utf8_lossy(&output.stdout);
    parse(text.trim()).ok_or_else(|| {
        let reason = String::from_utf8_lossy(&output.stderr);
        format!(
            "video file {path} is not readable ({}); use one with a video stream",
            reason.trim()
        )
    })
}

fn not_installed(program: &str, error: &io::Error) -> String {
    format!("{program} did not start ({error}); video files need it: apt-get install ffmpeg")
}

/// Parses ffprobe's `640,480,30000/1001`.
fn parse(line: &str) -> Option<Video> {
    let mut parts = line.lines().next()?.split(',');
    let (width, height) = (parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    let (over, under) = parts.next()?.split_once('/')?;
    let rate = over.parse::<f64>().ok()? / under.parse::<f64>().ok()?;
    let plausible = (1..=16_384).contains(&width)
        && (1..=16_384).contains(&height)
        && rate.is_finite()
        && rate > 0.0;
    plausible.then_some(Video { width, height, rate })
}

/// Kills the process on drop.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Thread of the file: sends each frame at its time, then [`Arrival::Ended`].
pub(crate) fn run(
    parameters: &MarkerTrackerParameters,
    video: Video,
    sender: &DeviceSender<Arrival>,
    clock: &Clock,
) {
    let end = play(parameters, video, sender, clock);
    sender.send(Arrival::Ended(end));
}

fn play(
    parameters: &MarkerTrackerParameters,
    video: Video,
    sender: &DeviceSender<Arrival>,
    clock: &Clock,
) -> Result<(), String> {
    let child = Command::new("ffmpeg")
        .args(["-v", "error", "-nostdin", "-i", &parameters.file_path])
        .args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-vsync", "passthrough", "pipe:1"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .map_err(|e| not_installed("ffmpeg", &e))?;
    let mut child = Killed(child);
    let mut pipe = child.0.stdout.take().ok_or_else(|| "ffmpeg has no output".to_owned())?;
    let size = video.width as usize * video.height as usize * 3;
    let start = clock.now();
    let mut number = 0u32;
    while sender.is_open() {
        let mut data = vec![0; size];
        match pipe.read_exact(&mut data) {
            Ok(()) => {}
            Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => break,
            Err(e) => return Err(format!("video file {}: {e}", parameters.file_path)),
        }
        let stamp = start.plus_seconds(f64::from(number) / video.rate);
        loop {
            let early = stamp.seconds_since(clock.now());
            if early <= 0.0 || !sender.is_open() {
                break;
            }
            std::thread::sleep(Duration::from_secs_f64(early.min(0.1)));
        }
        let frame = Frame {
            stamp,
            sequence: Some(number),
            encoding: Some("rgb8"),
            width: video.width,
            height: video.height,
            step: video.width * 3,
            data,
        };
        sender.send(Arrival::Frame(Box::new(frame)));
        number += 1;
    }
    if number == 0 {
        return Err(format!("video file {}: ffmpeg decoded no frame", parameters.file_path));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_output_of_ffprobe_is_parsed() {
        assert_eq!(parse("632,468,30/1"), Some(Video { width: 632, height: 468, rate: 30.0 }));
        assert_eq!(parse("632,468,0/0"), None);
        assert_eq!(parse(""), None);
        assert!(probe("/does/not/exist.mp4").unwrap_err().contains("/does/not/exist.mp4"));
    }
}
