//! How far vertices are known: Laplace's approximation about the mode.
//!
//! With `A = UᵀU` the matrix of the equations at the mode, unknowns have the covariance `A⁻¹`, and a
//! vertex's place, which moves by `J δ`, has `J A⁻¹ Jᵀ`, whose trace is `‖U⁻ᵀ Jᵀ‖²`.

use super::evidence::Look;
use super::options::LEVELS;
use super::place::{PLACE, Place};
use super::state::Registration;
use crate::lanes::LANES;
use crate::least_squares::stride;
use crate::math;

impl Registration<'_, '_> {
    /// Fills `deviations`, one per vertex of the model, with standard deviations of its place in mm (root
    /// of the covariance's trace). Where the scan says nothing, it is what the prior leaves, given all other places.
    pub fn deviations(&mut self, deviations: &mut [f32]) {
        let memory = core::mem::take(&mut self.passing);
        let _ = self.deviations_in(deviations, memory);
        self.passing = memory;
    }

    fn deviations_in(&mut self, deviations: &mut [f32], memory: &mut [u32]) -> Option<()> {
        let k = self.shape.len();
        let n = k + PLACE;
        let trust = LEVELS[LEVELS.len() - 1].trust;
        let colors = self.problem.options.albedo;
        let look = Look { components: k, size: true, trust, stride: 1, colors };
        let (mut system, matrix) = self.system(n, memory)?;
        self.add_all(&look, k, &mut system);
        system.solve_damped(0.0, |_| 0.0, matrix, self.step.get_mut(..n)?)?;
        for (v, deviation) in (0..self.problem.model.vertices() as u32).zip(deviations) {
            self.fill_rows(v, k, Place::HOME.rotation);
            let mut sum = 0.0;
            for row in &mut self.rows {
                sum += solved(matrix, row.get_mut(..n)?)?;
            }
            *deviation = math::sqrt(sum);
        }
        Some(())
    }
}

/// Square of the length of `y` in `Uᵀ y = row`, which takes the row's place; `U` is row-major, rows in
/// whole groups of lanes.
fn solved(matrix: &[f32], row: &mut [f32]) -> Option<f32> {
    let n = row.len();
    let mut sum = 0.0;
    for (i, u) in matrix.chunks_exact(LANES * stride(n)).enumerate().take(n) {
        let (pivot, u) = u.get(i..n)?.split_first()?;
        let (x, rest) = row.get_mut(i..)?.split_first_mut()?;
        let y = *x / pivot;
        sum += y * y;
        for (r, u) in rest.iter_mut().zip(u) {
            *r -= y * u;
        }
    }
    Some(sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;

    #[test]
    fn variances_are_those_of_the_inverse() {
        // UᵀU = [[4, 2], [2, 5]], whose inverse is [[5, −2], [−2, 4]] / 16.
        let mut matrix = vec![0.0; 2 * LANES];
        (matrix[0], matrix[1], matrix[LANES + 1]) = (2.0, 1.0, 2.0);
        for (row, expected) in [([1.0, 0.0], 5.0), ([0.0, 1.0], 4.0), ([1.0, 1.0], 5.0)] {
            let found = solved(&matrix, &mut row.clone()).unwrap();
            assert!((found - expected / 16.0).abs() < 1e-6, "{row:?}: {found}");
        }
    }
}
