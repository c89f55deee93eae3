//! What all photos of a search share.

use super::instance::Instance;
use super::priors::{Complexion, Priors, Widths};
use super::unknowns::Layout;
use crate::basis::ByVertex;
use crate::chain::{Dimensions, Photo, Problem};
use crate::scene::{MAX_RANK, Subject};

/// One resolution of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Standard deviation of the photo's blur, pixels; at most 4.
    pub blur: f32,
    /// Standard deviation of a pixel's colour channel, as a multiple of the configuration's.
    pub error: f32,
    /// The most pixels whose rows make a step's metric.
    pub pixels: usize,
    /// The most components that are sought of shape and of albedo each, the leading ones.
    pub components: usize,
    /// The most iterations.
    pub iterations: u32,
}

/// The levels of a search, coarse to fine. How many components each has was measured
/// (docs/accuracy.md, "Components by level"); the rest was chosen.
pub const LEVELS: [Level; 5] = [
    Level { blur: 4.0, error: 2.8, pixels: 500, components: 20, iterations: 5 },
    Level { blur: 2.0, error: 1.86, pixels: 500, components: 50, iterations: 5 },
    Level { blur: 1.0, error: 1.4, pixels: 500, components: 100, iterations: 5 },
    Level { blur: 0.0, error: 1.3, pixels: 1500, components: MAX_RANK, iterations: 10 },
    Level { blur: 0.0, error: 1.0, pixels: 1500, components: MAX_RANK, iterations: 30 },
];

/// What a search needs to know besides the problem.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options<'a> {
    /// Priors that only the search uses.
    pub widths: Widths,
    /// Whether pixels may show something else than the face.
    pub occlusion: bool,
    /// More photos of the same subject, besides the problem's.
    pub others: &'a [Photo<'a>],
}

impl Default for Options<'_> {
    fn default() -> Self {
        Self { widths: Widths::default(), occlusion: true, others: &[] }
    }
}

/// The larger of two.
pub(super) const fn larger(a: usize, b: usize) -> usize {
    if a > b { a } else { b }
}

/// `E`, part by part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    /// Of the covered pixels.
    pub image: f64,
    /// Of the landmarks.
    pub landmarks: f64,
    /// Of everything else.
    pub prior: f64,
}

impl Energy {
    /// The sum.
    pub fn total(&self) -> f64 {
        self.image + self.landmarks + self.prior
    }
}

/// What all photos share: whom they show, and how that is looked for.
pub(super) struct Common<'a, 'w> {
    pub(super) problem: Problem<'a>,
    pub(super) widths: Widths,
    pub(super) complexion: Complexion,
    pub(super) level: usize,
    /// Of the unknowns at this level.
    pub(super) layout: Layout,
    pub(super) subject: Subject,
    /// The subject's, once it has been computed.
    pub(super) instance: Instance<'w>,
}

impl<'a> Common<'a, '_> {
    /// Whether the level is the last.
    pub(super) fn finest(&self) -> bool {
        self.level + 1 == LEVELS.len()
    }

    /// The level the search is at.
    pub(super) fn level(&self) -> Level {
        LEVELS.get(self.level).copied().unwrap_or(LEVELS[LEVELS.len() - 1])
    }

    /// Goes to a level.
    pub(super) fn enter(&mut self, level: usize) {
        self.level = level;
        let most = self.level().components;
        let Dimensions { shape_rank, albedo_rank, .. } = self.problem.dimensions();
        self.layout.shape_rank = shape_rank.min(most);
        self.layout.albedo_rank = albedo_rank.min(most);
    }

    /// Standard deviation of a pixel's channel at this level.
    pub(super) fn sd(&self) -> f32 {
        self.level().error * self.problem.config.pixel_sd
    }

    /// What a squared difference of colours counts.
    pub(super) fn pixel_weight(&self) -> f32 {
        let sd = self.sd();
        1.0 / (sd * sd * self.patch())
    }

    /// Pixels that share one independent error. What the model cannot explain of a subject is wrong
    /// in all its photos alike, so that many say no more of it than one.
    pub(super) fn patch(&self) -> f32 {
        self.problem.config.pixel_patch * self.layout.views as f32
    }

    /// The priors at work.
    pub(super) fn priors(&self) -> Priors<'a> {
        let Self { widths, complexion, .. } = *self;
        Priors { prior: &self.problem.config.prior, widths, complexion }
    }
}

/// What rows of the matrix are made with.
pub(super) struct Scratch<'w> {
    /// Shape and albedo by vertex, unless memory is scarce.
    pub(super) by_vertex: [Option<ByVertex<'w>>; 2],
    /// Of a pixel's three channels.
    pub(super) rows: [&'w mut [f32]; 3],
}
