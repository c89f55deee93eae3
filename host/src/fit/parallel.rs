//! A whole fit on the computer's threads.

use super::checkpoint::{Identity, Save};
use super::mode::{Searching, most_steps};
use super::summary::Laplace;
use super::{Fit, Job, Observed, Run, Running, Schedule};
use crate::error::{Error, Result};
use crate::simd;
use onescan_core::chain::Problem;
use onescan_core::hash::Fnv64;
use onescan_core::posterior;
use onescan_core::search::unknowns::Parts;
use onescan_core::search::{self, Options};
use rayon::prelude::*;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// What the caller sees and says while a fit runs.
pub struct Control<'a> {
    /// Set by the caller to stop after the current step.
    pub stop: &'a AtomicBool,
    /// Steps done by all chains, for a progress bar.
    pub steps: &'a AtomicU64,
}

/// Nobody stops it, nobody watches.
impl Default for Control<'_> {
    fn default() -> Self {
        static STOP: AtomicBool = AtomicBool::new(false);
        static STEPS: AtomicU64 = AtomicU64::new(0);
        Self { stop: &STOP, steps: &STEPS }
    }
}

/// How long a fit goes on before it is kept again.
pub(crate) const EVERY: Duration = Duration::from_secs(3);

/// What is wrong with a checkpoint that is not this fit's.
pub(crate) const OF_ANOTHER: &str = "it was saved by a fit of another model, photo, landmark file or \
                                     settings; repeat the first command exactly, or fit without \
                                     --resume";

/// Called with what continues a fit, in order to keep it.
pub type Keep<'a> = dyn Fn(&Save) -> Result<()> + Sync + 'a;

/// How a fit ended.
pub enum Ending {
    /// All steps were made.
    Done(Box<Fit>),
    /// [`Control::stop`] was set. What is inside continues the fit, if it was a chain's.
    Stopped(Option<Box<Save>>),
}

impl Job<'_> {
    /// What identifies the job, so that a checkpoint is only used for the job it was made by.
    pub(crate) fn identity(&self) -> Identity {
        let mut hash = Fnv64::default();
        hash.write(self.photo.rgb.as_flattened());
        if let Some(mask) = self.mask {
            hash.write(mask.rgb.as_flattened());
        }
        for value in [self.crop.origin, self.crop.size, self.crop.scaled_to].as_flattened() {
            hash.write(&value.to_le_bytes());
        }
        for landmark in self.landmarks.visible() {
            hash.write(landmark.id.as_bytes());
            hash.write_f32(&[landmark.x, landmark.y]);
        }
        Identity {
            model: self.model.checksum(),
            picture: hash.finish(),
            config: self.config.clone(),
            seed: self.seed,
            chains: self.chains,
        }
    }

    /// The most steps of the fit, for a progress bar.
    pub fn steps(&self) -> u64 {
        match self.schedule {
            Schedule::Mode => most_steps(),
            Schedule::Paper | Schedule::Sampler => u64::from(self.chains) * self.config.steps(),
        }
    }

    /// Runs the fit, from the beginning or from where `resume` left it.
    ///
    /// A search takes one thread, and cannot be resumed. Chains run in parallel on rayon's threads;
    /// each is a function of the seed and its number, so the number of threads changes nothing.
    ///
    /// # Errors
    /// Landmarks the model does not have, a crop that does not fit the photo, a checkpoint of
    /// another job.
    pub fn run(&self, resume: Option<Save>, control: &Control<'_>) -> Result<Ending> {
        self.run_kept(resume, control, &|_| Ok(()))
    }

    /// The same as [`run`](Self::run); if it is a chain's, `keep` is given what continues the fit every few
    /// seconds. If `keep` fails, the fit goes on: its result is worth more.
    ///
    /// # Errors
    /// See [`run`](Self::run).
    pub fn run_kept(
        &self,
        resume: Option<Save>,
        control: &Control<'_>,
        keep: &Keep<'_>,
    ) -> Result<Ending> {
        if self.schedule == Schedule::Mode {
            let found = find_mode(std::slice::from_ref(self), control)?;
            let fit = found.into_iter().flatten().next();
            return Ok(fit.map_or(Ending::Stopped(None), |fit| Ending::Done(Box::new(fit))));
        }
        let observed = Observed::new(self.photo, self.landmarks, &self.crop)?;
        let problem = observed.problem(self.model, &self.config, simd::best());
        let chains = self.chains.max(1) as usize;
        let saves = match resume {
            None => vec![None; chains],
            Some(save) => {
                if save.identity != self.identity() || save.chains.len() != chains {
                    return Err(Error::new(OF_ANOTHER));
                }
                save.chains
            }
        };
        let shelf = Mutex::new((Instant::now(), saves.clone()));
        let shelve = |number: usize, chain: &Running<'_, '_>| {
            let Ok(mut shelf) = shelf.lock() else { return };
            let (last, chains) = &mut *shelf;
            chains[number] = Some(chain.save());
            if last.elapsed() >= EVERY {
                let _ = keep(&Save { identity: self.identity(), chains: chains.clone() });
                *last = Instant::now();
            }
        };
        let runs = saves
            .into_par_iter()
            .enumerate()
            .map(|(number, save)| {
                let mut memory = vec![0_u32; problem.dimensions().words()];
                let running = Running::start(problem, self.seed, number as u32, save, &mut memory)?;
                Ok(to_the_end(running, control, |chain| shelve(number, chain)))
            })
            .collect::<Result<Vec<_>>>()?;
        if control.stop.load(Ordering::Relaxed) && !runs.iter().all(|run| run.finished) {
            let chains = runs.into_iter().map(|run| Some(run.save)).collect();
            let save = Save { identity: self.identity(), chains };
            return Ok(Ending::Stopped(Some(Box::new(save))));
        }
        let fit = self.summarize(runs).ok_or_else(|| Error::new("no chain ran"))?;
        Ok(Ending::Done(Box::new(fit)))
    }
}

/// Searches for the mode on one thread, the jobs being photos of one subject. Returns a fit for each photo, or
/// `None` if [`Control::stop`] was set. Model and settings are the first job's.
///
/// # Errors
/// No jobs, or more than [`MAX_PHOTOS`](search::unknowns::MAX_PHOTOS); landmarks the model does not
/// have, a crop that does not fit the photo or its mask, masks that hide the whole face.
pub fn find_mode(jobs: &[Job<'_>], control: &Control<'_>) -> Result<Option<Vec<Fit>>> {
    let found = find_mode_and(jobs, control, |_, _| Ok(Some(())))?;
    Ok(found.map(|(fits, ())| fits))
}

/// The same, and what `then` makes of the search's problem and options.
///
/// # Errors
/// Those of [`find_mode`] and of `then`.
pub(crate) fn find_mode_and<T>(
    jobs: &[Job<'_>],
    control: &Control<'_>,
    then: impl FnOnce(Problem<'_>, Options<'_>) -> Result<Option<T>>,
) -> Result<Option<(Vec<Fit>, T)>> {
    let start = Instant::now();
    let looks = jobs.iter().map(Look::new).collect::<Result<Vec<_>>>()?;
    let problems: Vec<_> = jobs.iter().zip(&looks).map(|(job, look)| look.problem(job)).collect();
    let photos: Vec<_> = problems.iter().map(|problem| problem.photo).collect();
    let (Some(&problem), Some((_, others))) = (problems.first(), photos.split_first()) else {
        return Err(Error::new("no photo to fit to"));
    };
    let options = Options { others, ..Options::default() };
    let mut memory = vec![0; search::words(&problem, &options)];
    let mut searching = Searching::start(problem, options, &mut memory)?;
    let mut steps = 0;
    while searching.step().is_some() {
        if control.stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        control.steps.fetch_add(1, Ordering::Relaxed);
        steps += 1;
    }
    if !searching.search.energy().total().is_finite() {
        return Err(Error::new(if jobs.iter().any(|job| job.mask.is_some()) {
            "nothing of the face can be seen: the mask hides all of it; white is where it may be \
             seen, black where not"
        } else {
            "nothing of the face can be seen where the landmarks put it; are they this photo's?"
        }));
    }
    // It may have converged early.
    control.steps.fetch_add(most_steps().saturating_sub(steps), Ordering::Relaxed);
    let seconds = start.elapsed().as_secs_f64();
    let mut fits = searching.end(jobs.iter().zip(problems.iter().copied()), seconds)?;
    let layout = searching.search.layout();
    let mut more = vec![0; posterior::words(&problem, &options, 0)];
    // A mode without is a mode all the same.
    if let Ok(mut found) = posterior::laplace(searching.search, &mut more) {
        for (number, fit) in fits.iter_mut().enumerate() {
            if let (Some(mode), Some(parts)) =
                (&mut fit.mode, layout.split(&mut found.deviations, number))
            {
                mode.laplace = Some(laplace(&parts, found.ln_evidence));
            }
        }
    }
    Ok(then(problem, options)?.map(|made| (fits, made)))
}

/// The approximation as the summary has it.
fn laplace(parts: &Parts<'_>, ln_evidence: f64) -> Laplace {
    let [x, y, z, tx, ty, zoom, distance] = *parts.pose;
    Laplace {
        ln_evidence,
        rotation_deg: [x, y, z].map(f32::to_degrees),
        translation_mm: [tx, ty],
        zoom,
        distance,
        shape: parts.shape.to_vec(),
        albedo: parts.albedo.to_vec(),
        light: parts.light.to_vec(),
        color: parts.color.to_vec(),
    }
}

/// What a search looks at of a photo.
struct Look<'a> {
    observed: Observed<'a>,
    open: Option<Vec<u8>>,
}

impl<'a> Look<'a> {
    fn new(job: &Job<'a>) -> Result<Self> {
        let open = job.mask.map(|mask| job.crop.cut(mask)).transpose()?.map(|mask| {
            let grey =
                |[r, g, b]: &[u8; 3]| ((u16::from(*r) + u16::from(*g) + u16::from(*b)) / 3) as u8;
            mask.rgb.iter().map(grey).collect::<Vec<u8>>()
        });
        Ok(Self { observed: Observed::new(job.photo, job.landmarks, &job.crop)?, open })
    }

    fn problem<'l>(&'l self, job: &'l Job<'_>) -> Problem<'l> {
        self.observed.problem(job.model, &job.config, simd::best()).with_open(self.open.as_deref())
    }
}

/// Runs a chain to its end, or until it is to stop; every now and then it is shelved.
fn to_the_end(
    mut running: Running<'_, '_>,
    control: &Control<'_>,
    shelve: impl Fn(&Running<'_, '_>),
) -> Run {
    let (before, _) = running.chain.progress();
    control.steps.fetch_add(u64::from(before), Ordering::Relaxed);
    let start = Instant::now();
    let mut last = start;
    while !control.stop.load(Ordering::Relaxed) && running.step().is_some() {
        control.steps.fetch_add(1, Ordering::Relaxed);
        if last.elapsed() >= EVERY {
            shelve(&running);
            last = Instant::now();
        }
    }
    shelve(&running);
    running.end(start.elapsed().as_secs_f64())
}
