//! Fig. 13 and Table II: six curves, and the errors of camera, IMU, the published filter
//! and the default one, all with the same gravity.

use super::{
    Made, Value,
    bars::{Bars, decades, draw_bars},
    offline::{filter, fuse, record, track},
};
use crate::{
    accuracy::{AXES, Errors, THRESHOLD, Track, UNITS, inertial_alone, six},
    live::{ImageSequence, Scenario},
};
use anyhow::Result;
use marker_tracker::{BinaryThreshold, Method, TrackerConfig};
use nalgebra::Isometry3;
use pose_fusion::Model;
use rig_model::Stamp;
use std::fmt::Write;
use volant::report::{Axis, Color, Curve, Run, Table, colors, six_curves};

/// An estimator of Table II.
struct Column {
    /// Column of the CSV files.
    key: &'static str,
    /// Name in the charts.
    name: &'static str,
    color: Color,
    /// Line width in Fig. 13, px; 0: dots.
    width: u32,
    track: Track,
}

/// The tracks of one run.
pub struct Curves<'a> {
    scenario: &'a Scenario,
    columns: [Column; 6],
}

impl<'a> Curves<'a> {
    /// Runs all estimators over the scenario.
    pub fn of(scenario: &'a Scenario, images: &ImageSequence) -> Result<Self> {
        let inputs = record(scenario, track(scenario, images, TrackerConfig::default())?);
        // Binary images, flow and hue, eq. 3.
        let method = Method::Paper(BinaryThreshold::default());
        let published = TrackerConfig { method, ..TrackerConfig::default() };
        let as_published = record(scenario, track(scenario, images, published)?);
        let tight = fuse(scenario, &inputs, filter(scenario, Model::Tight))?;
        let paper = fuse(scenario, &inputs, filter(scenario, Model::Paper))?.fused;
        let whole = fuse(scenario, &as_published, filter(scenario, Model::Paper))?.fused;
        let mut config = filter(scenario, Model::Paper);
        config.paper.velocity_from_fused = true;
        let corrected = fuse(scenario, &inputs, config)?.fused;
        // The IMU alone starts with the run, stationary.
        let start = (scenario.sensors.epoch, scenario.motion.world_from_volant(0.0));
        let samples = scenario.simulated_sensors().imu_samples();
        let inertial = inertial_alone(scenario, &samples, &start, THRESHOLD);
        let column = |key, name, color, width, track| Column { key, name, color, width, track };
        let columns = [
            column("camera", "camera alone", colors::CAMERA, 0, tight.visual),
            column("inertial", "IMU alone", colors::INERTIAL, 2, inertial),
            column("paper", "published filter, our tracker", colors::PAPER, 2, paper),
            column("tight", "default filter", colors::FUSED, 3, tight.fused),
            column("paper_whole", "published system, whole", colors::BROWN, 2, whole),
            column(
                "paper_velocity_from_fused",
                "published filter, velocity from fused poses",
                colors::VIOLET,
                1,
                corrected,
            ),
        ];
        Ok(Self { scenario, columns })
    }

    /// Time since the start of the run, s.
    fn seconds(&self, at: Stamp) -> f64 {
        at.seconds_since(self.scenario.sensors.epoch)
    }

    fn truth(&self, at: Stamp) -> Isometry3<f64> {
        self.scenario.motion.world_from_volant(self.seconds(at))
    }

    pub fn table_2(&self) -> Made {
        let (scenario, epoch) = (self.scenario, self.scenario.sensors.epoch);
        // The first second is the filters' to settle.
        let (from, to) = (epoch.plus_seconds(1.0), epoch.plus_seconds(scenario.duration()));
        let errors =
            self.columns.each_ref().map(|c| Errors::of(&c.track, from, to, |at| self.truth(at)));
        let mut csv = format!("axis,{}\n", self.columns.each_ref().map(|c| c.key).join(","));
        for axis in [3, 4, 5, 0, 1, 2] {
            let cells = errors.each_ref().map(|e| format!("{:.6}", e.rmse[axis]));
            let _ = writeln!(csv, "{},{}", AXES[axis], cells.join(","));
        }
        let [camera, inertial, paper, tight, whole, corrected] = &errors;
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
        Made {
            name: "table-2",
            title: "Table II: errors of camera, IMU, EKF and the default filter",
            table: Some(Table::from_csv(&csv, 3, true)),
            csv,
            svg: draw_errors(&self.columns, &errors),
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
        }
    }

    pub fn figure_13(&self) -> Result<Made> {
        let scenario = self.scenario;
        let head: Vec<String> =
            AXES.iter().zip(UNITS).map(|(axis, unit)| format!("{axis}_{unit}")).collect();
        let mut csv = format!("seconds,estimate,{}\n", head.join(","));
        let mut line = |t: f64, name: &str, pose: &Isometry3<f64>| {
            let cells = six(pose).map(|v| format!("{v:.4}"));
            let _ = writeln!(csv, "{t:.4},{name},{}", cells.join(","));
        };
        for i in 0..=(scenario.duration() * 30.0) as usize {
            let t = i as f64 / 30.0;
            line(t, "truth", &scenario.motion.world_from_volant(t));
        }
        for column in &self.columns {
            for (at, pose) in &column.track {
                line(self.seconds(*at), column.key, pose);
            }
        }
        let shaded: Vec<[f64; 2]> = scenario.covers.iter().map(|c| c.seconds).collect();
        let curves: Vec<Curve<'_>> = self
            .columns
            .iter()
            .map(|c| Curve { name: c.name, track: &c.track, color: c.color, width: c.width })
            .collect();
        let svg = six_curves(
            &Run {
                title: "Fig. 13: pose by camera, IMU, the published EKF and the default filter",
                epoch: scenario.sensors.epoch,
                seconds: scenario.duration(),
                truth: &|t| Some(scenario.motion.world_from_volant(t)),
                shaded: &shaded,
            },
            &curves,
        )?;
        let left = |track: &Track| {
            let off = |(at, pose): &&(Stamp, Isometry3<f64>)| {
                (pose.translation.vector - self.truth(*at).translation.vector).norm() > 0.1
            };
            let after = |(at, _): &(Stamp, _)| format!("after {:.1} s", self.seconds(*at));
            track.iter().find(off).map_or("never".to_owned(), after)
        };
        Ok(Made {
            name: "fig-13",
            title: "Fig. 13: x, y, z, roll, pitch, yaw against the truth",
            csv,
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
fn draw_errors(columns: &[Column], errors: &[Errors]) -> String {
    let rows: Vec<(String, Color)> =
        columns.iter().map(|column| (column.name.to_owned(), column.color)).collect();
    let of = |axis: usize| errors.iter().map(move |e| e.rmse[axis]);
    let panels = [3, 4, 5, 0, 1, 2].map(|i| {
        let half = i / 3 * 3;
        let range = decades((half..half + 3).flat_map(of));
        Bars {
            axis: Axis::new(format!("{} [{}]", AXES[i], UNITS[i]), range, true),
            values: of(i).collect(),
            spread: Vec::new(),
        }
    });
    draw_bars("Table II: RMSE of each axis", &rows, 3, &panels)
}
