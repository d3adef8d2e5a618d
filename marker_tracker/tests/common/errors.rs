//! Errors of markers against the truth.

#![allow(dead_code, clippy::unwrap_used)] // each test uses a part

use nalgebra::Vector2;
use rig_model::{MarkerObservation, MarkerState};
use std::fmt;

/// Sums over markers.
#[derive(Clone, Copy, Default)]
pub struct Errors {
    /// Markers in view, and those that were measured.
    pub shown: usize,
    pub count: usize,
    /// Sums of the errors (px) and of their squares (px²) by coordinate.
    sum: Vector2<f64>,
    square: Vector2<f64>,
    /// Sum of the variances per coordinate, px².
    variance: f64,
    /// Sum of the normalized squared errors.
    nes: f64,
    /// Largest distance from the truth, px.
    pub worst: f64,
}

impl Errors {
    /// Adds a marker in view, measured where it was detected.
    pub fn show(&mut self, m: &MarkerObservation, truth: Vector2<f64>) {
        self.shown += 1;
        if m.state == MarkerState::Detected {
            self.add(m, truth);
        }
    }

    /// Adds a measured or predicted marker.
    pub fn add(&mut self, m: &MarkerObservation, truth: Vector2<f64>) {
        let error = m.centroid - truth;
        self.count += 1;
        self.sum += error;
        self.square += error.component_mul(&error);
        self.variance += m.covariance.trace() / 2.0;
        self.nes += error.dot(&(m.covariance.try_inverse().unwrap() * error));
        self.worst = self.worst.max(error.norm());
    }

    fn n(&self) -> f64 {
        self.count.max(1) as f64
    }

    /// Share of the markers in view that were measured.
    pub fn share(&self) -> f64 {
        self.count as f64 / self.shown.max(1) as f64
    }

    /// RMS of each coordinate, px.
    pub fn rms(&self) -> Vector2<f64> {
        (self.square / self.n()).map(f64::sqrt)
    }

    /// RMS of both coordinates, px.
    pub fn rms_per_axis(&self) -> f64 {
        (self.square.sum() / 2.0 / self.n()).sqrt()
    }

    /// Mean normalized squared error.
    pub fn nes(&self) -> f64 {
        self.nes / self.n()
    }
}

impl fmt::Display for Errors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (rms, mean, sigma) = (self.rms(), self.sum / self.n(), self.variance / self.n());
        write!(
            f,
            "{:4}/{:4} rms {:.4} {:.4} mean {:7.4} {:7.4} sigma {:.3} nes {:5.2} worst {:.2}",
            self.count,
            self.shown,
            rms.x,
            rms.y,
            mean.x,
            mean.y,
            sigma.sqrt(),
            self.nes(),
            self.worst,
        )
    }
}
