//! Product of a matrix with the transition `F` of the error over a step (see
//! [`super::propagation`]), of which only blocks are not zero.

use super::state::{
    ACCELEROMETER_BIAS, ATTITUDE, CLIMBER, CLIMBER_ACCELERATION, CLIMBER_RATE, GYROSCOPE_BIAS, N,
    TIME_OFFSET, VELOCITY,
};
use nalgebra::{Matrix3, RealField, SMatrix, Vector3};

/// Blocks of the transition that are neither zero, one nor the step itself.
pub(super) struct Blocks {
    by_attitude: Matrix3<f64>,
    by_bias: Matrix3<f64>,
    by_offset: [Vector3<f64>; 2],
}

impl Blocks {
    /// `change` is that of specific force and angular velocity by the time, IMU axes.
    pub(super) fn new(
        rotation: &Matrix3<f64>,
        force: &Vector3<f64>,
        dt: f64,
        change: [Vector3<f64>; 2],
    ) -> Self {
        Self {
            by_attitude: -(force.cross_matrix() * dt),
            by_bias: -(rotation * dt),
            by_offset: change.map(|change| rotation * change),
        }
    }
}

/// `M ← M Fᵀ` of a matrix with a column for each entry of the error and `R` rows, by columns.
pub(super) fn times_transition<T: RealField + Copy, const R: usize>(
    m: &mut SMatrix<T, R, N>,
    blocks: &Blocks,
    dt: f64,
) {
    let number = nalgebra::convert::<f64, T>;
    let (half, dt) = (number(0.5), number(dt));
    // One column at a time as plain slices: the compiler vectorizes these loops.
    let columns = m.as_mut_slice();
    let (body, climber) = columns.split_at_mut(CLIMBER * R);
    let (position, rest) = body.split_at_mut(VELOCITY * R);
    let (velocity, rest) = rest.split_at_mut((ATTITUDE - VELOCITY) * R);
    let (attitude, biases) = rest.split_at_mut((ACCELEROMETER_BIAS - ATTITUDE) * R);
    let (accelerometer, gyroscope) = biases.split_at_mut((GYROSCOPE_BIAS - ACCELEROMETER_BIAS) * R);
    let (climber, offset) = climber.split_at_mut((TIME_OFFSET - CLIMBER) * R);
    for axis in 0..3 {
        let row = |m: &Matrix3<f64>| [0, 1, 2].map(|k| number(m[(axis, k)]));
        let (a, b) = (row(&blocks.by_attitude), row(&blocks.by_bias));
        let by_offset = blocks.by_offset.map(|v| number(v[axis]));
        let at = axis * R..(axis + 1) * R;
        let (pc, vc) = (&mut position[at.clone()], &mut velocity[at]);
        for i in 0..R {
            let change = a[0] * attitude[i]
                + a[1] * attitude[R + i]
                + a[2] * attitude[2 * R + i]
                + b[0] * accelerometer[i]
                + b[1] * accelerometer[R + i]
                + b[2] * accelerometer[2 * R + i]
                + by_offset[0] * offset[i];
            pc[i] += dt * (vc[i] + half * change);
            vc[i] += change;
        }
    }
    for axis in 0..3 {
        let ac = &mut attitude[axis * R..(axis + 1) * R];
        let b = [0, 1, 2].map(|k| number(blocks.by_bias[(axis, k)]));
        let by_offset = number(blocks.by_offset[1][axis]);
        for i in 0..R {
            ac[i] += b[0] * gyroscope[i]
                + b[1] * gyroscope[R + i]
                + b[2] * gyroscope[2 * R + i]
                + by_offset * offset[i];
        }
    }
    let (place, rest) = climber.split_at_mut((CLIMBER_RATE - CLIMBER) * R);
    let (speed, rest) = rest.split_at_mut((CLIMBER_ACCELERATION - CLIMBER_RATE) * R);
    for i in 0..3 * R {
        let change = dt * rest[i];
        place[i] += dt * (speed[i] + half * change);
        speed[i] += change;
    }
}
