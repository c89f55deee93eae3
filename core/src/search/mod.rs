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
//! `instance.rs`), at the cost of a few renderings. Its metric is the Gauss–Newton matrix of some of
//! the pixels, drawn evenly, others at every iteration. A step that does not lower `E` is not taken, but
//! tried again with more damping. Nothing is random.
//!
//! From coarse to fine: the photo is blurred less, a pixel's error is smaller and more components
//! are sought at every level ([`Level`]).

mod chart;
mod common;
mod curvature;
mod evidence;
mod gradient;
mod held;
mod image_term;
mod instance;
mod landmarks;
mod occlusion;
mod part;
mod picture;
pub mod priors;
mod shading;
mod state;
pub mod unknowns;
mod window;

use crate::chain::{ChainError, Problem};
use crate::least_squares::{System, system_words};
use crate::scene::Subject;
use common::Common;
pub use common::{Energy, LEVELS, Level, Options};
pub use evidence::Evidence;
pub(crate) use held::{Held, held_words};
pub(crate) use instance::instance_words;
pub use part::{Part, part_words};
pub use state::{ModeSearch, words, words_for};
use unknowns::VIEW;

/// Decrease of `E` below which a step counts as none. Chosen, not measured, as are patience and tries.
const STILL: f64 = 0.02;
/// The same where a finer level follows, which will change far more: half a nat, which saved 40 % of the
/// time.
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
    /// How many of them show the face, by the mask.
    pub visible: f32,
}

impl<'a, 'w> ModeSearch<'a, 'w> {
    /// Checks the problem, finds the pose by the landmarks and is ready to look at the photo, in
    /// [`words`] of memory.
    ///
    /// # Errors
    /// Whatever in the problem does not fit together, see [`ChainError`].
    pub fn new(
        problem: Problem<'a>,
        options: Options<'a>,
        memory: &'w mut [u32],
    ) -> Result<Self, ChainError> {
        Self::of_photos(problem, options, memory)
    }
}

impl<'a, 'w, const OTHERS: usize> ModeSearch<'a, 'w, OTHERS> {
    /// The same of several photos of one subject.
    ///
    /// # Errors
    /// Those of [`ModeSearch::new`]; more photos than there is room for.
    pub fn of_photos(
        problem: Problem<'a>,
        options: Options<'a>,
        memory: &'w mut [u32],
    ) -> Result<Self, ChainError> {
        let mut search = Self::carve(problem, options, memory)?;
        let Self { common, first, others, passing, .. } = &mut search;
        for evidence in core::iter::once(&mut *first).chain(&mut *others) {
            evidence.find_pose(common, passing);
        }
        let prior = search.common.priors().energy_of_subject(&search.common.subject);
        let mut energy = Energy { prior, ..Energy::default() };
        for evidence in search.evidence() {
            energy.landmarks += evidence.landmark_energy(&search.common);
            energy.prior += search.common.priors().energy_of_view(evidence.view());
        }
        search.energy = energy;
        search.render();
        search.rendered = true;
        let Self { first, others, passing, .. } = &mut search;
        for evidence in core::iter::once(first).chain(others) {
            evidence.look_outside(passing);
        }
        search.enter(0);
        Ok(search)
    }

    /// Whether the mode has been found: the last steps of the finest level changed nothing.
    pub fn converged(&self) -> bool {
        self.common.finest() && self.still >= PATIENCE
    }

    /// Log density of photos and mode together, up to a constant that models share. The image term is
    /// relative to the background, which each model finds elsewhere: so that is added.
    pub(crate) fn ln_mode(&self) -> f64 {
        let background: f64 = self.evidence().map(Evidence::ln_background).sum();
        background / f64::from(self.common.patch())
            - self.energy.total()
            - self.common.priors().ln_widths(self.common.layout)
    }

    /// Whether there is nothing left to do.
    pub fn done(&self) -> bool {
        let all = self.iteration >= self.common.level().iterations;
        self.common.finest() && (self.still >= PATIENCE || all)
    }

    /// Goes to a level.
    fn enter(&mut self, level: usize) {
        self.iteration = 0;
        self.still = 0;
        self.judged = false;
        self.damping = 1e-2;
        let Self { common, first, others, passing, .. } = self;
        common.enter(level);
        for evidence in core::iter::once(first).chain(others) {
            evidence.enter(common, passing);
        }
    }

    /// Decrease of `E` below which a step of this level counts as none.
    fn calm(&self) -> f64 {
        if self.common.finest() { STILL } else { STILL_COARSE }
    }

    /// One iteration; `None` when the search is done.
    pub fn step(&mut self) -> Option<Iteration> {
        if self.done() {
            return None;
        }
        self.make_judged();
        let before = self.energy;
        let seen = self.evidence().map(|evidence| evidence.seen);
        let (covered, visible) = seen.fold((0, 0.0), |sum, seen| (sum.0 + seen.0, sum.1 + seen.1));
        self.find_gradient();
        if self.descend().is_none() {
            // The planes are those of a step that was not taken.
            (self.rendered, self.judged) = (false, false);
            self.make_judged();
        }
        let after = self.energy;
        self.note();
        let level = self.common.level;
        let calm = before.total() - after.total() < self.calm();
        self.still = if calm { self.still + 1 } else { 0 };
        self.iteration += 1;
        self.iterations += 1;
        let all = self.iteration >= self.common.level().iterations;
        if !self.common.finest() && (all || self.still > 0) {
            if LEVELS.get(level + 1).is_some_and(|next| next.blur == 0.0) {
                let Self { common, first, others, .. } = self;
                for evidence in core::iter::once(first).chain(others) {
                    evidence.look_at_eyes(common);
                }
            }
            self.enter(level + 1);
        }
        Some(Iteration { level, before, after, damping: self.damping, covered, visible })
    }

    /// Adds what has been found to the fingerprint.
    fn note(&mut self) {
        for evidence in core::iter::once(&self.first).chain(&self.others) {
            for &parameter in evidence.view.parameters() {
                self.fingerprint.write_f32(&[parameter]);
            }
        }
        let Subject { shape, albedo } = &self.common.subject;
        for &coefficient in shape.iter().chain(albedo) {
            self.fingerprint.write_f32(&[coefficient]);
        }
    }

    /// Renders what has been found and compares it with the photos, unless that has been done.
    fn make_judged(&mut self) {
        if !self.rendered {
            self.render();
            self.rendered = true;
        }
        if !self.judged {
            self.energy = Self::judge(
                &self.common,
                core::iter::once(&mut self.first).chain(&mut self.others),
                self.passing,
            );
            self.judged = true;
        }
    }

    /// Compares what has been rendered with the photos; `memory` has room for three planes.
    fn judge<'e>(
        common: &Common<'_, '_>,
        all: impl Iterator<Item = &'e mut Evidence<'a, 'w>>,
        memory: &mut [f32],
    ) -> Energy
    where
        'a: 'e,
        'w: 'e,
    {
        let prior = common.priors().energy_of_subject(&common.subject);
        let mut sum = Energy { prior, ..Energy::default() };
        for evidence in all {
            let Energy { image, landmarks, prior } = evidence.judge(common, memory);
            sum.image += image;
            sum.landmarks += landmarks;
            sum.prior += prior;
        }
        sum
    }

    /// The image terms' derivative.
    fn find_gradient(&mut self) {
        let Self { common, first, others, passing, gradient, .. } = self;
        gradient.fill(0.0);
        for evidence in core::iter::once(&*first).chain(&*others) {
            evidence.add_gradient(common, passing, gradient);
        }
    }

    /// Solves for a step and takes it if it lowers the energy; otherwise damps more.
    #[inline(never)]
    fn descend(&mut self) -> Option<()> {
        let calm = self.calm();
        let Self { common, first, others, scratch, passing, gradient, step, .. } = self;
        let n = common.layout.len();
        let (equations, matrix) = passing.split_at_mut_checked(system_words(n))?;
        let mut system = System::new(n, common.problem.engine.normal_equations, equations)?;
        let pixels = common.level().pixels;
        for evidence in core::iter::once(&*first).chain(&*others) {
            evidence.add_equations(common, pixels, self.iterations, scratch, &mut system);
        }
        common.priors().add_of_subject(&common.subject, common.layout, &mut system);
        system.push(gradient);
        let subject = common.layout.subject();
        let damping = |i: usize| match i.checked_sub(subject) {
            Some(i) => evidence::damping(i % VIEW),
            None => 0.0,
        };
        let before = common.subject.clone();
        for _ in 0..TRIES {
            if system.solve_damped(self.damping, damping, matrix, step).is_some() {
                // To damp more will gain less.
                if system.gain(step) < 0.5 * calm {
                    return None;
                }
                if let Some(parts) = common.layout.split(step, 0) {
                    parts.advance_subject(&mut common.subject);
                }
                let Problem { model, engine, .. } = common.problem;
                common.instance.update(model, engine, &common.subject);
                for evidence in core::iter::once(&mut *first).chain(&mut *others) {
                    evidence.advance(common.layout, step);
                    evidence.render(common);
                }
                let all = core::iter::once(&mut *first).chain(&mut *others);
                let after = Self::judge(common, all, matrix);
                if after.total() < self.energy.total() {
                    self.energy = after;
                    self.damping = (0.25 * self.damping).max(1e-5);
                    return Some(());
                }
                common.subject.clone_from(&before);
                for evidence in core::iter::once(&mut *first).chain(&mut *others) {
                    evidence.retreat();
                }
            }
            self.damping = (5.0 * self.damping).min(1e6);
        }
        None
    }
}

#[cfg(test)]
pub(crate) use held::probe;
#[cfg(test)]
pub(crate) mod tests;
