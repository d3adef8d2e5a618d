//! Images of a run, rendered in advance: rendering is too slow for a live rig.

use super::scenario::{EXPOSURE, IMAGE_RATE, Scenario};
use rig_simulator::{Exposure, Renderer, parallel, random::Random};
use std::sync::atomic::{AtomicUsize, Ordering};

#[derive(Clone, Debug)]
pub struct Frame {
    /// Middle of its exposure, s of the scenario.
    pub seconds: f64,
    /// As the camera sends it.
    pub jpeg: Vec<u8>,
}

#[derive(Clone, Debug)]
pub struct ImageSequence {
    /// The stationary rig, repeated until the run begins.
    pub still: Vec<Frame>,
    /// The run.
    pub frames: Vec<Frame>,
}

impl ImageSequence {
    /// Renders all images of the scenario on at most four threads.
    pub fn of(scenario: &Scenario) -> Result<Self, jpeg_encoder::EncodingError> {
        Self::render(scenario, parallel::processors().min(4), |_, _| {})
    }

    /// Renders all images of the scenario on `threads` threads; calls `progress(done, of)` after
    /// each one.
    pub fn render(
        scenario: &Scenario,
        threads: usize,
        progress: impl Fn(usize, usize) + Sync,
    ) -> Result<Self, jpeg_encoder::EncodingError> {
        let mut random = Random::fork(scenario.scene.seed, "shutter");
        let count = (scenario.duration() * IMAGE_RATE) as usize;
        let still = IMAGE_RATE as usize / 3;
        // A camera's own clock runs evenly, with a little jitter.
        let times: Vec<f64> = (0..still + count)
            .map(|i| (i as f64 - still as f64 + 0.5) / IMAGE_RATE + 1e-4 * random.normal())
            .collect();
        let done = AtomicUsize::new(0);
        let renderer =
            || Renderer::new(scenario.camera.clone(), &scenario.rig, scenario.scene.clone());
        let images = parallel::map(threads, times.len(), renderer, |renderer, index| {
            let image = take(scenario, renderer, index, times[index]);
            progress(done.fetch_add(1, Ordering::Relaxed) + 1, times.len());
            image
        });
        let mut frames = images.into_iter().collect::<Result<Vec<_>, _>>()?;
        let moving = frames.split_off(still.min(frames.len()));
        Ok(Self { still: frames, frames: moving })
    }
}

/// The image whose exposure has its middle at `seconds`.
fn take(
    scenario: &Scenario,
    renderer: &mut Renderer,
    index: usize,
    seconds: f64,
) -> Result<Frame, jpeg_encoder::EncodingError> {
    let instants =
        (-2..=2).map(|i| scenario.instant(seconds + EXPOSURE * f64::from(i) / 5.0)).collect();
    let image = renderer.render(&Exposure {
        instants,
        covers: scenario.covers_at(seconds),
        seconds,
        noise: Some(scenario.scene.seed.wrapping_mul(1_000_003).wrapping_add(index as u64)),
    });
    Ok(Frame { seconds, jpeg: image.to_jpeg(90)? })
}
