//! A sampler of the posterior around its mode.
//!
//! What is sampled is what the search for the mode lowers, with what pixels count held
//! (`search/held.rs`).
//!
//! States are `x = mode ⊕ u`: a rotation vector about the object's origin, places, logarithms of
//! focal length and distance, coefficients, light and colours ([`crate::search::unknowns`]). In
//! `v = U u`, where `A = UᵀU` is a Gauss–Newton matrix ([`Metric`]), the posterior is about a standard
//! normal, and trajectories ([`hamiltonian`]) go from one end of it to the other in a few turns.
//!
//! First a [`Pilot`] goes around: from where it has been come the matrix, which is the mean of what it
//! met (at the mode alone the posterior seems longer than it is, since it is bent), and which pixels
//! contours pass. Both are the [`Ground`] of all chains, and stay. Then chains ([`Sampler`]) adapt the
//! angle of a turn in a warm-up, which is thrown away, and hold it.

pub mod hamiltonian;
mod metric;

use crate::chain::{ChainError, Problem};
use crate::hash::Fnv64;
use crate::least_squares::matrix_words;
use crate::math;
use crate::memory::Carver;
use crate::metropolis::{self, Outcome};
use crate::rng::Rng;
use crate::scene::{Subject, View};
use crate::search::unknowns::Layout;
use crate::search::{Held, ModeSearch, Options, held_words};
use hamiltonian::{Density, Field, State, Trajectory};
pub use metric::Metric;

/// The most unknowns there may be.
pub const MAX_UNKNOWNS: usize = Layout::MOST.len();
/// Pixels whose rows make the first metric.
const METRIC_PIXELS: usize = 6000;
/// The same of each state that the pilot notes.
const NOTED_PIXELS: usize = 2000;
/// Draws of the mode's normal approximation that tell the pilot where contours may run.
const DRAWS: usize = 32;
/// States of the pilot that make a metric.
const NOTED: usize = 8;
/// Steps from one of them to the next.
const EVERY: u32 = 5;
/// Metrics that the pilot makes, the last of which stays.
const ROUNDS: u32 = 3;
/// Acceptance that the angle is adapted to.
const ACCEPTANCE: f64 = 0.75;
/// Angles between which it is adapted, radians.
const ANGLES: [f64; 2] = [0.1, 0.4];
/// The angle to begin with.
const ANGLE: f64 = 0.2;
/// How far trajectories go, radians: a quarter turn would forget the start.
const WAY: f64 = 1.2;

/// A number per unknown.
pub type Unknowns = heapless::Vec<f32, MAX_UNKNOWNS>;

fn layout(problem: &Problem<'_>, options: &Options<'_>) -> Layout {
    let d = problem.dimensions();
    let views = 1 + options.others.len();
    Layout { shape_rank: d.shape_rank, albedo_rank: d.albedo_rank, views }
}

/// Words of memory a [`Sampler`] of a problem needs besides its search's.
pub fn words(problem: &Problem<'_>, options: &Options<'_>) -> usize {
    let photos = core::iter::once(&problem.photo).chain(options.others);
    let pixels = photos.map(|photo| photo.image.pixels.len());
    let vertices = problem.model.vertices();
    let layout = layout(problem, options);
    matrix_words(layout.len()) + held_words(vertices, layout.albedo_rank, pixels)
}

/// Words of memory a [`Pilot`] needs besides its search's.
pub fn pilot_words(problem: &Problem<'_>, options: &Options<'_>) -> usize {
    words(problem, options) + NOTED * layout(problem, options).len()
}

/// A density around a mode.
struct Around<'a, 'w, const OTHERS: usize> {
    held: Held<'a, 'w, OTHERS>,
    metric: Metric<'w>,
}

impl<'a, 'w, const OTHERS: usize> Around<'a, 'w, OTHERS> {
    /// Holds what a search has found; the metric is still to be made. Beside that it takes room for
    /// `notes` numbers per unknown.
    fn new(
        search: ModeSearch<'a, 'w, OTHERS>,
        notes: usize,
        memory: &'w mut [u32],
    ) -> Result<(Self, &'w mut [f32]), ChainError> {
        let n = search.layout().len();
        if n > MAX_UNKNOWNS {
            return Err(ChainError::Photos { found: 1 + OTHERS });
        }
        let needed = matrix_words(n) + Held::words(&search) + notes * n;
        let error = ChainError::Memory { needed, found: memory.len() };
        let mut carver = Carver::new(memory);
        let factor = carver.floats(matrix_words(n)).ok_or(error)?;
        let metric = Metric::new(n, factor.as_chunks_mut().0).ok_or(error)?;
        let held = Held::new(search, &mut carver).ok_or(error)?;
        Ok((Self { held, metric }, carver.floats(notes * n).ok_or(error)?))
    }

    fn unknowns(&self) -> usize {
        self.held.layout().len()
    }

    /// The step from the mode to a position.
    fn step(&self, position: &[f32]) -> Unknowns {
        let mut step = Unknowns::new();
        // There is room for all there are.
        let _ = step.extend_from_slice(position);
        self.metric.solve(&mut step);
        step
    }

    /// Where in a step the views' rotation vectors begin.
    fn rotations(&self) -> impl Iterator<Item = usize> + use<OTHERS> {
        let layout = self.held.layout();
        (0..layout.views).map(move |view| layout.pose(view).start)
    }

    /// Makes the metric of what is met some steps from the mode; whether that can be done.
    fn make_metric(&mut self, steps: &mut [f32], pixels: usize) -> bool {
        self.held.factorise(steps, pixels, self.metric.factor()).is_some()
    }
}

impl<const OTHERS: usize> Field for Around<'_, '_, OTHERS> {
    fn energy(&mut self, position: &[f32], force: &mut [f32]) -> Option<f64> {
        let mut step = self.step(position);
        let vector = |from: &[f32], at: usize| from.get(at..)?.first_chunk().copied();
        let mut haar = 0.0;
        for at in self.rotations() {
            haar += ln_haar(vector(&step, at)?)?;
        }
        let energy = self.held.energy(&mut step)?;
        for (to, f) in force.iter_mut().zip(self.held.force()) {
            *to = *f;
        }
        // From the turn w on to w + dw it is a turn δ = (I + ½[w]×) dw, or nearly so.
        for at in self.rotations() {
            let [x, y, z] = vector(&step, at)?.map(|w| 0.5 * w);
            let [fx, fy, fz] = force.get_mut(at..)?.first_chunk_mut()?;
            (*fx, *fy, *fz) =
                (*fx - (y * *fz - z * *fy), *fy - (z * *fx - x * *fz), *fz - (x * *fy - y * *fx));
        }
        self.metric.solve_transposed(force);
        Some(energy - haar)
    }
}

/// Log density of a rotation vector when rotations are uniform: `2 ln (sin(θ/2)/(θ/2))`; none beyond
/// half a turn, where vectors name the same rotations again.
fn ln_haar([x, y, z]: [f32; 3]) -> Option<f64> {
    let half = 0.5 * math::sqrt(x * x + y * y + z * z);
    if half < 1e-3 {
        return Some(-f64::from(half * half) / 3.0);
    }
    (half < core::f32::consts::FRAC_PI_2)
        .then(|| 2.0 * math::ln(f64::from(math::sin_cos(half).0 / half)))
}

/// A state that goes around a density.
struct Walk<'a, 'w, const OTHERS: usize> {
    target: Density<Around<'a, 'w, OTHERS>>,
    state: State,
    rng: Rng,
    /// Logarithm of the angle, and its average since it is adapted.
    ln_angle: [f64; 2],
    /// Steps that adapted it.
    adapted: u32,
}

impl<'a, 'w, const OTHERS: usize> Walk<'a, 'w, OTHERS> {
    /// Begins at a draw of the normal approximation.
    fn new(around: Around<'a, 'w, OTHERS>, mut rng: Rng) -> Result<Self, ChainError> {
        let mut target = Density(around);
        let mut position = Unknowns::new();
        // At most as many as there is room for.
        let _ = position.resize(target.0.unknowns(), 0.0);
        let mut state = State { force: position.clone(), position, energy: f64::INFINITY };
        // Nearer if that is where it may not go.
        for spread in [1.0, 0.3, 0.0] {
            for v in &mut state.position {
                *v = spread * rng.normal() as f32;
            }
            if state.look(&mut target.0) {
                let ln_angle = [math::ln(ANGLE); 2];
                return Ok(Self { target, state, rng, ln_angle, adapted: 0 });
            }
        }
        Err(ChainError::Config)
    }

    /// Makes a step by turns of about such an angle.
    fn step(&mut self, ln_angle: f64) -> Outcome {
        // Never twice the same, so that no orbit closes.
        let angle = math::exp(ln_angle) * (0.8 + 0.4 * self.rng.uniform());
        let turns = (WAY / angle + 0.5) as u32;
        let mut moves = Trajectory { angle, turns };
        let mut density = [-self.state.energy];
        let Self { target, state, rng, .. } = self;
        metropolis::step(target, &mut moves, 0, 1, state, &mut density, rng)
    }

    /// The same, and adapts the angle.
    fn step_and_adapt(&mut self) -> Outcome {
        let outcome = self.step(self.ln_angle[0]);
        self.adapted += 1;
        let k = f64::from(self.adapted);
        let miss = f64::from(u8::from(outcome == Outcome::Accepted)) - ACCEPTANCE;
        let [now, average] = &mut self.ln_angle;
        *now = (*now + miss / math::sqrt_f64(k)).clamp(math::ln(ANGLES[0]), math::ln(ANGLES[1]));
        // The later a step, the more it counts.
        *average += 2.0 / (k + 1.0) * (*now - *average);
        outcome
    }

    fn unknowns(&self) -> Unknowns {
        self.target.0.step(&self.state.position)
    }
}

/// Standard deviations of the unknowns around a mode in Laplace's approximation: the posterior as the
/// normal distribution that has the mode's Gauss–Newton matrix. Order and units are those of
/// [`crate::search::unknowns`]; `memory` is [`words`] long.
///
/// # Errors
/// [`ChainError::Memory`] if the memory is shorter; [`ChainError::Config`] of a mode that nothing is
/// seen of.
pub fn laplace<'w, const OTHERS: usize>(
    search: ModeSearch<'_, 'w, OTHERS>,
    memory: &'w mut [u32],
) -> Result<Unknowns, ChainError> {
    let (mut around, _) = Around::new(search, 0, memory)?;
    let mut step = Unknowns::new();
    // There is room for all.
    let _ = step.resize(around.unknowns(), 0.0);
    let mut deviations = step.clone();
    if !around.make_metric(&mut step, NOTED_PIXELS) {
        return Err(ChainError::Config);
    }
    around.metric.variances(&mut step, &mut deviations);
    for x in &mut deviations {
        *x = math::sqrt(*x);
    }
    Ok(deviations)
}

/// What all chains stand on: what pixels count, and the metric.
#[derive(Clone, Copy, Debug)]
pub struct Ground<'g> {
    counts: &'g [f32],
    factor: &'g [f32],
}

/// Goes around a mode before chains do. It is the same for all of them, whatever their seeds.
pub struct Pilot<'a, 'w, const OTHERS: usize = 0> {
    walk: Walk<'a, 'w, OTHERS>,
    steps: u32,
    noted: &'w mut [f32],
}

impl<'a, 'w, const OTHERS: usize> Pilot<'a, 'w, OTHERS> {
    /// Steps of all pilots.
    pub const STEPS: u32 = ROUNDS * NOTED as u32 * EVERY;

    /// Around the mode that a search has found, in [`pilot_words`] of memory.
    ///
    /// # Errors
    /// [`ChainError::Memory`] if the memory is shorter; [`ChainError::Config`] of a mode that
    /// nothing is seen of, or whose metric is singular.
    pub fn new(
        search: ModeSearch<'a, 'w, OTHERS>,
        memory: &'w mut [u32],
    ) -> Result<Self, ChainError> {
        let (mut around, noted) = Around::new(search, NOTED, memory)?;
        let mut step = Unknowns::new();
        // There is room for all.
        let _ = step.resize(around.unknowns(), 0.0);
        let mut mode = step.clone();
        let mut rng = Rng::new(0, 0);
        let made = |made: bool| made.then_some(()).ok_or(ChainError::Config);
        made(around.make_metric(&mut mode, METRIC_PIXELS))?;
        around.held.leave_contours_out(&mut mode);
        for _ in 0..DRAWS {
            for z in &mut step {
                *z = rng.normal() as f32;
            }
            around.metric.solve(&mut step);
            around.held.leave_contours_out(&mut step);
        }
        around.held.settle();
        made(around.make_metric(&mut mode, METRIC_PIXELS))?;
        Ok(Self { walk: Walk::new(around, rng)?, steps: 0, noted })
    }

    /// Makes one step; `false` when there are no more.
    pub fn step(&mut self) -> bool {
        if self.steps >= Self::STEPS {
            return false;
        }
        self.walk.step_and_adapt();
        self.steps += 1;
        if self.steps.is_multiple_of(EVERY) {
            self.note((self.steps / EVERY - 1) as usize % NOTED);
        }
        true
    }

    /// Notes the state; when that is the last of a round, makes contours and metric anew.
    fn note(&mut self, number: usize) {
        let Self { walk, noted, .. } = self;
        let mut step = walk.unknowns();
        let n = step.len();
        if let Some(to) = noted.get_mut(number * n..(number + 1) * n) {
            to.copy_from_slice(&step);
        }
        if number + 1 < NOTED {
            return;
        }
        let Walk { target: Density(around), state, .. } = walk;
        for step in noted.chunks_exact_mut(n.max(1)) {
            around.held.leave_contours_out(step);
        }
        around.held.settle();
        if !around.make_metric(noted, NOTED_PIXELS) {
            // Then the mode's, which could be made.
            let mut mode = step.clone();
            mode.fill(0.0);
            around.make_metric(&mut mode, METRIC_PIXELS);
        }
        around.metric.multiply(&mut step);
        state.position = step;
        state.look(around);
        walk.adapted = 0;
        walk.ln_angle = [math::ln(ANGLE); 2];
    }

    /// What it found, once there are no more steps.
    pub fn ground(&mut self) -> Ground<'_> {
        let Around { held, metric } = &mut self.walk.target.0;
        Ground { counts: held.counts(), factor: metric.factor() }
    }
}

/// A running chain.
pub struct Sampler<'a, 'w, const OTHERS: usize = 0> {
    walk: Walk<'a, 'w, OTHERS>,
    steps: u32,
    warm_up: u32,
    accepted: u32,
    fingerprint: Fnv64,
}

impl<'a, 'w, const OTHERS: usize> Sampler<'a, 'w, OTHERS> {
    /// Number `stream` of a seed, around the mode that a search has found, on the ground that a pilot
    /// of the same search has made; it begins at a draw of a normal distribution with its metric.
    /// `memory` is [`words`] long. The first `warm_up` steps adapt it.
    ///
    /// # Errors
    /// [`ChainError::Memory`] if the memory is shorter; [`ChainError::Config`] of a mode that
    /// nothing is seen of, or another search's ground.
    pub fn new(
        search: ModeSearch<'a, 'w, OTHERS>,
        ground: &Ground<'_>,
        warm_up: u32,
        seed: u64,
        stream: u32,
        memory: &'w mut [u32],
    ) -> Result<Self, ChainError> {
        let (mut around, _) = Around::new(search, 0, memory)?;
        let factor = around.metric.factor();
        if factor.len() != ground.factor.len() || !around.held.count(ground.counts) {
            return Err(ChainError::Config);
        }
        around.metric.factor().copy_from_slice(ground.factor);
        // The pilot has stream 0 of seed 0.
        let walk = Walk::new(around, Rng::new(seed, stream + 1))?;
        let fingerprint = Fnv64::default();
        Ok(Self { walk, steps: 0, warm_up, accepted: 0, fingerprint })
    }

    /// Makes one step.
    pub fn step(&mut self) -> Outcome {
        let outcome = if self.warm() {
            self.walk.step(self.walk.ln_angle[1])
        } else {
            self.walk.step_and_adapt()
        };
        self.steps += 1;
        if outcome == Outcome::Accepted {
            self.accepted += 1;
            self.fingerprint.write_f32(&self.walk.state.position);
        }
        outcome
    }

    /// Whether the warm-up is over.
    pub fn warm(&self) -> bool {
        self.steps >= self.warm_up
    }

    /// The subject of the state.
    pub fn subject(&self) -> Subject {
        self.walk.target.0.held.subject(&mut self.walk.unknowns())
    }

    /// Its views, photo by photo.
    pub fn views(&self) -> impl Iterator<Item = View> {
        self.walk.target.0.held.views(self.walk.unknowns())
    }

    /// Log density of the state, up to a constant.
    pub fn ln_density(&self) -> f64 {
        -self.walk.state.energy
    }

    /// Steps, and accepted ones.
    pub fn tally(&self) -> (u32, u32) {
        (self.steps, self.accepted)
    }

    /// Hash of every accepted state.
    pub fn fingerprint(&self) -> u64 {
        self.fingerprint.finish()
    }
}
