//! Camera time offset from several windows, none of which suffices by itself.

use super::alignment::{
    ACCEPTED, Aligned, CANDIDATES, LARGEST, STEP, TimeOffset, WINDOW, candidate, others_are_refuted,
};
use rig_model::Stamp;

/// Number of windows that count: at rest the sum of all would be a random walk, which refutes all
/// candidates but one in the end.
const MEMORY: f64 = 20.0;

/// Costs of the candidates, added up over windows that do not overlap; older ones fade.
#[derive(Clone, Debug, Default)]
pub(super) struct Windows {
    /// χ² of each candidate above the best of its window.
    costs: Option<[f64; CANDIDATES]>,
    /// Newest image of the last window.
    until: Option<Stamp>,
}

impl Windows {
    /// Returns whether a window is due with the image at `newest`: it begins behind the last one.
    pub(super) fn is_due(&mut self, newest: Stamp) -> bool {
        let until = *self.until.get_or_insert(newest);
        let due = newest.seconds_since(until) >= WINDOW;
        if due {
            self.until = Some(newest);
        }
        due
    }

    /// Adds a window.
    pub(super) fn add(&mut self, aligned: &Aligned) {
        if aligned.scale < LARGEST {
            let sum = self.costs.get_or_insert([0.0; CANDIDATES]);
            let fade = 1.0 - 1.0 / MEMORY;
            sum.iter_mut().zip(&aligned.costs).for_each(|(sum, cost)| *sum = *sum * fade + cost);
        }
    }

    /// Returns the offset, where all windows together show it.
    pub(super) fn offset(&self) -> Option<TimeOffset> {
        let costs = self.costs.as_ref()?;
        let best = (0..CANDIDATES).min_by(|&a, &b| costs[a].total_cmp(&costs[b]))?;
        let (low, high) = (costs.get(best.checked_sub(1)?)?, costs.get(best + 1)?);
        let curvature = low + high - 2.0 * costs[best];
        let offset = candidate(best) + STEP * (low - high) / (2.0 * curvature);
        let sigma = STEP * (2.0 / curvature).sqrt();
        let refuted = others_are_refuted(costs, costs[best], offset, sigma);
        (sigma < ACCEPTED && refuted).then_some(TimeOffset { offset, sigma })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ekf::propagation::ImuReading;

    /// A window whose cost is a parabola about `offset` with the standard deviation `sigma`, s.
    fn window(offset: f64, sigma: f64, scale: f64) -> Aligned {
        let costs = std::array::from_fn(|i| ((candidate(i) - offset) / sigma).powi(2));
        Aligned { found: None, biases: ImuReading::default(), scale, costs }
    }

    #[test]
    fn windows_that_do_not_suffice_one_by_one_do_together() {
        let mut windows = Windows::default();
        for (k, offset) in [0.052, 0.038, 0.049, 0.041].into_iter().enumerate() {
            assert_eq!(windows.offset().is_some(), k > 2, "{k}");
            windows.add(&window(offset, 0.015, 1.0));
        }
        let found = windows.offset().unwrap();
        // The weights are 0.95³, 0.95², 0.95 and 1.
        assert!((found.offset - 0.044861).abs() < 1e-6, "{found:?}");
        assert!((found.sigma - 0.007788).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn flat_costs_bad_fits_and_two_minima_give_no_offset() {
        // At rest; a bad fit; a minimum beyond the candidates; two minima that fit alike.
        let flat = window(0.0, 1.0, 1.0);
        let bad = window(0.05, 0.002, 1.3);
        let beyond = window(0.31, 0.005, 1.0);
        let mut two = window(-0.1, 0.005, 1.0);
        for i in 0..CANDIDATES {
            two.costs[i] = two.costs[i].min(window(0.1, 0.005, 1.0).costs[i] + 10.0);
        }
        // Readings that do not reach some candidates.
        let mut short = window(0.29, 0.005, 1.0);
        short.costs[CANDIDATES - 1] = f64::NAN;
        for (name, wrong) in
            [("flat", flat), ("bad", bad), ("beyond", beyond), ("two", two), ("short", short)]
        {
            let mut windows = Windows::default();
            windows.add(&wrong);
            assert_eq!(windows.offset(), None, "{name}");
        }
    }

    /// Four hours at rest: what each window prefers is noise.
    #[test]
    fn windows_without_motion_give_no_offset_however_many_they_are() {
        let mut random = rig_simulator::random::Random::new(1);
        let mut windows = Windows::default();
        for k in 0..10_000 {
            let mut rest = window(0.0, 1.0, 1.0);
            rest.costs = std::array::from_fn(|_| 2.0 * random.normal().abs());
            windows.add(&rest);
            assert_eq!(windows.offset(), None, "{k}");
        }
    }

    #[test]
    fn windows_do_not_overlap() {
        let mut windows = Windows::default();
        let due: Vec<i64> =
            (0..100).filter(|k| windows.is_due(Stamp::from_nanos(k * 100_000_000))).collect();
        assert_eq!(due, [15, 30, 45, 60, 75, 90]);
    }
}
