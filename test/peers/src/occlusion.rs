//! Every method with a part of its target hidden: one corner, two, a hand.
//!
//! A marker and a corner of the tag's black square lie at the same place of the plates, so that one
//! patch hides either, and that corner of the texture.

use crate::{
    bench,
    measure::{Record, mean_and_deviation},
    methods::{Carrier, Ours},
    progress::Progress,
    report::{Csv, number},
    scene::{Pinhole, Rng, Thing},
    stage::Stage,
    sweep::{Condition, motion},
};
use anyhow::Result;
use nalgebra::Isometry3;
use std::{f64::consts::TAU, path::Path};

/// Images before anything is hidden, for the methods that follow their target.
const LEAD: usize = 15;
/// Edge of a patch, m: wider than a marker (0.076 m) on each side.
const PATCH: f64 = 0.1;
/// Place of the markers' centers and of the tag's corners, m.
const CORNER: f64 = 0.15;
const GRAY: [f32; 3] = [92.0, 90.0, 88.0];
const SKIN: [f32; 3] = [196.0, 150.0, 124.0];

/// What is hidden.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hidden {
    Nothing,
    OneCorner,
    TwoCorners,
    Hand,
}

impl Hidden {
    const ALL: [Self; 4] = [Self::Nothing, Self::OneCorner, Self::TwoCorners, Self::Hand];

    fn name(self) -> &'static str {
        match self {
            Self::Nothing => "nothing",
            Self::OneCorner => "one marker or corner",
            Self::TwoCorners => "two markers or corners",
            Self::Hand => "a hand",
        }
    }

    /// Covers at `share` (0 to 1) of the run.
    fn covers(self, camera: &Pinhole, pose: &Isometry3<f64>, share: f64) -> Vec<Thing> {
        let polygon = |corners: &[[f64; 2]], color| Thing {
            outline: camera.polygon(pose, corners, 0.0),
            color,
        };
        let box_of = |x: [f64; 2], y: [f64; 2], color| {
            polygon(&[[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]], color)
        };
        let patch = |x: f64, y: f64| {
            let h = PATCH / 2.0;
            box_of([x - h, x + h], [y - h, y + h], GRAY)
        };
        match self {
            Self::Nothing => Vec::new(),
            Self::OneCorner => vec![patch(CORNER, CORNER)],
            Self::TwoCorners => vec![patch(CORNER, CORNER), patch(-CORNER, -CORNER)],
            Self::Hand => {
                // Over the side x < 0: it covers the first corner and, at its furthest, the second.
                let tip = 0.15 - 0.3 * (0.5 - 0.5 * (TAU * share).cos());
                let mut covers = vec![
                    box_of([-0.18, -0.11], [tip + 0.15, tip + 0.6], SKIN),
                    box_of([-0.19, -0.1], [tip + 0.06, tip + 0.16], SKIN),
                ];
                covers.extend((0..4).map(|finger| {
                    let x = -0.19 + 0.023 * f64::from(finger);
                    let length = if finger == 0 || finger == 3 { 0.055 } else { 0.07 };
                    box_of([x, x + 0.019], [tip + 0.07 - length, tip + 0.07], SKIN)
                }));
                covers
            }
        }
    }
}

/// Every method in every condition; `occlusion.csv`.
pub fn run(folder: &Path, images: usize, seed: u64, progress: &Progress) -> Result<()> {
    let camera = Pinhole::BENCH;
    let mut stage = Stage::new(camera, seed)?;
    let layout = bench::layout(&stage)?;
    let mut methods = bench::methods(&camera, &layout, seed)?;
    methods.insert(1, Box::new(Ours::published(&camera, layout)));
    let mut rng = Rng::new(seed ^ 0x0cc1);
    let mut csv = Csv::new("hidden,method,images,successes,mean_mm,max_mm,mean_deg,max_deg");
    println!("success in %, mean error in mm and deg, of {images} images per row");
    let condition = Condition { sweep: "occlusion", value: 0.0, range: 1.25, tilt_deg: 20.0 };
    for (done, hidden) in Hidden::ALL.into_iter().enumerate() {
        progress.report(done as f64 / Hidden::ALL.len() as f64);
        let mut records = vec![Record::default(); methods.len()];
        // Two motions per condition, each from a start without any prior.
        for _ in 0..2 {
            methods.iter_mut().for_each(|m| m.forget());
            let half = images.div_ceil(2);
            let poses = motion(&camera, &condition, LEAD + half, &mut rng);
            for (number, pose) in poses.into_iter().enumerate() {
                let share = number.checked_sub(LEAD).map(|i| i as f64 / half as f64);
                let covers = share.map_or(Vec::new(), |s| hidden.covers(&camera, &pose, s));
                let shots = [Carrier::Markers, Carrier::Tag, Carrier::Texture]
                    .map(|c| stage.shoot_covered(c, &pose, number, &covers));
                for (method, record) in methods.iter_mut().zip(&mut records) {
                    let estimate = method.estimate(&shots[method.carrier() as usize])?;
                    if share.is_some() {
                        record.add(&estimate, &pose, &[]);
                    }
                }
            }
        }
        println!("{}", hidden.name());
        for (method, record) in methods.iter().zip(&records) {
            let largest = |values: &[f64]| values.iter().copied().fold(f64::NAN, f64::max);
            let mm = mean_and_deviation(&record.millimetres).0;
            let deg = mean_and_deviation(&record.degrees).0;
            println!(
                "  {:<34} {:>4.0} {:>8} {:>8} {:>3} gross",
                method.name(),
                100.0 * record.success(),
                number(mm, 2),
                number(deg, 3),
                record.gross
            );
            csv.row(&[
                hidden.name().into(),
                method.name().into(),
                record.images.to_string(),
                record.successes.to_string(),
                number(mm, 4),
                number(largest(&record.millimetres), 4),
                number(deg, 5),
                number(largest(&record.degrees), 5),
            ]);
        }
    }
    progress.report(1.0);
    csv.write(&folder.join("occlusion.csv"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_hide_whole_markers_and_the_hand_up_to_two() {
        let camera = Pinhole::BENCH;
        let stage = Stage::new(camera, 1).unwrap();
        let pose = crate::trajectory::pose(&camera, camera.center(), 1.25, 0.3, 0.4, 0.2);
        let shown = |hidden: Hidden, share: f64| {
            let covers = hidden.covers(&camera, &pose, share);
            stage.plate(Carrier::Markers).truth(&camera, &[pose], &covers).map(|t| t.shown)
        };
        let count = |shown: [f64; 4]| shown.iter().filter(|s| **s < 0.02).count();
        assert_eq!(count(shown(Hidden::Nothing, 0.5)), 0);
        assert_eq!(count(shown(Hidden::OneCorner, 0.5)), 1);
        assert_eq!(count(shown(Hidden::TwoCorners, 0.5)), 2);
        let most = (0..20)
            .map(|i| shown(Hidden::Hand, f64::from(i) / 20.0).iter().filter(|s| **s < 0.7).count())
            .max();
        assert_eq!(most, Some(2));
    }
}
