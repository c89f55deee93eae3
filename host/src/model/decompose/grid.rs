//! A Gaussian by way of a regular grid.
//!
//! `g(x − y) ≈ Σ_mn w(x − m) G(m − n) w(n − y)` over the nodes `m`, `n` of a grid, with a window
//! `w` that vanishes a few nodes away. So a product spreads values to the nodes about each point,
//! filters the grid, and gathers; all three are products over the axes. With `ŵ` the window's
//! transform, `G` has the transform `ĝ / ŵ²` (as in non-uniform Fourier transforms: Dutt & Rokhlin
//! 1993; the window is Kaiser's). Points that are mirrored spread what is mirrored on the grid.
//! Thousands of points spread to one node, so these sums are in double precision.

// Without it `pulp`'s dispatch compiles for the base instruction set.
#![allow(clippy::inline_always)]

use super::columns::{ABREAST, Row, Sum, aligned};
use faer::{Accum, Mat, MatMut, MatRef, Par, linalg::matmul::matmul};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Nodes a point's value is spread to, per axis: a vector register full.
const WIDTH: usize = 8;
/// Nodes per σ of the narrowest Gaussian; with the width above it makes the error of the next.
const DENSITY: f64 = 3.5;
/// Kaiser's parameter, for the least error at this width and density: 5e-8 per axis.
const BETA: f64 = 19.2;
/// Steps of the integral for `G`. Chosen, not measured.
const STEPS: usize = 4000;

/// The grid of some Gaussians over some points.
pub(super) struct Grid {
    negates: [bool; 3],
    /// Nodes per axis, x varying fastest.
    nodes: [usize; 3],
    /// `G` per axis, of each Gaussian.
    filters: Vec<[Mat<f32>; 3]>,
    /// Per point, the first node it is spread to.
    first: Vec<usize>,
    /// Per point and axis, the window's values; rounding them would be most of the error.
    windows: Vec<[[f64; WIDTH]; 3]>,
}

/// Memory for one product at a time: four fields, and one of sums.
#[derive(Default)]
pub(super) struct Workspace([Vec<f32>; 4], Vec<HalfRow>);

/// What is spread to a node, of half of the columns: as much as fits the nearest cache.
type HalfRow = [f64; ABREAST / 2];

/// Where the nodes of an axis lie: node `k` at `centre + (k − (count − 1)/2) spacing`.
struct Axis {
    centre: f64,
    spacing: f64,
    count: usize,
}

impl Axis {
    /// The points of one coordinate with room for the window; symmetric about zero if mirrored.
    fn new(points: &[f64], mirrored: bool, rate: f64) -> Self {
        let [low, high] = points
            .iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], x| [l.min(*x), h.max(*x)]);
        let centre = if mirrored { 0.0 } else { 0.5 * (low + high) };
        let spacing = 1.0 / (DENSITY * rate.sqrt());
        let half = (high - centre).max(centre - low) / spacing;
        Self { centre, spacing, count: 2 * (half.ceil() as usize + WIDTH / 2) + 1 }
    }

    /// A coordinate in units of nodes.
    fn place(&self, x: f64) -> f64 {
        (x - self.centre) / self.spacing + 0.5 * (self.count - 1) as f64
    }
}

fn axes(points: &[Vec<f64>; 3], negates: [bool; 3], rate: f64) -> [Axis; 3] {
    std::array::from_fn(|k| Axis::new(&points[k], negates[k], rate))
}

/// Multiplications of one product, of spreading and gathering and of filtering.
pub(super) fn work(points: &[Vec<f64>; 3], negates: [bool; 3], rate: f64) -> [f64; 2] {
    let counts = axes(points, negates, rate).map(|axis| axis.count as f64);
    let spread = 2.0 * points[0].len() as f64 * (WIDTH as f64).powi(3);
    [spread, counts.iter().product::<f64>() * counts.iter().sum::<f64>()]
}

impl Grid {
    /// The grid for Gaussians over points, the narrowest, of the largest `rate = 1/σ²`, first.
    pub(super) fn new(points: &[Vec<f64>; 3], negates: [bool; 3], rates: &[f64]) -> Self {
        let axes = axes(points, negates, rates[0]);
        let nodes = [0, 1, 2].map(|k| axes[k].count);
        let filter = |rate: &f64| {
            let density = DENSITY * (rates[0] / rate).sqrt();
            let kernel = kernel(nodes.iter().copied().max().unwrap_or(0), density);
            nodes.map(|n| Mat::from_fn(n, n, |i, j| kernel[i.abs_diff(j)] as f32))
        };
        let filters = rates.iter().map(filter).collect();
        let spread = |i: usize| -> (usize, [[f64; WIDTH]; 3]) {
            let places = [0, 1, 2].map(|k| axes[k].place(points[k][i]));
            let [x, y, z] = places.map(|t| (t - 0.5 * WIDTH as f64).ceil() as usize);
            let windows = [(0, x), (1, y), (2, z)].map(|(axis, first)| {
                std::array::from_fn(|k| window(places[axis] - (first + k) as f64))
            });
            ((z * nodes[1] + y) * nodes[0] + x, windows)
        };
        let (first, windows) = (0..points[0].len()).into_par_iter().map(spread).unzip();
        Self { negates, nodes, filters, first, windows }
    }

    /// Adds `Σ (w G + w' G Φ) x`, for each Gaussian's weights `[w, w']`.
    pub(super) fn apply(
        &self,
        x: &[Row],
        weights: &[[f64; 2]],
        sums: &mut [Sum],
        Workspace(memory, halves): &mut Workspace,
    ) {
        let count = self.nodes.iter().product();
        let [field, total, first, second] = memory.each_mut().map(|memory| aligned(memory, count));
        for half in [0, ABREAST / 2] {
            halves.clear();
            halves.resize(count, [0.0; ABREAST / 2]);
            pulp::Arch::new().dispatch(Spread { grid: self, values: x, half, sums: halves });
            for (node, sums) in field.iter_mut().zip(&*halves) {
                node[half..].iter_mut().zip(sums).for_each(|(node, sum)| *node = *sum as f32);
            }
        }
        total.fill([0.0; ABREAST]);
        for (filters, weights) in self.filters.iter().zip(weights) {
            if *weights != [0.0; 2] {
                self.along(&filters[0], 0, field, first);
                self.along(&filters[1], 1, first, second);
                self.along(&filters[2], 2, second, first);
                self.add(first, *weights, total);
            }
        }
        pulp::Arch::new().dispatch(Gather { grid: self, field: total, sums });
    }

    /// Applies a filter along an axis of a field.
    fn along(&self, filter: &Mat<f32>, axis: usize, from: &[Row], to: &mut [Row]) {
        let (below, count) = (self.nodes[..axis].iter().product::<usize>(), self.nodes[axis]);
        let blocks = to.chunks_exact_mut(below * count).zip(from.chunks_exact(below * count));
        for (to, from) in blocks {
            let (to, from) = (to.as_flattened_mut(), from.as_flattened());
            let from = MatRef::from_column_major_slice(from, ABREAST * below, count);
            let to = MatMut::from_column_major_slice_mut(to, ABREAST * below, count);
            matmul(to, Accum::Replace, from, filter, 1.0, Par::Seq);
        }
    }

    /// Adds `w F + w' Φ F` of a field.
    fn add(&self, field: &[Row], [plain, mirrored]: [f64; 2], total: &mut [Row]) {
        let [nx, ny, nz] = self.nodes;
        let [plain, mirrored] = [plain as f32, mirrored as f32];
        let image = |k: usize, axis: usize| {
            if self.negates[axis] { self.nodes[axis] - 1 - k } else { k }
        };
        for z in 0..nz {
            for y in 0..ny {
                let row = (z * ny + y) * nx;
                let other = &field[(image(z, 2) * ny + image(y, 1)) * nx..][..nx];
                for x in 0..nx {
                    let (f, o) = (&field[row + x], &other[image(x, 0)]);
                    for (lane, sum) in total[row + x].iter_mut().enumerate() {
                        *sum += plain * f[lane] + mirrored * o[lane];
                    }
                }
            }
        }
    }
}

/// Adds the points' values to the nodes about them.
struct Spread<'a> {
    grid: &'a Grid,
    values: &'a [Row],
    /// The first column.
    half: usize,
    sums: &'a mut [HalfRow],
}

impl pulp::WithSimd for Spread<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let [nx, ny, _] = self.grid.nodes;
        for ((values, first), [wx, wy, wz]) in
            self.values.iter().zip(&self.grid.first).zip(&self.grid.windows)
        {
            let values: HalfRow = std::array::from_fn(|lane| f64::from(values[self.half + lane]));
            for (part, values) in S::as_simd_f64s(&values).0.iter().enumerate() {
                for (z, wz) in wz.iter().enumerate() {
                    for (y, wy) in wy.iter().enumerate() {
                        let w = simd.splat_f64s(wz * wy);
                        let values = simd.mul_f64s(w, *values);
                        let row = &mut self.sums[first + (z * ny + y) * nx..][..WIDTH];
                        for (node, &w) in row.iter_mut().zip(wx) {
                            let node = &mut S::as_mut_simd_f64s(node).0[part];
                            *node = simd.mul_add_e_f64s(simd.splat_f64s(w), values, *node);
                        }
                    }
                }
            }
        }
    }
}

/// Adds to the points' sums what the nodes about them have.
struct Gather<'a> {
    grid: &'a Grid,
    field: &'a [Row],
    sums: &'a mut [Sum],
}

impl pulp::WithSimd for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let [nx, ny, _] = self.grid.nodes;
        for ((sums, first), [wx, wy, wz]) in
            self.sums.iter_mut().zip(&self.grid.first).zip(&self.grid.windows)
        {
            for part in 0..ABREAST / S::F32_LANES {
                // Sums over y, then z, then x: short ones, whose rounding is small.
                let mut line = [simd.splat_f32s(0.0); WIDTH];
                for (z, wz) in wz.iter().enumerate() {
                    let mut inner = [simd.splat_f32s(0.0); WIDTH];
                    for (y, wy) in wy.iter().enumerate() {
                        let w = simd.splat_f32s(*wy as f32);
                        let row = &self.field[first + (z * ny + y) * nx..][..WIDTH];
                        for (sum, node) in inner.iter_mut().zip(row) {
                            *sum = simd.mul_add_e_f32s(w, S::as_simd_f32s(node).0[part], *sum);
                        }
                    }
                    let w = simd.splat_f32s(*wz as f32);
                    for (sum, inner) in line.iter_mut().zip(inner) {
                        *sum = simd.mul_add_e_f32s(w, inner, *sum);
                    }
                }
                let sums = &mut sums[part * S::F32_LANES..];
                for (line, w) in line.iter().zip(wx) {
                    let line: &[f32] = pulp::bytemuck::cast_slice(std::slice::from_ref(line));
                    sums.iter_mut().zip(line).for_each(|(sum, x)| *sum += w * f64::from(*x));
                }
            }
        }
    }
}

/// Kaiser's window at a distance in nodes, `I₀(β √(1 − (2d/width)²)) / I₀(β)`.
fn window(distance: f64) -> f64 {
    let inside = 1.0 - (2.0 * distance / WIDTH as f64).powi(2);
    if inside < 0.0 { 0.0 } else { bessel(BETA * inside.sqrt()) / bessel(BETA) }
}

/// The modified Bessel function `I₀`, by its series.
fn bessel(x: f64) -> f64 {
    let quarter = 0.25 * x * x;
    let (mut term, mut sum, mut k) = (1.0, 1.0, 1.0);
    while term > 1e-17 * sum {
        term *= quarter / (k * k);
        sum += term;
        k += 1.0;
    }
    sum
}

/// `G` at the distances 0 to `count − 1` nodes: `1/π ∫ ĝ(ω) / ŵ(ω)² cos(kω) dω` over `[0, π]`.
/// `density` is σ in nodes.
fn kernel(count: usize, density: f64) -> Vec<f64> {
    let transform = |omega: f64| {
        let g = density * PI.sqrt() * (-(0.5 * density * omega).powi(2)).exp();
        let root = (BETA * BETA - (0.5 * WIDTH as f64 * omega).powi(2)).sqrt();
        let w = WIDTH as f64 * root.sinh() / (root * bessel(BETA));
        g / (w * w)
    };
    let step = PI / STEPS as f64;
    let values: Vec<f64> = (0..=STEPS)
        .map(|s| {
            let end = if s == 0 || s == STEPS { 0.5 } else { 1.0 };
            end * transform(s as f64 * step) / STEPS as f64
        })
        .collect();
    let at = |k: usize| {
        let term = |(s, v): (usize, &f64)| v * ((k * s) as f64 * step).cos();
        values.iter().enumerate().map(term).sum()
    };
    (0..count).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_is_its_gaussians() {
        let n = 2000;
        let scatter = |k: usize| (0..n).map(move |i| (i * k % 997) as f64 / 10.0 - 20.0);
        let points = [3, 5, 8].map(|k| scatter(k).collect::<Vec<f64>>());
        let row = |i: usize| std::array::from_fn(|lane| ((i * 7 + lane * 5) % 13) as f32 - 6.0);
        let x: Vec<Row> = (0..n).map(row).collect();
        let sigmas = [6.0, 90.0, 3000.0];
        let weights = [[0.5, -0.25], [0.0, 0.7], [-0.3, 0.0]];
        for negates in [[true, false, false], [false, true, true]] {
            let grid = Grid::new(&points, negates, &sigmas.map(|sigma: f64| sigma.powi(-2)));
            let mut found = vec![[0.0; ABREAST]; n];
            grid.apply(&x, &weights, &mut found, &mut Workspace::default());
            let squared = |i: usize, j: usize, mirrored: bool| -> f64 {
                let turn = |k: usize| if mirrored && negates[k] { -1.0 } else { 1.0 };
                (0..3).map(|k| (points[k][i] - turn(k) * points[k][j]).powi(2)).sum()
            };
            for i in (0..n).step_by(97) {
                for lane in [0, ABREAST - 1] {
                    let value = |j: usize| -> f64 {
                        let sides = [squared(i, j, false), squared(i, j, true)];
                        let gaussian = |(sigma, weights): (&f64, &[f64; 2])| -> f64 {
                            let side = |(w, d): (&f64, f64)| w * (-d / (sigma * sigma)).exp();
                            weights.iter().zip(sides).map(side).sum()
                        };
                        sigmas.iter().zip(&weights).map(gaussian).sum()
                    };
                    let expected: f64 = (0..n).map(|j| value(j) * f64::from(x[j][lane])).sum();
                    let mass: f64 = (0..n).map(|j| f64::from(x[j][lane].abs())).sum();
                    let error = (found[i][lane] - expected).abs() / mass;
                    assert!(error < 1e-7, "off by {error:e} of all");
                }
            }
        }
    }

    /// The error of a single value, everywhere within a cell.
    #[test]
    fn a_value_is_right_to_1e_7() {
        for i in 0..40 {
            let x = f64::from(i) / 40.0 / DENSITY;
            for j in 0..120 {
                let y = f64::from(j) / 24.0;
                let points = [vec![x, y], vec![0.0; 2], vec![0.0; 2]];
                let grid = Grid::new(&points, [false; 3], &[1.0]);
                let unit = [[1.0; ABREAST], [0.0; ABREAST]];
                let mut found = [[0.0; ABREAST]; 2];
                grid.apply(&unit, &[[1.0, 0.0]], &mut found, &mut Workspace::default());
                let errors = [found[0][0] - 1.0, found[1][0] - (-(x - y) * (x - y)).exp()];
                assert!(errors.iter().all(|e| e.abs() < 2e-7), "{errors:?} at {x}, {y}");
            }
        }
    }
}
