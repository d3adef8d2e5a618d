//! The part of `volant calibrate` that needs no large OpenCV; the camera's is the executable
//! `volant-calibrate`. Each command updates the rig or parameter file in place.

pub mod climber;
pub mod colors;
pub mod imu;
mod live;
pub mod rig;

use crate::{settings, terminal};
use clap::{Parser, Subcommand};
use std::{
    ffi::OsString,
    path::{Path, PathBuf},
};
use volant::parameter_update::{Setting, update};

/// Calibrate the rig: each command updates the rig or parameter file in place, keeps every other
/// key and comment, and leaves the former file as FILE.bak (.bak1, … where that exists)
#[derive(Parser)]
#[command(name = "volant calibrate", bin_name = "volant calibrate")]
pub struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Subcommand)]
enum Action {
    /// Measure the markers' colors in the camera's images
    Colors(colors::Arguments),
    /// Refine mountings and marker positions from a recording of free motion
    Rig(rig::Arguments),
    /// Find joint names, signs, scales, zeros and height of the climber's encoders from a jog of
    /// each axis over the platform on the floor
    Climber(climber::Arguments),
    /// Measure the noise of the IMU at rest (Allan deviation)
    Imu(imu::Arguments),
    /// Calibrate the camera from images of a chessboard (executable volant-calibrate)
    #[command(disable_help_flag = true)]
    Camera {
        /// See `volant calibrate camera --help`
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        words: Vec<OsString>,
    },
}

/// Where the result goes.
#[derive(clap::Args, Default)]
pub struct Output {
    /// Write this file instead of updating the given one
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Replace existing output files
    #[arg(long)]
    pub overwrite: bool,
}

impl Output {
    /// Fails before the work where the result, or a further output, could not be written after it;
    /// `inputs` are never replaced.
    pub fn check(&self, further: Option<&Path>, inputs: &[&Path]) -> anyhow::Result<()> {
        let outputs: Vec<&Path> = further.into_iter().chain(self.out.as_deref()).collect();
        Ok(node_kit::files::check_outputs(&outputs, self.overwrite, inputs)?)
    }

    /// Changes parameters of a file for the nodes of a namespace, and reports what was written.
    pub fn update(&self, file: &Path, settings: &[Setting], namespace: &str) -> anyhow::Result<()> {
        let (out, overwrite) = (self.out.as_deref(), self.overwrite);
        let update = update(file, out, overwrite, settings, Some(namespace))?;
        let path = self.out.as_deref().unwrap_or(file).display();
        terminal::line(&match (update.backup, update.changed.as_slice()) {
            (_, []) => format!("{path}: has these values already"),
            (None, changed) => format!("{path}: written, with {} changed", changed.join(", ")),
            (Some(backup), changed) => format!(
                "{path}: {} changed; the former file is {}",
                changed.join(", "),
                backup.display()
            ),
        });
        Ok(())
    }
}

/// Whether the words after `volant` are a command of this module.
pub fn is_here(words: &[OsString]) -> bool {
    words.first().is_some_and(|w| w == "calibrate") && words.get(1).is_none_or(|w| w != "camera")
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    match &arguments.action {
        // A signal ends the recording.
        Action::Climber(arguments) if arguments.live => {}
        Action::Colors(_) => node_kit::console::end_on_signals("volant", live::discard)?,
        _ => node_kit::console::end_on_signals("volant", || {})?,
    }
    match &arguments.action {
        Action::Colors(arguments) => colors::run(arguments),
        Action::Rig(arguments) => rig::run(arguments).map(drop),
        Action::Climber(arguments) => climber::run(arguments).map(drop),
        Action::Imu(arguments) => imu::run(arguments).map(drop),
        // Dispatched to the executable before this.
        Action::Camera { .. } => Ok(()),
    }
}

/// Reads a rig file.
///
/// # Errors
/// It is not readable, or not a valid rig file; a live node would reject its parameters.
pub fn read_rig(path: &Path) -> anyhow::Result<rig_model::Rig> {
    use anyhow::Context;
    let rig = node_kit::files::read_text(path)
        .map_err(anyhow::Error::from)
        .and_then(|text| Ok(rig_model::Rig::from_yaml(&text)?))
        .with_context(|| format!("{}: not a usable rig file", path.display()))?;
    settings::check_given(path)?;
    Ok(rig)
}
