//! `volant calibrate camera`.

use super::{
    Board, Calibration, Coverage, LensModel, Options, View, board::Corners, calibrate, camera_info_yaml, find,
};
use crate::pictures::{self, Kind};
use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};
use indicatif::ProgressBar;
use rig_model::Distortion;
use std::{
    fs,
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

/// The lens models by their names in camera_info.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Lens {
    #[value(name = "plumb_bob")]
    PlumbBob,
    #[value(name = "rational_polynomial")]
    RationalPolynomial,
}

/// The camera from pictures of a chessboard; writes a standard camera_info file.
#[derive(Args, Debug)]
pub struct CameraArguments {
    /// A folder of pictures, a bag (.mcap or rosbag2 folder) with images, a video file, or live: a camera such as /dev/video0, or an
    /// image topic (both go on until enough is seen, or until Ctrl-C).
    source: PathBuf,
    /// Inner corners of the chessboard, COLUMNSxROWS.
    #[arg(long, default_value = "9x6")]
    board: Corners,
    /// Edge of a square, m.
    #[arg(long, default_value_t = 0.025)]
    square: f64,
    /// The camera_info file to write.
    #[arg(long, default_value = "camera.yaml")]
    out: PathBuf,
    /// camera_name in that file.
    #[arg(long, default_value = "camera")]
    name: String,
    /// The image topic of a bag; without it the first one that is found.
    #[arg(long)]
    topic: Option<String>,
    /// The lens model.
    #[arg(long, value_enum, default_value = "plumb_bob")]
    model: Lens,
    /// Hold fx = fy.
    #[arg(long)]
    fix_aspect_ratio: bool,
    /// Half width of the window in which a corner is refined, px (OpenCV's 11; smaller for strongly tilted boards).
    #[arg(long, default_value_t = 11, value_parser = clap::value_parser!(i32).range(2..=50))]
    window: i32,
    /// Leave out views that are worse than this many times the median; without it all are used.
    #[arg(long)]
    reject: Option<f64>,
    /// At most this many views of a bag, video or camera, each of which differs from those before it.
    #[arg(long, default_value_t = 80)]
    views: usize,
    /// One line per view.
    #[arg(long)]
    verbose: bool,
}

/// Runs the command.
///
/// # Errors
/// What stands in the message, with the remedy.
pub fn run(arguments: &CameraArguments) -> Result<()> {
    let Corners(columns, rows) = arguments.board;
    ensure!(
        arguments.square > 0.0 && arguments.square.is_finite(),
        "--square {}: the edge of a square is a length in metres, such as 0.025",
        arguments.square
    );
    let board = Board { columns, rows, square: arguments.square };
    let (mut views, mut coverage, mut without) = (Vec::<View>::new(), Coverage::default(), Vec::new());
    let shown = arguments.source.display();
    let kind = Kind::of(&arguments.source);
    let from_files = kind == Kind::Files;
    let guide = Guide::new(kind)?;
    let count = pictures::each(&arguments.source, arguments.topic.as_deref(), |picture| {
        match find(&picture.bgr, &picture.name, &board, arguments.window)? {
            // Out of a recording only what shows something new; pictures were chosen by hand.
            Some(view) if from_files || coverage.adds(&view, &board) => {
                coverage.add(&view, &board);
                views.push(view);
                guide.say(&coverage, views.len());
            }
            Some(_) => {}
            None => without.push(picture.name),
        }
        let enough = kind.is_live() && coverage.missing().is_empty();
        Ok(from_files || (views.len() < arguments.views && !enough && !guide.interrupted()))
    })?;
    guide.end();
    ensure!(
        !views.is_empty(),
        "{shown}: none of {count} pictures shows the whole board of {columns}x{rows} inner corners; count its inner corners \
         for --board"
    );
    println!("{} of {count} pictures taken", views.len());
    if from_files && !without.is_empty() {
        println!("the whole board of {columns}x{rows} inner corners is not seen in {}", without.join(", "));
    }
    println!("{coverage}");
    for sentence in coverage.missing() {
        println!("missing: {sentence}");
    }
    let options = Options {
        lens: match arguments.model {
            Lens::PlumbBob => LensModel::PlumbBob,
            Lens::RationalPolynomial => LensModel::RationalPolynomial,
        },
        fix_aspect_ratio: arguments.fix_aspect_ratio,
        reject: arguments.reject.unwrap_or(f64::INFINITY),
    };
    let calibration = calibrate(&board, &views, &options)
        .with_context(|| format!("{shown}: no calibration from {} views", views.len()))?;
    print(&calibration, arguments);
    fs::write(&arguments.out, camera_info_yaml(&calibration.model, &arguments.name)).with_context(|| {
        format!("{} cannot be written; name another file with --out", arguments.out.display())
    })?;
    println!("written: {}", arguments.out.display());
    Ok(())
}

/// What a person before a live camera is told: how many views there are and what is missing, one line that changes.
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
            // Ctrl-C ends the looking, not the program: what was seen so far is used.
            signal_hook::flag::register(signal_hook::consts::SIGINT, interrupted.clone())
                .context("Ctrl-C cannot be caught")?;
        }
        Ok(Self { bar, interrupted })
    }

    fn say(&self, coverage: &Coverage, views: usize) {
        if let Some(bar) = &self.bar {
            let next = coverage.missing().into_iter().next().unwrap_or_else(|| "nothing is missing".into());
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

fn print(calibration: &Calibration, arguments: &CameraArguments) {
    let (f, c) = (calibration.model.focal_lengths(), calibration.model.principal_point());
    let sd = &calibration.intrinsic_deviations;
    println!("\n{:<5} {:>14} {:>12}", "", "value", "std dev");
    // With fx = fy OpenCV tells the deviation of fy only.
    let first = if arguments.fix_aspect_ratio { sd[1] } else { sd[0] };
    for (name, value, deviation) in
        [("fx", f.x, first), ("fy", f.y, sd[1]), ("cx", c.x, sd[2]), ("cy", c.y, sd[3])]
    {
        println!("{name:<5} {value:>14.4} {deviation:>12.4}  px");
    }
    let (names, values): (&[&str], &[f64]) = match calibration.model.distortion() {
        Distortion::PlumbBob(d) => (&["k1", "k2", "p1", "p2", "k3"], d),
        Distortion::RationalPolynomial(d) => (&["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"], d),
        Distortion::Equidistant(d) => (&["k1", "k2", "k3", "k4"], d),
    };
    for ((name, value), deviation) in names.iter().zip(values).zip(&calibration.distortion_deviations) {
        println!("{name:<5} {value:>14.6} {deviation:>12.6}");
    }
    println!(
        "mean reprojection error: {:.4} px over {} views",
        calibration.mean_error,
        calibration.views.len()
    );
    for (name, error) in &calibration.rejected {
        println!("left out: {name} ({error:.3} px)");
    }
    let mut errors: Vec<f64> = calibration.views.iter().map(|v| v.1).collect();
    errors.sort_by(f64::total_cmp);
    let median = errors[errors.len() / 2];
    for (name, error, tilt) in &calibration.views {
        if arguments.verbose {
            println!("  {name}: {error:.3} px, tilted by {:.0} deg", tilt.to_degrees());
        }
        if *error > 3.0 * median {
            println!(
                "doubtful: {name} is off by {error:.3} px, {:.0} times the median; look at it, or try --reject 3 or --window 7",
                error / median
            );
        }
    }
}
