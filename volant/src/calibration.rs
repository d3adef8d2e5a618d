//! Reads a bag into the samples of the batch estimators, refines a rig with them, and checks it.

use crate::replay::{
    Cores, Fed, Feed, FrontEnd, ImageTopic, Roles, TopicNames, decoding_threads, summarize,
};
use anyhow::{Context, Result, anyhow, bail};
use bag::BagReader;
use climber_driver::Climber;
use marker_tracker::{Input, Output, Tracker, TrackerConfig};
use rig_calibration::{Configured, Estimate, Report, Samples, Track, examine_stamps, refine_rig};
use rig_model::{CameraModel, MarkerColor, MarkerLayout, MarkerObservations, Sample, topics};
use std::path::Path;
use volant_msgs::{
    Message, geometry_msgs, msg::MarkerObservations as MarkersMessage, sensor_msgs::msg,
};

/// The images are tracked again until the markers move by less than this, m: a tenth of the
/// accuracy of a good recording.
const SETTLED: f64 = 3e-5;
const ROUNDS: usize = 4;

/// Reads camera and markers of a bag; the markers are tracked again if it holds images. What the
/// bag lost, and why inputs are unusable, is appended to `losses`, also before an error.
///
/// # Errors
/// No usable `camera_info`, several topics of a type of which none has the rig's name, or an
/// unreadable bag.
pub fn read_markers(
    path: &Path,
    cores: &Cores,
    losses: &mut Vec<String>,
) -> Result<(CameraModel, Vec<MarkerObservations>)> {
    let samples = read(path, cores, false, losses)?;
    Ok((samples.camera, samples.markers))
}

/// Reads a bag; with `motion`, also what IMU and encoders measured. `losses`: see [`read_markers`].
fn read(path: &Path, cores: &Cores, motion: bool, losses: &mut Vec<String>) -> Result<Samples> {
    let shown = path.display();
    let summary = summarize(path, losses)?;
    let choose = |alternatives: &[_]| {
        cores.names.choose(&summary, alternatives).with_context(|| shown.to_string())
    };
    let only = |name, kind| -> Result<_> { Ok(choose(&[(name, kind)])?.map(|(_, name)| name)) };
    let mut roles = Roles {
        images: ImageTopic::of(&summary, &cores.names).with_context(|| shown.to_string())?,
        camera: only(topics::CAMERA_INFO, msg::CameraInfo::TYPE_NAME)?,
        ..Roles::default()
    };
    if roles.images.is_none() {
        roles.markers = only(topics::MARKERS, MarkersMessage::TYPE_NAME)?;
    }
    let mut driver = None;
    if motion {
        match choose(&[
            (topics::CLIMBER_TRANSFORM, geometry_msgs::msg::TransformStamped::TYPE_NAME),
            (topics::JOINT_STATES, msg::JointState::TYPE_NAME),
        ])? {
            None => {}
            Some((0, name)) => roles.transforms = Some(name),
            Some((_, name)) => {
                let config = cores.climber.clone().map_err(|reason| {
                    anyhow!(
                        "{shown}: climber/joint_states is converted by climber_driver: {reason}"
                    )
                })?;
                let climber = Climber::new(config).map_err(anyhow::Error::msg);
                driver = Some(climber.with_context(|| shown.to_string())?);
                roles.joints = Some(name);
            }
        }
        roles.imu = only(topics::IMU, msg::Imu::TYPE_NAME)?;
    }
    let cameras = summary.topics_of(msg::CameraInfo::TYPE_NAME).len();
    let others = cameras > usize::from(roles.camera.is_some());
    let mut feed = Feed::start(path, roles.images.clone(), roles.messages(), decoding_threads())?;
    let mut front_end = FrontEnd::new(&cores.rig, roles, &cores.tracker, driver);
    let (mut markers, mut imu, mut climber) = (vec![], vec![], vec![]);
    while let Some(fed) = feed.take()? {
        for sample in front_end.handle(fed) {
            match sample {
                Sample::Markers(observations) => markers.push(observations),
                Sample::Imu(sample) => imu.push(sample),
                Sample::Climber(sample) => climber.push(sample),
                // The last one counts.
                Sample::Camera(_) => {}
            }
        }
    }
    let FrontEnd { camera, rejected, counts, .. } = front_end;
    losses.extend_from_slice(feed.losses());
    losses.extend(counts.warning_lines());
    if let Some(error) = rejected.first() {
        let (number, all) = (rejected.len(), rejected.len() + climber.len());
        let text = format!("{shown}: {number} of {all} climber transforms are rejected: {error}");
        if number > climber.len() {
            bail!(text);
        }
        losses.push(text);
    }
    let camera = camera.with_context(|| {
        let topic = cores.names.resolve(topics::CAMERA_INFO);
        let other = ", or name the rig's topics with --namespace or --remap";
        let other = if others { other } else { "" };
        format!("{shown}: no usable camera_info in it; record {topic} too{other}")
    })?;
    Ok(Samples { camera, markers, imu, climber })
}

/// Tracks the markers in the images of a bag, or in its first `limit` images.
///
/// # Errors
/// An unreadable bag, or several topics with images of which none has the rig's name.
pub fn track_bag(
    path: &Path,
    layout: &MarkerLayout,
    config: &TrackerConfig,
    camera: &CameraModel,
    limit: Option<usize>,
    names: &TopicNames,
) -> Result<Vec<MarkerObservations>> {
    let images = ImageTopic::of(&BagReader::summary(path)?, names)?;
    let mut feed = Feed::start(path, images, vec![], decoding_threads())?;
    let mut tracker = Tracker::new(layout.clone(), config.clone());
    tracker.handle(Input::Camera(camera.clone()));
    let mut markers = vec![];
    while let Some(fed) = feed.take()? {
        if let Fed::Image(Ok((stamp, image))) = fed {
            tracker.handle(Input::Image(image.view(stamp)));
            while let Some(output) = tracker.poll() {
                if let Output::Observations(observations) = output {
                    markers.push(observations);
                }
            }
        }
        if limit.is_some_and(|limit| markers.len() >= limit) {
            break;
        }
    }
    Ok(markers)
}

/// Checks a rig's files against a bag; `losses`: see [`read_markers`].
///
/// # Errors
/// As [`read_markers`] and [`rig_calibration::check`].
pub fn check_bag(bag: &Path, cores: &Cores, losses: &mut Vec<String>) -> Result<Report> {
    let samples = read(bag, cores, true, losses)?;
    let has_images = ImageTopic::of(&BagReader::summary(bag)?, &cores.names)?.is_some();
    let mut track = |layout: &MarkerLayout, camera: &CameraModel, limit| {
        track_bag(bag, layout, &cores.tracker, camera, limit, &cores.names).unwrap_or_default()
    };
    let track: Option<&mut Track<'_>> = if has_images { Some(&mut track) } else { None };
    let config = &cores.fusion.tight;
    let configured = Configured {
        climber_offset: config.clock.climber_offset,
        image_readout: config.clock.image_readout,
        camera_tilt: config.markers.camera_tilt,
    };
    rig_calibration::check(&samples, &cores.rig, configured, track)
        .with_context(|| bag.display().to_string())
}

/// Refines the cores' rig with a bag; `held`: see [`refine_rig`], `losses`: see [`read_markers`].
/// The tracker's measurements depend slightly on the marker positions, so the images are tracked
/// again with the refined positions until these converge. The rig file stays the prior of what the
/// motion does not determine.
///
/// # Errors
/// As [`read_markers`] and [`refine_rig`]; stamps with which nothing can be estimated.
pub fn refine_from_bag(
    bag: &Path,
    cores: &Cores,
    held: &[&str],
    losses: &mut Vec<String>,
) -> Result<Estimate> {
    let mut seen_with = cores.clone();
    let mut round = 1;
    let known = losses.len();
    loop {
        // The same in each round.
        losses.truncate(known);
        let mut samples = read(bag, &seen_with, true, losses)?;
        if let Some(finding) = examine_stamps(&samples).iter().find(|f| f.blocks) {
            bail!("{}: {}; {}", bag.display(), finding.text, finding.remedy);
        }
        samples.repair();
        samples.at_one_time(cores.fusion.tight.clock.image_readout);
        let estimate =
            refine_rig(&samples, &cores.rig, held).with_context(|| bag.display().to_string())?;
        let centers = [&estimate.rig, &seen_with.rig].map(|r| &r.markers.centers);
        let moved = MarkerColor::ALL
            .map(|c| (centers[0][c] - centers[1][c]).norm())
            .into_iter()
            .fold(0.0, f64::max);
        if moved < SETTLED || round == ROUNDS {
            return Ok(estimate);
        }
        seen_with.rig.markers = estimate.rig.markers.clone();
        round += 1;
    }
}
