//! Video file, decoded by an `ffmpeg` process. [`Frames`] is that process, for other programs too.

use super::{Arrival, MarkerTrackerParameters, source::Frame};
use node_kit::{Clock, DeviceSender};
use std::{
    io::{self, BufRead, BufReader, Read},
    process::{Child, ChildStdout, Command, Stdio},
    thread::JoinHandle,
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
pub(crate) fn probe(path: &str) -> Result<Video, String> {
    if !std::path::Path::new(path).is_file() {
        return Err(format!("video file {path} does not exist; set file.path"));
    }
    let output = Command::new("ffprobe")
        .args(["-v", "error", "-select_streams", "v:0", "-of", "csv=p=0", "-show_entries"])
        .args(["stream=width,height,r_frame_rate,avg_frame_rate", path])
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
    format!("{program} did not start ({error}); install it: apt-get install ffmpeg")
}

/// Parses ffprobe's `640,480,30000/1001,30000/1001`: size, base rate and mean rate.
///
/// The base rate is exact for a constant rate. Of a variable one it is the common multiple of all
/// intervals, such as 1000 Hz.
fn parse(line: &str) -> Option<Video> {
    let mut parts = line.lines().next()?.split(',');
    let (width, height) = (parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    let base = ratio(parts.next()?)?;
    let mean = parts.next().and_then(ratio).unwrap_or(base);
    let rate = if (base / mean - 1.0).abs() < 0.01 { base } else { mean };
    let plausible = (1..=16_384).contains(&width) && (1..=16_384).contains(&height);
    plausible.then_some(Video { width, height, rate })
}

/// A rate, Hz; `None` for an unknown one (0/0).
fn ratio(text: &str) -> Option<f64> {
    let (over, under) = text.split_once('/')?;
    let rate = over.parse::<f64>().ok()? / under.parse::<f64>().ok()?;
    (rate.is_finite() && rate > 0.0).then_some(rate)
}

/// Kills the process on drop.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Frames that an `ffmpeg` process writes; it is killed on drop.
pub struct Frames {
    child: Killed,
    /// Standard output of the process.
    pub pipe: ChildStdout,
    /// The last line of its messages, read on a thread of its own so that their pipe never fills.
    reason: JoinHandle<Option<String>>,
}

impl Frames {
    /// Starts the process.
    ///
    /// # Errors
    /// It did not start, such as because it is not installed.
    pub fn start(command: &mut Command) -> Result<Self, String> {
        let piped = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let child = piped.spawn().map_err(|e| not_installed("ffmpeg", &e))?;
        let mut child = Killed(child);
        let (Some(pipe), Some(errors)) = (child.0.stdout.take(), child.0.stderr.take()) else {
            return Err("ffmpeg has no output".to_owned());
        };
        let reason = std::thread::spawn(move || {
            let lines = BufReader::new(errors).split(b'\n').map_while(Result::ok);
            let lines = lines.map(|line| String::from_utf8_lossy(&line).trim().to_owned());
            lines.filter(|line| !line.is_empty()).last()
        });
        Ok(Self { child, pipe, reason })
    }

    /// The next frame of `size` bytes; `None` at the end.
    fn next(&mut self, size: usize) -> Result<Option<Vec<u8>>, String> {
        let mut data = vec![0; size];
        match self.pipe.read_exact(&mut data) {
            Ok(()) => Ok(Some(data)),
            Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => Ok(None),
            Err(e) => Err(e.to_string()),
        }
    }

    /// Waits for the end of the process's messages, and returns the last line of them.
    pub fn reason(self) -> Option<String> {
        self.reason.join().ok().flatten()
    }

    /// Waits for the process after its last frame.
    ///
    /// # Errors
    /// Its reason, where it failed or `number` is 0.
    fn finish(mut self, number: u32) -> Result<(), String> {
        let is_done = self.child.0.wait().is_ok_and(|status| status.success());
        if is_done && number > 0 {
            return Ok(());
        }
        let reason = self.reason().unwrap_or_else(|| "no reason given".to_owned());
        Err(format!("ffmpeg failed after {number} frames ({reason}); convert it to another format"))
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
    let named = |reason: String| format!("video file {}: {reason}", parameters.file_path);
    sender.send(Arrival::Ended(end.map_err(named)));
}

fn play(
    parameters: &MarkerTrackerParameters,
    video: Video,
    sender: &DeviceSender<Arrival>,
    clock: &Clock,
) -> Result<(), String> {
    // The size is that before a rotation, and the stamps are those of a constant rate.
    let mut frames = Frames::start(
        Command::new("ffmpeg")
            .args(["-v", "error", "-nostdin", "-noautorotate", "-i", &parameters.file_path])
            .args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-r", &video.rate.to_string(), "pipe:1"]),
    )?;
    let size = video.width as usize * video.height as usize * 3;
    let start = clock.now();
    let mut number = 0u32;
    while sender.is_open() {
        let Some(data) = frames.next(size)? else { return frames.finish(number) };
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
            sequence: number,
            encoding: Some("rgb8"),
            width: video.width,
            height: video.height,
            step: video.width * 3,
            data,
        };
        sender.send(Arrival::Frame(Box::new(frame)));
        number += 1;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_output_of_ffprobe_is_parsed() {
        assert_eq!(parse("632,468,30/1"), Some(Video { width: 632, height: 468, rate: 30.0 }));
        assert_eq!(parse("632,468,0/0,0/0"), None);
        let rate = |line| parse(line).map(|video| video.rate);
        assert_eq!(rate("632,468,25/1,0/0"), Some(25.0));
        assert_eq!(rate("632,468,30/1,20120/671,"), Some(30.0));
        assert_eq!(rate("632,468,1000/1,24/1"), Some(24.0));
        assert_eq!(parse(""), None);
        assert!(probe("/does/not/exist.mp4").unwrap_err().contains("/does/not/exist.mp4"));
    }

    #[test]
    fn a_decoder_that_fails_is_reported_with_its_reason() {
        let played = |script: &str| {
            let mut frames = Frames::start(Command::new("sh").args(["-c", script])).unwrap();
            let mut number = 0;
            while frames.next(3).unwrap().is_some() {
                number += 1;
            }
            (number, frames.finish(number))
        };
        assert_eq!(played("printf 123456789"), (3, Ok(())));
        let (number, end) = played("printf 1234567; echo 'Invalid data' >&2; exit 1");
        assert!(number == 2 && end.unwrap_err().contains("after 2 frames (Invalid data)"));
        assert!(played("true").1.is_err());
        // More messages than a pipe holds do not block it.
        let (number, end) = played("head -c 1000000 /dev/zero | tr '\\0' '\\n' >&2; printf 123");
        assert_eq!((number, end), (1, Ok(())));
    }
}
