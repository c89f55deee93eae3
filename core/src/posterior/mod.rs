//! A sampler of the posterior around its mode.
//!
//! What is sampled is the density that the search for the mode climbs, but with those points of the surface
//! held that the photo shows at the mode (`search/held.rs`).
//!
//! States are `x = mode ⊕ u`: a rotation vector about the object's origin, places, logarithms of
//! focal length and distance, coefficients, light and colours ([`crate::search::unknowns`]). In
//! `v = U u`, where `A = UᵀU` is roughly the posterior's precision ([`Metric`]), the posterior is nearly a
//! standard normal, and trajectories ([`hamiltonian`]) go from one end of it to the other in a few turns.
//!
//! Chains begin with the Gauss–Newton matrix of the mode. They warm up in rounds, whose states are thrown
//! away. In each, a chain notes positions and forces that it meets ([`Sampler::places`]); from those of all
//! chains together comes a better metric ([`improve`]), and along turns of the head, where the posterior is
//! bent, its width ([`widen`]); all chains adopt it. How far they turn at once is adapted as well. After the
//! warm-up both stay as they are.

pub mod hamiltonian;
#[cfg(test)]
mod joint;
mod metric;
mod precision;

use crate::chain::{ChainError, Problem};
use crate::hash::Fnv64;
use crate::least_squares::matrix_words;
use crate::math;
use crate::memory::Carver;
use crate::metropolis::{self, Outcome};
use crate::rng::Rng;
use crate::scene::{Subject, View};
use crate::search::unknowns::Layout;
use crate::search::{Held, ModeSearch, Options, Part, held_words, instance_words};
use core::f64::consts::FRAC_PI_2;
use hamiltonian::{Density, Field, State, Trajectory};
pub use metric::Metric;
pub use precision::{improve, improve_words, widen};
use serde::{Deserialize, Serialize};

/// The most unknowns there may be.
pub const MAX_UNKNOWNS: usize = Layout::MOST.len();
/// Acceptance that the angle is adapted to.
const ACCEPTANCE: f64 = 0.88;
/// By how much a step changes the angle's logarithm at first, and as how many steps what was adapted in
/// other coordinates counts.
const GAIN: f64 = 0.5;
const KNOWN: u32 = 8;
/// Angles between which it is adapted, radians.
const ANGLES: [f64; 2] = [0.05, 1.0];
/// The angle to begin with.
const ANGLE: f64 = 0.2;
/// How far trajectories go, in quarter turns, one time out of two each: after an odd number of them the start
/// and its distance are forgotten, were the metric right. The longer ones are for where the posterior is
/// wider than that.
const QUARTERS: [f64; 2] = [1.0, 3.0];
/// By how many radians they are longer or shorter, so that no orbit closes.
const SLACK: f64 = 0.35;

/// A number per unknown.
pub type Unknowns = heapless::Vec<f32, MAX_UNKNOWNS>;

fn layout(problem: &Problem<'_>, options: &Options<'_>) -> Layout {
    let d = problem.dimensions();
    let views = 1 + options.others.len();
    Layout { shape_rank: d.shape_rank, albedo_rank: d.albedo_rank, views }
}

/// Words of memory that a [`Sampler`] of a problem needs besides its search's, with room for `places` places
/// ([`Sampler::places`]).
pub fn words(problem: &Problem<'_>, options: &Options<'_>, places: usize) -> usize {
    let photos = core::iter::once(&problem.photo).chain(options.others);
    let sizes = photos.map(|photo| [photo.image.width, photo.image.height].map(|n| n as usize));
    let layout = layout(problem, options);
    let (vertices, triangles) = (problem.model.vertices(), problem.model.triangles.len());
    matrix_words(layout.len())
        + held_words(vertices, layout, sizes)
        + instance_words(vertices, triangles)
        + 2 * layout.len() * places
}

/// A density around a mode.
struct Around<'a, 'w, const OTHERS: usize> {
    held: Held<'a, 'w, OTHERS>,
    metric: Metric<'w>,
    /// Places: position and force, one after the other.
    places: &'w mut [f32],
    /// Numbers of these that have been noted.
    noted: usize,
}

impl<'a, 'w, const OTHERS: usize> Around<'a, 'w, OTHERS> {
    /// Around what a search has found, in its metric, looking at a part of the model if there is one, with
    /// room for so many places.
    fn new(
        search: ModeSearch<'a, 'w, OTHERS>,
        part: Option<&'a Part<'a>>,
        places: usize,
        memory: &'w mut [u32],
    ) -> Result<Self, ChainError> {
        let n = search.layout().len();
        if n > MAX_UNKNOWNS {
            return Err(ChainError::Photos { found: 1 + OTHERS });
        }
        let instance = part.map_or(0, Part::instance_words);
        let needed = matrix_words(n) + Held::words(&search) + instance + 2 * n * places;
        let error = ChainError::Memory { needed, found: memory.len() };
        let mut carver = Carver::new(memory);
        let factor = carver.floats(matrix_words(n)).ok_or(error)?;
        let mut held = Held::new(search, &mut carver).ok_or(error)?;
        held.factorise(factor).ok_or(ChainError::Config)?;
        let metric = Metric::new(n, factor.as_chunks_mut().0).ok_or(error)?;
        if let Some(part) = part {
            held.look_at(part, &mut carver).ok_or(error)?;
        }
        let places = carver.floats(2 * n * places).ok_or(error)?;
        Ok(Self { held, metric, places, noted: 0 })
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

    /// Notes a place, if there is room.
    fn note(&mut self, position: &[f32], force: &[f32]) {
        let room = self.places.get_mut(self.noted..).unwrap_or_default();
        if room.len() >= position.len() + force.len() {
            for (to, x) in room.iter_mut().zip(position.iter().chain(force)) {
                *to = *x;
            }
            self.noted += position.len() + force.len();
        }
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
        self.note(position, force);
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
struct Walk<F> {
    target: Density<F>,
    state: State,
    rng: Rng,
    /// Logarithm of the angle, and its average since it is adapted.
    ln_angle: [f64; 2],
    /// Steps that adapted it.
    adapted: u32,
}

impl<F: Field> Walk<F> {
    /// Begins at a draw of the normal approximation, of so many unknowns.
    fn new(field: F, unknowns: usize, mut rng: Rng) -> Result<Self, ChainError> {
        let mut target = Density(field);
        let mut position = Unknowns::new();
        // At most as many as there is room for.
        let _ = position.resize(unknowns, 0.0);
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
        let angle = math::exp(ln_angle) * (0.8 + 0.4 * self.rng.uniform());
        let quarters = QUARTERS[usize::from(self.rng.uniform() < 0.5)];
        let way = quarters * FRAC_PI_2 + SLACK * (2.0 * self.rng.uniform() - 1.0);
        let turns = (way / angle + 0.5) as u32;
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
        *now = (*now + GAIN * miss / math::sqrt_f64(k))
            .clamp(math::ln(ANGLES[0]), math::ln(ANGLES[1]));
        // The later a step, the more it counts.
        *average += 2.0 / (k + 1.0) * (*now - *average);
        outcome
    }
}

impl<const OTHERS: usize> Walk<Around<'_, '_, OTHERS>> {
    fn unknowns(&self) -> Unknowns {
        self.target.0.step(&self.state.position)
    }
}

/// A posterior in Laplace's approximation.
pub struct Laplace {
    /// Standard deviations of the unknowns; order and units are those of [`crate::search::unknowns`].
    pub deviations: Unknowns,
    /// Logarithm of the marginal likelihood, `ln p(photos | model)`,
    ///
    /// `1/patch · Σ ln h − E − ½ ln|A| − Σ ln sᵢ`
    ///
    /// of the density `h` of all pixels under the background, the mode's energy `E`, the precision `A` and
    /// the prior standard deviations `sᵢ` of the coefficients; up to a constant that depends on photos and
    /// settings alone, so that models, of whatever rank, may be compared on the same photos.
    pub ln_evidence: f64,
}

/// Laplace's approximation around a mode: the posterior as the normal distribution that has the mode's
/// Gauss–Newton matrix. `memory` is [`words`] long.
///
/// # Errors
/// [`ChainError::Memory`] if the memory is shorter; [`ChainError::Config`] if nothing of the face is seen at
/// the mode.
pub fn laplace<'w, const OTHERS: usize>(
    search: ModeSearch<'_, 'w, OTHERS>,
    memory: &'w mut [u32],
) -> Result<Laplace, ChainError> {
    let ln_mode = search.ln_mode();
    let around = Around::new(search, None, 0, memory)?;
    let mut step = Unknowns::new();
    // There is room for all.
    let _ = step.resize(around.unknowns(), 0.0);
    let mut deviations = step.clone();
    around.metric.variances(&mut step, &mut deviations);
    for x in &mut deviations {
        *x = math::sqrt(*x);
    }
    Ok(Laplace { deviations, ln_evidence: ln_mode - around.metric.ln_pivots() })
}

/// Where a chain stands, and how far it turns at once. One around the same mode that goes on from there, in
/// the same metric, does so with the same bits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Standing {
    position: Unknowns,
    force: Unknowns,
    energy: f64,
    rng: Rng,
    ln_angle: [f64; 2],
    adapted: u32,
    steps: u32,
    accepted: u32,
    fingerprint: Fnv64,
}

/// A running chain.
pub struct Sampler<'a, 'w, const OTHERS: usize = 0> {
    walk: Walk<Around<'a, 'w, OTHERS>>,
    steps: u32,
    accepted: u32,
    fingerprint: Fnv64,
}

impl<'a, 'w, const OTHERS: usize> Sampler<'a, 'w, OTHERS> {
    /// Chain number `stream` of a seed, around the mode that a search has found. It looks at the [`Part`] of
    /// the model that was made of the same search, has room for `places` places, and begins at a draw of the
    /// normal distribution with the mode's metric. `memory` is [`words`] long.
    ///
    /// # Errors
    /// [`ChainError::Memory`] if the memory is shorter, or the part another search's; [`ChainError::Config`]
    /// if nothing of the face is seen at the mode.
    pub fn new(
        search: ModeSearch<'a, 'w, OTHERS>,
        part: &'a Part<'a>,
        places: usize,
        seed: u64,
        stream: u32,
        memory: &'w mut [u32],
    ) -> Result<Self, ChainError> {
        let around = Around::new(search, Some(part), places, memory)?;
        let unknowns = around.unknowns();
        let walk = Walk::new(around, unknowns, Rng::new(seed, stream))?;
        Ok(Self { walk, steps: 0, accepted: 0, fingerprint: Fnv64::default() })
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.walk.target.0.unknowns()
    }

    /// Makes a step of the warm-up, which adapts how far the chain turns at once.
    pub fn warm_up(&mut self) -> Outcome {
        self.walk.step_and_adapt()
    }

    /// Places that the warm-up has met since this was called last, as far as there was room: positions and
    /// forces in turn, each with a number per unknown.
    pub fn places(&mut self) -> &[f32] {
        let Around { places, noted, .. } = &mut self.walk.target.0;
        places.get(..core::mem::take(noted)).unwrap_or_default()
    }

    /// How the head turns as the position changes: for every view three directions, whose products with a
    /// position are the view's rotation vector, radians.
    pub fn turns(&self) -> impl Iterator<Item = Unknowns> {
        let Around { held, metric, .. } = &self.walk.target.0;
        let layout = held.layout();
        let unknowns = (0..layout.views).flat_map(move |view| layout.pose(view).take(3));
        unknowns.map(move |unknown| {
            let mut direction = Unknowns::new();
            // There is room for all.
            let _ = direction.resize(layout.len(), 0.0);
            if let Some(one) = direction.get_mut(unknown) {
                *one = 1.0;
            }
            metric.solve_transposed(&mut direction);
            direction
        })
    }

    /// Changes to other coordinates, which [`improve`] or [`widen`] has found, and adapts anew.
    pub fn adopt(&mut self, change: &Metric<'_>) {
        let Walk { target: Density(around), state, .. } = &mut self.walk;
        around.metric.change(change);
        change.multiply(&mut state.position);
        change.solve_transposed(&mut state.force);
        let [now, average] = &mut self.walk.ln_angle;
        *now = *average;
        self.walk.adapted = self.walk.adapted.min(KNOWN);
    }

    /// How far it turns at once, radians, by what has been adapted.
    pub fn angle(&self) -> f64 {
        math::exp(self.walk.ln_angle[1])
    }

    /// Sets how far it turns at once, radians; an angle out of the sensible range is moved into it.
    pub fn turn_by(&mut self, angle: f64) {
        self.walk.ln_angle = [math::ln(angle.clamp(ANGLES[0], ANGLES[1])); 2];
    }

    /// Makes one step.
    pub fn step(&mut self) -> Outcome {
        let outcome = self.walk.step(self.walk.ln_angle[1]);
        self.steps += 1;
        if outcome == Outcome::Accepted {
            self.accepted += 1;
            self.fingerprint.write_f32(&self.walk.state.position);
        }
        outcome
    }

    /// The numbers of its metric, which all chains around a mode have in common.
    pub fn metric(&self) -> &[f32] {
        self.walk.target.0.metric.numbers()
    }

    /// What it takes, in its metric, to go on from here.
    pub fn standing(&self) -> Standing {
        let State { position, force, energy } = self.walk.state.clone();
        let Walk { ref rng, ln_angle, adapted, .. } = self.walk;
        let Self { steps, accepted, fingerprint, .. } = *self;
        let rng = rng.clone();
        Standing { position, force, energy, rng, ln_angle, adapted, steps, accepted, fingerprint }
    }

    /// Goes on in another's [`Sampler::metric`], from a standing in that, and forgets the places it met.
    /// `false`, and nothing changes, if that is not of as many unknowns.
    pub fn go_on_in(&mut self, metric: &[f32]) -> bool {
        let Around { metric: own, noted, .. } = &mut self.walk.target.0;
        let alike = own.take(metric);
        if alike {
            *noted = 0;
        }
        alike
    }

    /// Goes on from where another stood in the same metric; `false`, and nothing changes, if that has
    /// not as many unknowns.
    pub fn go_on_from(&mut self, standing: &Standing) -> bool {
        let Standing { position, force, energy, rng, .. } = standing.clone();
        let n = self.unknowns();
        if [&position, &force].iter().any(|numbers| numbers.len() != n) {
            return false;
        }
        self.walk.state = State { position, force, energy };
        self.walk.rng = rng;
        (self.walk.ln_angle, self.walk.adapted) = (standing.ln_angle, standing.adapted);
        (self.steps, self.accepted) = (standing.steps, standing.accepted);
        self.fingerprint = standing.fingerprint;
        true
    }

    /// The subject of the state.
    pub fn subject(&self) -> Subject {
        self.walk.target.0.held.subject(&mut self.walk.unknowns())
    }

    /// The views of the state, photo by photo.
    pub fn views(&self) -> impl Iterator<Item = View> {
        self.walk.target.0.held.views(self.walk.unknowns())
    }

    /// Log density of the state, up to a constant.
    pub fn ln_density(&self) -> f64 {
        -self.walk.state.energy
    }

    /// Steps since the warm-up, and accepted ones.
    pub fn tally(&self) -> (u32, u32) {
        (self.steps, self.accepted)
    }

    /// Hash of every accepted state since the warm-up.
    pub fn fingerprint(&self) -> u64 {
        self.fingerprint.finish()
    }
}
