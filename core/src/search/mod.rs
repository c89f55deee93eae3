//! The mode of the posterior: Levenberg–Marquardt on everything at once.
//!
//! The unknowns are pose, camera, shape, albedo, light and colour transform ([`unknowns`]); what is
//! minimised is
//!
//! `E = ½Σ aᵢ²/t² + ½Σ bᵢ²/sᵢ² + priors + Σ landmarks + image term`
//!
//! of shape coefficients `a` and albedo coefficients `b` (`priors.rs`, with `t` and `s`). A pixel may also
//! show something before the face (`image_term.rs`, `occlusion.rs`).
//!
//! A step's direction is the derivative of every covered pixel's colour, passed back by reverse
//! differentiation through shading, normals, projection and basis (`gradient.rs`, `shading.rs`,
//! `surface.rs`), at the cost of a few renderings. Its metric is the Gauss–Newton matrix of some of
//! the pixels, drawn evenly, others at every iteration. Steps that do not lower `E` are not taken,
//! but damped more. Nothing is random.
//!
//! From coarse to fine: the photo is blurred less, a pixel's error is smaller and more components
//! are sought at every level ([`Level`]).

mod curvature;
mod gradient;
mod held;
mod image_term;
mod landmarks;
mod occlusion;
mod picture;
pub mod priors;
mod shading;
mod state;
mod surface;
pub mod unknowns;
mod vector;
mod window;

use crate::chain::{ChainError, Problem};
use crate::least_squares::{System, system_words};
use crate::scene::Scene;
use core::f32::consts::{FRAC_PI_2, PI};
pub(crate) use held::Held;
use shading::Shading;
pub use state::{Energy, LEVELS, Level, ModeSearch, Options, words, words_for};
use surface::at;
use unknowns::{Layout, advance};

/// Iterations on the landmarks alone, for the pose.
const POSE_ITERATIONS: u32 = 40;
/// Rolls to begin with, radians.
const WAYS_UP: [f32; 4] = [0.0, FRAC_PI_2, PI, -FRAC_PI_2];
/// Decrease of `E` below which a step counts as none.
const STILL: f64 = 0.02;
/// The same where a finer level follows, which will change far more.
const STILL_COARSE: f64 = 0.5;
/// Steps in a row that count as none before the search has converged.
const PATIENCE: u32 = 2;
/// Dampings tried for one step.
const TRIES: u32 = 6;

/// What an iteration came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// Index of the level in [`LEVELS`].
    pub level: usize,
    /// Energy before it.
    pub before: Energy,
    /// Energy after it; the same if no step was taken.
    pub after: Energy,
    /// Levenberg's damping after it.
    pub damping: f32,
    /// Covered pixels.
    pub covered: usize,
    /// How many of them show the face.
    pub visible: f32,
}

impl<'a, 'w> ModeSearch<'a, 'w> {
    /// Checks the problem, finds the pose by the landmarks and is ready to look at the picture.
    ///
    /// # Errors
    /// Whatever in the problem does not fit together, see [`ChainError`]; [`Options::open`] of
    /// another size than the picture.
    pub fn new(
        problem: Problem<'a>,
        options: Options<'a>,
        memory: &'w mut [u32],
    ) -> Result<Self, ChainError> {
        let observed = problem.check()?;
        if options.open.is_some_and(|open| open.len() != problem.image.pixels.len()) {
            return Err(ChainError::Image);
        }
        let needed = words(&problem);
        let error = ChainError::Memory { needed, found: memory.len() };
        if memory.len() < needed {
            return Err(error);
        }
        let mut search = Self::carve(problem, options, &observed, memory).ok_or(error)?;
        search.find_pose();
        search.look_outside();
        search.enter(0);
        Ok(search)
    }

    /// Whether the mode has been found: the last steps of the finest level changed nothing.
    pub fn converged(&self) -> bool {
        self.finest() && self.still >= PATIENCE
    }

    /// Whether there is nothing left to do.
    pub fn done(&self) -> bool {
        self.finest() && (self.still >= PATIENCE || self.iteration >= self.level().iterations)
    }

    /// Pose and camera by the landmarks, the shape being the mean: upright, unless begun on a side
    /// or upside down they explain the landmarks better.
    #[inline(never)]
    fn find_pose(&mut self) {
        let mut best: Option<(f64, Scene)> = None;
        for roll in WAYS_UP {
            let (energy, scene) = self.find_pose_from(roll);
            if best.as_ref().is_none_or(|(least, _)| energy < least - 1.0) {
                best = Some((energy, scene));
            }
        }
        let Some((_, scene)) = best else { return };
        (self.scene.view.pose, self.scene.view.camera) = (scene.view.pose, scene.view.camera);
        self.rendered = false;
        self.initial.clone_from(&self.scene);
        self.energy.landmarks = self.landmark_energy(&self.scene);
        self.energy.prior = self.priors().energy(&self.scene);
    }

    /// The same from a face turned by `roll`, and its energy.
    fn find_pose_from(&mut self, roll: f32) -> (f64, Scene) {
        let [width, height] = self.scene.view.camera.image_size;
        // Without coefficients there are few unknowns; nothing here pulls on light and colour.
        let mut scene = Scene::initial(width, height, 0, 0);
        scene.view.pose.roll = roll;
        let energy = |scene: &Scene, search: &Self| {
            search.landmark_energy(scene) + search.priors().energy(scene)
        };
        let mut damping = 1e-3;
        for _ in 0..POSE_ITERATIONS {
            let mut ahead = scene.clone();
            self.step_pose(&mut ahead, damping);
            if energy(&ahead, self) < energy(&scene, self) {
                scene = ahead;
                damping *= 0.2;
            } else {
                damping *= 5.0;
            }
        }
        (energy(&scene, self), scene)
    }

    /// Goes a step of the pose, of a scene without coefficients.
    fn step_pose(&mut self, scene: &mut Scene, lambda: f32) -> Option<()> {
        let layout = Layout { shape_rank: 0, albedo_rank: 0 };
        let n = layout.len();
        let priors = self.priors();
        let (equations, matrix) = self.passing.split_at_mut_checked(system_words(n))?;
        let mut system = System::new(n, self.problem.engine.normal_equations, equations)?;
        let (model, sd) = (self.problem.model, self.problem.config.landmark_sd);
        landmarks::add_equations(model, &self.landmarks, scene, sd, &mut [], &mut system);
        priors.add(scene, layout, &mut system);
        system.solve_damped(lambda, pose_damping, matrix, self.step)?;
        advance(scene, &layout.split(self.step)?);
        Some(())
    }

    /// Blurs the photo for a level.
    #[inline(never)]
    fn enter(&mut self, level: usize) {
        self.level = level;
        self.iteration = 0;
        self.still = 0;
        self.judged = false;
        self.damping = 1e-2;
        self.layout = self.layout_of(self.level());
        let blur = self.level().blur;
        let width = self.width();
        for (c, plane) in self.planes.photo.iter_mut().enumerate() {
            for (value, pixel) in plane.iter_mut().zip(self.problem.image.pixels) {
                *value = f32::from(at(pixel, c)) / 255.0;
            }
            picture::blur(plane, self.passing, width, blur);
        }
    }

    /// Decrease of `E` below which a step of this level counts as none.
    fn calm(&self) -> f64 {
        if self.finest() { STILL } else { STILL_COARSE }
    }

    /// One iteration; `None` when the search is done.
    pub fn step(&mut self) -> Option<Iteration> {
        if self.done() {
            return None;
        }
        self.make_judged();
        let before = self.energy;
        let (covered, visible) = self.seen;
        let shading = Shading::new(&self.scene);
        self.gradient.fill(0.0);
        self.add_gradient(&shading);
        if let Some((scene, energy)) = self.descend(&shading, covered, before) {
            (self.scene, self.energy) = (scene, energy);
            self.rendered = true;
        } else {
            // The planes are those of a step that was not taken.
            self.judge();
        }
        let after = self.energy;
        for &parameter in self.scene.parameters() {
            self.fingerprint.write_f32(&[parameter]);
        }
        let level = self.level;
        let calm = before.total() - after.total() < self.calm();
        self.still = if calm { self.still + 1 } else { 0 };
        self.iteration += 1;
        self.iterations += 1;
        if !self.finest() && (self.iteration >= self.level().iterations || self.still > 0) {
            if LEVELS.get(level + 1).is_some_and(|next| next.blur == 0.0) {
                self.look_at_eyes();
            }
            self.enter(level + 1);
        }
        Some(Iteration { level, before, after, damping: self.damping, covered, visible })
    }

    /// Renders the scene and compares it with the photo, unless that has been done.
    fn make_judged(&mut self) {
        if !self.judged {
            self.judge();
        }
    }

    /// Renders the scene and compares it with the photo.
    fn judge(&mut self) {
        self.render();
        let scene = self.scene.clone();
        self.energy = self.in_passing(|search, memory| search.evaluate(&scene, memory));
        self.judged = true;
    }

    /// Energy of a scene that has been rendered; infinite if nothing of it is seen.
    fn evaluate(&mut self, scene: &Scene, memory: &mut [f32]) -> Energy {
        Energy {
            image: self.compare(scene, memory).unwrap_or(f64::INFINITY),
            landmarks: self.landmark_energy(scene),
            prior: self.priors().energy(scene),
        }
    }

    fn landmark_energy(&self, scene: &Scene) -> f64 {
        let points = self.landmarks.points(&scene.subject.shape);
        let sd = self.problem.config.landmark_sd;
        landmarks::energy(&self.landmarks, scene, &points, sd)
    }

    /// Solves for a step and takes it if it lowers the energy; otherwise damps more.
    #[inline(never)]
    fn descend(
        &mut self,
        shading: &Shading,
        covered: usize,
        before: Energy,
    ) -> Option<(Scene, Energy)> {
        self.in_passing(|search, memory| search.descend_in(memory, shading, covered, before))
    }

    fn descend_in(
        &mut self,
        memory: &mut [f32],
        shading: &Shading,
        covered: usize,
        before: Energy,
    ) -> Option<(Scene, Energy)> {
        let n = self.layout.len();
        let (equations, matrix) = memory.split_at_mut_checked(system_words(n))?;
        let mut system = System::new(n, self.problem.engine.normal_equations, equations)?;
        self.add_equations(shading, covered, self.level().samples, &mut system)?;
        system.push(self.gradient);
        let light = self.layout.light()..self.layout.color();
        let damping = |i: usize| {
            if light.contains(&i) { 1.0 } else { pose_damping(i) }
        };
        for _ in 0..TRIES {
            if system.solve_damped(self.damping, damping, matrix, self.step).is_some() {
                // To damp more will gain less.
                if system.gain(self.step) < 0.5 * self.calm() {
                    return None;
                }
                let mut scene = self.scene.clone();
                advance(&mut scene, &self.layout.split(self.step)?);
                self.render_other(&scene);
                let after = self.evaluate(&scene, matrix);
                if after.total() < before.total() {
                    self.damping = (0.25 * self.damping).max(1e-5);
                    return Some((scene, after));
                }
            }
            self.damping = (5.0 * self.damping).min(1e6);
        }
        None
    }
}

impl ModeSearch<'_, '_> {
    /// Adds the Gauss–Newton matrix of so many pixels, and what landmarks and priors say.
    fn add_equations(
        &mut self,
        shading: &Shading,
        covered: usize,
        samples: usize,
        system: &mut System<'_>,
    ) -> Option<()> {
        self.add_curvature(shading, covered, samples, system);
        landmarks::add_equations(
            self.problem.model,
            &self.landmarks,
            &self.scene,
            self.problem.config.landmark_sd,
            self.components.get_mut(..self.layout.shape_rank)?,
            system,
        );
        self.priors().add(&self.scene, self.layout, system);
        Some(())
    }

    /// Factorises the Gauss–Newton matrix of the scene as it is by Cholesky's method, from so many
    /// pixels, into [`matrix_words`](crate::least_squares::matrix_words) of memory; `None` if there
    /// is too little.
    pub(crate) fn factorise(&mut self, samples: usize, factor: &mut [f32]) -> Option<()> {
        self.make_judged();
        let (shading, covered) = (Shading::new(&self.scene), self.seen.0);
        self.in_passing(|search, memory| {
            let n = search.layout.len();
            let equations = memory.get_mut(..system_words(n))?;
            let mut system = System::new(n, search.problem.engine.normal_equations, equations)?;
            search.add_equations(&shading, covered, samples, &mut system)?;
            // So little that it is lost but where nothing is known.
            system.solve_damped(1e-6, |_| 1e-6, factor, search.step)
        })
    }
}

/// Levenberg's absolute damping of pose and camera: half a radian, 100 mm, half the focal length;
/// none of anything else.
fn pose_damping(i: usize) -> f32 {
    [4.0, 4.0, 4.0, 1e-4, 1e-4, 4.0, 0.0].get(i).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests;
