//! Sums that become the figures of a table.

use crate::{methods::Estimate, report::number};
use nalgebra::{Isometry3, Vector2};
use std::time::Duration;

/// A pose further off than this is a failure, not an error to be averaged (for every method alike).
const GROSS_MM: f64 = 50.0;
const GROSS_DEG: f64 = 5.0;
/// The success of Fig. 11: a pose within 5 mm and 1°.
pub const SUCCESS_MM: f64 = 5.0;
/// The success of Fig. 11: a pose within 5 mm and 1°.
pub const SUCCESS_DEG: f64 = 1.0;

/// What a method did over a run of images.
#[derive(Clone, Debug, Default)]
pub struct Record {
    /// Time per frame and stage.
    pub times: Vec<Vec<Duration>>,
    /// Translation errors, mm, of poses that are not gross failures.
    pub millimetres: Vec<f64>,
    /// Rotation errors, degrees, of the same.
    pub degrees: Vec<f64>,
    /// Sum of squared point errors per axis, px², and how many.
    pub pixel: (Vector2<f64>, usize),
    /// Sum of point errors, px.
    pub bias: Vector2<f64>,
    pub images: usize,
    /// Images with a pose within 5 mm and 1°.
    pub successes: usize,
    /// Images with a pose beyond 50 mm or 5°.
    pub gross: usize,
}

impl Record {
    pub fn add(&mut self, estimate: &Estimate, truth: &Isometry3<f64>, points: &[Vector2<f64>]) {
        self.images += 1;
        self.times.push(estimate.stages.clone());
        for (index, point) in &estimate.points {
            if let Some(t) = points.get(*index) {
                let error = point - t;
                if error.norm() < 5.0 {
                    self.pixel.0 += error.component_mul(&error);
                    self.bias += error;
                    self.pixel.1 += 1;
                }
            }
        }
        let Some(pose) = estimate.camera_from_volant else { return };
        let millimetres = (pose.translation.vector - truth.translation.vector).norm() * 1e3;
        let degrees = pose.rotation.angle_to(&truth.rotation).to_degrees();
        if millimetres > GROSS_MM || degrees > GROSS_DEG || millimetres.is_nan() || degrees.is_nan()
        {
            self.gross += 1;
            return;
        }
        self.successes += usize::from(millimetres <= SUCCESS_MM && degrees <= SUCCESS_DEG);
        self.millimetres.push(millimetres);
        self.degrees.push(degrees);
    }

    /// Median of the whole time, µs.
    pub fn median_us(&self) -> f64 {
        median(self.times.iter().map(|t| t.iter().sum::<Duration>().as_secs_f64() * 1e6).collect())
    }

    /// Median of one stage, µs.
    pub fn stage_us(&self, stage: usize) -> f64 {
        median(
            self.times.iter().filter_map(|t| t.get(stage)).map(|t| t.as_secs_f64() * 1e6).collect(),
        )
    }

    /// RMS of the points per axis, px; NaN where the method yields none.
    pub fn pixel_rms(&self) -> f64 {
        ((self.pixel.0.x + self.pixel.0.y) / (2.0 * self.pixel.1 as f64)).sqrt()
    }

    /// Mean error of the points, px.
    pub fn pixel_bias(&self) -> Vector2<f64> {
        self.bias / self.pixel.1 as f64
    }

    /// RMSE of the translation, mm.
    pub fn translation_rmse(&self) -> f64 {
        rms(&self.millimetres)
    }

    /// RMSE of the rotation, degrees.
    pub fn rotation_rmse(&self) -> f64 {
        rms(&self.degrees)
    }

    /// Mean and deviation of the translation errors, mm, and of the rotation errors, degrees.
    pub fn error_cells(&self) -> [String; 4] {
        let (mm, deg) = (mean_and_deviation(&self.millimetres), mean_and_deviation(&self.degrees));
        [number(mm.0, 4), number(mm.1, 4), number(deg.0, 5), number(deg.1, 5)]
    }

    pub fn success(&self) -> f64 {
        self.successes as f64 / self.images as f64
    }
}

pub fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

pub fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let variance =
        values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / values.len() as f64;
    (mean, variance.sqrt())
}

/// The median; NaN of no values.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}
