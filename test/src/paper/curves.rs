//! Fig. 13 and Table II: six curves, and the errors of camera, inertial unit, the published filter
//! and the default one.

use super::{
    Made, PaperError,
    offline::{fuse, record},
    write,
};
use crate::{
    accuracy::{AXES, Errors, Track, UNITS, inertial_alone, six},
    live::{ImageSequence, Scenario},
};
use nalgebra::Vector3;
use pose_fusion::Model;
use rig_model::Stamp;
use std::{fmt::Write, path::Path};
use volant::report::{Anchor, Color, Curve, Drawing, Ink, Run, Table, colors, six_curves};

/// The tracks of one run.
pub struct Curves {
    epoch: Stamp,
    camera: Track,
    inertial: Track,
    paper: Track,
    tight: Track,
}

impl Curves {
    /// Runs all estimators over the scenario.
    ///
    /// # Errors
    /// An invalid image, or a filter without output.
    pub fn of(scenario: &Scenario, images: &ImageSequence) -> Result<Self, PaperError> {
        let recording = record(scenario, images)?;
        let epoch = scenario.sensors.epoch;
        let tight = fuse(scenario, &recording, Model::Tight)?;
        let paper = fuse(scenario, &recording, Model::Paper)?;
        // The IMU alone starts with the run, stationary.
        let first = (epoch, scenario.motion.world_from_volant(0.0));
        let mounting = &scenario.rig.imu.volant_from_imu;
        let inertial = inertial_alone(&recording.samples, mounting, &first, Vector3::zeros(), 1e-5);
        Ok(Self { epoch, camera: tight.visual, inertial, paper: paper.fused, tight: tight.fused })
    }

    fn columns(&self) -> [(&'static str, &Track); 4] {
        [
            ("camera", &self.camera),
            ("inertial", &self.inertial),
            ("paper", &self.paper),
            ("tight", &self.tight),
        ]
    }

    /// Errors of each estimate after the first second.
    pub fn errors(&self, scenario: &Scenario) -> [(&'static str, Errors); 4] {
        let (from, to) =
            (self.epoch.plus_seconds(1.0), self.epoch.plus_seconds(scenario.duration()));
        let truth = |at: Stamp| scenario.motion.world_from_volant(at.seconds_since(self.epoch));
        self.columns().map(|(name, track)| (name, Errors::of(track, from, to, truth)))
    }

    /// Writes `table-2.csv`.
    ///
    /// # Errors
    /// The folder is not writable.
    pub fn table_2(&self, scenario: &Scenario, folder: &Path) -> Result<Made, PaperError> {
        let errors = self.errors(scenario);
        let mut csv = String::from("axis,camera,inertial,paper,tight\n");
        for axis in [3, 4, 5, 0, 1, 2] {
            let _ = write!(csv, "{}", AXES[axis]);
            for (_, e) in &errors {
                let _ = write!(csv, ",{:.6}", e.rmse[axis]);
            }
            csv.push('\n');
        }
        let path = folder.join("table-2.csv");
        write(&path, &csv)?;
        let svg = folder.join("table-2.svg");
        write(&svg, &draw_errors(&errors))?;
        let [camera, inertial, paper, tight] = &errors;
        let nearest = |mine: &Errors| {
            let names: Vec<&str> = (0..6)
                .filter(|&i| mine.rmse[i] < camera.1.rmse[i].min(inertial.1.rmse[i]))
                .map(|i| AXES[i])
                .collect();
            if names.is_empty() {
                "none of 6 axes".to_owned()
            } else {
                format!("{} of 6 ({})", names.len(), names.join(", "))
            }
        };
        let unit_turns_better = (3..6).filter(|&i| inertial.1.rmse[i] < camera.1.rmse[i]).count();
        Ok(Made {
            name: "table-2",
            title: "Table II: errors of camera, inertial unit, EKF and the default filter",
            table: Some(Table::from_csv(&csv, 3, true)),
            csv: path,
            svg,
            shows: format!(
                "RMSE of each axis (degrees, millimeters) over {:.0} s of swing with one marker \
                 covered for a while, without the first second. The default filter (`tight`) is \
                 nearer to the truth than camera and IMU in {}, the filter as published (`paper`) \
                 in {}.",
                scenario.duration(),
                nearest(&tight.1),
                nearest(&paper.1)
            ),
            published: format!(
                "Published: the EKF is nearest to the truth in all six, and the IMU has smaller \
                 rotation errors than the camera. Here the IMU has smaller rotation errors in \
                 {unit_turns_better} of 3 axes; elsewhere the tracker is better, because it \
                 predicts the centroid of each projected square and fits its edges, which makes \
                 the camera's own rotations better than an attitude with an error of half a \
                 degree. The published filter fuses finished poses, and its prediction adds the \
                 IMU's doubly integrated translation, whose velocity nothing corrects; so its \
                 translation drifts away from the camera's (the parameter \
                 `paper.velocity_from_fused` corrects it). The default uses every visible marker's \
                 pixels and estimates velocity, biases and clock offsets too.",
            ),
        })
    }

    /// Writes `fig-13.csv` and `fig-13.svg`.
    ///
    /// # Errors
    /// The folder is not writable.
    pub fn figure_13(&self, scenario: &Scenario, folder: &Path) -> Result<Made, PaperError> {
        let mut csv = String::from("seconds,estimate");
        for (axis, unit) in AXES.iter().zip(UNITS) {
            let _ = write!(csv, ",{axis}_{unit}");
        }
        csv.push('\n');
        let mut line = |t: f64, name: &str, values: [f64; 6]| {
            let _ = write!(csv, "{t:.4},{name}");
            for v in values {
                let _ = write!(csv, ",{v:.4}");
            }
            csv.push('\n');
        };
        for i in 0..=(scenario.duration() * 30.0) as usize {
            let t = i as f64 / 30.0;
            line(t, "truth", six(&scenario.motion.world_from_volant(t)));
        }
        for (name, track) in self.columns() {
            for (at, pose) in track {
                line(at.seconds_since(self.epoch), name, six(pose));
            }
        }
        let path = folder.join("fig-13.csv");
        write(&path, &csv)?;
        let svg = folder.join("fig-13.svg");
        let shaded: Vec<[f64; 2]> = scenario.covers.iter().map(|c| c.seconds).collect();
        let curve = |name, track, color, width| Curve { name, track, color, width };
        let drawn = six_curves(
            &Run {
                title: "Fig. 13: pose by camera, IMU, the published EKF and the default filter",
                epoch: self.epoch,
                seconds: scenario.duration(),
                truth: &|t| Some(scenario.motion.world_from_volant(t)),
                shaded: &shaded,
            },
            &[
                curve("camera alone", &self.camera, colors::CAMERA, 0),
                curve("inertial alone", &self.inertial, colors::INERTIAL, 2),
                curve("EKF as published", &self.paper, colors::PAPER, 2),
                curve("default filter", &self.tight, colors::FUSED, 3),
            ],
        )?;
        write(&svg, &drawn)?;
        let left = |track: &Track| {
            let off = |p: &&(Stamp, nalgebra::Isometry3<f64>)| {
                let truth = scenario.motion.world_from_volant(p.0.seconds_since(self.epoch));
                (p.1.translation.vector - truth.translation.vector).norm() > 0.1
            };
            track.iter().find(off).map_or("never".to_owned(), |p| {
                format!("after {:.1} s", p.0.seconds_since(self.epoch))
            })
        };
        Ok(Made {
            name: "fig-13",
            title: "Fig. 13: x, y, z, roll, pitch, yaw against the truth",
            csv: path,
            svg,
            table: None,
            shows: format!(
                "One run of {:.0} s. The IMU alone is 100 mm off {}; the EKF as published {}; the \
                 default filter {}. Camera and default filter lie on the truth at this scale. A \
                 curve that leaves a panel has left the range of the truth.",
                scenario.duration(),
                left(&self.inertial),
                left(&self.paper),
                left(&self.tight)
            ),
            published: "Published: the IMU's translation drifts and its rotations stay near, the \
                        camera is noisy, the EKF follows the truth. The first is so here; the \
                        camera's noise is too small to be visible at this scale (Table II has it). \
                        The filter as published follows the rotations; its translation is pulled \
                        along by the uncorrected velocity, the more the longer the run."
                .to_owned(),
        })
    }
}

/// The six errors as bars on a logarithmic scale.
fn draw_errors(errors: &[(&'static str, Errors); 4]) -> String {
    let title = "Table II: RMSE of each axis";
    let mut d = Drawing::new(1120.0);
    d.text(24.0, 34.0, 20.0, colors::INK, Anchor::Start, title);
    let legend: [(&str, Color); 4] = [
        ("camera alone", colors::CAMERA),
        ("inertial alone", colors::INERTIAL),
        ("EKF as published", colors::PAPER),
        ("default filter", colors::FUSED),
    ];
    for (i, (name, color)) in legend.iter().enumerate() {
        let x = 28.0 + 190.0 * i as f64;
        d.bar(x, 50.0, 20.0, 14.0, *color);
        d.text(x + 28.0, 63.0, 15.0, colors::INK, Anchor::Start, name);
    }
    let halves: [([usize; 3], &str, [f64; 2]); 2] = [
        ([3, 4, 5], "deg", decades(errors, [3, 4, 5])),
        ([0, 1, 2], "mm", decades(errors, [0, 1, 2])),
    ];
    let (high, top) = (300.0, 104.0);
    let base = top + high;
    for (half, (axes, unit, [low, up])) in halves.into_iter().enumerate() {
        let (x0, wide) = (84.0 + 552.0 * half as f64, 450.0);
        let y = |v: f64| {
            base - high * ((v.max(low).log10() - low.log10()) / (up.log10() - low.log10()))
        };
        d.text(
            x0,
            top - 14.0,
            15.0,
            colors::INK,
            Anchor::Start,
            &format!("RMSE [{unit}], logarithmic"),
        );
        let mut tick = low;
        while tick <= up * 1.001 {
            d.line([x0, y(tick)], [x0 + wide, y(tick)], Ink(colors::GRID, 1.0));
            let digits = (-tick.log10().floor()).max(0.0) as usize;
            d.text(
                x0 - 8.0,
                y(tick) + 4.5,
                13.0,
                colors::SOFT,
                Anchor::End,
                &format!("{tick:.digits$}"),
            );
            tick *= 10.0;
        }
        d.line([x0, base], [x0 + wide, base], Ink(colors::AXIS, 1.0));
        for (k, axis) in axes.into_iter().enumerate() {
            let group = x0 + 14.0 + 150.0 * k as f64;
            for (j, ((_, e), (_, color))) in errors.iter().zip(&legend).enumerate() {
                let (v, x) = (e.rmse[axis], group + 32.0 * j as f64);
                d.bar(x, y(v), 24.0, base - y(v), *color);
                let digits = if v >= 100.0 {
                    0
                } else if v >= 10.0 {
                    1
                } else if v >= 0.1 {
                    2
                } else {
                    3
                };
                d.text(
                    x + 12.0,
                    y(v) - 6.0,
                    13.0,
                    colors::SOFT,
                    Anchor::Middle,
                    &format!("{v:.digits$}"),
                );
            }
            d.text(group + 60.0, base + 24.0, 15.0, colors::INK, Anchor::Middle, AXES[axis]);
        }
    }
    d.finish(base + 44.0, title)
}

/// Powers of ten around the errors of these axes, the lower one with space for a bar.
fn decades(errors: &[(&'static str, Errors); 4], axes: [usize; 3]) -> [f64; 2] {
    let values = || {
        errors
            .iter()
            .flat_map(|(_, e)| axes.map(|a| e.rmse[a]))
            .filter(|v| *v > 0.0 && v.is_finite())
    };
    let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(0.0, f64::max));
    if low > high {
        return [0.1, 10.0];
    }
    [10f64.powf((low * 0.5).log10().floor()), 10f64.powf(high.log10().ceil())]
}
