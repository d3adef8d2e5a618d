//! `volant markers`: the sheets to print.

use crate::{calibrate::read_rig, terminal};
use anyhow::Context;
use rig_model::CameraModel;
use std::{
    ffi::OsString,
    path::{Path, PathBuf},
};
use volant::markers::{Paper, pdf, sheets, svg};

#[derive(clap::Args)]
pub struct Arguments {
    /// Rig file: size and positions of the markers
    #[arg(long, value_name = "FILE")]
    pub rig: PathBuf,
    /// File to write: .pdf, or .svg (all sheets one below the other)
    #[arg(long, value_name = "FILE", value_parser = sheets_file)]
    pub out: PathBuf,
    /// Replace an existing file
    #[arg(long)]
    pub overwrite: bool,
    /// Paper
    #[arg(long, value_enum, default_value = "a4")]
    pub page: Page,
    /// camera_info file (`volant calibrate camera`): its focal length is used for the table of
    /// sizes
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
}

#[derive(Clone, Copy, clap::ValueEnum)]
pub enum Page {
    A4,
    A3,
    Letter,
}

fn ending(path: &Path) -> OsString {
    path.extension().unwrap_or_default().to_ascii_lowercase()
}

fn sheets_file(name: &str) -> Result<PathBuf, &'static str> {
    let path = PathBuf::from(name);
    if ending(&path) == "pdf" || ending(&path) == "svg" {
        Ok(path)
    } else {
        Err("name it .pdf or .svg")
    }
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let inputs = [&arguments.rig].into_iter().chain(&arguments.camera).map(PathBuf::as_path);
    let inputs: Vec<&Path> = inputs.collect();
    node_kit::files::check_outputs(&[&arguments.out], arguments.overwrite, &inputs)?;
    let is_pdf = ending(&arguments.out) == "pdf";
    let rig = read_rig(&arguments.rig)?;
    let focal_length = arguments.camera.as_ref().map(|path| {
        node_kit::files::read_text(path)
            .map_err(anyhow::Error::from)
            .and_then(|text| Ok(CameraModel::from_calibration_file(&text)?.focal_lengths().mean()))
            .with_context(|| format!("{}: not a usable camera_info file", path.display()))
    });
    let paper = match arguments.page {
        Page::A4 => Paper::A4,
        Page::A3 => Paper::A3,
        Page::Letter => Paper::LETTER,
    };
    let sheets = sheets(&rig, &paper, focal_length.transpose()?)?;
    let bytes = if is_pdf { pdf(&sheets, &paper) } else { svg(&sheets, &paper).into_bytes() };
    node_kit::files::write(&arguments.out, &bytes, arguments.overwrite)?;
    terminal::line(&format!(
        "{}: {} sheets of {}; print at 100 % and measure the bar",
        arguments.out.display(),
        sheets.len(),
        paper.name
    ));
    Ok(())
}
