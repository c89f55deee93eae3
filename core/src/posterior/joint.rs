//! The joint distribution of everything, of what is seen as well, stays what it is (Geweke 2004).
//!
//! A scene is drawn from the prior, landmarks and a photo are drawn given it, and the sampler makes some
//! steps given these. If it samples what it should, the scene afterwards is distributed together with
//! landmarks and photo as before: every statistic of them all has the same mean.
//!
//! Priors, landmarks, colours and the image term are computed here once more from their definitions
//! (`face.rs`, `search/held/probe.rs`); of the code under test only which points are held, what they
//! count, and the slopes of the mode's picture are taken over.
//!
//! - Rotations are uniform, and anything else is drawn as the priors say.
//! - Landmarks: a t distribution of 8 degrees of freedom about where they are, of [`LANDMARK`] pixels.
//! - The photo is a pattern, the same in all of them, plus one colour `y`. The density of `y` is
//!   `exp −E_image` up to a constant, whatever that is: `y` is drawn from about a normal
//!   distribution `q`, and scene and photo then weigh `w = exp(−E_image)/q(y)`. Most of those that weigh little
//!   are thrown away: kept by chance `w/c` if that is less than 1, and then weighing `c` (Liu, Chen & Wong
//!   1998). That is exact for any `c`.
//!
//! The rotation's measure, the chart's Jacobian, trajectories and their test are then all that is left to be
//! wrong, and errors that are planted there are found.

mod face;
mod quadrature;
mod ranks;

use super::hamiltonian::Field;
use super::{Around, Metric, Walk, ln_haar};
use crate::least_squares::{matrix_words, row_words};
use crate::metropolis::Outcome;
use crate::rng::Rng;
use crate::search::Options;
use crate::search::probe::{Naive, WIDER};
use crate::search::tests::Case;
use core::array::from_fn;
use face::{Face, Shown, Vector, mean};
use std::vec;
use std::vec::Vec;

/// Coefficients of shape and of albedo.
const RANK: usize = 6;
/// Standard deviations of a landmark, pixels: wide, so that scenes are free to move, and wider still.
const LANDMARK: f32 = 60.0;
const FREE: f32 = 200.0;
/// The same of a colour channel.
const PIXEL: f32 = 0.1;
/// How steep the mode's picture is, as a multiple of what it is: so that scenes that move freely may still
/// look like one photo.
const FLAT: f32 = 0.03;
/// How many independent pixels the picture is worth.
const WORTH: f32 = 2.0;
/// Logarithm of `c`.
const CUT: f64 = 6.5;
/// `s`, radians.
const ROTATION: f64 = 1.3;
/// Share of colours that are uniform, and where.
const ANYWHERE: f64 = 0.01;
const COLORS: [f64; 2] = [-0.5, 1.5];
/// Angle of a turn.
const ANGLE: f64 = 0.35;
/// Any will do.
const SEED: u64 = 1;

/// An error that is planted.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Error {
    None,
    /// The chart's Jacobian is left out.
    Chart,
    /// The measure of rotations is.
    Haar,
    /// The prior of the leading albedo coefficient counts twice.
    Albedo,
    /// That of the distance does.
    Distance,
    /// A step's test forgets kinetic energy.
    Kinetic,
    /// Landmarks are thought to be 1.3 times as far off.
    Landmarks,
    /// The image counts 1.5 times.
    Image,
}

/// What is seen.
#[derive(Clone, Default)]
struct Seen {
    landmarks: Vec<[f32; 2]>,
    color: Vector,
}

/// A density with an error.
struct Planted<'a, 'w> {
    around: Around<'a, 'w, 0>,
    table: Table,
    seen: Seen,
    error: Error,
    /// Standard deviation of a landmark.
    landmark: f32,
}

/// What is known of the case.
struct Table {
    naive: Naive,
    landmarks: Vec<usize>,
    mode: Face,
    albedo: Vector,
    pattern: Vec<f64>,
    side: usize,
}

/// The pattern of all photos.
fn pattern(side: usize) -> Vec<f64> {
    let value = |x: usize, y: usize| 0.05 * ((0.15 * x as f64).sin() + (0.2 * y as f64).cos());
    (0..side * side).map(|i| value(i % side, i / side)).collect()
}

impl Table {
    fn new(around: &mut Around<'_, '_, 0>) -> Self {
        let n = around.unknowns();
        let mode = Face::at(around, &vec![0.0; n]);
        let (naive, landmarks) = (around.held.naive(), around.held.landmarks());
        let side = around.held.problem().photo.image.width as usize;
        let albedo = mode.show(around.held.problem(), &naive, &landmarks).albedo;
        Self { naive, landmarks, mode, albedo, pattern: pattern(side), side }
    }

    fn show(&self, around: &Around<'_, '_, 0>, face: &Face) -> Shown {
        face.show(around.held.problem(), &self.naive, &self.landmarks)
    }

    /// What the points' colours lack of the pattern.
    fn lacking(&self, shown: &Shown) -> Vec<Vector> {
        let all = self.naive.points.iter().zip(&shown.colors).zip(&shown.places);
        let lacking = all.map(|((point, color), place)| {
            let (moved, seen) = (point.moved(*place), self.pattern[point.pixel(self.side)]);
            from_fn(|c| color[c] - moved[c] - seen)
        });
        lacking.collect()
    }

    fn image(&self, lacking: &[Vector], color: Vector) -> f64 {
        let off = |lacking: &Vector| from_fn(|c| color[c] - lacking[c]);
        self.naive.energy(&lacking.iter().map(off).collect::<Vec<Vector>>())
    }
}

/// The landmarks' term.
fn landmark_energy(shown: &Shown, seen: &Seen, sd: f64) -> f64 {
    let all = shown.landmarks.iter().zip(&seen.landmarks);
    let squares = all.map(|(a, b)| (0..2).map(|i| (f64::from(b[i]) - a[i]).powi(2)).sum::<f64>());
    squares.map(|square| 5.0 * (square / (8.0 * sd * sd)).ln_1p()).sum()
}

impl Field for Planted<'_, '_> {
    fn energy(&mut self, position: &[f32], force: &mut [f32]) -> Option<f64> {
        let mut energy = self.around.energy(position, force)?;
        // The factor of rotations.
        let (step, at) = (self.around.step(position), self.around.rotations().next()?);
        let mut pull = vec![0.0; position.len()];
        for (pull, w) in pull.iter_mut().zip(&step).skip(at).take(3) {
            *pull = -w / (ROTATION * ROTATION) as f32;
            energy -= 0.5 * f64::from(*pull * w);
        }
        self.around.metric.solve_transposed(&mut pull);
        for (force, pull) in force.iter_mut().zip(&pull) {
            *force += pull;
        }
        let face = || Face::at(&self.around, position);
        let shown = || self.table.show(&self.around, &face());
        let prior = &self.around.held.problem().config.prior;
        let more = match self.error {
            Error::None | Error::Kinetic => 0.0,
            Error::Chart => {
                let (face, shown, Table { mode, albedo, .. }) = (face(), shown(), &self.table);
                let bright = |c| shown.albedo[c] * face.gain[c] / (albedo[c] * mode.gain[c]);
                (0..3).map(|c| -9.0 * f64::ln(bright(c))).sum()
            }
            Error::Haar => ln_haar(from_fn(|axis| step[at + axis]))?,
            Error::Albedo => 0.5 * f64::from(face().subject.albedo[0]).powi(2),
            Error::Distance => {
                let ln = (-face().place[2] / f64::from(prior.distance)).ln();
                0.5 * (ln / f64::from(prior.distance_sd)).powi(2)
            }
            Error::Landmarks => {
                let (shown, sd) = (shown(), f64::from(self.landmark));
                landmark_energy(&shown, &self.seen, 1.3 * sd)
                    - landmark_energy(&shown, &self.seen, sd)
            }
            Error::Image => 0.5 * self.table.image(&self.table.lacking(&shown()), self.seen.color),
        };
        Some(energy + more)
    }
}

/// A step as chains make it, or one whose test forgets kinetic energy; whether it was taken.
fn step(walk: &mut Walk<Planted<'_, '_>>) -> bool {
    if walk.target.0.error != Error::Kinetic {
        return walk.step(ANGLE.ln()) == Outcome::Accepted;
    }
    let before = walk.state.clone();
    let mut moves = super::Trajectory { angle: ANGLE, turns: 8 };
    let Walk { target, state, rng, .. } = walk;
    let kept = crate::metropolis::Moves::draw(&mut moves, 0, target, state, rng)
        .is_some_and(|_| rng.uniform().ln() < before.energy - state.energy);
    if !kept {
        walk.state = before;
    }
    kept
}

/// A weighted draw of scene and what is seen of it.
struct Drawn {
    face: Face,
    step: Vec<f32>,
    seen: Seen,
    weight: f64,
}

/// Density of a colour given what a face lacks, up to a constant, and a draw.
struct Proposal {
    mean: Vector,
    /// Standard deviations of the channels' mean, and of what is apart from it.
    sd: [f64; 2],
}

impl Proposal {
    fn draw(&self, rng: &mut Rng) -> Vector {
        if rng.uniform() < ANYWHERE {
            return from_fn(|_| COLORS[0] + (COLORS[1] - COLORS[0]) * rng.uniform());
        }
        let z: Vector = from_fn(|_| rng.normal());
        let [all, apart] = self.sd;
        from_fn(|c| self.mean[c] + apart * (z[c] - mean(z)) + all * mean(z))
    }

    /// Log density.
    fn ln(&self, color: Vector) -> f64 {
        let [all, apart] = self.sd;
        let off: Vector = from_fn(|c| color[c] - self.mean[c]);
        let common = 3.0 * mean(off).powi(2);
        let rest = off.iter().map(|x| x * x).sum::<f64>() - common;
        let normaliser = (2.0 * core::f64::consts::PI).powf(-1.5) / (all * apart * apart);
        let z = common / (all * all) + rest / (apart * apart);
        let anywhere = ANYWHERE / (COLORS[1] - COLORS[0]).powi(3);
        ((1.0 - ANYWHERE) * normaliser * (-0.5 * z).exp() + anywhere).ln()
    }
}

/// Draws until one is kept.
fn draw(planted: &Planted<'_, '_>, rng: &mut Rng) -> Drawn {
    let Planted { around, table, .. } = planted;
    let (problem, widths) = (around.held.problem(), around.held.widths());
    let spread = f64::from(PIXEL) / table.naive.weight().sqrt();
    loop {
        let albedo_sd = |i| around.held.albedo_sd(i);
        let prior = &problem.config.prior;
        let (face, turn) = Face::draw(rng, &table.mode, &widths, albedo_sd, prior);
        let shown = table.show(around, &face);
        let lacking = table.lacking(&shown);
        let proposal =
            Proposal { mean: table.naive.mean(&lacking), sd: [2.0 * spread, 1.1 * spread] };
        let color = proposal.draw(rng);
        let inside = color.iter().all(|c| COLORS[0] < *c && *c < COLORS[1]);
        let bright = shown.albedo.iter().zip(face.gain).all(|(a, g)| a * g > 0.0);
        if !(inside && bright) {
            continue;
        }
        let ln_weight = -table.image(&lacking, color) - proposal.ln(color) - CUT;
        if rng.uniform().ln() > ln_weight {
            continue;
        }
        let landmarks = shown.landmarks.iter().map(|place| {
            let square: f64 = (0..8).map(|_| rng.normal().powi(2)).sum();
            let sd = f64::from(planted.landmark) * (8.0 / square).sqrt();
            place.map(|x| (x + sd * rng.normal()) as f32)
        });
        let seen = Seen { landmarks: landmarks.collect(), color };
        let step = face.step(turn, shown.albedo, (&table.mode, table.albedo));
        return Drawn { face, step, seen, weight: ln_weight.max(0.0).exp() };
    }
}

/// Statistics of a scene and what is seen of it.
fn statistics(planted: &Planted<'_, '_>, face: &Face) -> Vec<f64> {
    let Planted { around, table, seen, .. } = planted;
    let shown = table.show(around, face);
    let (shape, albedo) = (&face.subject.shape, &face.subject.albedo);
    let mut own: Vec<f64> = shape.iter().chain(albedo).map(|x| f64::from(*x)).collect();
    let [x, y, z] = face.place;
    let mode = &table.mode;
    let [distance, focal] = [(z / mode.place[2]).ln(), (face.focal / mode.focal).ln()];
    own.extend([0.01 * x, 0.01 * y, distance, focal, distance + focal, face.contrast - 1.0]);
    let lights = face.light.as_flattened().iter().zip(mode.light.as_flattened());
    own.extend(lights.map(|(own, mode)| own - mode));
    own.extend(face.gain.iter().map(|gain| gain - 1.0).chain(face.offset));
    own.extend((0..3).map(|c| (shown.albedo[c] * face.gain[c] / table.albedo[c]).ln()));
    let mut all: Vec<f64> = own.iter().flat_map(|x| [*x, x * x]).collect();
    all.extend(face.rotation.as_flattened());
    let angle = face.cosine(&table.mode).clamp(-1.0, 1.0).acos();
    all.extend([angle, angle * angle]);
    all.push(distance * focal);
    for c in 0..3 {
        let light = face.light[0][c] - mode.light[0][c];
        all.push(light * f64::from(albedo[0]));
        all.push(light * (shown.albedo[c] - table.albedo[c]));
        all.push(face.light[0][c] * shown.albedo[c] * face.gain[c]);
        all.push(seen.color[c] * light);
        all.push(seen.color[c] * (shown.albedo[c] - table.albedo[c]));
        all.push(seen.color[c] * face.offset[c]);
    }
    for axis in 0..2 {
        let centre: f64 = seen.landmarks.iter().map(|place| 0.01 * f64::from(place[axis])).sum();
        all.push(centre * 0.01 * face.place[axis]);
    }
    all.push(landmark_energy(&shown, seen, f64::from(planted.landmark)));
    all.push(table.image(&table.lacking(&shown), seen.color));
    all
}

/// What a test came to.
#[derive(Debug)]
struct Found {
    /// The largest drift, in standard errors.
    z: f64,
    statistics: usize,
    accepted: f64,
    /// Effective share of replicates.
    effective: f64,
}

/// Goes to a draw.
fn go(walk: &mut Walk<Planted<'_, '_>>, drawn: &Drawn) {
    let Planted { around, table, seen, .. } = &mut walk.target.0;
    around.held.observe(&drawn.seen.landmarks);
    around.held.show(|i| drawn.seen.color.map(|c| (c + table.pattern[i]) as f32));
    seen.clone_from(&drawn.seen);
    walk.state.position.copy_from_slice(&drawn.step);
    around.metric.multiply(&mut walk.state.position);
    assert!(walk.state.look(&mut walk.target.0));
}

/// Cholesky's factor, as metrics have it, of a matrix and so much of 1.
fn factorise(matrix: &[Vec<f64>], left: f64) -> Option<Vec<f32>> {
    let (n, width) = (matrix.len(), row_words(matrix.len()));
    let mut a = matrix.to_vec();
    let mut factor = vec![0.0; matrix_words(n)];
    for (i, row) in a.iter_mut().enumerate() {
        for (j, x) in row.iter_mut().enumerate() {
            *x = (1.0 - left) * *x + if i == j { left } else { 0.0 };
        }
    }
    for i in 0..n {
        if !(a[i][i] > 0.25) {
            return None;
        }
        let pivot = a[i][i].sqrt();
        for j in i..n {
            a[i][j] /= pivot;
            factor[i * width + j] = a[i][j] as f32;
        }
        for k in i + 1..n {
            for j in k..n {
                a[k][j] -= a[i][k] * a[i][j];
            }
        }
    }
    Some(factor)
}

/// How forces change around a state, `−∂f/∂v`; `None` at an end of the space.
fn precision(walk: &mut Walk<Planted<'_, '_>>) -> Option<Vec<Vec<f64>>> {
    const OFF: f32 = 0.3;
    let n = walk.state.position.len();
    let mut precision = vec![vec![0.0; n]; n];
    for i in 0..n {
        let mut at = |off: f32| {
            let (mut there, mut force) = (walk.state.position.clone(), vec![0.0; n]);
            there[i] += off;
            walk.target.0.energy(&there, &mut force).map(|_| force)
        };
        let (ahead, behind) = (at(OFF)?, at(-OFF)?);
        for j in 0..n {
            let slope = f64::from((behind[j] - ahead[j]) / (2.0 * OFF));
            precision[i][j] += 0.5 * slope;
            precision[j][i] += 0.5 * slope;
        }
    }
    Some(precision)
}

/// Changes the metric to what forces say around some draws, on average but for the roughest.
fn adapt(walk: &mut Walk<Planted<'_, '_>>, rng: &mut Rng) {
    let mut all = Vec::new();
    while all.len() < 48 {
        let drawn = draw(&walk.target.0, rng);
        go(walk, &drawn);
        if let Some(found) = precision(walk) {
            all.push((found.iter().flatten().map(|x| x * x).sum::<f64>(), found));
        }
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all.truncate(36);
    let n = walk.state.position.len();
    let mean = |i: usize, j: usize| all.iter().map(|(_, p)| p[i][j]).sum::<f64>() / 36.0;
    let precision: Vec<Vec<f64>> = (0..n).map(|i| (0..n).map(|j| mean(i, j)).collect()).collect();
    // The more is left of the metric there was, the more is positive definite.
    let mut shares = [0.1, 0.2, 0.4, 0.7, 1.0].into_iter();
    let mut factor = shares.find_map(|left| factorise(&precision, left)).unwrap();
    walk.target.0.around.metric.change(&Metric::new(n, factor.as_chunks_mut().0).unwrap());
}

/// What is done with a walk that has an error, and whose landmarks are so wide.
fn with(error: Error, landmark: f32, f: impl FnOnce(&mut Walk<Planted<'_, '_>>, &mut Rng)) {
    let mut case = Case::new(4);
    case.config.landmark_sd = landmark;
    case.config.pixel_sd = PIXEL;
    (case.config.shape_rank, case.config.albedo_rank) = (RANK, RANK);
    // Of some 1,600 pixels.
    case.config.pixel_patch = 1600.0 / (WIDER * WORTH);
    case.give(Options::default(), false, |mut search| {
        while search.step().is_some() {}
        let mut memory = vec![0; 1 << 20];
        let mut around = Around::new(search, None, 0, &mut memory).unwrap();
        around.held.flatten(FLAT);
        let n = around.unknowns();
        let table = Table::new(&mut around);
        let planted = Planted { around, table, seen: Seen::default(), error, landmark };
        let mut walk = Walk::new(planted, n, Rng::new(SEED, 1)).unwrap();
        let mut rng = Rng::new(SEED, 0);
        adapt(&mut walk, &mut rng);
        f(&mut walk, &mut rng);
    });
}

/// Statistics of a walk's state.
fn statistics_of(walk: &Walk<Planted<'_, '_>>) -> Vec<f64> {
    let face = Face::at(&walk.target.0.around, &walk.state.position);
    statistics(&walk.target.0, &face)
}

/// The largest drift of all statistics from exact draws on.
fn drift(error: Error, landmark: f32, replicates: usize) -> Found {
    let (mut sums, mut accepted) = (Vec::new(), 0);
    let mut weights = [0.0; 2];
    with(error, landmark, |walk, rng| {
        for _ in 0..replicates {
            let drawn = draw(&walk.target.0, rng);
            go(walk, &drawn);
            let Drawn { face, weight, .. } = drawn;
            let before = statistics(&walk.target.0, &face);
            accepted += u32::from(self::step(walk));
            let after = statistics_of(walk);
            sums.resize(before.len(), [0.0; 2]);
            for (sum, (after, before)) in sums.iter_mut().zip(after.iter().zip(&before)) {
                let change = weight * (after - before);
                *sum = [sum[0] + change, sum[1] + change * change];
            }
            weights = [weights[0] + weight, weights[1] + weight * weight];
        }
    });
    assert!(sums.iter().all(|[_, squares]| *squares > 0.0));
    let count = replicates as f64;
    let z = |[sum, squares]: [f64; 2]| sum.abs() / (squares - sum * sum / count).sqrt();
    Found {
        z: sums.iter().map(|sum| z(*sum)).fold(0.0, f64::max),
        statistics: sums.len(),
        accepted: f64::from(accepted) / count,
        effective: weights[0] * weights[0] / (weights[1] * count),
    }
}

/// Standard errors beyond which a drift is no chance: of the 284 statistics one is in 6,000 seeds.
const BOUND: f64 = 5.0;

fn stays(landmark: f32, replicates: usize) {
    let found = drift(Error::None, landmark, replicates);
    std::println!("{found:?}");
    assert!(found.z < BOUND && found.accepted > 0.4, "{found:?}");
    assert!(found.effective > 0.5 && found.statistics == 142, "{found:?}");
}

#[test]
fn the_joint_distribution_stays() {
    stays(LANDMARK, 4000);
}

#[test]
fn the_joint_distribution_stays_where_rotations_are_free() {
    stays(FREE, 6500);
}

/// By the same statistics and the same bound, of no more replicates.
fn is_found(error: Error, landmark: f32, replicates: usize) {
    let found = drift(error, landmark, replicates);
    std::println!("{error:?}: {found:?}");
    assert!(found.z > BOUND, "{error:?}: {found:?}");
}

#[test]
fn a_missing_jacobian_is_found() {
    is_found(Error::Chart, LANDMARK, 600);
}

#[test]
fn a_missing_measure_of_rotations_is_found() {
    is_found(Error::Haar, FREE, 6500);
}

#[test]
fn a_prior_that_counts_twice_is_found() {
    is_found(Error::Distance, LANDMARK, 1200);
    is_found(Error::Albedo, LANDMARK, 3000);
}

#[test]
fn forgotten_kinetic_energy_is_found() {
    is_found(Error::Kinetic, LANDMARK, 1000);
}

#[test]
fn landmarks_of_a_wrong_width_are_found() {
    is_found(Error::Landmarks, LANDMARK, 3500);
}

#[test]
fn an_image_of_a_wrong_weight_is_found() {
    is_found(Error::Image, LANDMARK, 800);
}
