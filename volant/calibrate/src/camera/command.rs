//! `volant calibrate camera`.

use super::{
    board::{Board, View, corners, find},
    coverage::Coverage,
    solve::{Calibration, LensModel, calibrate},
};
use crate::images::{self, Kind};
use anyhow::{Context, Result, ensure};
use clap::Args;
use indicatif::ProgressBar;
use node_kit::outln;
use rig_model::{Distortion, median};
use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};
use volant::camera_info_file;

/// Calibrate the camera from images of a chessboard; writes a standard camera_info file
#[derive(Args, Debug)]
pub struct CameraArguments {
    /// Folder of images, bag (.mcap or rosbag2 folder) with images, video file, camera such as
    /// /dev/video0, or live image topic (the last two until the views suffice, or Ctrl-C)
    source: PathBuf,
    /// Inner corners of the chessboard, COLUMNSxROWS
    #[arg(long, default_value = "9x6", value_parser = corners)]
    board: (i32, i32),
    /// Edge of a square, m
    #[arg(long, default_value_t = 0.025)]
    square: f64,
    /// camera_info file: an existing one is updated in place, keeps every other key and comment,
    /// and the former file is kept as FILE.bak
    #[arg(long, default_value = "camera.yaml")]
    out: PathBuf,
    /// camera_name in that file [default: that of the file, else `camera`]
    #[arg(long)]
    name: Option<String>,
    /// Image topic of a bag [default: the first one]
    #[arg(long)]
    topic: Option<String>,
    /// Lens model
    #[arg(long, value_enum, default_value = "plumb_bob")]
    model: LensModel,
    /// Half width of the window in which a corner is refined, px (smaller for strongly tilted
    /// boards)
    #[arg(long, default_value_t = 11, value_parser = clap::value_parser!(i32).range(2..=50))]
    window: i32,
    /// Ignore views with an error above this multiple of the median [default: use all]
    #[arg(long)]
    reject: Option<f64>,
    /// Largest number of views from a bag, video or camera; each differs from the earlier ones
    #[arg(long, default_value_t = 80)]
    views: usize,
}

/// Runs the command.
///
/// # Errors
/// See the messages, which name the remedy.
pub fn run(arguments: &CameraArguments) -> Result<()> {
    let (columns, rows) = arguments.board;
    ensure!(
        arguments.square > 0.0 && arguments.square.is_finite(),
        "--square {}: the edge of a square is a length in meters, such as 0.025",
        arguments.square
    );
    camera_info_file::check(&arguments.out)?;
    let board = Board { columns, rows, square: arguments.square };
    let (mut views, mut coverage, mut without) =
        (Vec::<View>::new(), Coverage::default(), Vec::new());
    let shown = arguments.source.display();
    let kind = Kind::of(&arguments.source);
    let from_files = kind == Kind::Files;
    let guide = Guide::new(kind)?;
    let count = images::each(&arguments.source, arguments.topic.as_deref(), |frame| {
        match find(&frame.bgr, &frame.name, &board, arguments.window)? {
            // Of a recording only views that add information; image files were chosen by hand.
            Some(view) if from_files || coverage.adds(&view, &board) => {
                coverage.add(&view, &board);
                views.push(view);
                guide.say(&coverage, views.len());
            }
            Some(_) => {}
            None => without.push(frame.name),
        }
        let enough = kind.is_live() && coverage.missing().is_empty();
        Ok(from_files || (views.len() < arguments.views && !enough && !guide.interrupted()))
    })?;
    guide.end();
    ensure!(
        !views.is_empty(),
        "{shown}: none of {count} images shows the full board of {columns}x{rows} inner \
         corners; count its inner corners \
         for --board"
    );
    outln!("{} of {count} images used", views.len())?;
    if from_files && !without.is_empty() {
        outln!(
            "the board of {columns}x{rows} inner corners is not fully visible in {}",
            without.join(", ")
        )?;
    }
    outln!("{coverage}")?;
    for sentence in coverage.missing() {
        outln!("missing: {sentence}")?;
    }
    let reject = arguments.reject.unwrap_or(f64::INFINITY);
    let calibration = calibrate(&board, &views, arguments.model, reject)
        .with_context(|| format!("{shown}: no calibration from {} views", views.len()))?;
    print(&calibration)?;
    let name = arguments.name.as_deref();
    let former = camera_info_file::write(&arguments.out, &calibration.model, name)?;
    outln!("written: {}", arguments.out.display())?;
    if let Some(former) = former {
        outln!("the former file is {}", former.display())?;
    }
    Ok(())
}

/// Status line for a live camera: the number of views, and what is missing.
struct Guide {
    bar: Option<ProgressBar>,
    interrupted: Arc<AtomicBool>,
}

impl Guide {
    fn new(kind: Kind) -> Result<Self> {
        let interrupted = Arc::new(AtomicBool::new(false));
        let bar = (kind != Kind::Files).then(|| {
            let bar = ProgressBar::new_spinner();
            bar.enable_steady_tick(std::time::Duration::from_millis(120));
            bar.set_message("looking for the board");
            bar
        });
        if kind.is_live() {
            // Ctrl-C ends the search, not the program: the views so far are used.
            signal_hook::flag::register(signal_hook::consts::SIGINT, interrupted.clone())
                .context("Ctrl-C is not handled")?;
        }
        Ok(Self { bar, interrupted })
    }

    fn say(&self, coverage: &Coverage, views: usize) {
        if let Some(bar) = &self.bar {
            let missing = coverage.missing();
            let next = missing.first().map_or("nothing is missing", String::as_str);
            bar.set_message(format!("{views} views; next: {next}"));
        }
    }

    fn interrupted(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
    }

    fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

fn print(calibration: &Calibration) -> Result<()> {
    let (f, c) = (calibration.model.focal_lengths(), calibration.model.principal_point());
    let sd = &calibration.intrinsic_deviations;
    outln!("\n{:<5} {:>14} {:>12}", "", "value", "std dev")?;
    for (name, value, deviation) in
        [("fx", f.x, sd[0]), ("fy", f.y, sd[1]), ("cx", c.x, sd[2]), ("cy", c.y, sd[3])]
    {
        outln!("{name:<5} {value:>14.4} {deviation:>12.4}  px")?;
    }
    let (names, values): (&[&str], &[f64]) = match calibration.model.distortion() {
        Distortion::PlumbBob(d) => (&["k1", "k2", "p1", "p2", "k3"], d),
        Distortion::RationalPolynomial(d) => (&["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"], d),
        Distortion::Equidistant(d) => (&["k1", "k2", "k3", "k4"], d),
    };
    for ((name, value), deviation) in
        names.iter().zip(values).zip(&calibration.distortion_deviations)
    {
        outln!("{name:<5} {value:>14.6} {deviation:>12.6}")?;
    }
    outln!(
        "mean reprojection error: {:.4} px over {} views",
        calibration.mean_error,
        calibration.views.len()
    )?;
    for (name, error) in &calibration.rejected {
        outln!("ignored: {name} ({error:.3} px)")?;
    }
    let median = median(calibration.views.iter().map(|v| v.1).collect()).unwrap_or_default();
    for (name, error, _) in &calibration.views {
        if *error > 3.0 * median {
            outln!(
                "doubtful: {name} is off by {error:.3} px, {:.0} times the median; check it, or \
                 try --reject 3 or --window 7",
                error / median
            )?;
        }
    }
    Ok(())
}
