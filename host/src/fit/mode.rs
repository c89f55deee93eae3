//! The search for the mode of the posterior, in place of a chain.

use super::parallel::Control;
use super::summary::ModeFound;
use super::{Fit, Job, Mode, Observed};
use crate::error::{Error, Result};
use crate::simd;
use onescan_core::chain::{Chain, State};
use onescan_core::search::{self, ModeSearch, Options};
use std::sync::atomic::Ordering;
use std::time::Instant;

/// The most steps of [`Job::find_mode`], for a progress bar.
pub fn most_steps() -> u64 {
    search::LEVELS.iter().map(|level| u64::from(level.iterations)).sum()
}

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
        let mut search =
            ModeSearch::new(problem, Options::default(), &mut memory).map_err(Error::new)?;
        let (mut trace, mut taken) = (Vec::new(), 0);
        while let Some(iteration) = search.step() {
            if control.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            control.steps.fetch_add(1, Ordering::Relaxed);
            taken += u64::from(iteration.after != iteration.before);
            trace.push((search.iterations(), -iteration.after.total()));
        }
        // It may have converged early.
        control.steps.store(most_steps(), Ordering::Relaxed);
        let seconds = start.elapsed().as_secs_f64();
        let found = ModeFound {
            converged: search.converged(),
            iterations: search.iterations(),
            posterior: -search.energy().total(),
        };
        let mask = search.mask().to_vec();
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
        let iterations = u64::from(found.iterations);
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
            mode: Some(Mode { found, mask }),
        }))
    }
}
