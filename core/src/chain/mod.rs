//! The Metropolis–Hastings chain: one step at a time, driven by the caller.
//!
//! A fit has two stages (FACTS §6.6). The *landmark* stage moves the pose alone and looks at the
//! landmarks alone; the *image* stage starts from its best state, moves everything and looks at
//! the picture. Between them there may be a *shape* stage, which moves pose and shape and looks at
//! the landmarks: for objects whose template is far from what the picture shows. A proposal passes three tests in turn, each cheaper than the next: landmarks,
//! prior, image. A test accepts with probability `min(1, ratio of its factor)`; the product of the
//! three satisfies detailed balance for the product of the factors, and most bad proposals never
//! cost a rendering. The correction of the proposal density belongs to the first test.

mod dimensions;
mod pipeline;
mod problem;
mod refine;

use crate::hash::Fnv64;
use crate::likelihood::landmarks::{LandmarkSample, Landmarks, MAX_LANDMARKS, Points};
use crate::math;
use crate::memory::Carver;
use crate::proposal::{self, Branch, CENTRES, MAX_LEAVES, Part, Surroundings, Table, Touched};
use crate::rng::Rng;
use crate::scene::Scene;
pub use dimensions::Dimensions;
use pipeline::{Pipeline, Proposed};
pub use problem::{ChainError, Config, Problem};
use refine::{Constraints, Search, search_words};
use serde::{Deserialize, Serialize};

/// The stages of a fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Stage {
    /// Pose by landmarks.
    Landmarks,
    /// Pose and shape by landmarks.
    Shape,
    /// Everything by the picture.
    Image,
}

impl Stage {
    /// In order.
    pub const ALL: [Self; 3] = [Self::Landmarks, Self::Shape, Self::Image];

    /// What belongs to this stage, of what belongs to all in order.
    fn of<T>(self, [landmarks, shape, image]: [T; 3]) -> T {
        match self {
            Self::Landmarks => landmarks,
            Self::Shape => shape,
            Self::Image => image,
        }
    }
}

/// The tests a proposal passes, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Filter {
    Landmarks,
    Prior,
    Image,
}

/// What became of a proposal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It is the new state.
    Accepted,
    /// A test turned it down; the state stays.
    Rejected(Filter),
    /// The move had nowhere to go; the state stays.
    Failed,
}

/// One step of the chain.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// The stage it belongs to.
    pub stage: Stage,
    /// Which leaf of the stage's [`Table`] made the proposal.
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
    /// Image likelihood; 0 in the stages that do not look at it.
    pub image: f64,
}

impl Density {
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

/// Everything a chain has to remember; the rest of its memory follows from it. A chain resumed
/// from its checkpoint goes on with the same bits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    /// The stage of the next step.
    pub stage: Stage,
    /// Steps done in this stage.
    pub step: u32,
    /// Steps of the image stage so far that rendered and compared the picture.
    pub image_evaluated: u32,
    /// The current state.
    pub state: State,
    /// The state of highest target density in this stage.
    pub best: State,
    /// The state the image stage began with.
    pub initial: Option<State>,
    /// The random stream.
    pub rng: Rng,
    /// Hash of every accepted state.
    pub fingerprint: Fnv64,
    /// Acceptance per leaf, by stage.
    pub tallies: [Tallies; 3],
}

/// A running fit.
pub struct Chain<'a, 'w> {
    problem: Problem<'a>,
    tables: [Table; 3],
    centres: [Option<usize>; CENTRES.len()],
    landmarks: Landmarks<'w>,
    /// Model-frame landmark positions of the current state.
    points: Points,
    pipeline: Pipeline<'w>,
    /// Of the search moves.
    system: &'w mut [f32],
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
        let Problem { model, image, config, .. } = problem;
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
            stage: Stage::Landmarks,
            step: 0,
            image_evaluated: 0,
            best: state.clone(),
            state,
            initial: None,
            rng: Rng::new(seed, stream),
            fingerprint: Fnv64::default(),
            tallies: [const { Tallies::new() }; 3],
        };
        Self::assemble(problem, progress, memory)
    }

    /// Counts nothing yet, and evaluates the first state.
    #[inline(never)]
    fn begin(&mut self) {
        for (tallies, table) in self.progress.tallies.iter_mut().zip(&self.tables) {
            // At most MAX_LEAVES, like the table.
            let _ = tallies.resize(table.len(), Tally::default());
        }
        self.progress.state.density = self.evaluate_current();
        self.progress.best.clone_from(&self.progress.state);
        if self.problem.config.landmark_samples == 0 {
            self.enter_next_stage();
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
        let size = [problem.image.width, problem.image.height];
        let scenes = [&checkpoint.state.scene, &checkpoint.best.scene];
        if scenes.iter().any(|scene| {
            scene.camera.image_size != size
                || scene.shape.len() > problem.model.shape.rank()
                || scene.albedo.len() > problem.model.albedo.rank()
                || scene.shape.len() > problem.config.shape_rank
        }) {
            return Err(ChainError::Checkpoint);
        }
        let mut chain = Self::assemble(problem, checkpoint, memory)?;
        let fits = |t: &(&Tallies, &Table)| t.0.len() == t.1.len();
        if !chain.progress.tallies.iter().zip(&chain.tables).all(|t| fits(&t)) {
            return Err(ChainError::Checkpoint);
        }
        chain.points = chain.landmarks.points(&chain.progress.state.scene.shape);
        if chain.evaluate_current() != chain.progress.state.density {
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
        let Problem { model, image, landmarks, config, .. } = problem;
        let observed = problem.check()?;
        let centres = CENTRES.map(|name| landmarks.iter().position(|l| l.name == name));
        let scene = &progress.state.scene;
        let applies = |branch: &Branch| {
            let rank = match branch.kind.part() {
                Some(Part::Shape) => scene.shape.len(),
                Some(Part::Albedo) => scene.albedo.len(),
                None => 1,
            };
            rank > 0
                && branch.centre.is_none_or(|c| centres.get(c).is_some_and(Option::is_some))
                && (config.search || !branch.kind.is_search())
        };
        let is_face = centres.iter().any(Option::is_some);
        let [pose, shape, all] = if is_face {
            [&proposal::POSE, &proposal::POSE_AND_SHAPE, &proposal::FACE]
        } else {
            [&proposal::OBJECT_POSE, &proposal::OBJECT_POSE_AND_SHAPE, &proposal::OBJECT]
        };
        // No tree is ever empty: translation always applies. What searches looks at the picture.
        let blind = |branch: &Branch| applies(branch) && !branch.kind.is_search();
        let tables = [
            Table::new(pose, applies).ok_or(ChainError::Config)?,
            Table::new(shape, blind).ok_or(ChainError::Config)?,
            Table::new(all, applies).ok_or(ChainError::Config)?,
        ];

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
        let words = search_words(dimensions.shape_rank, dimensions.albedo_rank);
        let system = carver.floats(words).ok_or(error)?;
        let points = landmarks.points(&scene.shape);
        Ok(Self { problem, tables, centres, landmarks, points, pipeline, system, progress })
    }

    /// Makes one step; `None` when the fit is done.
    pub fn step(&mut self) -> Option<Step> {
        let config = self.problem.config;
        let stage = self.progress.stage;
        let end = stage.of(config.stages());
        if self.progress.step >= end {
            return None;
        }
        let branch = stage.of(self.tables.each_ref()).pick(&mut self.progress.rng);
        let outcome = self.try_branch(branch);
        // There are as many as leaves.
        if let Some(tally) = stage.of(self.progress.tallies.each_mut()).get_mut(branch) {
            tally.proposed += 1;
            tally.accepted += u32::from(outcome == Outcome::Accepted);
        }
        self.progress.step += 1;
        if stage != Stage::Image && self.progress.step == end {
            self.enter_next_stage();
        }
        Some(Step { stage, branch, outcome })
    }

    fn try_branch(&mut self, branch: usize) -> Outcome {
        let stage = self.progress.stage;
        let Some(branch) = stage.of(self.tables.each_ref()).branch(branch) else {
            return Outcome::Failed;
        };
        let current = &self.progress.state;
        let touched = branch.kind.touches();
        if branch.kind.is_search() {
            self.pipeline.restore(self.problem, &current.scene, Touched::COLOR);
        }
        let mut scene = current.scene.clone();
        let mut surroundings = Around {
            centres: &self.centres,
            points: &self.points,
            problem: self.problem,
            landmarks: &self.landmarks,
            pipeline: &self.pipeline,
            system: self.system,
        };
        let rng = &mut self.progress.rng;
        let proposal = proposal::propose(&branch, &mut scene, rng, &mut surroundings);
        let Some(correction) = proposal else {
            return Outcome::Failed;
        };
        let mut density = current.density;

        let mut points = None;
        if touched.shape {
            points = Some(self.landmarks.points(&scene.shape));
        }
        if touched.geometry {
            let points = points.as_ref().unwrap_or(&self.points);
            density.landmarks = self.landmarks.ln_likelihood(&scene, points);
        }
        let gain = density.landmarks - current.density.landmarks + correction;
        if !passes(rng, gain) {
            return Outcome::Rejected(Filter::Landmarks);
        }
        density.prior = self.problem.config.prior.ln_density(&scene);
        if !passes(rng, density.prior - current.density.prior) {
            return Outcome::Rejected(Filter::Prior);
        }
        if stage == Stage::Image {
            // The threshold is drawn first, so that a hopeless proposal can be given up midway.
            let patch = f64::from(self.problem.config.pixel_patch);
            let floor = current.density.image + patch * math::ln(rng.uniform());
            self.progress.image_evaluated += 1;
            self.pipeline.restore(self.problem, &current.scene, touched);
            let new = Proposed { problem: self.problem, scene: &scene, touched };
            self.pipeline.update(&new);
            match self.pipeline.ln_likelihood(&new, floor) {
                Some(image) => density.image = image,
                None => return Outcome::Rejected(Filter::Image),
            }
            self.pipeline.accept(touched);
        }
        if let Some(points) = points {
            self.points = points;
        }
        self.progress.state = State { scene, density };
        self.record();
        Outcome::Accepted
    }

    /// Fingerprint and best state after an acceptance.
    fn record(&mut self) {
        let progress = &mut self.progress;
        for &parameter in progress.state.scene.parameters() {
            progress.fingerprint.write_f32(&[parameter]);
        }
        let posterior = |state: &State| state.density.posterior(self.problem.config);
        if posterior(&progress.state) > posterior(&progress.best) {
            progress.best.clone_from(&progress.state);
        }
    }

    /// Goes on from the best state of this stage.
    fn enter_next_stage(&mut self) {
        let is_first = self.progress.stage == Stage::Landmarks;
        let to_shape = is_first && self.problem.config.shape_samples > 0;
        self.progress.stage = if to_shape { Stage::Shape } else { Stage::Image };
        self.progress.step = 0;
        self.progress.state = self.progress.best.clone();
        self.points = self.landmarks.points(&self.progress.state.scene.shape);
        self.progress.state.density = self.evaluate_current();
        self.progress.best = self.progress.state.clone();
        if !to_shape {
            self.progress.initial = Some(self.progress.state.clone());
        }
    }

    /// All densities of the current state, from scratch; fills the pipeline in the image stage.
    fn evaluate_current(&mut self) -> Density {
        let scene = self.progress.state.scene.clone();
        let density = self.evaluate(&scene);
        if self.progress.stage == Stage::Image {
            self.pipeline.accept(Touched::ALL);
        }
        density
    }

    /// All densities of a hypothesis, from scratch. The chain's state stays.
    pub fn evaluate(&mut self, scene: &Scene) -> Density {
        let mut image = 0.0;
        if self.progress.stage == Stage::Image {
            let new = Proposed { problem: self.problem, scene, touched: Touched::ALL };
            let none = f64::NEG_INFINITY;
            self.pipeline.update(&new);
            image = self.pipeline.ln_likelihood(&new, none).unwrap_or(none);
        }
        let points = self.landmarks.points(&scene.shape);
        Density {
            landmarks: self.landmarks.ln_likelihood(scene, &points),
            prior: self.problem.config.prior.ln_density(scene),
            image,
        }
    }

    /// What to save to go on later.
    pub fn checkpoint(&self) -> &Checkpoint {
        &self.progress
    }

    /// The current state.
    pub fn state(&self) -> &State {
        &self.progress.state
    }

    /// The state of highest target density in this stage.
    pub fn best(&self) -> &State {
        &self.progress.best
    }

    /// Hash of every accepted state so far.
    pub fn fingerprint(&self) -> u64 {
        self.progress.fingerprint.finish()
    }

    /// Steps done and steps in all, over all stages.
    pub fn progress(&self) -> (u32, u32) {
        let [landmarks, shape, image] = self.problem.config.stages();
        let searched = landmarks.saturating_add(shape);
        let before = self.progress.stage.of([0, landmarks, searched]);
        (before.saturating_add(self.progress.step), searched.saturating_add(image))
    }

    /// Acceptance per leaf of a stage.
    pub fn tallies(&self, stage: Stage) -> impl Iterator<Item = (Branch, Tally)> {
        let tallies = stage.of(self.progress.tallies.each_ref());
        stage.of(self.tables.each_ref()).branches().zip(tallies.iter().copied())
    }

    /// Fit of a hypothesis to the picture and the landmarks. Overwrites nothing of the chain's
    /// state.
    pub fn quality(&mut self, scene: &Scene) -> Quality {
        let points = self.landmarks.points(&scene.shape);
        let new = Proposed { problem: self.problem, scene, touched: Touched::ALL };
        self.pipeline.update(&new);
        let (covered, pixel_rmse) = self.pipeline.rmse(&new);
        Quality { covered, pixel_rmse, landmark_rmse: self.landmarks.rmse(scene, &points) }
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

/// Accepts with probability `min(1, eᵍ)`. Draws a number only when it decides. `−∞ − (−∞)` is
/// NaN: a state without density may be left for another without density.
fn passes(rng: &mut Rng, gain: f64) -> bool {
    gain >= 0.0 || gain.is_nan() || math::ln(rng.uniform()) < gain
}

/// What the moves see of the chain.
struct Around<'s, 'a, 'w> {
    centres: &'s [Option<usize>; CENTRES.len()],
    points: &'s Points,
    problem: Problem<'a>,
    landmarks: &'s Landmarks<'w>,
    pipeline: &'s Pipeline<'w>,
    system: &'s mut [f32],
}

impl Surroundings for Around<'_, '_, '_> {
    fn centre(&self, index: usize) -> Option<[f32; 3]> {
        self.points.get((*self.centres.get(index)?)?).copied()
    }

    fn solve_light(&mut self, scene: &mut Scene, points: u32, rng: &mut Rng) -> Option<()> {
        let triangles = self.problem.model.triangles;
        scene.light = self.pipeline.solve_light(triangles, scene, points, rng)?;
        Some(())
    }

    fn refine(&mut self, scene: &mut Scene, part: Part, points: u32, rng: &mut Rng) -> Option<()> {
        let Problem { model, config, engine, .. } = self.problem;
        let search = Search {
            points,
            fraction: rng.uniform() as f32,
            // What the linearised pixels' inverse variance amounts to.
            sd: config.pixel_sd * math::sqrt(config.pixel_patch),
            normal_equations: engine.normal_equations,
            memory: self.system,
        };
        match part {
            Part::Albedo => self.pipeline.refine_albedo(model, scene, search, rng),
            Part::Shape => {
                let mut samples = heapless::Vec::<LandmarkSample, MAX_LANDMARKS>::new();
                for sample in self.landmarks.samples(scene, self.points) {
                    // As many as landmarks.
                    let _ = samples.push(sample);
                }
                let constraints = Constraints {
                    landmarks: &samples,
                    landmark_sd: config.landmark_sd,
                    prior: &config.prior,
                };
                self.pipeline.refine_shape(model, scene, &constraints, search, rng)
            }
        }
    }
}
