//! Least squares with one small state per image, linked to the next one, and common parameters. The
//! normal matrix is block tridiagonal with a border; solving it takes time proportional to the
//! number of images.

use nalgebra::{Cholesky, DMatrix, DVector, SMatrix, SVector};

/// Size of the state of an image.
pub const STATE: usize = 9;
type Block = SMatrix<f64, STATE, STATE>;
type StateVector = SVector<f64, STATE>;
type Factor = Cholesky<f64, nalgebra::Const<STATE>>;

/// Share of the damping that acts on the states: a slow motion of the whole track is some 1e-7
/// times as stiff as one state, and must follow the parameters.
const OF_STATES: f64 = 1e-8;

/// Normal equations H·x = b.
pub struct Arrow {
    diagonal: Vec<Block>,
    /// Blocks between an image and the next.
    next: Vec<Block>,
    /// Blocks between an image and the parameters.
    border: Vec<DMatrix<f64>>,
    right: Vec<StateVector>,
    corner: DMatrix<f64>,
    corner_right: DVector<f64>,
}

/// Solution: a step, and the parameters' covariance.
pub struct Solution {
    /// Steps of the images' states.
    pub states: Vec<StateVector>,
    /// Step of the parameters.
    pub parameters: DVector<f64>,
    /// Marginal covariance of the parameters.
    pub covariance: DMatrix<f64>,
}

impl Arrow {
    /// Creates equations that are all zero.
    pub fn new(images: usize, parameters: usize) -> Self {
        Self {
            diagonal: vec![Block::zeros(); images],
            next: vec![Block::zeros(); images],
            border: vec![DMatrix::zeros(STATE, parameters); images],
            right: vec![StateVector::zeros(); images],
            corner: DMatrix::zeros(parameters, parameters),
            corner_right: DVector::zeros(parameters),
        }
    }

    /// Adds whitened residuals `r` of one image `first` or of two consecutive ones, with their
    /// derivatives by the state of each and by the parameters.
    pub fn add(
        &mut self,
        first: usize,
        by_states: &[&DMatrix<f64>],
        by_parameters: &DMatrix<f64>,
        r: &DVector<f64>,
    ) {
        for (k, by_state) in (first..).zip(by_states) {
            self.diagonal[k] += (by_state.transpose() * *by_state).fixed_view::<STATE, STATE>(0, 0);
            self.border[k] += by_state.transpose() * by_parameters;
            self.right[k] -= (by_state.transpose() * r).fixed_rows::<STATE>(0);
        }
        if let [by_first, by_second] = by_states {
            self.next[first] +=
                (by_first.transpose() * *by_second).fixed_view::<STATE, STATE>(0, 0);
        }
        self.add_parameters(by_parameters, r);
    }

    /// Adds whitened residuals of the parameters alone.
    pub fn add_parameters(&mut self, by_parameters: &DMatrix<f64>, r: &DVector<f64>) {
        self.corner += by_parameters.transpose() * by_parameters;
        self.corner_right -= by_parameters.transpose() * r;
    }

    /// Eliminates image by image, then the parameters. `damping` is Levenberg's, relative to the
    /// diagonal of the parameters' equations after the elimination. `None` where the matrix is not
    /// positive definite.
    pub fn solve(mut self, damping: f64) -> Option<Solution> {
        let n = self.diagonal.len();
        let factors = self.eliminate(damping * OF_STATES)?;
        let mut symmetric = 0.5 * (&self.corner + self.corner.transpose());
        for i in 0..symmetric.nrows() {
            symmetric[(i, i)] *= 1.0 + damping;
        }
        let corner = symmetric.cholesky()?;
        let parameters = corner.solve(&self.corner_right);
        let mut states = vec![StateVector::zeros(); n];
        for k in (0..n).rev() {
            let mut right = self.right[k] - &self.border[k] * &parameters;
            if k + 1 < n {
                right -= self.next[k] * states[k + 1];
            }
            states[k] = factors[k].solve(&right);
        }
        Some(Solution { states, parameters, covariance: corner.inverse() })
    }

    /// Eliminates all images and returns the normal equations of the parameters, which may be
    /// singular. `None` where an image's block is not positive definite.
    pub fn reduce(mut self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        self.eliminate(0.0)?;
        Some((0.5 * (&self.corner + self.corner.transpose()), self.corner_right))
    }

    fn eliminate(&mut self, damping: f64) -> Option<Vec<Factor>> {
        let n = self.diagonal.len();
        let mut factors = Vec::with_capacity(n);
        for k in 0..n {
            for i in 0..STATE {
                self.diagonal[k][(i, i)] *= 1.0 + damping;
            }
            let factor = Cholesky::new(self.diagonal[k])?;
            let border = factor.solve(&self.border[k]);
            let right = factor.solve(&self.right[k]);
            if k + 1 < n {
                let next = factor.solve(&self.next[k]);
                let back = self.next[k].transpose();
                self.diagonal[k + 1] -= back * next;
                let change = back * &border;
                self.border[k + 1] -= change;
                self.right[k + 1] -= back * right;
            }
            self.corner -= self.border[k].transpose() * &border;
            self.corner_right -= self.border[k].transpose() * right;
            factors.push(factor);
        }
        Some(factors)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_elimination_solves_the_full_system() {
        let (images, parameters) = (4, 3);
        let mut source = rig_simulator::random::Random::new(1);
        let mut random = || source.within(-0.5, 0.5);
        let total = images * STATE + parameters;
        let mut arrow = Arrow::new(images, parameters);
        let (mut dense, mut right) =
            (DMatrix::<f64>::zeros(total, total), DVector::<f64>::zeros(total));
        for k in 0..images {
            let by_parameters = DMatrix::from_fn(12, parameters, |_, _| random());
            let r = DVector::from_fn(12, |_, _| random());
            let a = DMatrix::from_fn(12, STATE, |_, _| random());
            let mut row = DMatrix::zeros(12, total);
            row.view_mut((0, k * STATE), (12, STATE)).copy_from(&a);
            row.view_mut((0, images * STATE), (12, parameters)).copy_from(&by_parameters);
            if k + 1 < images {
                let b = DMatrix::from_fn(12, STATE, |_, _| random());
                row.view_mut((0, (k + 1) * STATE), (12, STATE)).copy_from(&b);
                arrow.add(k, &[&a, &b], &by_parameters, &r);
            } else {
                arrow.add(k, &[&a], &by_parameters, &r);
            }
            dense += row.transpose() * &row;
            right -= row.transpose() * r;
        }
        let expected = dense.clone().cholesky().unwrap().solve(&right);
        let covariance = dense.cholesky().unwrap().inverse();
        let solution = arrow.solve(0.0).unwrap();
        for k in 0..images {
            assert!((solution.states[k] - expected.fixed_rows::<STATE>(k * STATE)).norm() < 1e-8);
        }
        assert!((solution.parameters - expected.rows(images * STATE, parameters)).norm() < 1e-8);
        let corner = covariance
            .view((images * STATE, images * STATE), (parameters, parameters))
            .into_owned();
        assert!((solution.covariance - corner).norm() < 1e-8);
    }
}
