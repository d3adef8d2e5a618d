//! Weighs what is on the time line again, once the noise of a sensor is known.

use super::Filter;
use crate::{
    adaptation::imu_noise::Densities,
    ekf::state::{ATTITUDE, CLIMBER, CLIMBER_RATE, Error, POSITION, State},
    input::climber_track::SPEED,
    timeline::history::Event,
};
use nalgebra::Vector3;
use rig_model::Stamp;

/// Factor between assumed and identified variance of the encoders from which the readings are
/// weighed again.
const REWEIGHED: f64 = 1.5;

impl Filter {
    /// Withdraws the noise that contradicting images added to the samples from an instant on.
    pub(super) fn withdraw_doubt(&mut self, from: Stamp) {
        for place in self.history.place_of(from)..self.history.len() {
            let Some(entry) = self.history.get_mut(place) else { continue };
            if let Event::Imu { noise, doubt, .. } = &mut entry.event {
                let doubt = std::mem::take(doubt);
                *noise = noise.zip(&doubt, |noise, doubt| noise - doubt);
            }
        }
    }

    /// The first readings identify the encoders' noise and were weighed before that: where it is
    /// found to be another than was assumed, they and the initial state are weighed again.
    pub(super) fn reweigh_readings(&mut self, variance: &Vector3<f64>) {
        let before = self.climber.assumed_variance;
        let factor = variance.component_div(&before);
        if factor.iter().all(|f| (1.0 / REWEIGHED..REWEIGHED).contains(f)) {
            return;
        }
        self.climber.assumed_variance = *variance;
        // Readings that are used with inflated noise keep their variance.
        let suspended = self.trust.is_suspended();
        let more = (variance - before).map(|more| more.max(0.0));
        for place in 0..self.history.len() {
            let Some(entry) = self.history.get_mut(place) else { continue };
            match &mut entry.event {
                Event::Encoders { reading, .. } => {
                    let known = variance.component_mul(&reading.multiplicity);
                    let before = if suspended { reading.variance } else { Vector3::zeros() };
                    reading.variance = known.sup(&before);
                }
                // Everything that the image measured moves with the climber.
                Event::Set if place == 0 => {
                    for axis in (0..3).filter(|axis| more[*axis] > 0.0) {
                        let moved = rigid(&entry.state, axis);
                        entry.state.covariance.ger(more[axis], &moved, &moved, 1.0);
                        let rate = CLIMBER_RATE + axis;
                        entry.state.covariance[(rate, rate)] += SPEED[axis].powi(2);
                    }
                }
                _ => {}
            }
        }
        self.history.rewind(0);
    }

    /// Adds noise to the IMU samples on the time line and processes them again.
    pub(super) fn reweigh_samples(&mut self, more: &Densities) {
        for place in 0..self.history.len() {
            if let Some(entry) = self.history.get_mut(place)
                && let Event::Imu { noise, .. } = &mut entry.event
            {
                *noise = noise.zip(more, |noise, more| noise + more);
            }
        }
        self.history.rewind(0);
    }
}

/// By how much everything differs per meter or radian of a climber's axis, where nothing is known
/// of the platform but what the camera sees of it: it moves rigidly with the climber.
fn rigid(state: &State, axis: usize) -> Error {
    let mut moved = Error::zeros();
    let unit = Vector3::ith(axis, 1.0);
    let arm = state.position - Vector3::new(state.climber.x, state.climber.y, state.position.z);
    let carried = Vector3::new(unit.x, unit.y, 0.0) + Vector3::z().cross(&arm) * unit.z;
    moved.fixed_rows_mut::<3>(POSITION).copy_from(&carried);
    moved[ATTITUDE + 2] = unit.z;
    moved[CLIMBER + axis] = 1.0;
    moved
}
