//! Backwards over what was recorded: every estimate with the knowledge of all data, those after it included.
//!
//! In flow the filter's [`Node`]s once nothing can change them any more, out flow the smoothed states. From the last
//! node back (Rauch, Tung and Striebel 1965; on the error state as in Särkkä, "Bayesian Filtering and Smoothing",
//! ch. 8): with `x⁺, P⁺` after the event at node i, `x⁻ = f(x⁺), P⁻ = F P⁺ Fᵀ + Q` the prediction of node i + 1 from it,
//!
//! `C = P⁺ Fᵀ (P⁻)⁻¹`, `x ← x⁺ ⊞ C (x_{i+1} ⊟ x⁻)`, `P ← P⁺ + C (P_{i+1} − P⁻) Cᵀ`.
//!
//! The prediction is made again by the filter's own [`propagate`], so the two cannot differ. `P⁻` is scaled to a unit diagonal
//! and factored by Cholesky. The errors are those at the camera's time (see [`super::state`]): where the clock's offset
//! differs, the nominal states are moved along their own motion before they are compared, and after they are corrected.

use super::{
    history::{Event, Node},
    propagate::{propagate, retime, transition},
    state::{CAMERA_CLOCK, Covariance, Error, N, State},
};
use nalgebra::{Cholesky, Const};

/// The smoothed states of nodes in order of time. A node that was set begins anew: nothing behind it is known before it.
/// `gravity` in m/s².
pub fn smooth(nodes: &[Node], gravity: f64) -> Vec<State> {
    let mut states: Vec<State> = Vec::with_capacity(nodes.len());
    for (i, node) in nodes.iter().enumerate().rev() {
        let state = match (nodes.get(i + 1), states.last()) {
            (Some(next), Some(later)) if !matches!(next.event, Event::Set) => {
                step(node, next, later, gravity).unwrap_or_else(|| node.state.clone())
            }
            _ => node.state.clone(),
        };
        states.push(state);
    }
    states.reverse();
    states
}

/// One step back; `None` where the prediction's covariance cannot be factored.
fn step(node: &Node, next: &Node, later: &State, gravity: f64) -> Option<State> {
    let dt = next.stamp.seconds_since(node.stamp);
    let f = transition(&node.state, &node.felt, &next.felt, dt);
    let mut prediction = node.state.clone();
    propagate(&mut prediction, &node.felt, &next.felt, dt, &next.process);
    let mut later_there = later.clone();
    retime(&mut later_there, &next.felt, prediction.camera_clock - later.camera_clock, gravity);
    let error = later_there.minus(&prediction);

    let scale = Error::from_fn(|i, _| {
        let variance = prediction.covariance[(i, i)];
        if variance > 0.0 { variance.sqrt() } else { 1.0 }
    });
    let mut scaled = Covariance::from_fn(|i, j| prediction.covariance[(i, j)] / (scale[i] * scale[j]));
    for i in 0..N {
        // What is known exactly stays so; the rest is far above rounding.
        scaled[(i, i)] = scaled[(i, i)].max(1.0) + 1e-12;
    }
    let cholesky = Cholesky::<f64, Const<N>>::new(scaled)?;
    let mut shared = f * node.state.covariance;
    for i in 0..N {
        shared.row_mut(i).unscale_mut(scale[i]);
    }
    let mut gain = cholesky.solve(&shared);
    for i in 0..N {
        gain.row_mut(i).unscale_mut(scale[i]);
    }
    let gain = gain.transpose();
    let correction = gain * error;
    let mut state = node.state.clone();
    state.add(&correction);
    retime(&mut state, &node.felt, correction[CAMERA_CLOCK], gravity);
    let covariance =
        node.state.covariance + gain * (later.covariance - prediction.covariance) * gain.transpose();
    state.covariance = (covariance + covariance.transpose()) * 0.5;
    state.is_sound().then_some(state)
}

#[cfg(test)]
mod tests {
    use super::super::{
        markers::scalar_update,
        propagate::{Felt, Process},
        state::{ACCELEROMETER, POSITION, VELOCITY},
    };
    use super::*;
    use nalgebra::Vector3;
    use rig_model::Stamp;

    /// In a linear problem the smoothed first state is the one that all measurements give in one go.
    #[test]
    fn it_is_the_batch_solution() {
        let felt = Felt { force: Vector3::new(0.0, 0.0, 9.81), rate: Vector3::zeros() };
        let process = Process {
            gravity: 9.81,
            force: 1e-4,
            rate: 1e-8,
            accelerometer_bias: 1e-8,
            gyroscope_bias: 1e-10,
            jerk: Vector3::repeat(1e-3),
            clock: 0.0,
        };
        let mut first = State::zero();
        for i in 0..24 {
            first.covariance[(i, i)] = 1e-2;
        }
        first.covariance[(VELOCITY, VELOCITY)] = 0.25;
        first.covariance[(ACCELEROMETER, ACCELEROMETER)] = 1e-4;
        let truth = |t: f64| 0.05 + 0.3 * t;
        let (n, dt) = (40, 0.01);
        let mut nodes = vec![Node {
            stamp: Stamp::from_nanos(0),
            event: Event::Set,
            felt,
            process,
            state: first.clone(),
        }];
        for i in 1..=n {
            let mut state = nodes[i - 1].state.clone();
            propagate(&mut state, &felt, &felt, dt, &process);
            if i % 4 == 0 {
                let residual = truth(i as f64 * dt) - state.position.x;
                scalar_update(&mut state, &[(POSITION, 1.0)], residual, 1e-6);
            }
            let stamp = Stamp::from_nanos(0).plus_seconds(i as f64 * dt);
            nodes.push(Node { stamp, event: Event::Imu { still: None }, felt, process, state });
        }
        let smoothed = smooth(&nodes, 9.81);
        // The same by augmenting the first state: its cross-covariance with every later one is carried along.
        let (mut mean, mut own) = (Error::zeros(), first.covariance);
        let (mut now, mut shared) = (first.clone(), first.covariance);
        for i in 1..=n {
            let f = transition(&now, &felt, &felt, dt);
            propagate(&mut now, &felt, &felt, dt, &process);
            shared *= f.transpose();
            if i % 4 == 0 {
                let spread = now.covariance[(POSITION, POSITION)] + 1e-6;
                let residual = truth(i as f64 * dt) - now.position.x;
                let gain = shared.column(POSITION) / spread;
                mean += gain * residual;
                own -= gain * gain.transpose() * spread;
                let row = now.covariance.column(POSITION).transpose();
                shared -= gain * row;
                scalar_update(&mut now, &[(POSITION, 1.0)], residual, 1e-6);
            }
        }
        let error = smoothed[0].minus(&first);
        assert!((error - mean).amax() < 1e-6, "{}", (error - mean).amax());
        assert!((smoothed[0].covariance - own).amax() < 1e-7, "{}", (smoothed[0].covariance - own).amax());
        assert!((smoothed[0].velocity.x - 0.3).abs() < 0.01);
        assert!(smoothed[0].covariance[(VELOCITY, VELOCITY)] < 1e-3);
    }
}
