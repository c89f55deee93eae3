//! Fitting a model to a photo: cut the face out, run the chains, keep the best state.

pub mod checkpoint;
pub mod output;

use crate::error::{Error, Result};
use crate::photo::Crop;
use crate::picture::Picture;
use crate::simd;
use crate::tlms::Tlms;
use checkpoint::{ChainSave, Identity, Save};
use onescan_core::chain::{
    Chain, Config, Image, Observation, Problem, Quality, Stage, State, Tally,
};
use onescan_core::hash::Fnv64;
use onescan_core::model::Model;
use onescan_core::proposal::Branch;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

/// Points of a likelihood trace.
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
    /// How to fit.
    pub config: Config,
    /// Seed of all randomness.
    pub seed: u64,
    /// Independent chains; the best state of all wins.
    pub chains: u32,
}

/// What the caller sees and says while a fit runs.
pub struct Control<'a> {
    /// Set by the caller to stop after the current step.
    pub stop: &'a AtomicBool,
    /// Steps done by all chains, for a progress bar.
    pub steps: &'a AtomicU64,
}

/// How a fit ended.
pub enum Ending {
    /// All steps were made.
    Done(Box<Fit>),
    /// [`Control::stop`] was set; this continues the fit.
    Stopped(Box<Save>),
}

/// One point of a trace: step over both stages, and the log likelihood of the stage.
pub type TracePoint = (u32, f64);

/// Acceptance of one kind of proposal in one stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Acceptance {
    /// The stage.
    pub stage: Stage,
    /// The proposal's name.
    pub name: &'static str,
    /// Whether it is a search move.
    pub search: bool,
    /// How often.
    pub tally: Tally,
}

/// A finished fit.
pub struct Fit {
    /// What the fit looked at.
    pub crop: Crop,
    /// The state the image stage began with, of the winning chain.
    pub initial: State,
    /// The best state of the image stage, of the winning chain. Its camera sees the crop.
    pub best: State,
    /// Fit of the initial state.
    pub initial_quality: Quality,
    /// Fit of the best state.
    pub best_quality: Quality,
    /// Hash of the accepted states of all chains.
    pub fingerprint: u64,
    /// Steps of all chains and stages.
    pub steps: u64,
    /// Accepted steps of all chains and stages.
    pub accepted: u64,
    /// Steps of all chains that compared the picture.
    pub image_evaluated: u64,
    /// Seconds of the slowest chain, both stages; of a resumed fit, since it was resumed.
    pub seconds: f64,
    /// Steps per second of one chain.
    pub steps_per_second: f64,
    /// Trace of the winning chain.
    pub trace: Vec<TracePoint>,
    /// Acceptance over all chains.
    pub acceptance: Vec<Acceptance>,
}

impl Job<'_> {
    /// What identifies the job, so that a checkpoint is only used for the job it was made by.
    fn identity(&self) -> Identity {
        let mut hash = Fnv64::default();
        hash.write(self.photo.rgb.as_flattened());
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

    /// Runs the fit, from the beginning or from where `resume` left it.
    ///
    /// Chains run in parallel on rayon's threads; each is a function of the seed and its number,
    /// so their number of threads changes nothing.
    ///
    /// # Errors
    /// Landmarks the model does not have, a crop that does not fit the photo, a checkpoint of
    /// another job.
    pub fn run(&self, resume: Option<Save>, control: &Control<'_>) -> Result<Ending> {
        let picture = self.crop.cut(self.photo)?;
        let positions: Vec<_> = self
            .landmarks
            .visible()
            .map(|l| {
                let p = self.crop.to_crop([f64::from(l.x), f64::from(l.y)]);
                Observation { name: &l.id, position: p.map(|x| x as f32) }
            })
            .collect();
        let problem = Problem {
            model: self.model,
            image: Image { pixels: &picture.rgb, width: picture.width, height: picture.height },
            landmarks: &positions,
            config: &self.config,
            engine: simd::best(),
            lean: false,
        };
        let chains = self.chains.max(1) as usize;
        let saves: Vec<Option<ChainSave>> = match resume {
            None => vec![None; chains],
            Some(save) => {
                if save.identity != self.identity() || save.chains.len() != chains {
                    return Err(Error::new(
                        "it was saved by a fit of another model, photo, landmark file or \
                         settings; repeat the first command exactly, or fit without --resume",
                    ));
                }
                save.chains.into_iter().map(Some).collect()
            }
        };
        let runs = saves
            .into_par_iter()
            .enumerate()
            .map(|(number, save)| run_chain(problem, self.seed, number as u32, save, control))
            .collect::<Result<Vec<_>>>()?;
        if control.stop.load(Ordering::Relaxed) && !runs.iter().all(|run| run.finished) {
            let chains = runs.into_iter().map(|run| run.save).collect();
            return Ok(Ending::Stopped(Box::new(Save { identity: self.identity(), chains })));
        }
        Ok(Ending::Done(Box::new(self.summarize(runs))))
    }

    fn summarize(&self, runs: Vec<Run>) -> Fit {
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
            match acceptance.iter_mut().find(|a| (a.stage, a.name) == (entry.stage, entry.name)) {
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
        let run = runs.into_iter().nth(winner);
        // One run per chain, and at least one chain.
        let run = run.expect("a chain won");
        let best = run.save.checkpoint.best;
        Fit {
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
        }
    }
}

/// A chain that has been run to its end, or stopped.
struct Run {
    save: ChainSave,
    finished: bool,
    seconds: f64,
    steps: u64,
    qualities: [Quality; 2],
    acceptance: Vec<Acceptance>,
}

fn run_chain(
    problem: Problem<'_>,
    seed: u64,
    number: u32,
    save: Option<ChainSave>,
    control: &Control<'_>,
) -> Result<Run> {
    let mut memory = vec![0_u32; problem.dimensions().words()];
    let (mut chain, mut trace) = match save {
        None => (Chain::new(problem, seed, number, &mut memory), Vec::new()),
        Some(save) => (Chain::resume(problem, save.checkpoint, &mut memory), save.trace),
    };
    let chain = chain.as_mut().map_err(|e| Error::new(*e))?;
    let (before, total) = chain.progress();
    control.steps.fetch_add(u64::from(before), Ordering::Relaxed);
    let stride = total.div_ceil(TRACE_POINTS).max(1);
    let start = Instant::now();
    let mut steps = 0;
    let mut finished = false;
    while !control.stop.load(Ordering::Relaxed) {
        let (at, _) = chain.progress();
        if at % stride == 0 {
            trace_point(chain, at, &mut trace);
        }
        if chain.step().is_none() {
            finished = true;
            break;
        }
        steps += 1;
        control.steps.fetch_add(1, Ordering::Relaxed);
    }
    let seconds = start.elapsed().as_secs_f64();
    if finished {
        trace_point(chain, chain.progress().0, &mut trace);
    }
    let checkpoint = chain.checkpoint().clone();
    let initial = checkpoint.initial.as_ref().unwrap_or(&checkpoint.state).scene.clone();
    let qualities = [initial, checkpoint.best.scene.clone()].map(|scene| chain.quality(&scene));
    Ok(Run {
        finished,
        seconds,
        steps,
        qualities,
        acceptance: acceptance(chain),
        save: ChainSave { checkpoint, trace },
    })
}

fn trace_point(chain: &Chain<'_, '_>, at: u32, trace: &mut Vec<TracePoint>) {
    let density = chain.state().density;
    let value = match chain.checkpoint().stage {
        Stage::Landmarks => density.landmarks,
        Stage::Image => density.image,
    };
    // A state the picture does not see at all has no finite likelihood and no place in a chart.
    if value.is_finite() && trace.last().is_none_or(|&(last, _)| last < at) {
        trace.push((at, value));
    }
}

/// Acceptance by stage and name, summed over the leaves of a name, in the tree's order.
fn acceptance(chain: &Chain<'_, '_>) -> Vec<Acceptance> {
    let mut all = Vec::new();
    for stage in [Stage::Landmarks, Stage::Image] {
        let mut by_name: BTreeMap<&str, usize> = BTreeMap::new();
        for (Branch { name, kind, .. }, tally) in chain.tallies(stage) {
            let index = *by_name.entry(name).or_insert_with(|| {
                let tally = Tally::default();
                all.push(Acceptance { stage, name, search: kind.is_search(), tally });
                all.len() - 1
            });
            let sum: &mut Tally = &mut all[index].tally;
            sum.proposed += tally.proposed;
            sum.accepted += tally.accepted;
        }
    }
    all
}
