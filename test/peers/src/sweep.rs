//! Fig. 11: success over the viewing angle and over the distance, with the errors of what
//! succeeded.

use crate::{
    bench,
    measure::Record,
    methods::Carrier,
    progress::Progress,
    report::{Csv, Targets, number},
    scene::{Pinhole, Rng},
    stage::{FOOTPRINT, Stage},
    trajectory,
};
use anyhow::Result;
use nalgebra::{Isometry3, Vector2};
use std::path::Path;

/// One condition of a sweep.
pub struct Condition {
    pub sweep: &'static str,
    pub value: f64,
    /// m.
    pub range: f64,
    /// Viewing angle, degrees.
    pub tilt_deg: f64,
}

fn conditions() -> Vec<Condition> {
    let angles = (0..=12).map(|i| {
        let tilt_deg = 5.0 * f64::from(i);
        Condition { sweep: "angle_deg", value: tilt_deg, range: 1.25, tilt_deg }
    });
    let distances = (0..=10).map(|i| {
        let range = 0.5 + 0.25 * f64::from(i);
        Condition { sweep: "distance_m", value: range, range, tilt_deg: 20.0 }
    });
    angles.chain(distances).collect()
}

/// A short smooth motion in this condition, the whole footprint in the frame, each pose on a step
/// of the bench.
pub fn motion(
    camera: &Pinhole,
    condition: &Condition,
    images: usize,
    rng: &mut Rng,
) -> Vec<Isometry3<f64>> {
    loop {
        let (yaw, direction) = (rng.within(-0.7, 0.7), rng.within(0.0, std::f64::consts::TAU));
        let offset = Vector2::new(rng.within(-150.0, 150.0), rng.within(-90.0, 90.0)) * rng.unit();
        let poses: Vec<_> = (0..images)
            .map(|i| {
                let t = i as f64 / images as f64;
                let pixel = camera.center() + offset + Vector2::new(6.0, -4.0) * t;
                let tilt = condition.tilt_deg.to_radians();
                trajectory::on_bench(
                    camera,
                    pixel,
                    condition.range,
                    tilt,
                    direction + 0.3 * t,
                    yaw + 0.1 * t,
                )
            })
            .collect();
        // The plate's rim may leave the frame at 0.5 m, its pattern may not.
        if poses.iter().all(|p| trajectory::is_inside(camera, p, FOOTPRINT, 3.0)) {
            return poses;
        }
    }
}

/// Every method in every condition; `fig-11.csv`, and the targets that it decides.
pub fn run(folder: &Path, per_condition: usize, seed: u64, progress: &Progress) -> Result<Targets> {
    let camera = Pinhole::BENCH;
    let mut stage = Stage::new(camera, seed)?;
    let layout = bench::layout(&stage)?;
    let mut methods = bench::methods(&camera, &layout, seed)?;
    let mut rng = Rng::new(seed ^ 0xf11);
    let mut csv = Csv::new("sweep,value,method,success,mean_mm,std_mm,mean_deg,std_deg,px_rms");
    let conditions = conditions();
    let (mut ours, mut images) = (0.0, 0.0);
    let mut number_of_picture = 0;
    println!("success (a pose within 5 mm and 1 deg) in % of {per_condition} images");
    print!("{:<12} {:>6}", "sweep", "value");
    for method in &methods {
        print!(" {:>12}", method.about().name.chars().take(12).collect::<String>());
    }
    println!(" {:>12}", "our px RMS");
    for (done, condition) in conditions.iter().enumerate() {
        progress.report(done as f64 / conditions.len() as f64);
        let mut records = vec![Record::default(); methods.len()];
        // Two motions per condition, each from a start without any prior.
        for _ in 0..2 {
            methods.iter_mut().for_each(|m| m.forget());
            for pose in motion(&camera, condition, per_condition.div_ceil(2), &mut rng) {
                number_of_picture += 1;
                let shots = [Carrier::Markers, Carrier::Tag, Carrier::Texture]
                    .map(|c| stage.shoot(c, &pose, number_of_picture));
                for (method, record) in methods.iter_mut().zip(&mut records) {
                    let carrier = method.about().carrier;
                    let estimate = method.estimate(&shots[carrier as usize])?;
                    record.add(&estimate, &pose, &stage.truth(carrier, &pose));
                }
            }
        }
        print!("{:<12} {:>6}", condition.sweep, condition.value);
        for (method, record) in methods.iter().zip(&records) {
            print!(" {:>12.0}", 100.0 * record.success());
            let mut row = vec![
                condition.sweep.into(),
                condition.value.to_string(),
                method.about().name.into(),
                number(record.success(), 4),
            ];
            row.extend(record.error_cells());
            row.push(number(record.pixel_rms(), 5));
            csv.row(row);
        }
        println!(" {:>12}", number(records[0].pixel_rms(), 4));
        ours += records[0].successes as f64;
        images += records[0].images as f64;
    }
    progress.report(1.0);
    csv.write(&folder.join("fig-11.csv"))?;
    let mut targets = Targets::default();
    targets.at_least("success over tilt 0-60 deg and 0.5-3 m, ours", ours / images, 0.99);
    Ok(targets)
}
