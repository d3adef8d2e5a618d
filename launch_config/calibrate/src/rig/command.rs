//! `volant calibrate rig`.

use super::{Estimate, refine_from_bag};
use anyhow::{Context, Result, anyhow};
use clap::Args;
use rig_model::Rig;
use std::{fmt::Write, fs, path::PathBuf};

/// The rig file, refined by a recording of free motion; writes a new one.
#[derive(Args, Debug)]
pub struct RigArguments {
    /// A bag with images (or climber/markers), camera_info, climber/transform and volant/imu/data.
    bag: PathBuf,
    /// The rig file as measured by hand.
    #[arg(long)]
    rig: PathBuf,
    /// The refined rig file.
    #[arg(long, default_value = "rig_refined.yaml")]
    out: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// What stands in the message, with the remedy.
pub fn run(arguments: &RigArguments) -> Result<()> {
    let shown = arguments.rig.display();
    let text = fs::read_to_string(&arguments.rig)
        .with_context(|| format!("{shown} cannot be read; name a rig file"))?;
    let rig = Rig::from_yaml(&text).map_err(|e| anyhow!("{shown}: {e}"))?;
    let estimate = refine_from_bag(&arguments.bag, &rig)?;
    print(&estimate);
    fs::write(&arguments.out, yaml(&estimate)).with_context(|| {
        format!("{} cannot be written; name another file with --out", arguments.out.display())
    })?;
    println!("written: {}", arguments.out.display());
    Ok(())
}

fn print(estimate: &Estimate) {
    println!(
        "{} images with all four markers ({} left out as outliers); pixel residual {:.3} -> {:.3} px RMS; squared residual \
         per degree of freedom {:.2}",
        estimate.images.0, estimate.images.1, estimate.pixel_rms.0, estimate.pixel_rms.1, estimate.reduced
    );
    println!("{:<30} {:>10} {:>10}", "", "change", "std dev");
    for row in &estimate.rows {
        if row.determined {
            println!("{:<30} {:>10.3} {:>10.3}  {}", row.name, row.change, row.deviation, row.unit);
        } else {
            println!(
                "{:<30} {:>10} {:>10}  not determined by this motion: as in the rig file",
                row.name, "held", ""
            );
        }
    }
    println!("The markers' mean place, turn and size are those of the rig file: images cannot tell them.");
}

fn yaml(estimate: &Estimate) -> String {
    let rig = &estimate.rig;
    let (frames, imu, camera) = (&rig.frames, &rig.imu, &rig.climber_from_camera);
    let list = |values: &[f64]| values.iter().map(|v| format!("{v:.8}")).collect::<Vec<_>>().join(", ");
    let q = |r: &nalgebra::UnitQuaternion<f64>| {
        let c = r.coords;
        list(&[c.x, c.y, c.z, c.w])
    };
    let mut text = String::from("# Refined by `volant calibrate rig`. Standard deviations:\n");
    for row in estimate.rows.iter().take(24) {
        let said = if row.determined {
            format!("{:.4} {}", row.deviation, row.unit)
        } else {
            "not determined".into()
        };
        let _ = writeln!(text, "#   {}: {said}", row.name);
    }
    let _ = write!(
        text,
        "/**:\n  ros__parameters:\n    frames: {{world: {}, climber: {}, camera: {}, imu: {}, volant: {}}}\n",
        frames.world, frames.climber, frames.camera, frames.imu, frames.volant
    );
    let _ = write!(
        text,
        "    camera:\n      position: [{}]\n      orientation: [{}]\n",
        list(camera.translation.vector.as_slice()),
        q(&camera.rotation)
    );
    let _ = write!(
        text,
        "    imu:\n      position: [{}]\n      orientation: [{}]\n      accelerometer_noise_density: {}\n      \
         gyroscope_noise_density: {}\n",
        list(imu.volant_from_imu.translation.vector.as_slice()),
        q(&imu.volant_from_imu.rotation),
        imu.accelerometer_noise_density,
        imu.gyroscope_noise_density
    );
    let _ = write!(text, "    markers:\n      size: {}\n", rig.markers.side);
    for (color, centre) in rig.markers.centres.iter() {
        let _ = writeln!(text, "      {color}: [{}]", list(centre.coords.as_slice()));
    }
    text
}
