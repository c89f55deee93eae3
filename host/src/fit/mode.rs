//! The search for the mode of the posterior, in place of a chain.

use super::summary::ModeFound;
use super::{Fit, Job, Mode, TracePoint};
#[cfg(feature = "full")]
use super::{Observed, parallel::Control};
use crate::error::{Error, Result};
#[cfg(feature = "full")]
use crate::simd;
use onescan_core::chain::{Chain, Problem, State};
use onescan_core::search::{self, Iteration, ModeSearch, Options};
#[cfg(feature = "full")]
use std::{sync::atomic::Ordering, time::Instant};

/// The most steps of a search, for a progress bar.
pub fn most_steps() -> u64 {
    search::LEVELS.iter().map(|level| u64::from(level.iterations)).sum()
}

/// A search on its way, and its trace.
pub struct Searching<'a, 'w> {
    /// The search.
    pub search: ModeSearch<'a, 'w>,
    trace: Vec<TracePoint>,
    levels: Vec<u8>,
    taken: u64,
}

impl<'a, 'w> Searching<'a, 'w> {
    /// Begins, in [`search::words`] of memory.
    ///
    /// # Errors
    /// Those of [`ModeSearch::new`].
    pub fn start(problem: Problem<'a>, seed: u64, memory: &'w mut [u32]) -> Result<Self> {
        let search =
            ModeSearch::new(problem, Options::default(), seed, memory).map_err(Error::new)?;
        Ok(Self { search, trace: Vec::new(), levels: Vec::new(), taken: 0 })
    }

    /// Makes one step; `None` when the search is done.
    pub fn step(&mut self) -> Option<Iteration> {
        let iteration = self.search.step()?;
        self.taken += u64::from(iteration.after != iteration.before);
        self.trace.push((self.search.iterations(), -iteration.after.total()));
        self.levels.push(iteration.level as u8);
        Some(iteration)
    }

    /// The log posterior density after every step, at its level.
    pub fn trace(&self) -> &[TracePoint] {
        &self.trace
    }

    /// The level of every step.
    pub fn levels(&self) -> &[u8] {
        &self.levels
    }

    /// What it came to, `seconds` after it started. The problem is the one it was started with.
    ///
    /// # Errors
    /// None for that problem.
    pub fn end(&self, job: &Job<'_>, problem: Problem<'_>, seconds: f64) -> Result<Fit> {
        let search = &self.search;
        let found = ModeFound {
            converged: search.converged(),
            iterations: search.iterations(),
            posterior: -search.energy().total(),
        };
        let scenes = [search.initial().clone(), search.scene().clone()];
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
            mode: Some(Mode { found, mask: search.mask().to_vec() }),
        })
    }
}

#[cfg(feature = "full")]
impl Job<'_> {
    /// Searches for the mode on one thread; `None` if [`Control::stop`] was set. Seed and settings
    /// are the job's, but for its chains and their steps.
    ///
    /// # Errors
    /// Landmarks the model does not have, a crop that does not fit the photo.
    pub fn find_mode(&self, control: &Control<'_>) -> Result<Option<Fit>> {
        let config = self.config.clone().with(|config| {
            (config.landmark_samples, config.shape_samples, config.samples) = (0, 0, 0);
        });
        let observed = Observed::new(self.photo, self.landmarks, &self.crop)?;
        let problem = observed.problem(self.model, &config, simd::best());
        let start = Instant::now();
        let mut memory = vec![0; search::words(&problem)];
        let mut searching = Searching::start(problem, self.seed, &mut memory)?;
        while searching.step().is_some() {
            if control.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            control.steps.fetch_add(1, Ordering::Relaxed);
        }
        // It may have converged early.
        control.steps.store(most_steps(), Ordering::Relaxed);
        searching.end(self, problem, start.elapsed().as_secs_f64()).map(Some)
    }
}
