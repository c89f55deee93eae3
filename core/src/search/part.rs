//! The part of a model that photos show at a mode: all that a sampler around it looks at.
//!
//! It has the triangles that are seen, and those around their corners, by which normals are made. A side of
//! the head that is turned away, say, is left out, and with it half the memory that every instance streams.

use super::evidence::Evidence;
use super::instance::{at, instance_words};
use super::state::ModeSearch;
use crate::basis::{BLOCK, Basis, padded};
use crate::memory::Carver;
use crate::model::{Model, Triangles};
use crate::render::rasterize::Hit;
use bytemuck::try_cast_slice_mut;

/// What a pixel counts at least, or it is left out. Chosen, not measured.
pub(super) const HARDLY: f32 = 0.01;
/// Columns and rows of a block of pixels that one point of the surface stands for (docs/posterior.md, "What
/// is sampled").
pub(super) const APART: usize = 3;
/// Number of a triangle or vertex that is left out.
const NONE: u32 = u32::MAX;
/// A vertex whose normal is wanted, and one that is only around such a vertex.
const WANTED: u32 = 1;
const AROUND: u32 = 2;

/// The pixels in the middles of blocks that may count, with what they show.
pub(super) fn seen(evidence: &Evidence<'_, '_>) -> impl Iterator<Item = ([usize; 2], Hit)> {
    const FIRST: usize = APART / 2;
    let [width, height] = evidence.size();
    let all = (FIRST..height)
        .step_by(APART)
        .flat_map(move |y| (FIRST..width).step_by(APART).map(move |x| [x, y]));
    all.filter_map(move |[x, y]| {
        let counts = at(evidence.planes.weights, y * width + x) > HARDLY;
        Some(([x, y], evidence.frame.hit(x, y).filter(|_| counts)?))
    })
}

/// Words of memory that a [`Part`] of a model needs at most.
pub fn part_words(model: &Model<'_>) -> usize {
    let (vertices, triangles) = (model.vertices(), model.triangles.len());
    let half = |rank: usize| 3 * padded(vertices) + 3 * padded(vertices) * rank.div_ceil(2);
    vertices + 4 * triangles + half(model.shape.rank()) + half(model.albedo.rank())
}

/// The part of a model that photos show.
pub struct Part<'m> {
    model: Model<'m>,
    /// Of every triangle of the whole its number here, or [`NONE`].
    numbers: &'m [u32],
}

impl<'m> Part<'m> {
    /// The part that is seen in what a search has found, in [`part_words`] of memory; `None` if there is less,
    /// or nothing is seen.
    pub fn new<'a: 'm, const OTHERS: usize>(
        search: &mut ModeSearch<'a, '_, OTHERS>,
        memory: &'m mut [u32],
    ) -> Option<Self> {
        search.make_judged();
        let model: &'a Model<'a> = search.common.problem.model;
        let triangles = model.triangles;
        let mut carver = Carver::new(memory);
        let numbers = carver.words(triangles.len())?;
        let vertices = carver.words(model.vertices())?;
        vertices.fill(0);
        for evidence in search.evidence() {
            for (_, hit) in seen(evidence) {
                for corner in triangles.get(hit.triangle)? {
                    *vertices.get_mut(corner as usize)? = WANTED;
                }
            }
        }
        let mut kept = 0;
        for (t, number) in numbers.iter_mut().enumerate() {
            let corners = triangles.get(t)?.map(|v| at(vertices, v as usize));
            let wanted = corners.contains(&WANTED);
            *number = if wanted { kept } else { NONE };
            kept += u32::from(wanted);
        }
        let shown = carver.words(3 * kept as usize)?.as_chunks_mut().0;
        for (t, _) in numbers.iter().enumerate().filter(|(_, number)| **number != NONE) {
            for corner in triangles.get(t)? {
                let vertex = vertices.get_mut(corner as usize)?;
                *vertex = if *vertex == WANTED { WANTED } else { AROUND };
            }
        }
        let mut count = 0;
        for vertex in &mut *vertices {
            let kept = *vertex != 0;
            *vertex = if kept { count } else { NONE };
            count += u32::from(kept);
        }
        let all = numbers.iter().enumerate().filter(|(_, number)| **number != NONE);
        for (to, (t, _)) in shown.iter_mut().zip(all) {
            *to = triangles.get(t)?.map(|v| at(vertices, v as usize));
        }
        let mut half = |basis: &Basis<'a>| copy(basis, vertices, count as usize, &mut carver);
        let (shape, albedo) = (half(&model.shape)?, half(&model.albedo)?);
        let model = Model::part(count as usize, shape, albedo, Triangles::U32(shown))?;
        Some(Self { model, numbers })
    }

    /// Words of memory that its instance needs.
    pub(crate) fn instance_words(&self) -> usize {
        instance_words(self.model.vertices(), self.model.triangles.len())
    }

    /// The part as a model.
    pub(super) fn model(&self) -> &Model<'m> {
        &self.model
    }

    /// Number here of one of the whole's triangles.
    pub(super) fn number(&self, triangle: usize) -> Option<usize> {
        let number = *self.numbers.get(triangle)?;
        (number != NONE).then_some(number as usize)
    }
}

/// Copies a basis at those vertices that have a number.
fn copy<'m, 'a: 'm>(
    basis: &Basis<'a>,
    numbers: &[u32],
    count: usize,
    carver: &mut Carver<'m>,
) -> Option<Basis<'m>> {
    let (rank, blocks, own) = (basis.rank(), basis.mean.len() / 3, padded(count) / BLOCK);
    let mean: &mut [[f32; BLOCK]] = try_cast_slice_mut(carver.words(3 * BLOCK * own)?).ok()?;
    let columns: &mut [[i16; BLOCK]] =
        try_cast_slice_mut(carver.words(3 * BLOCK * own * rank / 2)?).ok()?;
    mean.fill([0.0; BLOCK]);
    columns.fill([0; BLOCK]);
    for (from, to) in numbers.iter().enumerate().filter(|(_, to)| **to != NONE) {
        let to = *to as usize;
        for axis in 0..3 {
            let (old, new) = (axis * blocks + from / BLOCK, axis * own + to / BLOCK);
            mean.get_mut(new)?[to % BLOCK] = basis.mean.get(old)?[from % BLOCK];
            let old = basis.columns.get(old * rank..(old + 1) * rank)?;
            let new = columns.get_mut(new * rank..(new + 1) * rank)?;
            for (new, old) in new.iter_mut().zip(old) {
                new[to % BLOCK] = old[from % BLOCK];
            }
        }
    }
    Some(Basis { mean, columns, ..*basis })
}
