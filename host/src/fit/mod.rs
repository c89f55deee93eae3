//! Fitting a model to a photo: cut the face out, run the chains, keep the best state.

pub mod checkpoint;
pub mod landmarks;
#[cfg(feature = "full")]
pub mod mixture;
mod mode;
pub mod output;
#[cfg(feature = "full")]
mod parallel;
pub mod rps;
mod schedule;
pub mod summary;

use crate::error::{Error, Result};
use crate::photo::Crop;
use crate::photo::picture::Picture;
use crate::photo::tlms::Tlms;
use checkpoint::ChainSave;
use summary::ModeFound;

pub use mode::Searching;
use onescan_core::chain::{self, Chain, Config, PhaseName, Problem, Quality, State, Step, Tally};
use onescan_core::engine::Engine;
use onescan_core::hash::Fnv64;
use onescan_core::image::Image;
use onescan_core::likelihood::landmarks::ObservedLandmark;
use onescan_core::model::Model;
use onescan_core::proposal::Branch;
#[cfg(feature = "full")]
pub use parallel::{Control, Ending, Keep, find_mode};
pub use schedule::Schedule;
use std::collections::BTreeMap;
#[cfg(feature = "full")]
pub(crate) use {
    mode::{OTHERS, most_steps as most_mode_steps},
    parallel::{EVERY, OF_ANOTHER, find_mode_and},
};

/// Points of a likelihood trace. Chosen, not measured.
const TRACE_POINTS: u32 = 400;

/// What is to be fitted.
pub struct Job<'a> {
    /// The model.
    pub model: &'a Model<'a>,
    /// The whole photo.
    pub photo: &'a Picture,
    /// Landmarks in the photo.
    pub landmarks: &'a Tlms,
    /// The part of the photo the fit looks at.
    pub crop: Crop,
    /// Where the face may be seen, in a search: a picture of the photo's size, white there and
    /// black where it is hidden.
    pub mask: Option<&'a Picture>,
    /// In what way to fit.
    pub schedule: Schedule,
    /// How: [`Schedule::config`] with what is to be otherwise.
    pub config: Config,
    /// Seed of all randomness.
    pub seed: u64,
    /// Independent chains; the best state of all wins.
    pub chains: u32,
}

impl<'a> Job<'a> {
    /// The fit of a photo as `onescan fit` makes it if nothing else is said: a search for the mode, with all
    /// components, around the landmarks.
    ///
    /// # Errors
    /// A model without landmarks; landmarks that cannot be its, or not the photo's.
    pub fn new(model: &'a Model<'a>, photo: &'a Picture, landmarks: &'a Tlms) -> Result<Self> {
        let (schedule, side) = (Schedule::default(), Crop::LONGER_SIDE);
        let config = schedule.config(model, side);
        let size = [photo.width, photo.height];
        let names: Vec<_> = model.landmarks().map(|(name, _)| name).collect();
        if names.is_empty() {
            return Err(Error::new("the model has no landmarks; build it with --landmarks"));
        }
        landmarks.check(photo.width, photo.height, &names)?;
        landmarks::check_sides(model, landmarks, size, side, config.landmark_sd)?;
        let crop = landmarks::crop_around(model, landmarks, size, side, config.landmark_sd)?;
        Ok(Self { model, photo, landmarks, crop, mask: None, schedule, config, seed: 7, chains: 1 })
    }
}

/// One point of a trace: step over both phases, and the log likelihood of the phase.
pub type TracePoint = (u32, f64);

/// Acceptance of one kind of proposal in one phase.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Acceptance {
    /// The phase.
    pub phase: PhaseName,
    /// The proposal's name.
    pub name: &'static str,
    /// Whether it steers, see [`Move::steers`](onescan_core::proposal::Move::steers).
    pub steers: bool,
    /// How often.
    pub tally: Tally,
}

/// A finished fit.
pub struct Fit {
    /// What the fit looked at.
    pub crop: Crop,
    /// The state the image phase began with, of the winning chain.
    pub initial: State,
    /// The best state of the image phase, of the winning chain. Its camera sees the crop.
    pub best: State,
    /// How well the initial state fits.
    pub initial_quality: Quality,
    /// How well the best state fits.
    pub best_quality: Quality,
    /// Hash of the accepted states of all chains.
    pub fingerprint: u64,
    /// Steps of all chains and phases.
    pub steps: u64,
    /// Accepted steps of all chains and phases.
    pub accepted: u64,
    /// Steps of all chains that compared the picture.
    pub image_evaluated: u64,
    /// Seconds of the slowest chain, all phases; of a resumed fit, since it was resumed.
    pub seconds: f64,
    /// Steps per second of one chain.
    pub steps_per_second: f64,
    /// Trace of the winning chain.
    pub trace: Vec<TracePoint>,
    /// Acceptance over all chains.
    pub acceptance: Vec<Acceptance>,
    /// What a search for the mode leaves besides; `None` of a chain.
    pub mode: Option<Mode>,
}

#[cfg(feature = "full")]
impl Fit {
    /// Log marginal likelihood under the model, up to a constant that models share, if it was computed.
    pub fn ln_evidence(&self) -> Option<f64> {
        Some(self.mode.as_ref()?.laplace.as_ref()?.ln_evidence)
    }
}

/// What a search for the mode leaves besides its scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Mode {
    /// How it ended.
    pub found: ModeFound,
    /// Probability of each pixel of the crop to show the face; 0 where it does not reach.
    pub mask: Vec<f32>,
    /// How exact the result is, approximately, if that was computed.
    #[cfg(feature = "full")]
    pub laplace: Option<summary::Laplace>,
}

impl Job<'_> {
    /// The fit that chains which have ended make up together; `None` if there are none.
    pub fn summarize(&self, runs: Vec<Run>) -> Option<Fit> {
        let fingerprint = match &runs[..] {
            [one] => one.save.checkpoint.fingerprint.finish(),
            many => {
                let mut hash = Fnv64::default();
                for run in many {
                    hash.write(&run.save.checkpoint.fingerprint.finish().to_le_bytes());
                }
                hash.finish()
            }
        };
        let tallies = |run: &Run| run.save.checkpoint.tallies.clone().into_iter().flatten();
        let sum = |f: fn(&Tally) -> u32| {
            runs.iter().flat_map(tallies).map(|tally| u64::from(f(&tally))).sum()
        };
        let mut acceptance: Vec<Acceptance> = Vec::new();
        for entry in runs.iter().flat_map(|run| &run.acceptance) {
            match acceptance.iter_mut().find(|a| (a.phase, a.name) == (entry.phase, entry.name)) {
                Some(a) => {
                    a.tally.proposed += entry.tally.proposed;
                    a.tally.accepted += entry.tally.accepted;
                }
                None => acceptance.push(entry.clone()),
            }
        }
        let (steps, accepted) = (sum(|t| t.proposed), sum(|t| t.accepted));
        let image_evaluated =
            runs.iter().map(|run| u64::from(run.save.checkpoint.image_evaluated)).sum();
        let seconds = runs.iter().map(|run| run.seconds).fold(0.0, f64::max);
        let own_steps: u64 = runs.iter().map(|run| run.steps).sum();
        let own_seconds: f64 = runs.iter().map(|run| run.seconds).sum();
        let posterior = |run: &Run| run.save.checkpoint.best.density.posterior(&self.config);
        // The first of equals, so that the choice does not depend on the order of arrival.
        let mut winner = 0;
        for (number, run) in runs.iter().enumerate() {
            if posterior(run) > posterior(&runs[winner]) {
                winner = number;
            }
        }
        let run = runs.into_iter().nth(winner)?;
        let best = run.save.checkpoint.best;
        Some(Fit {
            crop: self.crop,
            initial: run.save.checkpoint.initial.unwrap_or_else(|| best.clone()),
            best,
            initial_quality: run.qualities[0],
            best_quality: run.qualities[1],
            fingerprint,
            steps,
            accepted,
            image_evaluated,
            seconds,
            steps_per_second: own_steps as f64 / own_seconds.max(1e-9),
            trace: run.save.trace,
            acceptance,
            mode: None,
        })
    }
}

/// The part of a photo a fit looks at, with the landmarks in it.
pub struct Observed<'a> {
    /// The pixels.
    pub picture: Picture,
    /// The visible landmarks.
    pub landmarks: Vec<ObservedLandmark<'a>>,
}

impl<'a> Observed<'a> {
    /// What chains look at.
    ///
    /// # Errors
    /// A crop that does not fit the photo.
    pub fn new(photo: &Picture, landmarks: &'a Tlms, crop: &Crop) -> Result<Self> {
        let positions = landmarks.visible().map(|l| {
            let p = crop.to_crop([f64::from(l.x), f64::from(l.y)]);
            ObservedLandmark { name: &l.id, position: p.map(|x| x as f32) }
        });
        Ok(Self { landmarks: positions.collect(), picture: crop.cut(photo)? })
    }

    /// The chain's problem.
    pub fn problem(
        &'a self,
        model: &'a Model<'a>,
        config: &'a Config,
        engine: &'a Engine,
    ) -> Problem<'a> {
        let Picture { rgb, width, height } = &self.picture;
        let image = Image { pixels: rgb, width: *width, height: *height };
        Problem::new(model, image, &self.landmarks, config)
            .with_schedule(chain::Schedule::of(&self.landmarks))
            .with_engine(engine)
    }
}

/// A chain that has been run to its end, or stopped.
pub struct Run {
    save: ChainSave,
    /// Whether all steps were made.
    pub finished: bool,
    seconds: f64,
    steps: u64,
    qualities: [Quality; 2],
    acceptance: Vec<Acceptance>,
}

/// A chain on its way, and its trace.
pub struct Running<'a, 'w> {
    /// The chain.
    pub chain: Chain<'a, 'w>,
    trace: Vec<TracePoint>,
    stride: u32,
    steps: u64,
}

impl<'a, 'w> Running<'a, 'w> {
    /// Begins, or goes on from where `save` was made.
    ///
    /// # Errors
    /// Those of [`Chain::new`] and [`Chain::resume`].
    pub fn start(
        problem: Problem<'a>,
        seed: u64,
        number: u32,
        save: Option<ChainSave>,
        memory: &'w mut [u32],
    ) -> Result<Self> {
        let (chain, trace) = match save {
            None => (Chain::new(problem, seed, number, memory), Vec::new()),
            Some(save) => (Chain::resume(problem, save.checkpoint, memory), save.trace),
        };
        let chain = chain.map_err(Error::new)?;
        let (done, total) = chain.progress();
        let stride = total.div_ceil(TRACE_POINTS).max(1);
        let mut running = Self { chain, trace, stride, steps: 0 };
        if done % stride == 0 {
            running.note();
        }
        Ok(running)
    }

    /// Makes one step; `None` when the fit is done.
    pub fn step(&mut self) -> Option<Step> {
        let step = self.chain.step()?;
        self.steps += 1;
        let (at, total) = self.chain.progress();
        if at % self.stride == 0 || at == total {
            self.note();
        }
        Some(step)
    }

    /// The log likelihood by step so far.
    pub fn trace(&self) -> &[TracePoint] {
        &self.trace
    }

    /// What it takes to go on from here.
    #[cfg(feature = "full")]
    pub(crate) fn save(&self) -> ChainSave {
        ChainSave { checkpoint: self.chain.checkpoint().clone(), trace: self.trace.clone() }
    }

    /// What it came to, `seconds` after it started.
    pub fn end(&mut self, seconds: f64) -> Run {
        let (done, total) = self.chain.progress();
        let chain = &mut self.chain;
        let checkpoint = chain.checkpoint().clone();
        let initial = checkpoint.initial.as_ref().unwrap_or(&checkpoint.state).scene.clone();
        let scenes = [initial, checkpoint.best.scene.clone()];
        Run {
            qualities: scenes.map(|scene| chain.quality(&scene)),
            acceptance: acceptance(chain),
            finished: done == total,
            seconds,
            steps: self.steps,
            save: ChainSave { checkpoint, trace: self.trace.clone() },
        }
    }

    fn note(&mut self) {
        trace_point(&self.chain, self.chain.progress().0, &mut self.trace);
    }
}

fn trace_point(chain: &Chain<'_, '_>, at: u32, trace: &mut Vec<TracePoint>) {
    let density = chain.state().density;
    let value = match chain.phase() {
        PhaseName::Landmarks | PhaseName::Shape => density.landmarks,
        PhaseName::Image => density.image,
    };
    // A state the picture does not see at all has no finite likelihood and no place in a chart.
    if value.is_finite() && trace.last().is_none_or(|&(last, _)| last < at) {
        trace.push((at, value));
    }
}

/// Acceptance by phase and name, summed over the leaves of a name, in the tree's order.
fn acceptance(chain: &Chain<'_, '_>) -> Vec<Acceptance> {
    let mut all = Vec::new();
    for phase in PhaseName::ALL {
        let mut by_name: BTreeMap<&str, usize> = BTreeMap::new();
        for (Branch { name, kind, .. }, tally) in chain.tallies(phase) {
            let index = *by_name.entry(name).or_insert_with(|| {
                let tally = Tally::default();
                all.push(Acceptance { phase, name, steers: kind.steers(), tally });
                all.len() - 1
            });
            let sum: &mut Tally = &mut all[index].tally;
            sum.proposed += tally.proposed;
            sum.accepted += tally.accepted;
        }
    }
    all
}
