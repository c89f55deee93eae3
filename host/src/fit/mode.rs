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
#[cfg(feature = "full")]
pub(super) fn most_steps() -> u64 {
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
    pub fn start(
        problem: Problem<'a>,
        options: Options<'a>,
        memory: &'w mut [u32],
    ) -> Result<Self> {
        let search = ModeSearch::new(problem, options, memory).map_err(Error::new)?;
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

    /// What it came to, `seconds` after it started. The problem is the one it was started with.
    ///
    /// # Errors
    /// None for that problem.
    pub fn end(&self, job: &Job<'_>, problem: Problem<'_>, seconds: f64) -> Result<Fit> {
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
    /// Searches for the mode on one thread; `None` if [`Control::stop`] was set.
    ///
    /// # Errors
    /// Landmarks the model does not have, a crop that does not fit the photo or its mask, a mask
    /// that hides the whole face.
    pub(super) fn find_mode(&self, control: &Control<'_>) -> Result<Option<Fit>> {
        let observed = Observed::new(self.photo, self.landmarks, &self.crop)?;
        let problem = observed.problem(self.model, &self.config, simd::best());
        let start = Instant::now();
        let mut memory = vec![0; search::words(&problem)];
        let open = self.mask.map(|mask| self.crop.cut(mask)).transpose()?.map(|mask| {
            let grey =
                |[r, g, b]: &[u8; 3]| ((u16::from(*r) + u16::from(*g) + u16::from(*b)) / 3) as u8;
            mask.rgb.iter().map(grey).collect::<Vec<u8>>()
        });
        let options = Options { open: open.as_deref(), ..Options::default() };
        let mut searching = Searching::start(problem, options, &mut memory)?;
        while searching.step().is_some() {
            if control.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            control.steps.fetch_add(1, Ordering::Relaxed);
        }
        if !searching.search.energy().total().is_finite() {
            return Err(Error::new(
                "nothing of the face can be seen: the mask hides all of it; white is where it may \
                 be seen, black where not",
            ));
        }
        // It may have converged early.
        control.steps.store(most_steps(), Ordering::Relaxed);
        searching.end(self, problem, start.elapsed().as_secs_f64()).map(Some)
    }
}
