//! A better metric from places where the force is known.
//!
//! In the coordinates of a metric that is right the density `π` has covariance 1. In those of one that is
//! not it has some other, `C`, and the linear map that is nearest to the force `∇ ln π(v)` on average is
//! `−C⁻¹(v − E v)`, since `E[∇ ln π(v) vᵀ] = −1` (Stein's identity). Of a normal density the force is that map,
//! wherever the places are. So the precision `S = C⁻¹` is found by least squares, as if [`PRIOR`] places for
//! each unknown had said `S = 1`, and is then made symmetric.
//!
//! Where the density is not normal, `S` is the mean of how the force changes, and a density that is narrow
//! here and flat there is wider than that says. Along a single direction it is better to look at the
//! places themselves ([`widen`]); along all of them that would take many more places than there are.

use super::Unknowns;
use super::metric::Metric;
use crate::engine::Engine;
use crate::least_squares::{System, matrix_words, row_words, system_words};

/// How many places the metric so far is worth, per unknown. Chosen, not measured.
const PRIOR: f32 = 2.0;
/// The share of the metric so far that is kept: the least of these with which the sum is positive definite.
/// Chosen, not measured.
const LEFT: [f32; 5] = [0.1, 0.2, 0.4, 0.6, 0.8];

/// The largest variance along a direction that places are believed. Turns of the head are twice as wide as
/// forces say (docs/posterior.md).
const WIDER: f32 = 4.0;

/// Words of memory that [`improve`] and [`widen`] need for so many unknowns.
pub fn improve_words(n: usize) -> usize {
    system_words(n) + 2 * matrix_words(n)
}

/// Finds coordinates in which a density's covariance is nearer 1. `places` are positions and forces in turn,
/// of `n` numbers each. Returns the factor that leads to the new coordinates, and changes `places` to them;
/// returns `None`, and leaves them as they are, if there is too little memory ([`improve_words`]) or nothing
/// to be learnt.
pub fn improve<'m>(
    n: usize,
    places: &mut [f32],
    engine: &Engine,
    memory: &'m mut [f32],
) -> Option<Metric<'m>> {
    if n == 0 || places.len() < 2 * n {
        return None;
    }
    let (equations, rest) = memory.split_at_mut_checked(system_words(n))?;
    let (factor, rest) = rest.split_at_mut_checked(matrix_words(n))?;
    let rows = rest.get_mut(..matrix_words(n))?;
    let width = row_words(n);
    let mut spare = Unknowns::new();
    spare.resize(n, 0.0).ok()?;
    regress(n, places, engine, [&mut *equations, &mut *factor, &mut *rows], &mut spare)?;
    let solve = engine.normal_equations.solve;
    let mut found = false;
    for left in LEFT {
        let all = factor.chunks_exact_mut(width).enumerate();
        for (i, row) in all {
            for (j, to) in row.iter_mut().enumerate().take(n).skip(i) {
                let at = |i: usize, j: usize| rows.get(i * width + j).copied().unwrap_or(0.0);
                let own = if i == j { left } else { 0.0 };
                *to = own + 0.5 * (1.0 - left) * (at(i, j) + at(j, i));
            }
        }
        let scratch = equations.as_chunks_mut().0;
        if solve(factor.as_chunks_mut().0, &mut spare, scratch).is_some() {
            found = true;
            break;
        }
    }
    if !found {
        return None;
    }
    let change = Metric::new(n, factor.as_chunks_mut().0)?;
    take_to(&change, n, places);
    Some(change)
}

/// Takes places to the coordinates that a change leads to.
fn take_to(change: &Metric<'_>, n: usize, places: &mut [f32]) {
    for place in places.chunks_exact_mut(2 * n) {
        let (position, force) = place.split_at_mut(n);
        change.multiply(position);
        change.solve_transposed(force);
    }
}

/// Finds coordinates in which the variance along one direction is 1, if it is more. `direction` has a number
/// per unknown, and any length: what is looked at is the variance of its product with the positions, and what
/// is uncorrelated with that product stays as it is. `places` and what is returned are those of [`improve`];
/// nothing changes if there is no such width, fewer than two places or too little memory
/// ([`improve_words`]).
pub fn widen<'m>(
    direction: &[f32],
    places: &mut [f32],
    engine: &Engine,
    memory: &'m mut [f32],
) -> Option<Metric<'m>> {
    let (n, width) = (direction.len(), row_words(direction.len()));
    let square: f32 = direction.iter().map(|x| x * x).sum();
    if places.len() < 4 * n || !(square > 0.0) {
        return None;
    }
    let (mut sum, mut squares, mut count) = (0.0_f64, 0.0_f64, 0.0_f64);
    for place in places.chunks_exact(2 * n) {
        let along: f32 = place.iter().zip(direction).map(|(x, d)| x * d).sum();
        let along = f64::from(along);
        (sum, squares, count) = (sum + along, squares + along * along, count + 1.0);
    }
    let variance = (squares - sum * sum / count) as f32 / (count as f32 * square);
    let less = 1.0 - 1.0 / variance.min(WIDER);
    if !(less > 0.0) {
        return None;
    }
    let (scratch, rest) = memory.split_at_mut_checked(system_words(n))?;
    let factor = rest.get_mut(..matrix_words(n))?;
    // 1 less so much of the direction's square.
    for ((i, row), d) in factor.chunks_exact_mut(width).enumerate().zip(direction) {
        row.fill(0.0);
        for ((j, to), other) in row.iter_mut().enumerate().zip(direction).skip(i) {
            let own = if i == j { 1.0 } else { 0.0 };
            *to = own - less / square * d * other;
        }
    }
    let mut spare = Unknowns::new();
    spare.resize(n, 0.0).ok()?;
    let solve = engine.normal_equations.solve;
    solve(factor.as_chunks_mut().0, &mut spare, scratch.as_chunks_mut().0)?;
    let change = Metric::new(n, factor.as_chunks_mut().0)?;
    take_to(&change, n, places);
    Some(change)
}

/// Fills `rows` with the precision, not yet symmetric. The other slices are scratch.
fn regress(
    n: usize,
    places: &[f32],
    engine: &Engine,
    [equations, factor, rows]: [&mut [f32]; 3],
    spare: &mut [f32],
) -> Option<()> {
    let width = row_words(n);
    let prior = PRIOR * n as f32;
    let share = n as f32 / (places.len() / 2) as f32;
    // Of position and force.
    let mut means = [Unknowns::new(), Unknowns::new()];
    for (mean, first) in means.iter_mut().zip([0, n]) {
        mean.resize(n, 0.0).ok()?;
        for place in places.chunks_exact(2 * n) {
            for (mean, x) in mean.iter_mut().zip(place.get(first..)?) {
                *mean += share * x;
            }
        }
    }
    let [position, force] = means;
    let mut system = System::new(n, engine.normal_equations, equations)?;
    rows.fill(0.0);
    for place in places.chunks_exact(2 * n) {
        let (at, pull) = place.split_at(n);
        for ((off, at), mean) in spare.iter_mut().zip(at).zip(&position) {
            *off = at - mean;
        }
        system.add_row(spare, 1.0, 0.0);
        let pulls = pull.iter().zip(&force);
        for (row, (pull, mean)) in rows.chunks_exact_mut(width).zip(pulls) {
            let k = mean - pull;
            for (to, off) in row.iter_mut().zip(&*spare) {
                *to += k * off;
            }
        }
    }
    system.solve_damped(0.0, |_| prior, factor, spare)?;
    let places = Metric::new(n, factor.as_chunks_mut().0)?;
    for (i, row) in rows.chunks_exact_mut(width).enumerate() {
        let row = row.get_mut(..n)?;
        *row.get_mut(i)? += prior;
        places.solve_transposed(row);
        places.solve(row);
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;
    use std::vec;
    use std::vec::Vec;

    const N: usize = 12;

    /// Standard deviations from 1/2 to 4, turned into each other in pairs.
    fn map(v: &[f32], power: i32) -> Vec<f32> {
        let mut out = v.to_vec();
        for pair in 0..N / 2 {
            let (i, j) = (pair, N - 1 - pair);
            let (sin, cos) = (0.3 + pair as f32).sin_cos();
            let (a, b) = (cos * v[i] + sin * v[j], cos * v[j] - sin * v[i]);
            let (a, b) = (a * (0.5_f32).powi(power), b * (4.0_f32).powi(power));
            (out[i], out[j]) = (cos * a - sin * b, sin * a + cos * b);
        }
        out
    }

    /// Of a normal density that is off centre, once draws and once places all about.
    #[test]
    fn a_normal_densitys_covariance_is_found_from_anywhere() {
        for drawn in [true, false] {
            let mut rng = Rng::new(5, 0);
            let mut places = Vec::new();
            for _ in 0..4000 {
                let z: Vec<f32> = (0..N).map(|_| rng.normal_sd(1.0)).collect();
                let off = if drawn { map(&z, 1) } else { z };
                places.extend(off.iter().map(|x| x + 3.0));
                places.extend(map(&off, -2).iter().map(|x| -x));
            }
            let mut memory = vec![0.0; improve_words(N)];
            let change = improve(N, &mut places, Engine::PORTABLE, &mut memory).unwrap();
            // How far a draw's standard deviation is along some directions, in the new coordinates.
            let mut worst = [f32::INFINITY, 0.0];
            for k in 0..N {
                let mut draw = vec![0.0; N];
                draw[k] = 1.0;
                let mut draw = map(&draw, 1);
                change.multiply(&mut draw);
                let length = draw.iter().map(|x| x * x).sum::<f32>().sqrt();
                worst = [worst[0].min(length), worst[1].max(length)];
            }
            // What is left of the metric there was shows where it was 4.
            assert!(worst[0] > 0.6 && worst[1] < 1.7, "{drawn}: {worst:?}");
            // The force there is about minus the position.
            let mean: f32 = places.chunks_exact(2 * N).map(|p| p[0]).sum::<f32>() / 4000.0;
            let off = places.chunks_exact(2 * N).map(|p| (p[0] - mean + p[N]).powi(2)).sum::<f32>();
            assert!(off < 0.5 * 4000.0, "{drawn}: {off}");
        }
    }

    #[test]
    fn a_density_that_is_wider_along_a_direction_is_made_round() {
        let mut rng = Rng::new(9, 0);
        let direction: Vec<f32> = (0..N).map(|_| rng.normal_sd(2.0)).collect();
        let square: f32 = direction.iter().map(|d| d * d).sum();
        let along = |v: &[f32]| direction.iter().zip(v).map(|(d, x)| d * x).sum::<f32>();
        let mut places = Vec::new();
        for _ in 0..4000 {
            let mut v: Vec<f32> = (0..N).map(|_| 1.0 + rng.normal_sd(1.0)).collect();
            let more = (3.0_f32.sqrt() - 1.0) * along(&v) / square;
            for (x, d) in v.iter_mut().zip(&direction) {
                *x += more * d;
            }
            let forces = vec![0.0; N];
            places.extend(v);
            places.extend(forces);
        }
        let mut memory = vec![0.0; improve_words(N)];
        widen(&direction, &mut places, Engine::PORTABLE, &mut memory).unwrap();
        for i in 0..N {
            for j in 0..=i {
                let mean = |f: &dyn Fn(&[f32]) -> f32| {
                    places.chunks_exact(2 * N).map(f).sum::<f32>() / 4000.0
                };
                let (a, b) = (mean(&|p| p[i]), mean(&|p| p[j]));
                let covariance = mean(&|p| (p[i] - a) * (p[j] - b));
                let expected = f32::from(u8::from(i == j));
                assert!((covariance - expected).abs() < 0.1, "{i} {j}: {covariance}");
            }
        }
        assert!(widen(&[0.0; N], &mut places, Engine::PORTABLE, &mut memory).is_none());
    }

    #[test]
    fn nothing_is_learnt_of_nothing() {
        let mut memory = vec![0.0; improve_words(N)];
        assert!(improve(N, &mut [], Engine::PORTABLE, &mut memory).is_none());
        assert!(improve(N, &mut [0.0; 2 * N], Engine::PORTABLE, &mut memory[1..]).is_none());
    }
}
