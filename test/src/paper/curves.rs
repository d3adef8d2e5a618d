//! Fig. 13 and Table II: six curves, and the errors of camera, inertial unit, the published filter and the default one.

use super::{
    Made, PaperError,
    offline::{fuse, record},
    write,
};
use crate::{
    accuracy::{AXES, Errors, Track, UNITS, inertial_alone, six},
    live::{Film, Scenario},
    report::{Curve, colours, six_curves},
};
use nalgebra::Vector3;
use pose_fusion::Model;
use rig_model::Stamp;
use std::{fmt::Write, path::Path};

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
    /// A picture, or a filter that says nothing.
    pub fn of(scenario: &Scenario, film: &Film) -> Result<Self, PaperError> {
        let recording = record(scenario, film)?;
        let epoch = scenario.sensors.epoch;
        let tight = fuse(scenario, &recording, Model::Tight)?;
        let paper = fuse(scenario, &recording, Model::Paper)?;
        // The unit alone begins where the run begins, at rest.
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
        let (from, to) = (self.epoch.plus_seconds(1.0), self.epoch.plus_seconds(scenario.duration()));
        let truth = |at: Stamp| scenario.motion.world_from_volant(at.seconds_since(self.epoch));
        self.columns().map(|(name, track)| (name, Errors::of(track, from, to, truth)))
    }

    /// Writes `table-2.csv`.
    ///
    /// # Errors
    /// A place that cannot be written to.
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
        let [camera, inertial, paper, tight] = &errors;
        let nearest = (0..6).filter(|&i| tight.1.rmse[i] < camera.1.rmse[i].min(inertial.1.rmse[i])).count();
        let paper_nearest =
            (0..6).filter(|&i| paper.1.rmse[i] < camera.1.rmse[i].min(inertial.1.rmse[i])).count();
        let unit_turns_better = (3..6).filter(|&i| inertial.1.rmse[i] < camera.1.rmse[i]).count();
        let words = format!(
            "RMSE per axis (degrees, millimetres) over {:.0} s of swing with one marker covered for a while. The default filter \
             (tight) is nearer to the truth than camera and inertial unit in {nearest} of 6 axes, the published filter in \
             {paper_nearest} of 6. Published: the EKF is nearest in all six, and the inertial unit has less rotation error than \
             the camera; here it has less in {unit_turns_better} of 3, because the tracker fits the squares' edges and \
             predicts centroids, which makes the camera's rotations better than a 0.55° attitude unit. The published \
             filter takes poses, and adds the unit's doubly integrated translation, whose velocity nothing corrects.",
            scenario.duration()
        );
        Ok(Made {
            name: "table-2",
            title: "Table II: errors of camera, inertial unit, EKF and the default filter",
            csv: path,
            svg: None,
            words,
        })
    }

    /// Writes `fig-13.csv` and `fig-13.svg`.
    ///
    /// # Errors
    /// A place that cannot be written to.
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
        let curve = |name, track, colour, width| Curve { name, track, colour, width };
        six_curves(
            &svg,
            "Fig. 13: pose by camera, inertial unit, the published EKF and the default filter",
            self.epoch,
            scenario.duration(),
            |t| scenario.motion.world_from_volant(t),
            &[
                curve("camera alone", &self.camera, colours::CAMERA, 0),
                curve("inertial alone", &self.inertial, colours::INERTIAL, 2),
                curve("EKF as published", &self.paper, colours::PAPER, 2),
                curve("default filter", &self.tight, colours::FUSED, 3),
            ],
            &shaded,
        )
        .map_err(PaperError::Drawing)?;
        let words = "Six curves over one run. As published, the inertial unit's translation drifts out of the picture within \
                     seconds and its rotations stay near; the camera follows the truth with some noise, more of it while a \
                     marker is covered."
            .to_owned();
        Ok(Made {
            name: "fig-13",
            title: "Fig. 13: x, y, z, roll, pitch, yaw against the truth",
            csv: path,
            svg: Some(svg),
            words,
        })
    }
}
