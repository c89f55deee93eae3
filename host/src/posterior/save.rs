//! What continues an interrupted sampling with the same bits: after the search, which is made again, the
//! warm-up goes on after the last round that was done, and then every chain from where it stood.

use super::{Draw, Request};
use crate::error::Result;
use crate::fit::Job;
use crate::fit::checkpoint::{self, Identity};
use onescan_core::posterior::{Sampler, Standing};
use onescan_core::scene::{Scene, Subject};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// First bytes of a file, version included.
const MAGIC: [u8; 8] = *b"1scanps2";

/// An interrupted sampling.
#[derive(Serialize, Deserialize)]
pub struct Save {
    /// Of every photo, and the kept states that each chain was asked for.
    identity: (Vec<Identity>, u32),
    pub(super) warm_up: WarmUp,
    /// Its chains, in order.
    pub(super) chains: Vec<ChainSave>,
}

/// What a warm-up has come to after a round of it.
#[derive(Default, Serialize, Deserialize)]
pub(super) struct WarmUp {
    /// Rounds that are done; none if there is nothing yet.
    pub(super) rounds: u32,
    /// What all chains together have noted in the metric, as long as that is still learnt.
    pub(super) places: Vec<f32>,
    /// Of all chains.
    metric: Vec<f32>,
    /// Where they stand.
    chains: Vec<Standing>,
}

impl WarmUp {
    /// Notes where all chains stand after a round.
    pub(super) fn keep<const OTHERS: usize>(&mut self, chains: &[Sampler<'_, '_, OTHERS>]) {
        self.rounds += 1;
        self.metric = chains.first().map_or(Vec::new(), |chain| chain.metric().to_vec());
        self.chains = chains.iter().map(Sampler::standing).collect();
    }

    /// Has chains go on from there; `false` if they cannot.
    pub(super) fn go_on<const OTHERS: usize>(
        &self,
        chains: &mut [Sampler<'_, '_, OTHERS>],
    ) -> bool {
        let n = chains.first().map_or(1, Sampler::unknowns);
        let whole =
            self.chains.len() == chains.len() && self.places.len().is_multiple_of(2 * n.max(1));
        let mut all = chains.iter_mut().zip(&self.chains);
        self.rounds == 0
            || (whole && all.all(|(c, at)| c.go_on_in(&self.metric) && c.go_on_from(at)))
    }
}

/// A chain.
#[derive(Clone, Default, Serialize, Deserialize)]
pub(super) struct ChainSave {
    /// Where it stands; not before its first step after the warm-up.
    standing: Option<Standing>,
    kept: Vec<Kept>,
}

/// A [`Draw`]: a scene for each photo, of one subject.
#[derive(Clone, Serialize, Deserialize)]
struct Kept {
    scenes: Vec<Scene>,
    ln_density: f64,
}

impl Save {
    /// Of chains that have not begun.
    pub(super) fn new(jobs: &[Job<'_>], request: &Request) -> Self {
        let chains = vec![ChainSave::default(); request.chains as usize];
        Self { identity: identity(jobs, request), warm_up: WarmUp::default(), chains }
    }

    /// Whether it is of these jobs, by what it says.
    pub(super) fn is_of(&self, jobs: &[Job<'_>], request: &Request) -> bool {
        self.identity == identity(jobs, request)
            && self.chains.len() == request.chains as usize
            && self.chains.iter().all(|chain| chain.len() <= request.draws as usize)
    }

    /// The file's bytes.
    ///
    /// # Errors
    /// None in practice; the encoder's are passed on.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        checkpoint::pack(MAGIC, self)
    }

    /// Reads a file's bytes.
    ///
    /// # Errors
    /// Not such a file, or damaged.
    pub fn parse(bytes: &[u8]) -> Result<Self> {
        checkpoint::unpack(MAGIC, bytes)
    }

    /// Reads a file.
    ///
    /// # Errors
    /// As [`Save::parse`], naming the file.
    pub fn read(path: &Path) -> Result<Self> {
        checkpoint::read(path, Self::parse)
    }
}

impl ChainSave {
    /// Adds a state, and where the chain stands now.
    pub(super) fn keep(&mut self, draw: Draw, standing: Standing) {
        let Draw { subject, views, ln_density } = draw;
        let scene = |view| Scene { subject: subject.clone(), view };
        self.kept.push(Kept { scenes: views.into_iter().map(scene).collect(), ln_density });
        self.standing = Some(standing);
    }

    /// Has the chain go on, whose states are like it; `false` if it cannot.
    pub(super) fn go_on<const OTHERS: usize>(&self, chain: &mut Sampler<'_, '_, OTHERS>) -> bool {
        let (subject, photos) = (chain.subject(), chain.views().count());
        let ranks = |subject: &Subject| [subject.shape.len(), subject.albedo.len()];
        let fits = |kept: &Kept| {
            kept.scenes.len() == photos
                && kept.scenes.iter().all(|scene| ranks(&scene.subject) == ranks(&subject))
        };
        match &self.standing {
            None => self.kept.is_empty(),
            Some(standing) => self.kept.iter().all(fits) && chain.go_on_from(standing),
        }
    }

    /// Kept states so far.
    pub(super) fn len(&self) -> usize {
        self.kept.len()
    }

    /// These.
    pub(super) fn into_draws(self) -> Vec<Draw> {
        let draw = |Kept { scenes, ln_density }: Kept| {
            let subject = scenes.first()?.subject.clone();
            let views = scenes.into_iter().map(|scene| scene.view).collect();
            Some(Draw { subject, views, ln_density })
        };
        self.kept.into_iter().filter_map(draw).collect()
    }
}

fn identity(jobs: &[Job<'_>], request: &Request) -> (Vec<Identity>, u32) {
    let of =
        |job: &Job<'_>| Identity { seed: request.seed, chains: request.chains, ..job.identity() };
    (jobs.iter().map(of).collect(), request.draws)
}
