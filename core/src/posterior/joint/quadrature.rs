//! On a real photo's likelihood, two unknowns at a time: the sampler's moments against quadrature.
//!
//! Everything else stays at the mode. Moments are sums over a grid, in coordinates in which the mean is
//! about 0 and the covariance 1, by a coarser grid.

use super::super::hamiltonian::Field;
use super::super::{Around, Walk};
use crate::rng::Rng;
use crate::search::Options;
use crate::search::tests::Case;
use core::array::from_fn;
use std::vec;
use std::vec::Vec;

/// How far grids reach, and their steps: the coarse one in coordinates of the mode's matrix.
const GRIDS: [[f64; 2]; 2] = [[20.0, 1.0], [7.0, 0.5]];
/// Batches of steps, by whose means errors are told.
const BATCHES: usize = 40;
/// Steps of a batch.
const STEPS: usize = 40;

/// Two unknowns of a density, the others held: `v = o + Σ zₖ bₖ` of two columns `b`.
struct Pair<'a, 'w> {
    around: Around<'a, 'w, 0>,
    origin: Vec<f32>,
    columns: [Vec<f32>; 2],
    /// An error of the energy, so many times `z₁²`.
    tilt: f64,
}

impl Pair<'_, '_> {
    fn look_at(&mut self, unknowns: [usize; 2]) {
        // Columns of U, made orthonormal, so that `vᵀv = zᵀz`.
        let n = self.around.unknowns();
        let [first, mut second] = unknowns.map(|unknown| {
            let mut column = vec![0.0; n];
            column[unknown] = 1.0;
            self.around.metric.multiply(&mut column);
            column
        });
        let first = normalised(first);
        let along = dot(&first, &second);
        for (x, f) in second.iter_mut().zip(&first) {
            *x -= along * f;
        }
        self.columns = [first, normalised(second)];
        self.origin = vec![0.0; n];
        let [x, y, xx, yy, xy] = by_grid(self, GRIDS[0]);
        // Of Cholesky's factor of the covariance.
        let a = (xx - x * x).sqrt();
        let b = (xy - x * y) / a;
        let c = (yy - y * y - b * b).sqrt();
        let combine = |k: f64, l: f64| -> Vec<f32> {
            let [first, second] = &self.columns;
            first.iter().zip(second).map(|(f, s)| k as f32 * f + l as f32 * s).collect()
        };
        (self.origin, self.columns) = (combine(x, y), [combine(a, b), combine(0.0, c)]);
    }
}

impl Field for &mut Pair<'_, '_> {
    fn energy(&mut self, z: &[f32], force: &mut [f32]) -> Option<f64> {
        let [a, b] = &self.columns;
        let along = a.iter().zip(b).map(|(a, b)| z[0] * a + z[1] * b);
        let position: Vec<f32> = self.origin.iter().zip(along).map(|(o, x)| o + x).collect();
        let mut whole = vec![0.0; position.len()];
        let energy = self.around.energy(&position, &mut whole)?;
        force.copy_from_slice(&[dot(a, &whole), dot(b, &whole)]);
        Some(energy + self.tilt * f64::from(z[0] * z[0]))
    }
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn normalised(mut v: Vec<f32>) -> Vec<f32> {
    let k = 1.0 / dot(&v, &v).sqrt();
    for x in &mut v {
        *x *= k;
    }
    v
}

fn moments([x, y]: [f64; 2]) -> [f64; 5] {
    [x, y, x * x, y * y, x * y]
}

/// Moments by a grid.
fn by_grid(mut pair: &mut Pair<'_, '_>, [reach, apart]: [f64; 2]) -> [f64; 5] {
    let steps = (reach / apart) as i32;
    let mut force = [0.0; 2];
    let least = pair.energy(&[0.0; 2], &mut force).unwrap();
    let (mut sums, mut whole, mut edge) = ([0.0; 5], 0.0, 0.0);
    for i in -steps..=steps {
        for j in -steps..=steps {
            let z = [i, j].map(|k| f64::from(k) * apart);
            let energy = pair.energy(&z.map(|z| z as f32), &mut force);
            let weight = energy.map_or(0.0, |energy| (least - energy).exp());
            whole += weight;
            if i.abs() == steps || j.abs() == steps {
                edge += weight;
            }
            for (sum, x) in sums.iter_mut().zip(moments(z)) {
                *sum += weight * x;
            }
        }
    }
    assert!(reach > 10.0 || edge < 1e-3 * whole, "{edge} of {whole}");
    sums.map(|sum| sum / whole)
}

/// The largest difference between moments by a walk and by a grid, in standard errors of batches' means.
fn worst(walk: &mut Walk<&mut Pair<'_, '_>>, expected: [f64; 5]) -> f64 {
    for _ in 0..STEPS {
        walk.step_and_adapt();
    }
    let mut sums = [[0.0; 2]; 5];
    for _ in 0..BATCHES {
        let mut means = [0.0; 5];
        for _ in 0..STEPS {
            walk.step(walk.ln_angle[1]);
            let z = from_fn(|i| f64::from(walk.state.position[i]));
            for (mean, x) in means.iter_mut().zip(moments(z)) {
                *mean += x / STEPS as f64;
            }
        }
        for ((sum, mean), expected) in sums.iter_mut().zip(means).zip(expected) {
            let off = mean - expected;
            *sum = [sum[0] + off, sum[1] + off * off];
        }
    }
    let n = BATCHES as f64;
    let z =
        sums.map(|[sum, squares]| sum.abs() / ((squares - sum * sum / n) * n / (n - 1.0)).sqrt());
    z.into_iter().fold(0.0, f64::max)
}

/// The largest of every pair's, given an error.
fn worst_of_all(tilt: f64) -> Vec<(&'static str, f64)> {
    let case = Case::new(4);
    case.give(Options::default(), false, |mut search| {
        while search.step().is_some() {}
        let mut memory = vec![0; 1 << 20];
        let around = Around::new(search, None, 0, &mut memory).unwrap();
        let layout = around.held.layout();
        let (albedo, pose) = (layout.shape_rank, layout.pose(0).start);
        let (light, color) = (layout.light(0).start, layout.color(0).start);
        let mut pair = Pair { around, origin: Vec::new(), columns: [Vec::new(), Vec::new()], tilt };
        let mut found = Vec::new();
        for (name, unknowns) in [
            ("shape", [0, 1]),
            ("albedo", [albedo, albedo + 1]),
            ("albedo and light", [albedo, light]),
            ("rotation", [pose, pose + 1]),
            ("place", [pose + 3, pose + 4]),
            ("zoom and recede", [pose + 5, pose + 6]),
            ("shape and rotation", [0, pose]),
            ("light", [light, light + 7]),
            ("gain and contrast", [color, color + 3]),
            ("light and gain", [light + 1, color + 1]),
        ] {
            pair.tilt = 0.0;
            pair.look_at(unknowns);
            let expected = by_grid(&mut pair, GRIDS[1]);
            pair.tilt = tilt;
            let mut walk = Walk::new(&mut pair, 2, Rng::new(8, 0)).unwrap();
            found.push((name, worst(&mut walk, expected)));
        }
        found
    })
}

/// With 40 batches one of the 50 moments is beyond 5 in some 1,500 seeds.
#[test]
fn moments_of_pairs_are_those_of_quadrature() {
    let found = worst_of_all(0.0);
    std::println!("{found:?}");
    assert!(found.iter().all(|(_, z)| *z < 5.0), "{found:?}");
}

#[test]
fn a_density_that_is_too_narrow_is_found() {
    let found = worst_of_all(0.4);
    std::println!("{found:?}");
    assert!(found.iter().all(|(_, z)| *z > 5.0), "{found:?}");
}
