//! Weighted least squares by normal equations, in the caller's memory.

use crate::lanes::LANES;
use crate::math;

/// Equations that are added together, so that the matrix is read and written once for all of them.
const BATCH: usize = 8;

/// Words of memory [`System`] needs for `n` unknowns.
pub(crate) const fn system_words(n: usize) -> usize {
    matrix_words(n) + BATCH * LANES * stride(n) + 3 * n
}

/// Groups of lanes of a row of `n` numbers, at least one.
const fn stride(n: usize) -> usize {
    let groups = n.div_ceil(LANES);
    if groups > 0 { groups } else { 1 }
}

/// A row's weight and what is on its right side.
type Equation = (f32, f32);

/// Normal equations `A δ = b`.
pub(crate) struct System<'s> {
    n: usize,
    /// Row-major, rows padded; only the upper triangle (`j ≥ i`) is kept up.
    a: &'s mut [[f32; LANES]],
    b: &'s mut [f32],
    /// Rows of a Jacobian waiting to be added, padded with zeros.
    batch: &'s mut [[f32; LANES]],
    waiting: heapless::Vec<Equation, BATCH>,
    /// Two rows in the making.
    pub(crate) rows: [&'s mut [f32]; 2],
    normal_equations: NormalEquations,
}

/// Type of [`add_normal_equations`].
pub type NormalEquations = fn(&[[f32; LANES]], &[Equation], &mut [[f32; LANES]], &mut [f32]);

/// Adds `Σ w·rᵀr` to a matrix and `Σ w·r·y` to a vector for rows `r` with `(w, y)`. The matrix is
/// row-major, a row per entry of the vector, and only its upper triangle is of consequence; rows
/// of `batch` and matrix are equally long, in whole groups of lanes.
#[inline(always)]
pub fn add_normal_equations(
    batch: &[[f32; LANES]],
    equations: &[Equation],
    matrix: &mut [[f32; LANES]],
    vector: &mut [f32],
) {
    let stride = stride(vector.len());
    for (i, (row, b)) in matrix.chunks_exact_mut(stride).zip(vector).enumerate() {
        let mut factors = [0.0; BATCH];
        for ((factor, r), (weight, y)) in
            factors.iter_mut().zip(batch.chunks_exact(stride)).zip(equations)
        {
            let Some(lanes) = r.get(i / LANES) else { continue };
            *factor = weight * lanes[i % LANES];
            *b += *factor * y;
        }
        for (j, a) in row.iter_mut().enumerate().skip(i / LANES) {
            let mut sum = *a;
            for (factor, r) in factors.iter().zip(batch.chunks_exact(stride)) {
                let Some(lanes) = r.get(j) else { continue };
                for l in 0..LANES {
                    sum[l] += factor * lanes[l];
                }
            }
            *a = sum;
        }
    }
}

impl<'s> System<'s> {
    /// An empty system of `n` unknowns; `None` if the memory is shorter than [`system_words`].
    pub(crate) fn new(
        n: usize,
        normal_equations: NormalEquations,
        memory: &'s mut [f32],
    ) -> Option<Self> {
        let memory = memory.get_mut(..system_words(n))?;
        memory.fill(0.0);
        let row = LANES * stride(n);
        let (a, rest) = memory.split_at_mut_checked(n * row)?;
        let (batch, rest) = rest.split_at_mut_checked(BATCH * row)?;
        let (b, rest) = rest.split_at_mut_checked(n)?;
        let (first, second) = rest.split_at_mut_checked(n)?;
        Some(Self {
            n,
            a: a.as_chunks_mut().0,
            b,
            batch: batch.as_chunks_mut().0,
            waiting: heapless::Vec::new(),
            rows: [first, second],
            normal_equations,
        })
    }

    /// Adds a quadratic penalty `½ w (x + δ_i)²` on one unknown.
    pub(crate) fn pull(&mut self, i: usize, weight: f32, x: f32) {
        let diagonal = i * LANES * stride(self.n) + i;
        let a = self.a.as_flattened_mut().get_mut(diagonal);
        if let (Some(a), Some(b)) = (a, self.b.get_mut(i)) {
            *a += weight;
            *b -= weight * x;
        }
    }

    /// Adds a weighted equation `row · δ = residual`; the row is `self.rows[which]`.
    pub(crate) fn add(&mut self, which: usize, weight: f32, residual: f32) {
        if let Some(row) = self.rows.get(which) {
            let place = self.batch.chunks_exact_mut(stride(self.n)).nth(self.waiting.len());
            put(place, row);
            self.weigh(weight, residual);
        }
    }

    /// Adds a weighted equation whose row is the caller's.
    pub(crate) fn add_row(&mut self, row: &[f32], weight: f32, residual: f32) {
        let place = self.batch.chunks_exact_mut(stride(self.n)).nth(self.waiting.len());
        put(place, row);
        self.weigh(weight, residual);
    }

    fn weigh(&mut self, weight: f32, residual: f32) {
        // There is room: the batch is emptied when full.
        let _ = self.waiting.push((weight, residual));
        if self.waiting.is_full() {
            self.flush();
        }
    }

    /// Adds the rows that wait.
    fn flush(&mut self) {
        for unused in self.batch.chunks_exact_mut(stride(self.n)).skip(self.waiting.len()) {
            unused.fill([0.0; LANES]);
        }
        (self.normal_equations)(self.batch, &self.waiting, self.a, self.b);
        self.waiting.clear();
    }

    /// Solves `A δ = b`, in place; `None` if the matrix is not positive definite.
    pub(crate) fn solve(&mut self) -> Option<&[f32]> {
        self.flush();
        cholesky(self.a, self.b)?;
        Some(self.b)
    }

    /// The right side `b`.
    #[cfg(test)]
    pub(crate) fn right_side(&mut self) -> &[f32] {
        self.flush();
        self.b
    }

    /// Adds to the right side.
    pub(crate) fn push(&mut self, gradient: &[f32]) {
        for (b, g) in self.b.iter_mut().zip(gradient) {
            *b += g;
        }
    }

    /// Solves `(A + λ diag A + D) δ = b` into `step` and leaves the equations as they are; `matrix`
    /// is scratch of [`matrix_words`]. `None` if the matrix is not positive definite.
    pub(crate) fn solve_damped(
        &mut self,
        lambda: f32,
        damping: impl Fn(usize) -> f32,
        matrix: &mut [f32],
        step: &mut [f32],
    ) -> Option<()> {
        self.flush();
        let matrix = matrix.as_chunks_mut().0;
        let matrix = matrix.get_mut(..self.a.len())?;
        for (to, from) in matrix.iter_mut().zip(&*self.a) {
            *to = *from;
        }
        let step = step.get_mut(..self.n)?;
        for (to, from) in step.iter_mut().zip(&*self.b) {
            *to = *from;
        }
        for (i, row) in matrix.chunks_exact_mut(stride(self.n)).enumerate() {
            let Some(x) = row.as_flattened_mut().get_mut(i) else { continue };
            *x += lambda * *x + damping(i);
        }
        cholesky(matrix, step)
    }
}

/// Copies a row to its place in the batch.
fn put(place: Option<&mut [[f32; LANES]]>, row: &[f32]) {
    let place = place.and_then(|place| place.as_flattened_mut().get_mut(..row.len()));
    if let Some(place) = place {
        place.copy_from_slice(row);
    }
}

/// Words of a matrix of `n` unknowns.
pub(crate) const fn matrix_words(n: usize) -> usize {
    n * LANES * stride(n)
}

/// Solves by Cholesky's method `A = UᵀU`, in place; `None` if the matrix is not positive definite.
///
/// Eliminates a row at a time: every inner loop but one adds a multiple of one row to another.
fn cholesky(matrix: &mut [[f32; LANES]], vector: &mut [f32]) -> Option<()> {
    let n = vector.len();
    let stride = stride(n);
    let subtract = |from: &mut [f32], factor: f32, row: &[f32]| {
        for (x, r) in from.iter_mut().zip(row) {
            *x -= factor * r;
        }
    };
    let (mut a, mut b) = (&mut *matrix, &mut *vector);
    for k in 0..n {
        // The rows from k on; of them only the columns from k to n are of consequence.
        let (row, below) = core::mem::take(&mut a).split_at_mut_checked(stride)?;
        let (y, rest) = core::mem::take(&mut b).split_first_mut()?;
        let (pivot, row) = row.as_flattened_mut().get_mut(k..n)?.split_first_mut()?;
        if !(*pivot > 0.0) {
            return None;
        }
        let inverse = 1.0 / math::sqrt(*pivot);
        *pivot *= inverse;
        for x in row.iter_mut() {
            *x *= inverse;
        }
        for (i, lower) in below.chunks_exact_mut(stride).enumerate() {
            let tail = row.get(i..).unwrap_or_default();
            let [factor, ..] = tail else { break };
            let lower = lower.as_flattened_mut().get_mut(k + 1 + i..).unwrap_or_default();
            subtract(lower, *factor, tail);
        }
        // Uᵀ y = b on the way.
        *y *= inverse;
        subtract(rest, *y, row);
        (a, b) = (below, rest);
    }
    for (i, row) in matrix.chunks_exact(stride).enumerate().rev() {
        let (pivot, row) = row.as_flattened().get(i..n)?.split_first()?;
        let (x, solved) = vector.get_mut(i..)?.split_first_mut()?;
        let dot: f32 = row.iter().zip(&*solved).map(|(u, x)| u * x).sum();
        *x = (*x - dot) / pivot;
    }
    vector.iter().all(|x| x.is_finite()).then_some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    const N: usize = 21;

    /// Solves noisy equations whose noiseless solution is `i − 3`.
    fn solve(equations: usize, memory: &mut [f32]) -> Option<[f32; N]> {
        let mut rng = Rng::new(5, 0);
        let mut system = System::new(N, add_normal_equations, memory)?;
        for _ in 0..equations {
            let mut right = 0.0;
            for (i, x) in system.rows[1].iter_mut().enumerate() {
                *x = rng.normal_sd(1.0);
                right += *x * (i as f32 - 3.0);
            }
            system.add(1, 0.5 + rng.uniform() as f32, right);
        }
        system.solve()?.try_into().ok()
    }

    #[test]
    fn consistent_equations_are_solved_exactly() {
        let mut memory = [f32::NAN; system_words(N)];
        let solution = solve(4 * N, &mut memory).unwrap();
        for (i, x) in solution.iter().enumerate() {
            assert!((x - (i as f32 - 3.0)).abs() < 1e-4, "{i}: {x}");
        }
    }

    #[test]
    fn too_few_equations_or_words_are_refused() {
        let mut memory = [0.0; system_words(N)];
        assert_eq!(solve(0, &mut memory), None);
        assert!(System::new(N, add_normal_equations, &mut memory[1..]).is_none());
    }

    #[test]
    fn a_pull_alone_leads_home() {
        let mut memory = [0.0; system_words(2)];
        let mut system = System::new(2, add_normal_equations, &mut memory).unwrap();
        system.pull(0, 4.0, 0.5);
        system.pull(1, 1.0, -2.0);
        assert_eq!(system.solve(), Some(&[-0.5, 2.0][..]));
    }
}
