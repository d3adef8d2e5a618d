//! Checks a rig's files against a recording: gross errors by simple detectors first, then one batch
//! estimate of everything that the filter takes as given.

mod encoders;
mod findings;
mod groups;
mod inertial;
mod layout;
mod places;
mod rates;
mod select;
mod sentences;
mod stamps;
#[cfg(test)]
mod tests;

pub use findings::{CheckRow, Finding, Report, Verdict};
pub use select::MISFIT;
pub use stamps::examine as examine_stamps;

use crate::{
    CalibrationError, Samples,
    adjustment::Adjustment,
    initial::first_states,
    parameters::{PARAMETERS, Parameters},
    recording::Recording,
};
use nalgebra::DVector;
use rig_model::{CameraModel, MarkerLayout, MarkerObservations, Rig};

/// Tracks the markers of a recording's images with a layout and a camera, in all images or in the
/// first ones.
pub type Track<'a> =
    dyn FnMut(&MarkerLayout, &CameraModel, Option<usize>) -> Vec<MarkerObservations> + 'a;

/// Largest number of corrections of the encoders: turn, then rails.
const ROUNDS: usize = 2;

/// Recording and rig with the gross errors corrected that were found so far.
#[derive(Clone)]
pub(crate) struct Corrected {
    pub samples: Samples,
    pub rig: Rig,
    /// Marker whose position is unknown, by index.
    pub moved: Option<usize>,
    /// Of a mirrored layout: the one mirrored along the other axis, which is the same turned by
    /// 180°, with its text.
    pub other_mirror: Option<(MarkerLayout, String)>,
    /// Offset that was removed from the IMU's stamps, s.
    pub imu_clock: f64,
    pub findings: Vec<Finding>,
}

impl Corrected {
    /// The report where a finding forbids to go on.
    fn blocked(&mut self) -> Option<Report> {
        self.findings.iter().any(|f| f.blocks).then(|| self.without_rows())
    }

    fn without_rows(&mut self) -> Report {
        Report { findings: std::mem::take(&mut self.findings), ..Report::default() }
    }
}

/// Parameters of the filter that the check judges.
#[derive(Clone, Copy, Debug, Default)]
pub struct Configured {
    /// Offset of the climber's stamps, s: climber stamp + offset = camera time.
    pub climber_offset: f64,
    /// Readout time of the camera's rolling shutter, s.
    pub image_readout: f64,
    /// Declared tilt of a carriage that rocks, rad.
    pub camera_tilt: f64,
}

/// Checks a rig's files against a recording.
///
/// `samples.markers` are those tracked with the rig's layout, or those of the recording; `track`
/// tracks the images again with another one, where the recording has images.
///
/// # Errors
/// The recording is too short, or no pose fits it.
pub fn check(
    samples: &Samples,
    rig: &Rig,
    configured: Configured,
    track: Option<&mut Track<'_>>,
) -> Result<Report, CalibrationError> {
    let mut state = Corrected {
        samples: samples.clone(),
        rig: rig.clone(),
        moved: None,
        other_mirror: None,
        imu_clock: 0.0,
        findings: stamps::examine(samples),
    };
    if let Some(report) = state.blocked() {
        return Ok(report);
    }
    inertial::examine_repeated(&mut state);
    if let Some(report) = state.blocked() {
        return Ok(report);
    }
    state.samples.repair();
    for sample in &mut state.samples.climber {
        sample.stamp = sample.stamp.plus_seconds(configured.climber_offset);
    }
    inertial::examine_units(&mut state);
    layout::examine_places(&mut state);
    layout::examine(&mut state, track)?;
    if let Some(report) = state.blocked() {
        return Ok(report);
    }
    state.samples.at_one_time(configured.image_readout);
    let recording = Recording::new(&state.samples)?;
    rates::examine_turn(&mut state, &recording);
    if let Some(report) = state.blocked() {
        return Ok(report);
    }
    layout::examine_view(&mut state, &recording);
    rates::examine(&mut state, &recording);
    let mut recording = Recording::new(&state.samples)?;
    recording.keep_liveliest();
    inertial::examine_noise(&mut state, &recording);
    for _ in 0..ROUNDS {
        if !encoders::examine(&mut state, &recording)? {
            break;
        }
        recording = Recording::new(&state.samples)?;
        recording.keep_liveliest();
    }
    if let Some(report) = state.blocked() {
        return Ok(report);
    }
    let mut file = Parameters::new(rig, &recording);
    let start = Parameters::new(&state.rig, &recording);
    let states = first_states(&recording, &start)?;
    let work = Adjustment::new(&recording, start, states, vec![0.0; PARAMETERS]);
    let outcome = match select::explain(work, state.moved)? {
        select::Explained::By(outcome) => outcome,
        select::Explained::Deaf(axes) => {
            state.findings.extend(axes.into_iter().map(findings::deaf));
            return Ok(state.without_rows());
        }
    };
    let change: DVector<f64> = outcome.parameters.minus(&file);
    // The samples are shifted by them, so that the changes are relative to them.
    (file.climber_clock, file.readout) = (configured.climber_offset, configured.image_readout);
    let tilts = findings::Tilts {
        largest: outcome.parameters.largest_tilt(&recording),
        declared: configured.camera_tilt,
    };
    let mut report = findings::report(&state, &file, &outcome, &change, tilts);
    // Larger errors are mended first.
    if report.findings.is_empty() {
        report.findings.extend(places::examine(rig, &outcome, &change));
    }
    Ok(report)
}
