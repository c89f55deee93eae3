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

/// The most steps of a search.
pub(super) fn most_steps() -> u64 {
    search::LEVELS.iter().map(|level| u64::from(level.iterations)).sum()
}

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
        let mut search = ModeSearch::new(problem, options, &mut memory).map_err(Error::new)?;
        let (mut trace, mut taken) = (Vec::new(), 0);
        let mut levels = vec![0; search::LEVELS.len()];
        while let Some(iteration) = search.step() {
            if control.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            control.steps.fetch_add(1, Ordering::Relaxed);
            taken += u64::from(iteration.after != iteration.before);
            levels[iteration.level] += 1;
            let step = search.iterations();
            trace.push((step - 1, -iteration.before.total()));
            trace.push((step, -iteration.after.total()));
        }
        if !search.energy().total().is_finite() {
            return Err(Error::new(
                "nothing of the face can be seen: the mask hides all of it; white is where it may \
                 be seen, black where not",
            ));
        }
        // It may have converged early.
        control.steps.store(most_steps(), Ordering::Relaxed);
        let seconds = start.elapsed().as_secs_f64();
        let found = ModeFound {
            converged: search.converged(),
            iterations: search.iterations(),
            levels,
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
