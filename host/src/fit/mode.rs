//! The search for the mode of the posterior, in place of a chain.

use super::summary::ModeFound;
use super::{Fit, Job, Mode, TracePoint};
use crate::error::{Error, Result};
use onescan_core::chain::{Chain, Problem, State};
use onescan_core::scene::{Scene, Subject};
use onescan_core::search::unknowns::MAX_PHOTOS;
use onescan_core::search::{self, Evidence, Iteration, ModeSearch, Options};

/// The most steps of a search, for a progress bar.
#[cfg(feature = "full")]
pub(crate) fn most_steps() -> u64 {
    search::LEVELS.iter().map(|level| u64::from(level.iterations)).sum()
}

/// Room for photos besides the first.
pub(crate) const OTHERS: usize = MAX_PHOTOS - 1;

/// A search on its way, and its trace.
pub struct Searching<'a, 'w> {
    /// The search.
    pub search: ModeSearch<'a, 'w, OTHERS>,
    trace: Vec<TracePoint>,
    levels: Vec<u8>,
    taken: u64,
}

impl<'a, 'w> Searching<'a, 'w> {
    /// Begins, in [`search::words`] of memory.
    ///
    /// # Errors
    /// Those of [`ModeSearch::of_photos`].
    pub fn start(
        problem: Problem<'a>,
        options: Options<'a>,
        memory: &'w mut [u32],
    ) -> Result<Self> {
        let search = ModeSearch::of_photos(problem, options, memory).map_err(Error::new)?;
        Ok(Self { search, trace: Vec::new(), levels: Vec::new(), taken: 0 })
    }

    /// Makes one step; `None` when the search is done.
    pub fn step(&mut self) -> Option<Iteration> {
        let iteration = self.search.step()?;
        self.taken += u64::from(iteration.after != iteration.before);
        let step = self.search.iterations();
        self.trace.push((step - 1, -iteration.before.total()));
        self.trace.push((step, -iteration.after.total()));
        self.levels.extend([iteration.level as u8; 2]);
        Some(iteration)
    }

    /// The log posterior density before and after every step, at its level.
    pub fn trace(&self) -> &[TracePoint] {
        &self.trace
    }

    /// The level of every point of the trace.
    pub fn levels(&self) -> &[u8] {
        &self.levels
    }

    /// What it came to, `seconds` after it started, photo by photo. The photos' jobs and problems
    /// are those it was started with, in their order.
    ///
    /// # Errors
    /// Never, for those.
    pub fn end<'p>(
        &self,
        photos: impl IntoIterator<Item = (&'p Job<'p>, Problem<'p>)>,
        seconds: f64,
    ) -> Result<Vec<Fit>> {
        let ends = self.search.evidence().zip(photos);
        ends.map(|(evidence, (job, problem))| self.end_of(evidence, job, problem, seconds))
            .collect()
    }

    fn end_of(
        &self,
        evidence: &Evidence<'_, '_>,
        job: &Job<'_>,
        problem: Problem<'_>,
        seconds: f64,
    ) -> Result<Fit> {
        let search = &self.search;
        let found = ModeFound {
            converged: search.converged(),
            iterations: search.iterations(),
            levels: (0..search::LEVELS.len())
                .map(|level| {
                    (self.levels.iter().filter(|l| usize::from(**l) == level).count() / 2) as u32
                })
                .collect(),
            posterior: -search.energy().total(),
            seen_rmse: evidence.seen_rmse(),
        };
        let subject = search.subject();
        let mean = Subject::mean(subject.shape.len(), subject.albedo.len());
        let scenes = [
            Scene { subject: mean, view: *evidence.initial() },
            Scene { subject: subject.clone(), view: *evidence.view() },
        ];
        // A chain without steps says how well the scenes explain the picture.
        let mut memory = vec![0; problem.dimensions().words()];
        let mut chain = Chain::new(problem, job.seed, 0, &mut memory).map_err(Error::new)?;
        let [initial_quality, best_quality] = scenes.each_ref().map(|scene| chain.quality(scene));
        let [initial, best] = scenes.map(|scene| {
            let density = chain.evaluate(&scene);
            State { scene, density }
        });
        let iterations = u64::from(found.iterations);
        Ok(Fit {
            crop: job.crop,
            initial,
            best,
            initial_quality,
            best_quality,
            fingerprint: search.fingerprint(),
            steps: iterations,
            accepted: self.taken,
            image_evaluated: iterations,
            seconds,
            steps_per_second: iterations as f64 / seconds.max(1e-9),
            trace: self.trace.clone(),
            acceptance: Vec::new(),
            mode: Some(Mode {
                found,
                mask: evidence.mask().to_vec(),
                #[cfg(feature = "full")]
                laplace: None,
            }),
        })
    }
}
