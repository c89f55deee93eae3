//! A sampler of the posterior around its mode.
//!
//! What is sampled is what the search for the mode lowers, with the mask held as the mode has it
//! (`search/held.rs`).
//!
//! States are `x = mode ⊕ u`: a rotation vector about the object's origin, places, logarithms of
//! focal length and distance, coefficients, light and colours ([`crate::search::unknowns`]). In
//! `v = U u`, where `A = UᵀU` is the Gauss–Newton matrix of the mode ([`Metric`]), the posterior is
//! about a standard normal, and trajectories ([`hamiltonian`]) go from one end of it to the other in
//! a few turns. During a warm-up, which is thrown away, their angle is adapted; then it is held.
//!
//! On a photo at 199 + 199 components about a third of the trajectories were accepted before there was
//! shade (`search/image_term.rs`), of which the metric knows nothing: now it is fewer. Some parameters
//! (complexion against light, yaw against shape) hardly mix in hundreds of them.

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
use crate::search::{Held, ModeSearch, Options};
use hamiltonian::{Density, Field, State, Trajectory};
pub use metric::Metric;

/// The most unknowns there may be.
pub const MAX_UNKNOWNS: usize = Layout::MOST.len();
/// Pixels whose rows make the metric.
const METRIC_PIXELS: usize = 6000;
/// Acceptance that the angle is adapted to. What parts of a surface hide from each other, and other
/// things that forces do not tell of, cost some at any angle.
const ACCEPTANCE: f64 = 0.4;
/// Angles between which it is adapted, radians.
const ANGLES: [f64; 2] = [0.1, 0.35];
/// How far trajectories go, radians: a quarter turn would forget the start.
const WAY: f64 = 1.2;

/// A number per unknown.
pub type Unknowns = heapless::Vec<f32, MAX_UNKNOWNS>;

/// Words of memory a [`Sampler`] of a problem needs besides its search's.
pub fn words(problem: &Problem<'_>, options: &Options<'_>) -> usize {
    let d = problem.dimensions();
    let views = 1 + options.others.len();
    let layout = Layout { shape_rank: d.shape_rank, albedo_rank: d.albedo_rank, views };
    matrix_words(layout.len())
}

/// The density that is sampled.
struct Around<'a, 'w, const OTHERS: usize> {
    held: Held<'a, 'w, OTHERS>,
    metric: Metric<'w>,
}

impl<const OTHERS: usize> Around<'_, '_, OTHERS> {
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

/// A running sampler.
pub struct Sampler<'a, 'w, const OTHERS: usize = 0> {
    target: Density<Around<'a, 'w, OTHERS>>,
    state: State,
    rng: Rng,
    /// Logarithm of the angle, adapted, and its average over the warm-up.
    ln_angle: [f64; 2],
    steps: u32,
    warm_up: u32,
    accepted: u32,
    turns: u64,
    fingerprint: Fnv64,
}

impl<'a, 'w, const OTHERS: usize> Sampler<'a, 'w, OTHERS> {
    /// Number `stream` of a seed, around the mode that a search has found; it begins at a draw of
    /// the mode's normal approximation. `memory` is [`words`] long. The first `warm_up` steps adapt
    /// it.
    ///
    /// # Errors
    /// [`ChainError::Memory`] if the memory is shorter; [`ChainError::Config`] of a mode that
    /// nothing is seen of, or whose metric is singular.
    pub fn new(
        mut search: ModeSearch<'a, 'w, OTHERS>,
        warm_up: u32,
        seed: u64,
        stream: u32,
        memory: &'w mut [u32],
    ) -> Result<Self, ChainError> {
        let n = search.layout().len();
        if n > MAX_UNKNOWNS {
            return Err(ChainError::Photos { found: 1 + OTHERS });
        }
        let needed = matrix_words(n);
        let error = ChainError::Memory { needed, found: memory.len() };
        let factor = Carver::new(memory).floats(matrix_words(n)).ok_or(error)?;
        search.factorise(METRIC_PIXELS, factor).ok_or(ChainError::Config)?;
        let metric = Metric::new(n, factor.as_chunks().0).ok_or(error)?;
        let mut target = Density(Around { held: Held::new(search), metric });
        let mut rng = Rng::new(seed, stream);
        let mut position = Unknowns::new();
        // At most as many as there is room for.
        let _ = position.resize(n, 0.0);
        let mut state = State { force: position.clone(), position, energy: f64::INFINITY };
        // Nearer if that is where the sampler may not go.
        for spread in [1.0, 0.3, 0.0] {
            for v in &mut state.position {
                *v = spread * rng.normal() as f32;
            }
            let State { position, force, energy } = &mut state;
            if let Some(found) = target.0.energy(position, force) {
                *energy = found;
                break;
            }
        }
        if !state.energy.is_finite() {
            return Err(ChainError::Config);
        }
        let ln_angle = [math::ln(0.2); 2];
        let (steps, accepted, turns) = (0, 0, 0);
        let fingerprint = Fnv64::default();
        Ok(Self { target, state, rng, ln_angle, steps, warm_up, accepted, turns, fingerprint })
    }

    /// Makes one step.
    pub fn step(&mut self) -> Outcome {
        let ln_angle = self.ln_angle[usize::from(self.warm())];
        // Never twice the same, so that no orbit closes.
        let angle = math::exp(ln_angle) * (0.8 + 0.4 * self.rng.uniform());
        let turns = (WAY / angle + 0.5) as u32;
        let mut moves = Trajectory { angle, turns };
        let mut density = [-self.state.energy];
        let Self { target, state, rng, .. } = self;
        let outcome = metropolis::step(target, &mut moves, 0, 1, state, &mut density, rng);
        let accepted = outcome == Outcome::Accepted;
        self.steps += 1;
        self.turns += u64::from(turns);
        self.accepted += u32::from(accepted);
        if self.steps <= self.warm_up {
            self.adapt(accepted);
        }
        if accepted {
            self.fingerprint.write_f32(&self.state.position);
        }
        outcome
    }

    /// Adapts the angle.
    fn adapt(&mut self, accepted: bool) {
        let k = f64::from(self.steps);
        let miss = if accepted { 1.0 - ACCEPTANCE } else { -ACCEPTANCE };
        let [now, average] = &mut self.ln_angle;
        *now = (*now + miss / math::sqrt_f64(k)).clamp(math::ln(ANGLES[0]), math::ln(ANGLES[1]));
        // The later a step, the more it counts.
        let share = 2.0 / (k + 1.0);
        *average += share * (*now - *average);
    }

    /// Whether the warm-up is over.
    pub fn warm(&self) -> bool {
        self.steps >= self.warm_up
    }

    /// The step of the state from the mode, see [`crate::search::unknowns`].
    pub fn unknowns(&self) -> Unknowns {
        self.target.0.step(&self.state.position)
    }

    /// The subject of the state.
    pub fn subject(&self) -> Subject {
        self.target.0.held.subject(&mut self.unknowns())
    }

    /// Its views, photo by photo.
    pub fn views(&self) -> impl Iterator<Item = View> {
        self.target.0.held.views(self.unknowns())
    }

    /// Log density of the state, up to a constant.
    pub fn ln_density(&self) -> f64 {
        -self.state.energy
    }

    /// The mode's metric.
    pub fn metric(&self) -> &Metric<'w> {
        &self.target.0.metric
    }

    /// Angle of a turn, radians.
    pub fn angle(&self) -> f64 {
        math::exp(self.ln_angle[1])
    }

    /// Steps, accepted ones, and turns.
    pub fn tally(&self) -> (u32, u32, u64) {
        (self.steps, self.accepted, self.turns)
    }

    /// Hash of every accepted state.
    pub fn fingerprint(&self) -> u64 {
        self.fingerprint.finish()
    }
}
