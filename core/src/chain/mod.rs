//! The Metropolis–Hastings chain: one step at a time, driven by the caller.
//!
//! A fit goes through the phases of its [`Schedule`], as in the paper: of a face, the *landmark* phase
//! moves the pose alone and looks at the landmarks alone; the *image* phase starts from its best
//! state, moves everything and looks at the picture. Between them there may be a *shape* phase,
//! which moves pose and shape and looks at the landmarks.
//!
//! A proposal passes three tests in turn, each cheaper than the next: landmarks,
//! prior, image. A test accepts with probability `min(1, ratio of its factor)`; the product of the
//! three satisfies detailed balance for the product of the factors, and most bad proposals never
//! cost a rendering. What corrects for the way a proposal was drawn belongs to the first test.

mod config;
mod dimensions;
mod pipeline;
mod problem;
pub mod schedule;
mod target;

use crate::hash::Fnv64;
use crate::likelihood::landmarks::{Landmarks, Points};
use crate::memory::Carver;
pub use crate::metropolis::Outcome;
use crate::metropolis::{self, Factors};
use crate::proposal::{Branch, CENTRES, Half, MAX_LEAVES, Table, Touched};
use crate::rng::Rng;
use crate::scene::{Scene, Subject};
pub use config::Config;
pub use dimensions::Dimensions;
use pipeline::{Pipeline, Proposed};
pub use problem::{ChainError, Photo, Problem};
use schedule::{Begin, IMAGE, MAX_PHASES, Phase};
pub use schedule::{PhaseName, Schedule};
use serde::{Deserialize, Serialize};
use target::{LnFactors, Mixture, Posterior};

/// One step of the chain.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// The phase it belongs to.
    pub phase: PhaseName,
    /// Which leaf of the phase's [`Table`] made the proposal.
    pub branch: usize,
    /// What became of it.
    pub outcome: Outcome,
}

/// Log densities of a hypothesis, factor by factor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Density {
    /// Landmark likelihood.
    pub landmarks: f64,
    /// Prior.
    pub prior: f64,
    /// Image likelihood; 0 in the phases that do not look at it.
    pub image: f64,
}

impl Density {
    const fn of([landmarks, prior, image]: LnFactors) -> Self {
        Self { landmarks, prior, image }
    }

    const fn factors(self) -> LnFactors {
        [self.landmarks, self.prior, self.image]
    }

    /// Log density of the chain's target, up to a constant.
    pub fn posterior(&self, config: &Config) -> f64 {
        self.landmarks + self.prior + self.image / f64::from(config.pixel_patch)
    }
}

/// A hypothesis with its densities.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// The hypothesis.
    pub scene: Scene,
    /// Its densities.
    pub density: Density,
}

/// How often a leaf proposed and how often it was accepted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tally {
    /// Proposals.
    pub proposed: u32,
    /// Acceptances.
    pub accepted: u32,
}

type Tallies = heapless::Vec<Tally, MAX_LEAVES>;

/// Everything a chain has to remember; the rest of its memory can be computed from it. A chain resumed
/// from its checkpoint goes on with the same bits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    /// Number of the next step's phase in the [`Schedule`].
    pub phase: u8,
    /// Steps done in this phase.
    pub step: u32,
    /// Steps so far that rendered and compared the picture.
    pub image_evaluated: u32,
    /// The current state.
    pub state: State,
    /// The state of highest target density in this phase.
    pub best: State,
    /// The state that the latest phase to look at the picture began with.
    pub initial: Option<State>,
    /// The random stream.
    pub rng: Rng,
    /// Hash of every accepted state.
    pub fingerprint: Fnv64,
    /// Acceptance per leaf, by phase.
    pub tallies: heapless::Vec<Tallies, MAX_PHASES>,
}

/// A running fit.
pub struct Chain<'a, 'w> {
    target: Posterior<'a, 'w>,
    tables: heapless::Vec<Table, MAX_PHASES>,
    progress: Checkpoint,
}

impl<'a, 'w> Chain<'a, 'w> {
    /// A chain at the mean face, one metre away. `stream` numbers the chains of one seed.
    ///
    /// # Errors
    /// Whatever in the problem does not fit together, see [`ChainError`].
    pub fn new(
        problem: Problem<'a>,
        seed: u64,
        stream: u32,
        memory: &'w mut [u32],
    ) -> Result<Self, ChainError> {
        // A chain is some kilobytes, and stacks can be small: it is made where it is returned, and
        // what that takes is gone before it renders.
        let mut result = Self::prepare(problem, seed, stream, memory);
        if let Ok(chain) = &mut result {
            chain.begin();
        }
        result
    }

    /// A chain that knows its first state, but not its density.
    #[inline(never)]
    fn prepare(
        problem: Problem<'a>,
        seed: u64,
        stream: u32,
        memory: &'w mut [u32],
    ) -> Result<Self, ChainError> {
        let Problem { model, photo: Photo { image, .. }, config, .. } = problem;
        let rank = |wanted: usize, available: usize| wanted.min(available);
        let scene = Scene::initial(
            image.width,
            image.height,
            rank(config.shape_rank, model.shape.rank()),
            rank(config.albedo_rank, model.albedo.rank()),
        );
        let density = Density { landmarks: 0.0, prior: 0.0, image: 0.0 };
        let state = State { scene, density };
        let progress = Checkpoint {
            phase: 0,
            step: 0,
            image_evaluated: 0,
            best: state.clone(),
            state,
            initial: None,
            rng: Rng::new(seed, stream),
            fingerprint: Fnv64::default(),
            tallies: heapless::Vec::new(),
        };
        Self::assemble(problem, progress, memory)
    }

    /// Counts nothing yet, and evaluates the first state.
    #[inline(never)]
    fn begin(&mut self) {
        // As many as phases, and as leaves.
        let _ = self.progress.tallies.resize_default(self.tables.len());
        for (tallies, table) in self.progress.tallies.iter_mut().zip(&self.tables) {
            let _ = tallies.resize_default(table.len());
        }
        self.progress.state.density = self.evaluate_current();
        self.progress.best.clone_from(&self.progress.state);
        let Problem { schedule, config, .. } = self.target.problem;
        let first = schedule.next(0, config);
        if first > 0 {
            self.enter(first);
        }
    }

    /// The chain a checkpoint was taken of, on the same problem.
    ///
    /// # Errors
    /// As [`Chain::new`], and [`ChainError::Checkpoint`] if it belongs to another problem.
    pub fn resume(
        problem: Problem<'a>,
        checkpoint: Checkpoint,
        memory: &'w mut [u32],
    ) -> Result<Self, ChainError> {
        let size = [problem.photo.image.width, problem.photo.image.height];
        let scenes = [&checkpoint.state.scene, &checkpoint.best.scene];
        let initial = checkpoint.initial.as_ref().map(|state| &state.scene);
        let Subject { shape, albedo } = &checkpoint.state.scene.subject;
        if scenes.into_iter().chain(initial).any(|scene| {
            scene.view.camera.image_size != size
                || scene.subject.shape.len() != shape.len()
                || scene.subject.albedo.len() != albedo.len()
        }) || shape.len() > problem.model.shape.rank().min(problem.config.shape_rank)
            || albedo.len() > problem.model.albedo.rank().min(problem.config.albedo_rank)
            || usize::from(checkpoint.phase) >= problem.schedule.phases.len()
        {
            return Err(ChainError::Checkpoint);
        }
        let mut chain = Self::assemble(problem, checkpoint, memory)?;
        let fits = |t: &(&Tallies, &Table)| t.0.len() == t.1.len();
        let tallies = &chain.progress.tallies;
        if tallies.len() != chain.tables.len()
            || !tallies.iter().zip(&chain.tables).all(|t| fits(&t))
        {
            return Err(ChainError::Checkpoint);
        }
        let looked_at = chain.looked_at();
        let best = Density::of(chain.target.evaluate(&chain.progress.best.scene, looked_at));
        if best != chain.progress.best.density
            || chain.evaluate_current() != chain.progress.state.density
        {
            return Err(ChainError::Checkpoint);
        }
        Ok(chain)
    }

    /// Checks the problem and carves the memory.
    #[inline(never)]
    fn assemble(
        problem: Problem<'a>,
        progress: Checkpoint,
        memory: &'w mut [u32],
    ) -> Result<Self, ChainError> {
        problem.check()?;
        let Problem { model, photo, config, .. } = problem;
        let Photo { image, landmarks, .. } = photo;
        let observed = photo.check(model)?;
        let centres = CENTRES.map(|name| landmarks.iter().position(|l| l.name == name));
        let scene = &progress.state.scene;
        let applies = |branch: &Branch| {
            let rank = match branch.kind.half() {
                Some(Half::Shape) => scene.subject.shape.len(),
                Some(Half::Albedo) => scene.subject.albedo.len(),
                None => 1,
            };
            rank > 0
                && branch.centre.is_none_or(|c| centres.get(c).is_some_and(Option::is_some))
                && (config.solve_light || !branch.kind.steers())
        };
        let mut tables = heapless::Vec::new();
        for phase in problem.schedule.phases {
            // What steers looks at the picture.
            let may_look = phase.factors & IMAGE != 0;
            let applies = |branch: &Branch| applies(branch) && (may_look || !branch.kind.steers());
            let table = Table::new(phase.moves, applies).ok_or(ChainError::Schedule)?;
            tables.push(table).map_err(|_| ChainError::Schedule)?;
        }
        if tables.is_empty() {
            return Err(ChainError::Schedule);
        }

        let dimensions = problem.dimensions();
        let error = ChainError::Memory { needed: dimensions.words(), found: memory.len() };
        if memory.len() < dimensions.words() {
            return Err(error);
        }
        let mut carver = Carver::new(memory);
        let pipeline = Pipeline::carve(&mut carver, &dimensions, image.pixels).ok_or(error)?;
        let landmarks = Landmarks::gather(
            &mut carver,
            model,
            &observed,
            dimensions.shape_rank,
            config.landmark_sd,
        )
        .ok_or(error)?;
        let (points, proposed) = (Points::new(), Points::new());
        let target = Posterior { problem, centres, landmarks, points, proposed, pipeline };
        Ok(Self { target, tables, progress })
    }

    /// Makes one step; `None` when the fit is done.
    pub fn step(&mut self) -> Option<Step> {
        let Problem { schedule, config, .. } = self.target.problem;
        let number = usize::from(self.progress.phase);
        let phase = self.current()?;
        let end = (phase.steps)(config);
        if self.progress.step >= end {
            return None;
        }
        let branch = self.tables.get(number)?.pick(&mut self.progress.rng);
        let outcome = self.try_branch(phase, number, branch);
        // There are as many as leaves.
        let tallies = self.progress.tallies.get_mut(number);
        if let Some(tally) = tallies.and_then(|tallies| tallies.get_mut(branch)) {
            tally.proposed += 1;
            tally.accepted += u32::from(outcome == Outcome::Accepted);
        }
        self.progress.step += 1;
        if self.progress.step == end && number + 1 < schedule.phases.len() {
            self.enter(schedule.next(number + 1, config));
        }
        Some(Step { phase: phase.name, branch, outcome })
    }

    /// The current phase.
    fn current(&self) -> Option<&'a Phase> {
        self.target.problem.schedule.phase(self.progress.phase)
    }

    fn try_branch(&mut self, phase: &Phase, number: usize, branch: usize) -> Outcome {
        let Self { target, tables, progress } = self;
        let Some(table) = tables.get(number) else { return Outcome::Failed };
        let State { scene, density } = &mut progress.state;
        let (factors, rng) = (phase.factors, &mut progress.rng);
        let mut values = density.factors();
        let outcome =
            metropolis::step(target, &mut Mixture(table), branch, factors, scene, &mut values, rng);
        *density = Density::of(values);
        let judged_by_last = outcome == Outcome::Accepted || outcome == Outcome::Rejected(2);
        progress.image_evaluated += u32::from(judged_by_last && factors & IMAGE != 0);
        if outcome == Outcome::Accepted {
            self.record();
        }
        outcome
    }

    /// Fingerprint and best state after an acceptance.
    fn record(&mut self) {
        let progress = &mut self.progress;
        for &parameter in progress.state.scene.parameters() {
            progress.fingerprint.write_f32(&[parameter]);
        }
        let posterior = |state: &State| state.density.posterior(self.target.problem.config);
        if posterior(&progress.state) > posterior(&progress.best) {
            progress.best.clone_from(&progress.state);
        }
    }

    /// Begins phase number `next`.
    fn enter(&mut self, next: usize) {
        self.progress.phase = next as u8;
        self.progress.step = 0;
        if self.current().is_some_and(|phase| phase.begin == Begin::Best) {
            self.progress.state.clone_from(&self.progress.best);
        }
        self.progress.state.density = self.evaluate_current();
        self.progress.best.clone_from(&self.progress.state);
        if self.looked_at() & IMAGE != 0 {
            self.progress.initial = Some(self.progress.state.clone());
        }
    }

    /// All densities of the current state, from scratch; fills the target's buffers.
    fn evaluate_current(&mut self) -> Density {
        let looked_at = self.looked_at();
        Density::of(self.target.begin(&self.progress.state.scene, looked_at))
    }

    /// All densities of a hypothesis, computed from scratch. The chain's state stays as it is.
    pub fn evaluate(&mut self, scene: &Scene) -> Density {
        let looked_at = self.looked_at();
        Density::of(self.target.evaluate(scene, looked_at))
    }

    /// The factors that the current phase looks at.
    fn looked_at(&self) -> Factors {
        self.current().map_or(0, |phase| phase.factors)
    }

    /// What to save to go on later.
    pub fn checkpoint(&self) -> &Checkpoint {
        &self.progress
    }

    /// The current state.
    pub fn state(&self) -> &State {
        &self.progress.state
    }

    /// The state of highest target density in this phase.
    pub fn best(&self) -> &State {
        &self.progress.best
    }

    /// Hash of every accepted state so far.
    pub fn fingerprint(&self) -> u64 {
        self.progress.fingerprint.finish()
    }

    /// Steps done and steps in all, over all phases.
    pub fn progress(&self) -> (u32, u32) {
        let Problem { schedule, config, .. } = self.target.problem;
        let before = schedule.steps_before(self.progress.phase.into(), config);
        let all = schedule.steps_before(schedule.phases.len(), config);
        (before.saturating_add(self.progress.step), all)
    }

    /// The phase of the next step.
    pub fn phase(&self) -> PhaseName {
        self.current().map_or(PhaseName::Image, |phase| phase.name)
    }

    /// Acceptance per leaf of a phase; of none, if the schedule has no such phase.
    pub fn tallies(&self, name: PhaseName) -> impl Iterator<Item = (Branch, Tally)> {
        let phases = self.target.problem.schedule.phases.iter().zip(&self.tables);
        let phases = phases.zip(&self.progress.tallies);
        let of_name = phases.filter(move |((phase, _), _)| phase.name == name);
        of_name.flat_map(|((_, table), tallies)| table.branches().zip(tallies.iter().copied()))
    }

    /// How well a hypothesis fits the picture and the landmarks. The chain's state stays as it is.
    pub fn quality(&mut self, scene: &Scene) -> Quality {
        let points = self.target.landmarks.points(&scene.subject.shape);
        let new = Proposed { problem: self.target.problem, scene, touched: Touched::ALL };
        self.target.pipeline.update(&new);
        let (covered, pixel_rmse) = self.target.pipeline.rmse(&new);
        Quality { covered, pixel_rmse, landmark_rmse: self.target.landmarks.rmse(scene, &points) }
    }
}

/// How well a hypothesis explains its observations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Pixels the model covers.
    pub covered: usize,
    /// Root mean square colour difference per channel over them, `[0, 1]`.
    pub pixel_rmse: f64,
    /// Root mean square landmark distance, pixels.
    pub landmark_rmse: f64,
}
