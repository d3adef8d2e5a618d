//! The main table: every method on the same motion, one run, one core.

use crate::{
    allocations,
    measure::{Record, median},
    methods::{AprilTag, Aruco, Carrier, Method, Ours, Recipe, Sift, sift},
    progress::Progress,
    report::{Csv, Targets, number},
    scene::{Frame, Pinhole, PlateKind},
    stage::{FOOTPRINT, Stage},
    trajectory,
};
use anyhow::{Result, bail};
use rig_model::{MarkerLayout, MarkerState};
use std::{path::Path, time::Duration};

/// Images that a method works on in one go.
const BLOCK: usize = 20;

/// The published times of Table I, ms.
pub const PUBLISHED_MS: [f64; 4] = [1.5, 2.1, 3.31, 0.36];

/// The layout that the standard plate bears.
pub fn layout(stage: &Stage) -> Result<MarkerLayout> {
    match &stage.plate(Carrier::Markers).kind {
        PlateKind::Markers { layout, .. } => Ok(layout.clone()),
        PlateKind::Cells { .. } => bail!("the first plate bears no markers"),
    }
}

/// Every method, ours first, the recipe second.
pub fn methods(camera: &Pinhole, layout: &MarkerLayout, seed: u64) -> Result<Vec<Box<dyn Method>>> {
    Ok(vec![
        Box::new(Ours::new(camera, layout.clone())),
        Box::new(Recipe::new(camera, layout)?),
        Box::new(Aruco::new(camera, FOOTPRINT)?),
        Box::new(AprilTag::new(camera, 1, FOOTPRINT)?),
        Box::new(AprilTag::new(camera, 2, FOOTPRINT)?),
        Box::new(Sift::new(camera, &sift::texture(seed), FOOTPRINT)?),
    ])
}

/// A frame as it would come from a decoder: just written, by the core that reads it.
pub fn fresh(frame: &Frame) -> Frame {
    frame.clone()
}

pub struct Outcome {
    /// Name of the method and its record, in the order of [`methods`].
    pub records: Vec<(&'static str, Record)>,
    /// What the stages of each are called.
    pub stages: Vec<&'static [&'static str]>,
    /// Whole-image acquisition of ours, median µs: a new tracker; one that had lost everything.
    pub acquisition_us: [f64; 2],
    /// Ours on the first frame after the peers, whose work left nothing of it in the caches: median
    /// µs.
    pub cold_us: f64,
    /// Share of those images in which all four markers were detected at once.
    pub acquired: f64,
    /// Allocations in a tracked frame: median and largest.
    pub allocations: (u64, u64),
    /// Mean normalized squared error of our centroids (ideal 2).
    pub nees: f64,
}

/// Runs the main sequence.
pub fn run(images: usize, seed: u64, progress: &Progress) -> Result<Outcome> {
    let camera = Pinhole::BENCH;
    let mut stage = Stage::new(camera, seed)?;
    let layout = layout(&stage)?;
    let mut methods = methods(&camera, &layout, seed)?;
    let mut records = vec![Record::default(); methods.len()];
    let mut ours = Ours::new(&camera, layout.clone());
    let (mut allocated, mut nees, mut detected) = (Vec::new(), 0.0, 0usize);
    let (mut first, mut again, mut acquired, mut tried) = (Vec::new(), Vec::new(), 0usize, 0usize);
    // Nine different gray images: repetitions of one image would be a frozen camera.
    let blanks: Vec<Frame> = (0..9)
        .map(|i| Frame {
            width: camera.width,
            height: camera.height,
            rgb: vec![124 + i; 3 * camera.width * camera.height],
        })
        .collect();
    let mut cold = Vec::new();
    let numbers: Vec<usize> = (0..images).collect();
    for block in numbers.chunks(BLOCK) {
        progress.report(block[0] as f64 / images as f64);
        let carriers = [Carrier::Markers, Carrier::Tag, Carrier::Texture];
        let scenes: Vec<_> = block
            .iter()
            .map(|&number| {
                let pose = trajectory::standard(&camera, number as f64 / 30.0);
                let shots = carriers.map(|c| stage.shoot(c, &pose, number));
                (number, pose, shots, carriers.map(|c| stage.truth(c, &pose)))
            })
            .collect();
        // Each method has the core to itself for some images, as in a process of its own: the
        // caches that another method leaves are not its cost. The first frame of a block shows
        // their effect.
        for (index, (method, record)) in methods.iter_mut().zip(&mut records).enumerate() {
            let carrier = method.about().carrier as usize;
            for (i, (_, pose, shots, truths)) in scenes.iter().enumerate() {
                let estimate = method.estimate(&fresh(&shots[carrier]))?;
                if index == 0 && i == 0 {
                    cold.push(estimate.stages.iter().sum::<Duration>().as_secs_f64() * 1e6);
                }
                record.add(&estimate, pose, &truths[carrier]);
            }
        }
        for (number, _, shots, truths) in &scenes {
            // The same images once more for what is not timed: allocations and consistency.
            let before = allocations();
            ours.track(&shots[0]);
            let count = allocations() - before;
            if *number >= 10 {
                allocated.push(count);
            }
            for (color, marker) in ours.observed.iter().flat_map(|o| o.markers.iter()) {
                if marker.state == MarkerState::Detected
                    && let Some(information) = marker.covariance.try_inverse()
                {
                    let error = marker.centroid - truths[0][color.index()];
                    nees += error.dot(&(information * error));
                    detected += 1;
                }
            }
            if number % 10 == 0 {
                let mut fresh_tracker = Ours::new(&camera, layout.clone());
                tried += 2;
                let image = fresh(&shots[0]);
                first.push(fresh_tracker.track(&image).as_secs_f64() * 1e6);
                acquired += usize::from(sum(&fresh_tracker));
                for blank in &blanks {
                    fresh_tracker.track(blank);
                }
                let image = fresh(&shots[0]);
                again.push(fresh_tracker.track(&image).as_secs_f64() * 1e6);
                acquired += usize::from(sum(&fresh_tracker));
            }
        }
    }
    allocated.sort_unstable();
    Ok(Outcome {
        records: methods.iter().map(|m| m.about().name).zip(records).collect(),
        stages: methods.iter().map(|m| m.about().stages).collect(),
        acquisition_us: [median(first), median(again)],
        cold_us: median(cold),
        acquired: acquired as f64 / tried as f64,
        allocations: (
            allocated.get(allocated.len() / 2).copied().unwrap_or(0),
            allocated.last().copied().unwrap_or(0),
        ),
        nees: nees / detected as f64,
    })
}

fn sum(ours: &Ours) -> bool {
    ours.observed
        .as_ref()
        .is_some_and(|o| o.markers.0.iter().all(|m| m.state == MarkerState::Detected))
}

impl Outcome {
    fn of(&self, part: &str) -> &Record {
        self.records.iter().find(|r| r.0.contains(part)).map_or(&self.records[0].1, |r| &r.1)
    }

    /// The main table as text.
    pub fn print(&self) {
        let recipe = self.of("recipe").median_us();
        println!(
            "{:<34} {:>10} {:>9} {:>9} {:>9} {:>9} {:>9} {:>7}",
            "method", "median us", "ratio", "px RMS", "mm RMSE", "deg RMSE", "success", "gross"
        );
        for (name, record) in &self.records {
            println!(
                "{name:<34} {:>10.1} {:>9.4} {:>9} {:>9.3} {:>9.4} {:>8.1}% {:>7}",
                record.median_us(),
                record.median_us() / recipe,
                number(record.pixel_rms(), 4),
                record.translation_rmse(),
                record.rotation_rmse(),
                100.0 * record.success(),
                record.gross,
            );
        }
        let ours = &self.records[0].1;
        println!(
            "ours: tracker {:.1} us + extrinsics {:.1} us; acquisition {:.0} us (new tracker), \
             {:.0} us (after a loss), {:.0}% at the first frame; {:.1} us right after the peers; \
             bias {:+.4} {:+.4} px",
            ours.stage_us(0),
            ours.stage_us(1),
            self.acquisition_us[0],
            self.acquisition_us[1],
            100.0 * self.acquired,
            self.cold_us,
            ours.pixel_bias().x,
            ours.pixel_bias().y,
        );
        for ((name, record), stages) in self.records.iter().zip(&self.stages) {
            let parts: Vec<String> = stages
                .iter()
                .enumerate()
                .map(|(i, stage)| format!("{stage} {}", number(record.stage_us(i), 1)))
                .collect();
            println!("  {name}: {} us", parts.join(", "));
        }
    }

    /// The rows that compare with a peer, each beside its target.
    pub fn targets(&self) -> Targets {
        let ours = &self.records[0].1;
        let (recipe, aruco, april) = (self.of("recipe"), self.of("ArUco"), self.of("decimate 2"));
        let time = ours.median_us();
        let mut targets = Targets::default();
        targets.at_most(
            "tracked frame, all criteria and pose / recipe",
            time / recipe.median_us(),
            1.0 / 80.0,
        );
        targets.at_most(
            "tracked frame / AprilTag decimate 2",
            time / april.median_us(),
            1.0 / 50.0,
        );
        targets.at_most("tracked frame / ArUco", time / aruco.median_us(), 1.0 / 100.0);
        targets.at_most(
            "whole-image acquisition / recipe",
            self.acquisition_us[1] / recipe.median_us(),
            1.0 / 15.0,
        );
        targets.at_most("allocations in a tracked frame", self.allocations.1 as f64, 0.0);
        targets.at_most("centroid, clean RGB, px RMS per axis", ours.pixel_rms(), 0.015);
        targets.at_most(
            "translation RMSE / AprilTag decimate 2",
            ours.translation_rmse() / april.translation_rmse(),
            0.25,
        );
        targets.at_most(
            "rotation RMSE / AprilTag decimate 2",
            ours.rotation_rmse() / april.rotation_rmse(),
            1.0 / 6.0,
        );
        targets.at_least("success, ours", ours.success(), 0.99);
        targets.within("normalized squared error of the centers", self.nees, 1.6, 2.6);
        targets
    }

    /// `bench.csv`, `table-1.csv`, `fig-12.csv`.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let recipe = self.of("recipe").median_us();
        let mut csv = Csv::new(concat!(
            "method,median_us,ratio_to_recipe,px_rms,",
            "translation_rmse_mm,rotation_rmse_deg,success,gross_errors"
        ));
        for (name, r) in &self.records {
            csv.row([
                (*name).into(),
                number(r.median_us(), 2),
                number(r.median_us() / recipe, 5),
                number(r.pixel_rms(), 5),
                number(r.translation_rmse(), 4),
                number(r.rotation_rmse(), 5),
                number(r.success(), 4),
                r.gross.to_string(),
            ]);
        }
        csv.write(&folder.join("bench.csv"))?;
        self.table_1().write(&folder.join("table-1.csv"))?;
        self.fig_12().write(&folder.join("fig-12.csv"))
    }

    /// Table I: each time is that of a timer around the stage. Our tracker does the first three
    /// stages in one pass over each marker's window, so it has one time for them.
    pub fn table_1(&self) -> Csv {
        let (ours, recipe) = (&self.records[0].1, self.of("recipe"));
        let mut csv = Csv::new("stage,published_ms,plain_opencv_ms,ours_ms");
        let names = ["optical flow", "tracking", "feature extraction", "extrinsics"];
        for (i, name) in names.iter().enumerate() {
            let own = if i == 3 { number(ours.stage_us(1) * 1e-3, 5) } else { String::new() };
            csv.row([
                (*name).into(),
                number(PUBLISHED_MS[i], 2),
                number(recipe.stage_us(i) * 1e-3, 4),
                own,
            ]);
        }
        csv.row([
            "flow, tracking and extraction".into(),
            number(PUBLISHED_MS[..3].iter().sum(), 2),
            number((0..3).map(|i| recipe.stage_us(i)).sum::<f64>() * 1e-3, 4),
            number(ours.stage_us(0) * 1e-3, 5),
        ]);
        csv.row([
            "total".into(),
            number(PUBLISHED_MS.iter().sum(), 2),
            number(recipe.median_us() * 1e-3, 4),
            number(ours.median_us() * 1e-3, 5),
        ]);
        csv
    }

    /// Mean error and deviation of each method over the run.
    pub fn fig_12(&self) -> Csv {
        let mut csv = Csv::new("method,mean_mm,std_mm,mean_deg,std_deg");
        for (name, r) in &self.records {
            csv.row([(*name).to_owned()].into_iter().chain(r.error_cells()));
        }
        csv
    }
}
