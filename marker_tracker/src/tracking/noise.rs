//! Adaptation of the measurement noise.

use crate::{
    edge::LAGS,
    geometry::PoseObservation,
    outline::QuadFit,
    tracking::{camera::View, marker::MarkerTrack, platform::PlatformModel},
};
use nalgebra::Matrix2;
use rig_model::{MarkerColor, PerColor};

/// Noise of the edges: correlation of neighboring rows, and what the rows do not show.
#[derive(Clone, Debug, Default)]
pub(super) struct NoiseModel {
    /// Running sums of the products of rows' residuals, by lag, px².
    lag: [f64; LAGS],
    /// Running sum of the centroids' χ² about the pose.
    chi2: f64,
    /// Running sum of its degrees of freedom.
    dof: f64,
}

impl NoiseModel {
    /// Correlation of neighboring rows that is assumed until it is measured: tuned; guarded by the
    /// normalized squared error in `tests/synthetic` and `tests/bags`; and its upper bound.
    const DEFAULT_CORRELATION: f64 = 0.4;
    const MAX_CORRELATION: f64 = 0.7;
    /// Degrees of freedom that the expectation χ² = dof counts for.
    const PRIOR_DOF: f64 = 50.0;
    /// Bounds of the excess.
    const EXCESS: (f64, f64) = (0.6, 4.0);
    /// Largest χ² of one image (two degrees of freedom) that is added, and from which on the image
    /// is ignored. Of normal residuals one in 3 million exceeds 30.
    const MAX_CHI2: f64 = 30.0;
    const OUTLIER_CHI2: f64 = 200.0;
    /// Sums at which the running sums are halved: some 200 images; the rows of a few seconds.
    const HALVE_DOF: f64 = 400.0;
    const HALVE_ROWS: f64 = 100.0;

    /// Variance of a mean of rows over that of as many independent ones, (1 + ρ)/(1 − ρ) for a
    /// correlation ρ of neighbors.
    pub fn correlation(&self) -> f64 {
        let rho = if self.lag[0] > 0.0 {
            (self.lag[1] / self.lag[0]).clamp(0.0, Self::MAX_CORRELATION)
        } else {
            Self::DEFAULT_CORRELATION
        };
        (1.0 + rho) / (1.0 - rho)
    }

    /// Factor on an edge's variance: the rows' correlation times the excess of the centroids'
    /// residuals about the pose over their covariances.
    pub fn inflation(&self) -> f64 {
        let excess = (self.chi2 + Self::PRIOR_DOF) / (self.dof + Self::PRIOR_DOF);
        self.correlation() * excess.clamp(Self::EXCESS.0, Self::EXCESS.1)
    }

    /// Adds the residuals of a whole outline's rows.
    pub fn add_rows(&mut self, fit: &QuadFit) {
        for e in fit.edges.iter().flatten() {
            for (sum, lag) in self.lag.iter_mut().zip(&e.lag) {
                *sum += lag;
            }
        }
    }

    /// Halves the weight of the past rows where it has become large.
    pub fn forget_rows(&mut self) {
        if self.lag[0] > Self::HALVE_ROWS {
            self.lag = self.lag.map(|v| v * 0.5);
        }
    }

    /// Adapts the excess to the residuals of four whole outlines about their best pose, which they
    /// over-determine by two degrees of freedom. It covers what an edge's rows cannot show: JPEG
    /// blocks, demosaicing, paper that is not flat. `view`: with the pose to start from.
    pub fn adapt_excess(
        &mut self,
        platform: &PlatformModel,
        tracks: &PerColor<MarkerTrack>,
        view: &View<'_>,
    ) {
        let mut observations = [PoseObservation::NONE; 4];
        let mut covariances = [Matrix2::identity(); 4];
        for color in MarkerColor::ALL {
            let fit = tracks[color].fit.filter(|f| f.is_whole() && !f.relit);
            let Some(fit) = fit.filter(|_| platform.markers[color].is_placed_well()) else {
                return;
            };
            let sigma = fit.sigma();
            observations[color.index()] =
                PoseObservation { color, pixel: fit.centroid, sigma, outline: None };
            // Without the excess itself.
            let rows = fit.covariance - fit.beside;
            covariances[color.index()] = rows * (self.correlation() / fit.inflation) + fit.beside;
        }
        let refined = platform.geometry(view.camera).refine(&observations, &view.pose, None, 4);
        let Some((best, ..)) = refined else { return };
        let mut chi2 = 0.0;
        for (o, covariance) in observations.iter().zip(&covariances) {
            let Some(p) = platform.layout.projected_centroid(o.color, view.camera, &best) else {
                return;
            };
            let Some(inverse) = covariance.try_inverse() else { return };
            let r = o.pixel - p.pixel;
            chi2 += (r.transpose() * inverse * r)[0];
        }
        if chi2.is_finite() && chi2 < Self::OUTLIER_CHI2 {
            self.chi2 += chi2.min(Self::MAX_CHI2);
            self.dof += 2.0;
        }
        if self.dof > Self::HALVE_DOF {
            (self.chi2, self.dof) = (self.chi2 * 0.5, self.dof * 0.5);
        }
    }
}
