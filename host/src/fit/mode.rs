//! The mode of the posterior instead of a chain: minutes of walking in a second or two.

use super::{Fit, Job, Observed};
use crate::error::{Error, Result};
use crate::simd;
use onescan_core::chain::{Chain, State};
use onescan_core::search::{self, ModeSearch, Options};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

/// The most iterations of a search, for a progress bar.
pub fn iterations() -> u64 {
    search::LEVELS.iter().map(|level| u64::from(level.iterations)).sum()
}

/// What a search for the mode knows besides its scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Mode {
    /// Whether the last steps changed nothing.
    pub converged: bool,
    /// Steps of all levels.
    pub iterations: u32,
    /// Log posterior density with the mask given, up to a constant.
    pub posterior: f64,
    /// Probability of each pixel of the crop to show the face; 0 where it does not reach.
    pub mask: Vec<f32>,
}

impl Job<'_> {
    /// Searches for the mode; `None` if `stop` was set. Seed and settings are the job's, as far as
    /// they do not speak of a chain's steps.
    ///
    /// # Errors
    /// Landmarks the model does not have, a crop that does not fit the photo.
    pub fn find_mode(&self, stop: &AtomicBool, steps: &AtomicU64) -> Result<Option<Fit>> {
        let config = self.config.clone().with(|config| {
            (config.landmark_samples, config.shape_samples, config.samples) = (0, 0, 0);
        });
        let observed = Observed::new(self.photo, self.landmarks, &self.crop)?;
        let problem = observed.problem(self.model, &config, simd::best());
        let start = Instant::now();
        let mut memory = vec![0; search::words(&problem)];
        let mut search = ModeSearch::new(problem, Options::default(), self.seed, &mut memory)
            .map_err(Error::new)?;
        let (mut trace, mut taken) = (Vec::new(), 0);
        while let Some(iteration) = search.step() {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            steps.fetch_add(1, Ordering::Relaxed);
            taken += u64::from(iteration.after != iteration.before);
            trace.push((search.iterations(), -iteration.after.total()));
        }
        // It may have converged early.
        steps.store(iterations(), Ordering::Relaxed);
        let seconds = start.elapsed().as_secs_f64();
        let mode = Mode {
            converged: search.converged(),
            iterations: search.iterations(),
            posterior: -search.energy().total(),
            mask: search.mask().to_vec(),
        };
        let scenes = [search.initial().clone(), search.scene().clone()];
        let fingerprint = search.fingerprint();
        // A chain without steps says how well the scenes explain the picture.
        let mut memory = vec![0; problem.dimensions().words()];
        let mut chain = Chain::new(problem, self.seed, 0, &mut memory).map_err(Error::new)?;
        let [initial_quality, best_quality] = scenes.each_ref().map(|scene| chain.quality(scene));
        let [initial, best] = scenes.map(|scene| {
            let density = chain.evaluate(&scene);
            State { scene, density }
        });
        let iterations = u64::from(mode.iterations);
        Ok(Some(Fit {
            crop: self.crop,
            initial,
            best,
            initial_quality,
            best_quality,
            fingerprint,
            steps: iterations,
            accepted: taken,
            image_evaluated: iterations,
            seconds,
            steps_per_second: iterations as f64 / seconds.max(1e-9),
            trace,
            acceptance: Vec::new(),
            mode: Some(mode),
        }))
    }
}
