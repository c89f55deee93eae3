//! What a fit to a photo samples: landmarks, prior and picture, with the memory to judge a scene by
//! them.

use super::pipeline::{Pipeline, Proposed};
use super::problem::Problem;
use super::schedule::{IMAGE, LANDMARKS};
use crate::likelihood::landmarks::{Landmarks, Points};
use crate::metropolis::{Drawn, Factor, Factors, Moves, New, Target};
use crate::proposal::{self, CENTRES, Surroundings, Table, Touched};
use crate::rng::Rng;
use crate::scene::Scene;

/// `[landmarks, prior, image]`.
pub(super) type LnFactors = [f64; 3];

/// The target of a fit, and the stages of its rendering.
pub(super) struct Posterior<'a, 'w> {
    pub(super) problem: Problem<'a>,
    /// The observed landmarks among [`CENTRES`].
    pub(super) centres: [Option<usize>; CENTRES.len()],
    pub(super) landmarks: Landmarks<'w>,
    /// Model-frame landmark positions of the current state.
    pub(super) points: Points,
    /// And of the proposal, if its shape is another.
    pub(super) proposed: Points,
    pub(super) pipeline: Pipeline<'w>,
}

impl<'a> Posterior<'a, '_> {
    /// All factors among `looked_at` of a hypothesis, from scratch; the image likelihood is 0 if it
    /// is not among them. The current state stays, but for the spare buffers.
    pub(super) fn evaluate(&mut self, scene: &Scene, looked_at: Factors) -> LnFactors {
        let mut image = 0.0;
        if looked_at & IMAGE != 0 {
            let new = self.rendered(scene, Touched::ALL);
            let none = f64::NEG_INFINITY;
            self.pipeline.update(&new);
            image = self.pipeline.ln_likelihood(&new, none).unwrap_or(none);
        }
        let points = self.landmarks.points(&scene.subject.shape);
        let landmarks = self.landmarks.ln_likelihood(scene, &points);
        [landmarks, self.problem.config.prior.ln_density(scene), image]
    }

    /// Makes a scene the current state.
    pub(super) fn begin(&mut self, scene: &Scene, looked_at: Factors) -> LnFactors {
        self.points = self.landmarks.points(&scene.subject.shape);
        let density = self.evaluate(scene, looked_at);
        if looked_at & IMAGE != 0 {
            self.pipeline.accept(Touched::ALL);
        }
        density
    }

    fn rendered<'s>(&self, scene: &'s Scene, touched: Touched) -> Proposed<'s, 'a> {
        Proposed { problem: self.problem, scene, touched }
    }
}

impl Target for Posterior<'_, '_> {
    type State = Scene;
    type Touched = Touched;
    type Density = LnFactors;
    const FACTORS: &'static [Factor] =
        &[Factor::cheap("landmarks"), Factor::cheap("prior"), Factor::costly("image")];

    fn temperature(&self, k: usize) -> f64 {
        if k == 2 { f64::from(self.problem.config.pixel_patch) } else { 1.0 }
    }

    fn prepare(&mut self, k: usize, new: &New<'_, Self>) {
        match k {
            0 if new.touched.shape => self.proposed = self.landmarks.points(&new.to.subject.shape),
            2 => {
                self.pipeline.restore(self.problem, new.from, new.touched);
                let rendered = self.rendered(new.to, new.touched);
                self.pipeline.update(&rendered);
            }
            _ => {}
        }
    }

    fn ln_factor(&mut self, k: usize, new: &New<'_, Self>, now: f64, floor: f64) -> Option<f64> {
        match k {
            0 if new.touched.geometry => {
                let points = if new.touched.shape { &self.proposed } else { &self.points };
                Some(self.landmarks.ln_likelihood(new.to, points))
            }
            1 => Some(self.problem.config.prior.ln_density(new.to)),
            2 => {
                let rendered = self.rendered(new.to, new.touched);
                self.pipeline.ln_likelihood(&rendered, floor)
            }
            _ => Some(now),
        }
    }

    fn accept(&mut self, new: &New<'_, Self>, looked_at: Factors) {
        if new.touched.shape {
            if looked_at & LANDMARKS != 0 {
                core::mem::swap(&mut self.points, &mut self.proposed);
            } else {
                self.points = self.landmarks.points(&new.to.subject.shape);
            }
        }
        if looked_at & IMAGE != 0 {
            self.pipeline.accept(new.touched);
        }
    }
}

/// The leaves of a tree of moves.
pub(super) struct Mixture<'t>(pub(super) &'t Table);

impl<'a, 'w> Moves<Posterior<'a, 'w>> for Mixture<'_> {
    fn draw(
        &mut self,
        leaf: usize,
        target: &mut Posterior<'a, 'w>,
        scene: &mut Scene,
        rng: &mut Rng,
    ) -> Option<Drawn<Touched>> {
        let branch = self.0.branch(leaf)?;
        if branch.kind.steers() {
            target.pipeline.restore(target.problem, scene, Touched::COLOR);
        }
        // The correction counts at the first test: it costs least there.
        let ln_ratio = proposal::propose(&branch, scene, rng, target)?;
        Some(Drawn { touched: branch.kind.touches(), ln_ratio, due: 0 })
    }
}

impl Surroundings for Posterior<'_, '_> {
    fn centre(&self, index: usize) -> Option<[f32; 3]> {
        self.points.get((*self.centres.get(index)?)?).copied()
    }

    fn solve_light(&mut self, scene: &mut Scene, points: u32, rng: &mut Rng) -> Option<()> {
        let triangles = self.problem.model.triangles;
        scene.view.light = self.pipeline.solve_light(triangles, scene, points, rng)?;
        Some(())
    }
}
