//! Weighted least squares by normal equations, in the caller's memory.

use crate::lanes::LANES;
use crate::math;

/// Equations come in batches, and rows of `U` in panels, of multiples of these, so that tiles
/// are whole.
const PANEL: usize = 8;
/// The most equations that are added together. Chosen, not measured.
const MAX_BATCH: usize = 64;

/// Equations that are added together, so that the matrix is read and written once for all of them:
/// an eighth of the unknowns, that the batch is small beside the matrix, in eights.
const fn batch(n: usize) -> usize {
    match n / 8 / PANEL * PANEL {
        0 => PANEL,
        rows @ 1..MAX_BATCH => rows,
        _ => MAX_BATCH,
    }
}

/// Words of memory [`System`] needs for `n` unknowns.
pub(crate) const fn system_words(n: usize) -> usize {
    matrix_words(n) + batch(n) * LANES * stride(n) + 2 * n
}

/// Groups of lanes of a row of `n` numbers, at least one.
pub(crate) const fn stride(n: usize) -> usize {
    let groups = n.div_ceil(LANES);
    if groups > 0 { groups } else { 1 }
}

/// Words of a row of `n` numbers.
pub(crate) const fn row_words(n: usize) -> usize {
    LANES * stride(n)
}

/// Numbers of a row side by side.
pub type Group = [f32; LANES];

/// A row's weight and what is on its right side.
pub type Equation = (f32, f32);

/// Normal equations `A δ = b`.
pub(crate) struct System<'s> {
    n: usize,
    /// Row-major, rows padded; only the upper triangle (`j ≥ i`) is kept up.
    a: &'s mut [Group],
    b: &'s mut [f32],
    /// Rows of a Jacobian waiting to be added, `[group of lanes][row]`, padded with zeros.
    batch: &'s mut [Group],
    waiting: heapless::Vec<Equation, MAX_BATCH>,
    /// The row in the making.
    row: &'s mut [f32],
    normal_equations: NormalEquations,
}

/// How normal equations are made and solved. Matrices are row-major, a row per entry of the vector
/// and in whole groups of lanes; only the upper triangle is of consequence.
#[derive(Clone, Copy)]
pub struct NormalEquations {
    /// [`add_normal_equations`].
    pub add: Add,
    /// [`cholesky`].
    pub solve: Solve,
}

/// Type of [`add_normal_equations`]: batch, its equations, matrix and vector.
pub type Add = fn(&[Group], &[Equation], &mut [Group], &mut [f32]);

/// Type of [`cholesky`]: matrix, vector and scratch.
pub type Solve = fn(&mut [Group], &mut [f32], &mut [Group]) -> Option<()>;

/// `[row][group of lanes]` of a matrix, some rows of it: adds `Σ_k factors[k][i]·lanes_k` to a group
/// of lanes of row `i`, in the order of `k`. The sums stay in registers.
#[inline(always)]
fn add_tile<const ROWS: usize>(
    rows: &mut [Group],
    stride: usize,
    group: usize,
    factors: &[[f32; ROWS]],
    lanes: &[Group],
) {
    let mut sums = [[0.0; LANES]; ROWS];
    for (i, sum) in sums.iter_mut().enumerate() {
        if let Some(row) = rows.get(i * stride + group) {
            *sum = *row;
        }
    }
    for (factor, lanes) in factors.iter().zip(lanes) {
        // In this order it becomes vectors at any level of optimisation.
        for l in 0..LANES {
            for r in 0..ROWS {
                sums[r][l] += factor[r] * lanes[l];
            }
        }
    }
    for (i, sum) in sums.iter().enumerate() {
        if let Some(row) = rows.get_mut(i * stride + group) {
            *row = *sum;
        }
    }
}

/// Adds `Σ w·rᵀr` of a batch to rows of a matrix, the first of which is row `first` (a multiple of
/// `ROWS`).
#[inline(always)]
fn add_products<const ROWS: usize>(
    batch: &[Group],
    equations: &[Equation],
    first: usize,
    matrix: &mut [Group],
    stride: usize,
) {
    let room = (batch.len() / stride).max(1);
    let mut factors = [[0.0; ROWS]; MAX_BATCH];
    let factors = factors.get_mut(..equations.len()).unwrap_or_default();
    for (tile, rows) in matrix.chunks_mut(ROWS * stride).enumerate() {
        let i = first + tile * ROWS;
        let panels = batch.get(i / LANES * room..).unwrap_or_default();
        for ((factors, lanes), (weight, _)) in factors.iter_mut().zip(panels).zip(equations) {
            for (r, factor) in factors.iter_mut().enumerate() {
                *factor = weight * lanes[(i + r) % LANES];
            }
        }
        for (group, panel) in panels.chunks_exact(room).enumerate() {
            add_tile(rows, stride, i / LANES + group, factors, panel);
        }
    }
}

/// Adds `Σ w·rᵀr` to a matrix and `Σ w·r·y` to a vector for rows `r` with `(w, y)`, at most 64. Rows
/// are in groups of lanes, `batch[group][row]`, with room for as many rows in every group; there is
/// nothing but zeros beyond a row's end.
///
/// `ROWS`, a divisor of 8, is how many of the matrix's rows are kept in registers. It does not change the
/// bits: every entry is one sum in the order of the equations.
#[inline(always)]
pub fn add_normal_equations<const ROWS: usize>(
    batch: &[Group],
    equations: &[Equation],
    matrix: &mut [Group],
    vector: &mut [f32],
) {
    let stride = stride(vector.len());
    let room = (batch.len() / stride).max(1);
    for (b, panel) in vector.chunks_mut(LANES).zip(batch.chunks_exact(room)) {
        let mut sums = [0.0; LANES];
        for (sum, b) in sums.iter_mut().zip(&*b) {
            *sum = *b;
        }
        for (lanes, (weight, y)) in panel.iter().zip(equations) {
            for l in 0..LANES {
                sums[l] += weight * lanes[l] * y;
            }
        }
        for (b, sum) in b.iter_mut().zip(sums) {
            *b = sum;
        }
    }
    add_products::<ROWS>(batch, equations, 0, matrix, stride);
}

/// What equations are added to: `½ w (row · δ − residual)²` each.
pub(crate) trait Equations {
    /// Adds a quadratic penalty `½ w (x + δ_i)²` on one unknown.
    fn pull(&mut self, i: usize, weight: f32, x: f32);

    /// A row to fill, as long as there are unknowns.
    fn row(&mut self) -> &mut [f32];

    /// Adds the equation of that row.
    fn add(&mut self, weight: f32, residual: f32);
}

impl Equations for System<'_> {
    fn pull(&mut self, i: usize, weight: f32, x: f32) {
        let diagonal = i * LANES * stride(self.n) + i;
        let a = self.a.as_flattened_mut().get_mut(diagonal);
        if let (Some(a), Some(b)) = (a, self.b.get_mut(i)) {
            *a += weight;
            *b -= weight * x;
        }
    }

    fn row(&mut self) -> &mut [f32] {
        self.row
    }

    fn add(&mut self, weight: f32, residual: f32) {
        put(self.batch, batch(self.n), self.waiting.len(), self.row);
        self.weigh(weight, residual);
    }
}

/// The right side alone: minus the gradient of what the equations cost, at `δ = 0`.
pub(crate) struct Slope<'s> {
    /// The row to fill.
    pub(crate) row: &'s mut [f32],
    /// What is added to.
    pub(crate) gradient: &'s mut [f32],
}

impl Equations for Slope<'_> {
    fn pull(&mut self, i: usize, weight: f32, x: f32) {
        if let Some(g) = self.gradient.get_mut(i) {
            *g -= weight * x;
        }
    }

    fn row(&mut self) -> &mut [f32] {
        self.row
    }

    fn add(&mut self, weight: f32, residual: f32) {
        for (g, r) in self.gradient.iter_mut().zip(&*self.row) {
            *g += weight * residual * r;
        }
    }
}

/// Equations in other coordinates, to which the function takes a row.
pub(crate) struct Pulled<'s, 'm, F>(pub(crate) &'s mut System<'m>, pub(crate) F);

impl<F: Fn(&mut [f32])> Equations for Pulled<'_, '_, F> {
    fn pull(&mut self, i: usize, weight: f32, x: f32) {
        let row = self.row();
        row.fill(0.0);
        if let Some(one) = row.get_mut(i) {
            *one = 1.0;
        }
        self.add(weight, -x);
    }

    fn row(&mut self) -> &mut [f32] {
        self.0.row()
    }

    fn add(&mut self, weight: f32, residual: f32) {
        (self.1)(self.0.row());
        self.0.add(weight, residual);
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
        let (batch, rest) = rest.split_at_mut_checked(batch(n) * row)?;
        let (b, rest) = rest.split_at_mut_checked(n)?;
        let row = rest.get_mut(..n)?;
        Some(Self {
            n,
            a: a.as_chunks_mut().0,
            b,
            batch: batch.as_chunks_mut().0,
            waiting: heapless::Vec::new(),
            row,
            normal_equations,
        })
    }

    /// Adds a weighted equation whose row is the caller's.
    pub(crate) fn add_row(&mut self, row: &[f32], weight: f32, residual: f32) {
        put(self.batch, batch(self.n), self.waiting.len(), row);
        self.weigh(weight, residual);
    }

    fn weigh(&mut self, weight: f32, residual: f32) {
        // There is room: the batch is emptied when full.
        let _ = self.waiting.push((weight, residual));
        if self.waiting.len() >= batch(self.n) {
            self.flush();
        }
    }

    /// Adds the rows that wait.
    fn flush(&mut self) {
        (self.normal_equations.add)(self.batch, &self.waiting, self.a, self.b);
        self.waiting.clear();
    }

    /// Solves `A δ = b`; `None` if the matrix is not positive definite.
    #[cfg(test)]
    pub(crate) fn solve(&mut self) -> Option<std::vec::Vec<f32>> {
        let mut matrix = std::vec![0.0; matrix_words(self.n)];
        let mut step = std::vec![0.0; self.n];
        self.solve_damped(0.0, |_| 0.0, &mut matrix, &mut step)?;
        Some(step)
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

    /// What a step `δ` that [`System::solve_damped`] found gains by these equations, at least: `½ bᵀδ`.
    pub(crate) fn gain(&self, step: &[f32]) -> f64 {
        0.5 * step.iter().zip(&*self.b).map(|(x, b)| f64::from(*x) * f64::from(*b)).sum::<f64>()
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
        (self.normal_equations.solve)(matrix, step, self.batch)
    }
}

/// Copies a row to its place in a batch with room for so many.
fn put(batch: &mut [Group], room: usize, place: usize, row: &[f32]) {
    let (whole, rest) = row.as_chunks();
    let mut places = batch.chunks_exact_mut(room).filter_map(|panel| panel.get_mut(place));
    // In this order: a pair that is not made takes no place.
    for (lanes, to) in whole.iter().zip(&mut places) {
        *to = *lanes;
    }
    if let Some(to) = places.next() {
        for (to, x) in to.iter_mut().zip(rest) {
            *to = *x;
        }
    }
}

/// Words of a matrix of `n` unknowns.
pub(crate) const fn matrix_words(n: usize) -> usize {
    n * LANES * stride(n)
}

/// Solves by Cholesky's method `A = UᵀU`, in place; `None` if the matrix is not positive definite.
///
/// Some rows are done at a time: once they are rows of `U`, their products are subtracted from all rows
/// below. How many depends on the scratch memory, which should have room for 8 to 16. It does not change
/// the bits: from every entry the products are subtracted in the order of `U`'s rows. `ROWS`, a divisor of
/// 8, is that of [`add_normal_equations`].
#[inline(always)]
pub fn cholesky<const ROWS: usize>(
    matrix: &mut [Group],
    vector: &mut [f32],
    scratch: &mut [Group],
) -> Option<()> {
    let n = vector.len();
    let stride = stride(n);
    // Whole tiles, so that those below begin where a tile begins.
    let room = (scratch.len() / stride).min(LANES) / PANEL * PANEL;
    if room == 0 {
        return None;
    }
    let batch = scratch.get_mut(..room * stride)?;
    let (mut a, mut b) = (&mut *matrix, &mut *vector);
    let mut first = 0;
    while !b.is_empty() {
        let count = b.len().min(room);
        let (panel, below) = core::mem::take(&mut a).split_at_mut_checked(count * stride)?;
        b = eliminate(panel, core::mem::take(&mut b), first, n)?;
        first += count;
        for (k, row) in panel.chunks_exact(stride).enumerate() {
            for (to, lanes) in batch.chunks_exact_mut(room).zip(row) {
                if let Some(to) = to.get_mut(k) {
                    *to = *lanes;
                }
            }
        }
        let subtract = [(-1.0, 0.0); LANES];
        add_products::<ROWS>(batch, subtract.get(..count)?, first, below, stride);
        a = below;
    }
    for (i, row) in matrix.chunks_exact(stride).enumerate().rev() {
        let (pivot, row) = row.as_flattened().get(i..n)?.split_first()?;
        let (x, solved) = vector.get_mut(i..)?.split_first_mut()?;
        let dot: f32 = row.iter().zip(&*solved).map(|(u, x)| u * x).sum();
        *x = (*x - dot) / pivot;
    }
    vector.iter().all(|x| x.is_finite()).then_some(())
}

/// Makes rows of a matrix rows of `U`, of which everything above has been subtracted. The first of
/// them is row `first` of `n`, and `b` begins with its entry of the right side; gives the entries
/// after those of these rows.
#[inline(always)]
fn eliminate<'b>(
    mut panel: &mut [Group],
    mut b: &'b mut [f32],
    first: usize,
    n: usize,
) -> Option<&'b mut [f32]> {
    let stride = stride(n);
    let subtract = |from: &mut [f32], factor: f32, row: &[f32]| {
        for (x, r) in from.iter_mut().zip(row) {
            *x -= factor * r;
        }
    };
    let mut k = first;
    while !panel.is_empty() {
        // Only the columns from k to n are of consequence.
        let (row, below) = panel.split_at_mut_checked(stride)?;
        let (y, rest) = b.split_first_mut()?;
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
        (panel, b, k) = (below, rest, k + 1);
    }
    Some(b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Engine;
    use crate::naive;
    use crate::rng::Rng;
    use std::vec;
    use std::vec::Vec;

    const N: usize = 21;

    /// Solves noisy equations whose noiseless solution is `i − 3`.
    fn solve(equations: usize, memory: &mut [f32]) -> Option<[f32; N]> {
        let mut rng = Rng::new(5, 0);
        let mut system = System::new(N, Engine::PORTABLE.normal_equations, memory)?;
        for _ in 0..equations {
            let mut right = 0.0;
            for (i, x) in system.row().iter_mut().enumerate() {
                *x = rng.normal_sd(1.0);
                right += *x * (i as f32 - 3.0);
            }
            system.add(0.5 + rng.uniform() as f32, right);
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
        assert!(System::new(N, Engine::PORTABLE.normal_equations, &mut memory[1..]).is_none());
    }

    #[test]
    fn a_pull_alone_leads_home() {
        let mut memory = [0.0; system_words(2)];
        let mut system = System::new(2, Engine::PORTABLE.normal_equations, &mut memory).unwrap();
        system.pull(0, 4.0, 0.5);
        system.pull(1, 1.0, -2.0);
        assert_eq!(system.solve(), Some(vec![-0.5, 2.0]));
    }

    /// Solves random equations, and by the twins; gives the bits of both solutions.
    fn solve_both(n: usize, normal_equations: NormalEquations) -> [Vec<u32>; 2] {
        let mut rng = Rng::new(n as u64, 0);
        let count = n + 70;
        let mut numbers = |count| -> Vec<f32> { (0..count).map(|_| rng.normal_sd(1.0)).collect() };
        let rows = numbers(n * count);
        let equations: Vec<Equation> = numbers(count).into_iter().map(|y| (1.5 - y, y)).collect();
        let mut memory = vec![f32::NAN; system_words(n)];
        let mut system = System::new(n, normal_equations, &mut memory).unwrap();
        let (mut a, mut b) = (vec![0.0; n * n], vec![0.0; n]);
        for i in 0..n {
            system.pull(i, 9.0, 0.0);
            a[n * i + i] = 9.0;
        }
        for (row, &(weight, y)) in rows.chunks(n).zip(&equations) {
            system.add_row(row, weight.abs(), y);
        }
        let equations: Vec<Equation> = equations.iter().map(|(w, y)| (w.abs(), *y)).collect();
        naive::normal_equations(&rows, &equations, &mut a, &mut b);
        naive::cholesky(&mut a, &mut b).unwrap();
        [system.solve().unwrap(), b].map(|x| x.iter().map(|x| x.to_bits()).collect())
    }

    #[test]
    fn the_bits_are_the_twins_whatever_there_are_registers_for() {
        let two = Engine::PORTABLE.normal_equations;
        let four = NormalEquations { add: add_normal_equations::<4>, solve: cholesky::<4> };
        for n in [1, 2, 7, 8, 15, 16, 17, 21, 57, 64, 77, 130, 200] {
            for normal_equations in [two, four] {
                let [fast, slow] = solve_both(n, normal_equations);
                assert!(fast == slow, "{n}");
            }
        }
    }
}
