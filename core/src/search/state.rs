//! The state of a search, in the caller's memory.

use super::common::{Common, Energy, Options, Scratch, larger};
use super::evidence::{Evidence, evidence_words};
use super::gradient::gradient_words;
use super::instance::{Instance, instance_words};
use super::priors::Complexion;
use super::unknowns::Layout;
use crate::basis::{ByVertex, by_vertex_words};
use crate::chain::{ChainError, Dimensions, Problem};
use crate::hash::Fnv64;
use crate::least_squares::{matrix_words, system_words};
use crate::likelihood::background::HISTOGRAM_LEN;
use crate::memory::Carver;
use crate::scene::{Scene, Subject, View};

/// Words of memory a [`ModeSearch`] of a problem needs. A [lean](Problem::lean) one has no copies of the
/// bases: it is slower, with the same bits.
pub fn words(problem: &Problem<'_>, options: &Options<'_>) -> usize {
    let first = problem.dimensions();
    let photos = || core::iter::once(&problem.photo).chain(options.others);
    let pixels = photos().map(|photo| photo.image.pixels.len()).max().unwrap_or(0);
    let own = photos().map(|photo| evidence_words(&photo.dimensions(&first))).sum::<usize>();
    shared_words(&first, 1 + options.others.len(), pixels, problem.model.triangles.len()) + own
}

/// The same for one photo, by sizes that are known before there is a problem.
pub const fn words_for(d: &Dimensions, triangles: usize) -> usize {
    shared_words(d, 1, d.width * d.height, triangles) + evidence_words(d)
}

/// Words of what photos share, the largest of so many pixels.
///
/// Per vertex its position, normal and albedo (4 each) and where its faces are listed, 3 per
/// triangle; what is needed in passing; and, unless it is to be lean, copies of the bases.
const fn shared_words(d: &Dimensions, views: usize, pixels: usize, triangles: usize) -> usize {
    let layout = Layout { shape_rank: d.shape_rank, albedo_rank: d.albedo_rank, views };
    let n = layout.len();
    instance_words(d.vertices, triangles)
        + copies_words(d)
        + passing_words(d.vertices, pixels, n)
        + 5 * n
}

/// Words of copies of both bases, which cost memory and save time.
const fn copies_words(d: &Dimensions) -> usize {
    if d.lean {
        return 0;
    }
    by_vertex_words(d.vertices, d.shape_rank) + by_vertex_words(d.vertices, d.albedo_rank)
}

/// Words of what is needed in passing, one after another: the histogram of the background; the
/// gradient's; equations, and beside them their matrix or three planes.
const fn passing_words(vertices: usize, pixels: usize, n: usize) -> usize {
    let equations = system_words(n) + larger(matrix_words(n), 3 * pixels);
    larger(larger(HISTOGRAM_LEN, gradient_words(vertices, pixels)), equations)
}

/// A running search, with room for `OTHERS` photos besides the first.
pub struct ModeSearch<'a, 'w, const OTHERS: usize = 0> {
    pub(super) common: Common<'a, 'w>,
    pub(super) first: Evidence<'a, 'w>,
    pub(super) others: heapless::Vec<Evidence<'a, 'w>, OTHERS>,
    pub(super) scratch: Scratch<'w>,
    /// Of what is needed in passing, see [`passing_words`].
    pub(super) passing: &'w mut [f32],
    pub(super) gradient: &'w mut [f32],
    pub(super) step: &'w mut [f32],
    pub(super) fingerprint: Fnv64,
    pub(super) damping: f32,
    pub(super) iteration: u32,
    pub(super) iterations: u32,
    pub(super) still: u32,
    /// Whether surface and frames are the subject's and its views'.
    pub(super) rendered: bool,
    /// Whether energy and planes are theirs at this level.
    pub(super) judged: bool,
    pub(super) energy: Energy,
}

impl<'a, 'w, const OTHERS: usize> ModeSearch<'a, 'w, OTHERS> {
    /// Checks what is to be fitted, and carves the memory.
    #[inline(never)]
    pub(super) fn carve(
        problem: Problem<'a>,
        options: Options<'a>,
        memory: &'w mut [u32],
    ) -> Result<Self, ChainError> {
        problem.check()?;
        for photo in core::iter::once(&problem.photo).chain(options.others) {
            photo.check(problem.model)?;
        }
        let needed = words(&problem, &options);
        let error = ChainError::Memory { needed, found: memory.len() };
        if memory.len() < needed {
            return Err(error);
        }
        let Problem { model, photo, .. } = problem;
        let d = problem.dimensions();
        let views = 1 + options.others.len();
        let layout = Layout { shape_rank: d.shape_rank, albedo_rank: d.albedo_rank, views };
        let n = layout.len();
        let mut carver = Carver::new(memory);
        let first = Evidence::carve(&mut carver, &problem, &options, &photo, 0)?.ok_or(error)?;
        let mut others = heapless::Vec::new();
        let mut pixels = photo.image.pixels.len();
        for (i, photo) in options.others.iter().enumerate() {
            let evidence = Evidence::carve(&mut carver, &problem, &options, photo, 1 + i)?;
            let evidence = evidence.ok_or(error)?;
            let full = |_| ChainError::Photos { found: views };
            others.push(evidence).map_err(full)?;
            pixels = pixels.max(photo.image.pixels.len());
        }
        let instance = Instance::carve(&mut carver, model).ok_or(error)?;
        let common = Common {
            problem,
            widths: options.widths,
            complexion: Complexion::of(&model.albedo, d.albedo_rank),
            level: 0,
            layout,
            subject: Subject::mean(d.shape_rank, d.albedo_rank),
            instance,
        };
        let mut floats = |count| carver.floats(count).ok_or(error);
        let rows = [floats(n)?, floats(n)?, floats(n)?];
        let passing = floats(passing_words(d.vertices, pixels, n))?;
        let (gradient, step) = (floats(n)?, floats(n)?);
        let mut by_vertex = [None, None];
        if !d.lean {
            let halves = [(&model.shape, d.shape_rank), (&model.albedo, d.albedo_rank)];
            for (copy, (basis, rank)) in by_vertex.iter_mut().zip(halves) {
                let made = ByVertex::carve(&mut carver, basis, d.vertices, rank);
                *copy = Some(made.ok_or(error)?);
            }
        }
        Ok(Self {
            common,
            first,
            others,
            scratch: Scratch { by_vertex, rows },
            passing,
            gradient,
            step,
            fingerprint: Fnv64::default(),
            damping: 1e-2,
            iteration: 0,
            iterations: 0,
            still: 0,
            rendered: false,
            judged: false,
            energy: Energy::default(),
        })
    }

    /// The subject so far.
    pub fn subject(&self) -> &Subject {
        &self.common.subject
    }

    /// What the photos say, one by one.
    pub fn evidence(&self) -> impl Iterator<Item = &Evidence<'a, 'w>> {
        core::iter::once(&self.first).chain(&self.others)
    }

    /// The same, to be changed.
    pub(super) fn evidence_mut(&mut self) -> impl Iterator<Item = &mut Evidence<'a, 'w>> {
        core::iter::once(&mut self.first).chain(&mut self.others)
    }

    /// The first photo's scene so far.
    pub fn scene(&self) -> Scene {
        Scene { subject: self.common.subject.clone(), view: *self.first.view() }
    }

    /// The view of the first photo by its landmarks alone, the subject being the mean.
    pub fn initial(&self) -> &View {
        self.first.initial()
    }

    /// The first photo's mask, see [`Evidence::mask`].
    pub fn mask(&self) -> &[f32] {
        self.first.mask()
    }

    /// Energy of what has been found so far, at its level.
    pub fn energy(&self) -> Energy {
        self.energy
    }

    /// Iterations so far.
    pub fn iterations(&self) -> u32 {
        self.iterations
    }

    /// Hash of every subject and its views on the way.
    pub fn fingerprint(&self) -> u64 {
        self.fingerprint.finish()
    }

    /// The unknowns that are sought.
    pub fn layout(&self) -> Layout {
        self.common.layout
    }

    /// Computes and rasterizes the subject's surface in every view.
    pub(super) fn render(&mut self) {
        let Common { problem: Problem { model, engine, .. }, subject, instance, .. } =
            &mut self.common;
        instance.update(model, engine, subject);
        for evidence in core::iter::once(&mut self.first).chain(&mut self.others) {
            evidence.render(&self.common);
        }
    }
}
