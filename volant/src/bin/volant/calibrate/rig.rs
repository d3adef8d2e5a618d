//! `volant calibrate rig`.

use super::Output;
use crate::{
    settings::{self, BagTopics},
    terminal,
};
use anyhow::{Context, Result, bail, ensure};
use node_kit::outln;
use rig_calibration::{Estimate, MISFIT, Refinement};
use ros_parameters::ParameterFile;
use std::path::PathBuf;
use volant::{
    calibration::refine_from_bag,
    parameter_update::{MARKER_SIGMA, MOUNTING_SIGMA, Setting, list, sigma},
};

#[derive(clap::Args)]
pub struct Arguments {
    /// Bag with images (or climber/markers), camera_info, volant/imu/data and climber/transform
    /// (or climber/joint_states, which the rig file's parameters of climber_driver convert)
    pub bag: PathBuf,
    /// Rig file as measured by hand, which is updated; with its calibration.marker_sigma and
    /// calibration.mounting_sigma of pose_fusion, where it has them
    #[arg(long, value_name = "FILE")]
    pub rig: PathBuf,
    /// ROS 2 parameter file of the nodes, in addition to the rig file; repeatable
    #[arg(long, value_name = "FILE")]
    pub params_file: Vec<PathBuf>,
    /// Keep the camera's mounting as it is in the rig file: the jog of `volant calibrate climber
    /// --camera` determines it better than a swing
    #[arg(long)]
    pub hold_camera: bool,
    #[command(flatten)]
    pub topics: BagTopics,
    #[command(flatten)]
    pub output: Output,
}

/// Runs the command; returns what it found.
pub fn run(arguments: &Arguments) -> Result<Estimate> {
    let more = &arguments.params_file;
    let inputs = [&arguments.rig, &arguments.bag].into_iter().chain(more).map(PathBuf::as_path);
    arguments.output.check(None, &inputs.collect::<Vec<_>>())?;
    let cores = settings::read(&arguments.rig, more, &arguments.topics)?;
    let camera: &[&str] = &["camera rotation", "camera position"];
    let held = if arguments.hold_camera { camera } else { &[] };
    let mut losses = vec![];
    let estimate = refine_from_bag(&arguments.bag, &cores, held, &mut losses);
    let estimate = terminal::with_losses(estimate, &losses)?;
    print(&estimate)?;
    ensure!(
        estimate.reduced <= MISFIT,
        "{}: the recording does not fit the rig (squared residual per degree of freedom {:.1}, at \
         most {MISFIT}), so {} is not changed; `volant check` names the cause",
        arguments.bag.display(),
        estimate.reduced,
        arguments.rig.display()
    );
    let mut changes = changes(&estimate);
    changes.extend(sigmas(&estimate, arguments)?);
    check_effect(&changes, arguments)?;
    arguments.output.update(&arguments.rig, &changes, &arguments.topics.namespace)?;
    Ok(estimate)
}

/// Fails where another parameter file sets what is to be changed in the rig file, for one of the
/// nodes that read the rig: they would not see the change.
fn check_effect(changes: &[Setting], arguments: &Arguments) -> Result<()> {
    let namespace = arguments.topics.namespace.trim_matches('/');
    for path in &arguments.params_file {
        let text = node_kit::files::read_text(path)
            .with_context(|| format!("{}: not readable", path.display()))?;
        let file = ParameterFile::parse(&text)?;
        for node in ["pose_fusion", "marker_tracker", "climber_driver", "imu_driver"] {
            let given = file.for_node(&format!("/{namespace}/{node}").replace("//", "/"));
            if let Some(change) = changes.iter().find(|change| given.contains_key(&change.name)) {
                bail!(
                    "{}: sets `{}` of {node}, which overrides {}: remove it there, else the new \
                     value has no effect; nothing is changed",
                    path.display(),
                    change.name,
                    arguments.rig.display()
                );
            }
        }
    }
    Ok(())
}

fn print(estimate: &Estimate) -> Result<()> {
    outln!(
        "{} images with all four markers ({} rejected as outliers); pixel residual {:.3} px RMS; \
         squared residual per degree of freedom {:.2}",
        estimate.images.0,
        estimate.images.1,
        estimate.pixel_rms,
        estimate.reduced
    )?;
    outln!("{:<32} {:>10} {:>10}", "", "change", "std dev")?;
    for row in &estimate.rows {
        let (change, deviation) = (row.change, row.deviation);
        match row.refinement {
            Refinement::Refined => {
                outln!("{:<32} {change:>10.3} {deviation:>10.3}  {}", row.name, row.unit)?;
            }
            Refinement::Agrees => outln!(
                "{:<32} {change:>10.3} {deviation:>10.3}  {}, agrees: as in the rig file",
                row.name,
                row.unit
            )?,
            Refinement::Undetermined => outln!(
                "{:<32} {:>10} {:>10}  not determined by this motion: as in the rig file",
                row.name,
                "held",
                ""
            )?,
        }
    }
    outln!(
        "The markers' mean position, rotation and size are those of the rig file: images do not \
         determine them."
    )?;
    Ok(())
}

/// How well the recording determines markers and camera, where the file has a value of the survey.
fn sigmas(estimate: &Estimate, arguments: &Arguments) -> Result<Vec<Setting>> {
    let namespace = &arguments.topics.namespace;
    let mut settings = vec![];
    // The filter's markers are known in x and y only.
    for (parameters, except, name, unit) in [
        ("marker ", " z", MARKER_SIGMA, 1e-3),
        ("camera rotation", "none", MOUNTING_SIGMA, 1f64.to_radians()),
    ] {
        let rows = || {
            let rows = estimate.rows.iter().filter(|r| r.name.starts_with(parameters));
            rows.filter(|r| !r.name.ends_with(except))
        };
        if rows().all(|r| r.refinement != Refinement::Undetermined) {
            let found = rows().map(|r| r.deviation * unit).fold(0.0, f64::max);
            // What agrees is kept, and was known better perhaps.
            let kept = rows().all(|r| r.refinement == Refinement::Agrees);
            settings.extend(sigma(&arguments.rig, namespace, name, found, kept)?);
        }
    }
    Ok(settings)
}

/// What the recording determines, as settings of the rig file.
fn changes(estimate: &Estimate) -> Vec<Setting> {
    let (rig, mut settings) = (&estimate.rig, vec![]);
    let mut set = |parameters: &str, name: String, value: &[f64]| {
        let mut rows = estimate.rows.iter().filter(|r| r.name.starts_with(parameters));
        if rows.any(|r| r.refinement == Refinement::Refined) {
            settings.push(Setting::rig(name, list(value)));
        }
    };
    for (name, pose) in [("camera", &rig.climber_from_camera), ("imu", &rig.imu.volant_from_imu)] {
        let position = pose.translation.vector;
        set(&format!("{name} position"), format!("{name}.position"), position.as_slice());
        let orientation = pose.rotation.coords;
        set(&format!("{name} rotation"), format!("{name}.orientation"), orientation.as_slice());
    }
    for (color, center) in rig.markers.centers.iter() {
        set(&format!("marker {color}"), format!("markers.{color}"), center.coords.as_slice());
    }
    settings
}
