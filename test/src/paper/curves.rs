//! Fig. 13 and Table II: six curves, and the errors of camera, IMU, the published filter
//! and the default one, all with the same gravity.

use super::{
    Made, Value, axis,
    bars::{Bars, decades, draw_bars},
    offline::{Recording, filter, fuse, published_tracker, record, record_observed, track},
    write,
};
use crate::{
    accuracy::{AXES, Errors, Track, UNITS, inertial_alone, six},
    live::{ImageSequence, Scenario},
};
use anyhow::Result;
use nalgebra::Vector3;
use pose_fusion::{FusionConfig, Model};
use rig_model::Stamp;
use std::{fmt::Write, path::Path};
use volant::report::{Color, Curve, Run, Table, colors, six_curves};

/// Threshold control as published, m/s.
const THRESHOLD: f64 = 1e-5;

/// An estimator of Table II.
pub struct Column {
    /// Column of the CSV files.
    pub key: &'static str,
    /// Name in the charts.
    pub name: &'static str,
    pub color: Color,
    /// Line width in Fig. 13, px; 0: dots.
    width: u32,
    track: Track,
}

/// The tracks of one run.
pub struct Curves {
    epoch: Stamp,
    columns: Vec<Column>,
}

/// The published filter, optionally with its velocity from the fused poses.
fn published_filter(scenario: &Scenario, velocity_from_fused: bool) -> FusionConfig {
    let mut config = filter(scenario, Model::Paper);
    config.paper.velocity_from_fused = velocity_from_fused;
    config
}

impl Curves {
    /// Runs all estimators over the scenario.
    pub fn of(scenario: &Scenario, images: &ImageSequence) -> Result<Self> {
        let recording = record(scenario, images)?;
        let published = record_observed(scenario, track(scenario, images, published_tracker())?);
        let epoch = scenario.sensors.epoch;
        let tight = fuse(scenario, &recording, filter(scenario, Model::Tight))?;
        let fused = |recording: &Recording, velocity_from_fused: bool| {
            let config = published_filter(scenario, velocity_from_fused);
            fuse(scenario, recording, config).map(|poses| poses.fused)
        };
        // The IMU alone starts with the run, stationary.
        let inertial = inertial_alone(
            &recording.samples,
            &scenario.rig.imu.volant_from_imu,
            &(epoch, scenario.motion.world_from_volant(0.0)),
            Vector3::zeros(),
            scenario.sensors.gravity,
            THRESHOLD,
        );
        let column = |key, name, color, width, track| Column { key, name, color, width, track };
        let columns = vec![
            column("camera", "camera alone", colors::CAMERA, 0, tight.visual),
            column("inertial", "IMU alone", colors::INERTIAL, 2, inertial),
            column(
                "paper",
                "published filter, our tracker",
                colors::PAPER,
                2,
                fused(&recording, false)?,
            ),
            column("tight", "default filter", colors::FUSED, 3, tight.fused),
            column(
                "paper_whole",
                "published system, whole",
                colors::BROWN,
                2,
                fused(&published, false)?,
            ),
            column(
                "paper_velocity_from_fused",
                "published filter, velocity from fused poses",
                colors::VIOLET,
                1,
                fused(&recording, true)?,
            ),
        ];
        Ok(Self { epoch, columns })
    }

    /// Errors of each estimate after the first second.
    fn errors(&self, scenario: &Scenario) -> Vec<(&Column, Errors)> {
        let (from, to) =
            (self.epoch.plus_seconds(1.0), self.epoch.plus_seconds(scenario.duration()));
        let truth = |at: Stamp| scenario.motion.world_from_volant(at.seconds_since(self.epoch));
        self.columns.iter().map(|c| (c, Errors::of(&c.track, from, to, truth))).collect()
    }

    /// Writes `table-2.csv`.
    pub fn table_2(&self, scenario: &Scenario, folder: &Path) -> Result<Made> {
        let errors = self.errors(scenario);
        let mut csv = String::from("axis");
        for (column, _) in &errors {
            let _ = write!(csv, ",{}", column.key);
        }
        csv.push('\n');
        for axis in [3, 4, 5, 0, 1, 2] {
            let _ = write!(csv, "{}", AXES[axis]);
            for (_, e) in &errors {
                let _ = write!(csv, ",{:.6}", e.rmse[axis]);
            }
            csv.push('\n');
        }
        let path = write(folder, "table-2.csv", &csv)?;
        let svg = write(folder, "table-2.svg", &draw_errors(&errors))?;
        let of = |key: &str| errors.iter().find(|(c, _)| c.key == key).map(|(_, e)| e);
        let default = Errors::default();
        let [camera, inertial, paper, tight, whole, corrected] =
            ["camera", "inertial", "paper", "tight", "paper_whole", "paper_velocity_from_fused"]
                .map(|key| of(key).unwrap_or(&default));
        let nearest = |mine: &Errors| {
            let names: Vec<&str> = (0..6)
                .filter(|&i| mine.rmse[i] < camera.rmse[i].min(inertial.rmse[i]))
                .map(|i| AXES[i])
                .collect();
            if names.is_empty() {
                "0 of 6 axes".to_owned()
            } else {
                format!("{} of 6 axes ({})", names.len(), names.join(", "))
            }
        };
        let unit_turns_better = (3..6).filter(|&i| inertial.rmse[i] < camera.rmse[i]).count();
        let values = vec![
            Value::new(
                "axes in which the EKF is nearer to the truth than camera and IMU",
                "6 of 6",
                format!("{}, on our tracker's markers", nearest(paper)),
            ),
            Value::new("the same, whole published system", "6 of 6", nearest(whole)),
            Value::new("the same, velocity from the fused poses", "–", nearest(corrected)),
            Value::new("the same, default filter", "–", nearest(tight)),
            Value::new(
                "rotation axes in which the IMU is nearer than the camera",
                "3 of 3",
                format!("{unit_turns_better} of 3"),
            ),
        ];
        Ok(Made {
            name: "table-2",
            title: "Table II: errors of camera, IMU, EKF and the default filter",
            table: Some(Table::from_csv(&csv, 3, true)),
            csv: path,
            svg,
            values,
            shows: format!(
                "RMSE of each axis (degrees, millimeters) over {:.0} s of swing with one marker \
                 covered for a while, without the first second, all estimators with the same \
                 gravity ({} m/s²). `paper` is the published filter on the markers of the default \
                 tracker, `paper_whole` the published tracker, pose and filter, \
                 `paper_velocity_from_fused` the published filter whose velocity comes from the \
                 fused poses, `tight` the default.",
                scenario.duration(),
                scenario.sensors.gravity,
            ),
            published: format!(
                "The table's numbers are in an image of the paper; its text gives the order. The \
                 default tracker fits the edges of each square, which makes the camera's own \
                 rotations better than an IMU attitude with an error of half a degree. Nothing \
                 corrects the published filter's inertial velocity, so its position is {:.0} mm \
                 off (RMSE; {:.0} mm with the published tracker) and drifts away from the \
                 camera's; with the velocity from the fused poses (`paper.velocity_from_fused`) \
                 it is {:.1} mm. What covers a part of a marker shifts its center of mass; eq. 3 \
                 goes on from there without the platform's turn, and the published pose weighs all \
                 pixels alike, so it tilts. Past six images three markers continue from that pose \
                 and may stay in another of their solutions: {:.2}° of rotation for the whole \
                 system, {:.2}° on the default tracker's markers, whose edges show what is \
                 covered. The default filter uses every visible marker's pixels and estimates \
                 velocity, biases and clock offsets too: {:.2} mm, {:.3}°.",
                paper.position_rmse,
                whole.position_rmse,
                corrected.position_rmse,
                whole.rotation_rmse,
                paper.rotation_rmse,
                tight.position_rmse,
                tight.rotation_rmse,
            ),
        })
    }

    /// Writes `fig-13.csv` and `fig-13.svg`.
    pub fn figure_13(&self, scenario: &Scenario, folder: &Path) -> Result<Made> {
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
        for column in &self.columns {
            for (at, pose) in &column.track {
                line(at.seconds_since(self.epoch), column.key, six(pose));
            }
        }
        let path = write(folder, "fig-13.csv", &csv)?;
        let shaded: Vec<[f64; 2]> = scenario.covers.iter().map(|c| c.seconds).collect();
        let curves: Vec<Curve<'_>> = self
            .columns
            .iter()
            .map(|c| Curve { name: c.name, track: &c.track, color: c.color, width: c.width })
            .collect();
        let drawn = six_curves(
            &Run {
                title: "Fig. 13: pose by camera, IMU, the published EKF and the default filter",
                epoch: self.epoch,
                seconds: scenario.duration(),
                truth: &|t| Some(scenario.motion.world_from_volant(t)),
                shaded: &shaded,
            },
            &curves,
        )?;
        let svg = write(folder, "fig-13.svg", &drawn)?;
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
            values: self
                .columns
                .iter()
                .map(|c| {
                    let what = format!("100 mm off the truth: {}", c.name);
                    let published = match c.key {
                        "inertial" => "drifts away",
                        "paper" | "paper_whole" => "stays near the truth",
                        _ => "–",
                    };
                    Value::new(&what, published, left(&c.track))
                })
                .collect(),
            shows: format!(
                "One run of {:.0} s, the same as in Table II. Each panel has the range of the \
                 truth: a curve that leaves it has left that range. Camera and default filter lie \
                 on the truth at this scale; Table II has their errors.",
                scenario.duration(),
            ),
            published: "The published curves are an image without numbers. As there, the IMU's \
                        translation drifts and its rotations stay near. The published EKF follows \
                        the truth in all axes; here its translation is pulled along by an inertial \
                        velocity that nothing corrects, unless the velocity is taken from the \
                        fused poses. Its rotations follow the truth on the default tracker's \
                        markers; on those of the published tracker they leave it where a covered \
                        marker makes the pose ambiguous."
                .to_owned(),
        })
    }
}

/// The six errors on logarithmic scales: rotations above, positions below.
fn draw_errors(errors: &[(&Column, Errors)]) -> String {
    let rows: Vec<(String, Color)> =
        errors.iter().map(|(column, _)| (column.name.to_owned(), column.color)).collect();
    let of = |axis: usize| errors.iter().map(move |(_, e)| e.rmse[axis]);
    let panels = [3, 4, 5, 0, 1, 2].map(|i| {
        let half = i / 3 * 3;
        let range = decades((half..half + 3).flat_map(of));
        Bars {
            axis: axis(format!("{} [{}]", AXES[i], UNITS[i]), range, true),
            values: of(i).collect(),
            spread: Vec::new(),
        }
    });
    draw_bars("Table II: RMSE of each axis", &rows, 3, &panels)
}
