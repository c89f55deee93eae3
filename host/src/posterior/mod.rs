//! The posterior around a fit's mode, sampled by several chains.

pub mod diagnostics;
pub mod output;
mod save;

use crate::error::{Error, Result};
use crate::fit::summary::{Marginal, PosteriorFound, hex};
use crate::fit::{Control, EVERY, Fit, Job, OF_ANOTHER, OTHERS, find_mode_and, most_mode_steps};
use diagnostics::{Diagnosis, quantile};
use onescan_core::chain::Problem;
use onescan_core::engine::Engine;
use onescan_core::hash::Fnv64;
use onescan_core::posterior::{self, Sampler};
use onescan_core::scene::{Subject, View};
use onescan_core::search::{self, ModeSearch, Options, Part, part_words};
use output::Spread;
use rayon::prelude::*;
pub use save::Save;
use std::f64::consts::{PI, TAU};
use std::sync::Mutex;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Steps of rounds of a chain's warm-up, after each of which all chains together learn a better metric.
/// Chosen, as are the next two; with them all parameters mix (docs/posterior.md).
const ROUNDS: [u32; 3] = [30, 40, 50];
/// Steps that then adapt how far it turns at once.
const TURNING: u32 = 30;
/// Steps of a chain that adapt it and are thrown away.
pub const WARM_UP: u32 = ROUNDS[0] + ROUNDS[1] + ROUNDS[2] + TURNING;
/// Places that a chain notes in a round, at most.
const PLACES: usize = 400;
/// R̂ below which, and sample sizes from which on, a parameter counts as mixed (Vehtari et al. 2021).
const R_HAT: f64 = 1.01;
const ESS: f64 = 400.0;

/// What is asked of a sampler.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    /// Kept states of each chain.
    pub draws: u32,
    /// Chains.
    pub chains: u32,
    /// Seed.
    pub seed: u64,
}

impl Request {
    /// Steps of search and chains, for a progress bar.
    pub fn steps(&self) -> u64 {
        let chain = u64::from(WARM_UP + self.draws);
        most_mode_steps() + u64::from(self.chains) * chain
    }
}

/// A state of a chain.
#[derive(Clone, Debug, PartialEq)]
pub struct Draw {
    /// Shape and albedo.
    pub subject: Subject,
    /// Photo by photo; cameras see the whole photo.
    pub views: Vec<View>,
    /// Log posterior density, up to a constant.
    pub ln_density: f64,
}

/// Samples of the posterior.
#[derive(Clone, Debug, PartialEq)]
pub struct Samples {
    /// The kept states of every chain.
    pub chains: Vec<Vec<Draw>>,
    /// Share of the trajectories that were accepted.
    pub acceptance: f64,
    /// Hash over the bits of every accepted state of all chains.
    pub fingerprint: u64,
}

/// Finds the mode of photos of one subject, and samples the posterior around it; `None` if
/// [`Control::stop`] was set. Chains run in parallel on rayon's threads; each is a function of the seed
/// and its number, so the number of threads changes nothing.
///
/// # Errors
/// Those of [`crate::fit::find_mode`]; a mode that nothing can be sampled around.
pub fn sample(
    jobs: &[Job<'_>],
    request: &Request,
    control: &Control<'_>,
) -> Result<Option<(Vec<Fit>, Samples)>> {
    sample_kept(jobs, request, None, control, &|_| Ok(()))
}

/// Called with what continues a sampling, in order to keep it.
pub type Keep<'a> = dyn Fn(&Save) -> Result<()> + Sync + 'a;

/// The same as [`sample`], from where `resume` left it. `keep` is given what continues it, every few seconds
/// and when it is stopped. If `keep` fails on the way, the sampling goes on: its result is worth more.
///
/// # Errors
/// Those of [`sample`]; a `resume` of other photos, models or settings.
pub fn sample_kept(
    jobs: &[Job<'_>],
    request: &Request,
    resume: Option<Save>,
    control: &Control<'_>,
    keep: &Keep<'_>,
) -> Result<Option<(Vec<Fit>, Samples)>> {
    let save = resume.unwrap_or_else(|| Save::new(jobs, request));
    if !save.is_of(jobs, request) {
        return Err(Error::new(OF_ANOTHER));
    }
    find_mode_and(jobs, control, |problem, options| {
        let shelf = Shelf { last: Instant::now(), pause: EVERY, save, keep };
        sample_around(jobs, problem, options, request, (shelf, control))
    })
}

/// What all chains have come to, and when it was kept last.
struct Shelf<'a> {
    last: Instant,
    pause: Duration,
    save: Save,
    keep: &'a Keep<'a>,
}

impl Shelf<'_> {
    /// Keeps all, unless it did so a while ago: less often, the longer that takes.
    fn keep_at_times(&mut self) {
        if self.last.elapsed() >= self.pause {
            let start = Instant::now();
            let _ = (self.keep)(&self.save);
            self.last = Instant::now();
            self.pause = EVERY.max(20 * start.elapsed());
        }
    }
}

/// The same around the mode of a search, once that has been found.
fn sample_around(
    jobs: &[Job<'_>],
    problem: Problem<'_>,
    options: Options<'_>,
    request: &Request,
    (mut shelf, control): (Shelf<'_>, &Control<'_>),
) -> Result<Option<Samples>> {
    let memories = |words: usize| vec![vec![0; words]; request.chains as usize];
    let mut firsts = memories(search::words(&problem, &options));
    let mut shown = vec![0; part_words(problem.model)];
    let mut seconds = memories(posterior::words(&problem, &options, PLACES));
    let searches = firsts.par_iter_mut().map(|memory| mode(problem, options, memory));
    let mut searches = searches.collect::<Result<Vec<_>>>()?;
    let part = searches.first_mut().and_then(|search| Part::new(search, &mut shown));
    let part = part.ok_or_else(|| Error::new("nothing of the face is seen"))?;
    let chains = searches.into_par_iter().zip(&mut seconds).zip(0..request.chains);
    let chains = chains.map(|((search, memory), number)| {
        Sampler::new(search, &part, PLACES, request.seed, number, memory).map_err(Error::new)
    });
    let mut chains = chains.collect::<Result<Vec<_>>>()?;
    if !shelf.save.warm_up.go_on(&mut chains) {
        return Err(Error::new(OF_ANOTHER));
    }
    if !warm_up(&mut chains, problem.engine, &mut shelf, control) {
        return Ok(None);
    }
    for (chain, save) in chains.iter_mut().zip(&shelf.save.chains) {
        control.steps.fetch_add(save.len() as u64, Ordering::Relaxed);
        if !save.go_on(chain) {
            return Err(Error::new(OF_ANOTHER));
        }
    }
    let shelf = Mutex::new(shelf);
    chains.par_iter_mut().enumerate().for_each(|(number, chain)| {
        let done = shelf.lock().map_or(0, |shelf| shelf.save.chains[number].len());
        for _ in done..request.draws as usize {
            if control.stop.load(Ordering::Relaxed) {
                return;
            }
            chain.step();
            control.steps.fetch_add(1, Ordering::Relaxed);
            let draw = draw(chain, jobs);
            let Ok(mut shelf) = shelf.lock() else { return };
            shelf.save.chains[number].keep(draw, chain.standing());
            shelf.keep_at_times();
        }
    });
    let shelf = shelf.into_inner().map_err(|_| Error::new("a chain ended early"))?;
    if shelf.save.chains.iter().any(|chain| chain.len() < request.draws as usize) {
        (shelf.keep)(&shelf.save)?;
        return Ok(None);
    }
    let mut hash = Fnv64::default();
    let (mut steps, mut accepted) = (0, 0);
    for chain in &chains {
        let tally = chain.tally();
        (steps, accepted) = (steps + tally.0, accepted + tally.1);
        hash.write(&chain.fingerprint().to_le_bytes());
    }
    let acceptance = f64::from(accepted) / f64::from(steps.max(1));
    let chains = shelf.save.chains.into_iter().map(save::ChainSave::into_draws).collect();
    Ok(Some(Samples { chains, acceptance, fingerprint: hash.finish() }))
}

/// A chain's state; cameras see the whole photo.
fn draw(chain: &Sampler<'_, '_, OTHERS>, jobs: &[Job<'_>]) -> Draw {
    let views = chain.views().zip(jobs).map(|(mut view, job)| {
        view.camera = job.crop.camera_in_photo(&view.camera);
        view
    });
    let (views, ln_density) = (views.collect(), chain.ln_density());
    Draw { subject: chain.subject(), views, ln_density }
}

/// Has chains learn from each other where to go, and how far at once; `false` if that was stopped. What has
/// come of it is kept after every round.
fn warm_up(
    chains: &mut [Sampler<'_, '_, OTHERS>],
    engine: &Engine,
    shelf: &mut Shelf<'_>,
    control: &Control<'_>,
) -> bool {
    let n = chains.first().map_or(0, Sampler::unknowns);
    let mut memory = vec![0.0; posterior::improve_words(n)];
    let rounds = ROUNDS.into_iter().chain([TURNING]);
    for (round, steps) in (0..).zip(rounds) {
        if round < shelf.save.warm_up.rounds {
            control.steps.fetch_add(u64::from(steps) * chains.len() as u64, Ordering::Relaxed);
            continue;
        }
        let places = &mut shelf.save.warm_up.places;
        let last = round as usize == ROUNDS.len();
        if last {
            widen(chains, places, engine, &mut memory);
        }
        if !go(chains, steps, control) {
            return false;
        }
        if last {
            places.clear();
            let angle = chains.iter().map(Sampler::angle).sum::<f64>() / chains.len() as f64;
            for chain in &mut *chains {
                chain.turn_by(angle);
            }
        } else {
            for chain in &mut *chains {
                places.extend(chain.places());
            }
            // Where nothing is learnt the metric is good enough.
            if let Some(change) = posterior::improve(n, places, engine, &mut memory) {
                for chain in &mut *chains {
                    chain.adopt(&change);
                }
            }
        }
        shelf.save.warm_up.keep(chains);
        let _ = (shelf.keep)(&shelf.save);
    }
    true
}

/// Has all chains make so many steps of the warm-up; `false` if that was stopped.
fn go(chains: &mut [Sampler<'_, '_, OTHERS>], steps: u32, control: &Control<'_>) -> bool {
    let stopped = || control.stop.load(Ordering::Relaxed);
    chains.par_iter_mut().for_each(|chain| {
        for _ in 0..steps {
            if stopped() {
                return;
            }
            chain.warm_up();
            control.steps.fetch_add(1, Ordering::Relaxed);
        }
    });
    !stopped()
}

/// Has chains learn how wide it is along turns of the head: one after the other, each in the coordinates
/// that the one before led to.
fn widen(
    chains: &mut [Sampler<'_, '_, OTHERS>],
    places: &mut [f32],
    engine: &Engine,
    memory: &mut [f32],
) {
    let turns = chains.first().map_or(0, |chain| chain.turns().count());
    for number in 0..turns {
        let direction = chains.first().and_then(|chain| chain.turns().nth(number));
        let change =
            direction.and_then(|direction| posterior::widen(&direction, places, engine, memory));
        if let Some(change) = change {
            for chain in &mut *chains {
                chain.adopt(&change);
            }
        }
    }
}

/// The search at its end: it is made again, since its memory goes to what samples around it.
fn mode<'a, 'w>(
    problem: Problem<'a>,
    options: Options<'a>,
    memory: &'w mut [u32],
) -> Result<ModeSearch<'a, 'w, OTHERS>> {
    let mut search = ModeSearch::of_photos(problem, options, memory).map_err(Error::new)?;
    while search.step().is_some() {}
    Ok(search)
}

/// How a state has a parameter.
type Of = Box<dyn Fn(&Draw) -> f64 + Send + Sync>;
/// A parameter's name, and that.
type Parameter = (String, Of);

/// Yaw, pitch and roll, radians.
fn rotation(view: &View) -> [f32; 3] {
    [view.pose.yaw, view.pose.pitch, view.pose.roll]
}

/// All parameters of the subject and of one photo's view.
fn parameters(first: &Draw, photo: usize) -> Vec<Parameter> {
    let mut all: Vec<Parameter> = Vec::new();
    let mut put = |name: String, of: Of| all.push((name, of));
    for i in 0..first.subject.shape.len() {
        put(format!("shape[{i}]"), Box::new(move |d| d.subject.shape[i].into()));
    }
    for i in 0..first.subject.albedo.len() {
        put(format!("albedo[{i}]"), Box::new(move |d| d.subject.albedo[i].into()));
    }
    for (i, name) in ["yaw", "pitch", "roll"].into_iter().enumerate() {
        let angle = move |view: &View| rotation(view)[i];
        // A turn more or less is the same angle: that nearest the first state's.
        let near = f64::from(angle(&first.views[photo]));
        let of = move |d: &Draw| {
            let off = f64::from(angle(&d.views[photo])) - near;
            (near + (off + PI).rem_euclid(TAU) - PI).to_degrees()
        };
        put(format!("pose.{name}"), Box::new(of));
    }
    for i in 0..3 {
        let of = move |d: &Draw| f64::from(d.views[photo].pose.translation[i]);
        put(format!("pose.translation[{i}]"), Box::new(of));
    }
    put("camera.focal_length".into(), Box::new(move |d| d.views[photo].camera.focal_length.into()));
    for k in 0..9 {
        for c in 0..3 {
            let of = move |d: &Draw| f64::from(d.views[photo].light[k][c]);
            put(format!("light[{k}][{c}]"), Box::new(of));
        }
    }
    for c in 0..3 {
        put(format!("color.gain[{c}]"), Box::new(move |d| d.views[photo].color.gain[c].into()));
    }
    put("color.contrast".into(), Box::new(move |d| d.views[photo].color.contrast.into()));
    for c in 0..3 {
        put(format!("color.offset[{c}]"), Box::new(move |d| d.views[photo].color.offset[c].into()));
    }
    all
}

impl Samples {
    /// All states.
    pub fn draws(&self) -> impl Iterator<Item = &Draw> {
        self.chains.iter().flatten()
    }

    /// What the samples say of the subject, whose vertices have the given spread, and of one photo's view;
    /// `None` if there are no states.
    pub fn found(&self, photo: usize, spread: &Spread) -> Option<PosteriorFound> {
        let first = self.draws().next()?;
        let marginals: Vec<Marginal> = parameters(first, photo)
            .into_par_iter()
            .map(|(name, of)| {
                let chains: Vec<Vec<f64>> =
                    self.chains.iter().map(|chain| chain.iter().map(&of).collect()).collect();
                marginal(name, &chains)
            })
            .collect();
        let worst = |of: fn(&Marginal) -> f64, pick: fn(f64, f64) -> f64| {
            marginals.iter().map(of).reduce(pick).unwrap_or(0.0)
        };
        let mixed = |m: &&Marginal| m.r_hat < R_HAT && m.ess_bulk.min(m.ess_tail) >= ESS;
        Some(PosteriorFound {
            chains: self.chains.len() as u32,
            draws: self.chains[0].len() as u32,
            warm_up: WARM_UP,
            acceptance: self.acceptance,
            fingerprint: hex(self.fingerprint),
            r_hat: worst(|m| m.r_hat, f64::max),
            ess: worst(|m| m.ess_bulk.min(m.ess_tail), f64::min),
            mixed: marginals.iter().filter(mixed).count(),
            vertex_sd_mm: spread.rms(),
            uncertainty_scale_mm: f64::from(spread.most()),
            parameters: marginals,
        })
    }
}

fn marginal(name: String, chains: &[Vec<f64>]) -> Marginal {
    let all = chains.concat();
    let n = all.len().max(1) as f64;
    let mean = all.iter().sum::<f64>() / n;
    let sd = (all.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / (n - 1.0).max(1.0)).sqrt();
    let Diagnosis { r_hat, ess_bulk, ess_tail } = Diagnosis::of(chains);
    // What never moved has not mixed.
    let known = |x: f64, or: f64| if x.is_finite() { x } else { or };
    Marginal {
        name,
        mean,
        sd,
        low: quantile(&all, 0.05),
        high: quantile(&all, 0.95),
        r_hat: known(r_hat, f64::MAX),
        ess_bulk: known(ess_bulk, 0.0),
        ess_tail: known(ess_tail, 0.0),
    }
}

/// Why samples cannot be believed, as a sentence; `None` if they can.
pub fn warning(found: &PosteriorFound) -> Option<String> {
    let all = found.parameters.len();
    (found.mixed < all).then(|| {
        format!(
            "{} of {all} parameters have not mixed (R-hat of 1.01 or more, or an effective sample size \
             below 400; fit.json names them): take their intervals with care, or draw more than {} \
             states",
            all - found.mixed,
            found.draws
        )
    })
}
