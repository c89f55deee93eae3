//! The state of a registration, in the caller's memory.

use super::nearest::{Nearest, nearest_words};
use super::options::Options;
use super::place::{PLACE, Place};
use super::scan::{RegisterError, Scan};
use crate::basis::{ByVertex, by_vertex_words, padded};
use crate::engine::{Engine, Quad};
use crate::least_squares::{matrix_words, system_words};
use crate::math;
use crate::memory::Carver;
use crate::model::Model;
use crate::scene::MAX_RANK;
use crate::vector::{Vec3, cross, dot, scale, sub, xyz};

/// Unknowns of the scan's colours beside the albedo coefficients: an offset and a gain per channel.
pub(super) const TINT: usize = 6;
/// Mean area of a vertex of the mesh that standard deviations and patches were chosen on, mm².
const VERTEX_AREA: f32 = 4.0;
/// Distances to a border are measured up to here, mm: none wider was tried
/// (docs/registration.md).
const RIM: f32 = 6.0;

/// What is registered.
#[derive(Clone, Copy, Debug)]
pub struct Problem<'a> {
    /// The model.
    pub model: &'a Model<'a>,
    /// The scan.
    pub scan: Scan<'a>,
    /// Vertices of the model whose places on the scan are known, mm. Three or more determine the pose.
    pub landmarks: &'a [(u32, Vec3)],
    /// The settings.
    pub options: Options,
    /// Implementation of the expensive stages.
    pub engine: &'a Engine,
}

impl Problem<'_> {
    /// Coefficients of shape and of albedo that are sought: the model's, or the leading ones.
    fn ranks(&self) -> [usize; 2] {
        [&self.model.shape, &self.model.albedo].map(|half| half.rank().min(MAX_RANK))
    }

    /// Unknowns of the larger of both systems of equations.
    fn unknowns(&self) -> usize {
        let [shape, albedo] = self.ranks();
        larger(shape + PLACE, albedo + TINT)
    }

    /// Words of what is needed in passing, one after another: edges of the scan (two words for three
    /// edges a triangle), sums of a blur (8 a vertex) or areas, or equations beside their matrix.
    pub(super) fn passing_words(&self) -> usize {
        let n = self.unknowns();
        let edges = 6 * self.scan.triangles.len();
        let sums = 8 * larger(self.scan.points.len(), self.model.vertices());
        larger(larger(edges, sums), system_words(n) + matrix_words(n))
    }
}

fn larger(a: usize, b: usize) -> usize {
    if a > b { a } else { b }
}

/// Words of memory a [`Registration`] of a problem needs.
///
/// They hold, of the scan, the tree, and per point a normal and a colour (3 each) and the distance to the rim;
/// of the model, per vertex, position, normal, albedo and what the foot shows (4 each), a colour (3) and how
/// it changes (9), and copies of both bases; coefficients and rows; and what is needed for a moment.
pub fn words(problem: &Problem<'_>) -> usize {
    let Problem { model, scan, .. } = problem;
    let vertices = model.vertices();
    let [shape, albedo] = problem.ranks();
    nearest_words(scan.triangles.len())
        + 7 * scan.points.len()
        + 16 * padded(vertices)
        + 12 * vertices
        + by_vertex_words(vertices, shape)
        + by_vertex_words(vertices, albedo)
        + shape
        + albedo
        + 4 * problem.unknowns()
        + problem.passing_words()
}

/// A running registration.
pub struct Registration<'a, 'w> {
    pub(super) problem: Problem<'a>,
    pub(super) nearest: Nearest<'w>,
    /// The scan's vertices'.
    pub(super) normals: &'w mut [Vec3],
    /// Distances of the scan's vertices to a border, mm.
    pub(super) rim: &'w mut [f32],
    /// The scan's at this level.
    pub(super) scan_colors: &'w mut [Vec3],
    /// Model frame, without size, mm.
    pub(super) positions: &'w mut [Quad],
    pub(super) vertex_normals: &'w mut [Quad],
    pub(super) albedo: &'w mut [Quad],
    /// What the feet show, and how much they count.
    pub(super) seen: &'w mut [Quad],
    /// The model's at this level.
    pub(super) colors: &'w mut [Vec3],
    /// How these change along the surface, per mm, channel by channel.
    pub(super) slopes: &'w mut [[Vec3; 3]],
    pub(super) shape_by_vertex: ByVertex<'w>,
    pub(super) albedo_by_vertex: ByVertex<'w>,
    pub(super) shape: &'w mut [f32],
    pub(super) albedo_coefficients: &'w mut [f32],
    pub(super) rows: [&'w mut [f32]; 3],
    pub(super) step: &'w mut [f32],
    pub(super) passing: &'w mut [u32],
    pub(super) place: Place,
    /// Offsets and gains of the scan's colours.
    pub(super) tint: [f32; TINT],
    /// Iterations done.
    pub(super) done: u32,
    /// The nearest start.
    pub(super) best: Option<(f64, Place)>,
    /// What an equation of one of the model's vertices counts, for meshes are fine or coarse.
    pub(super) share: f32,
}

impl<'a, 'w> Registration<'a, 'w> {
    /// Checks the problem and takes [`words`] of memory.
    ///
    /// # Errors
    /// [`RegisterError::Landmark`], [`RegisterError::Memory`].
    pub fn new(problem: Problem<'a>, memory: &'w mut [u32]) -> Result<Self, RegisterError> {
        let vertices = problem.model.vertices();
        let fits = |(v, p): &(u32, Vec3)| {
            (*v as usize) < vertices && p.iter().all(|x| x.is_finite() && *x * *x < 1e12)
        };
        if let Some(index) = problem.landmarks.iter().position(|landmark| !fits(landmark)) {
            return Err(RegisterError::Landmark { index });
        }
        let error = RegisterError::Memory { needed: words(&problem), found: memory.len() };
        let mut registration = Self::carve(problem, memory).ok_or(error)?;
        registration.update();
        let mut area = 0.0;
        for corners in (0..).map_while(|t| problem.model.triangles.get(t)) {
            let [a, b, c] = corners.map(|v| xyz(quad(registration.positions, v)));
            let normal = cross(sub(b, a), sub(c, a));
            area += 0.5 * math::sqrt(dot(normal, normal));
        }
        registration.share = area / (VERTEX_AREA * vertices as f32);
        Ok(registration)
    }

    #[inline(never)]
    fn carve(problem: Problem<'a>, memory: &'w mut [u32]) -> Option<Self> {
        let Problem { model, scan, .. } = problem;
        let (points, vertices) = (scan.points.len(), model.vertices());
        let [shape, albedo] = problem.ranks();
        let carver = &mut Carver::new(memory);
        let nearest = Nearest::carve(carver, &scan)?;
        let (normals, rim, scan_colors) =
            (vectors(carver, points)?, carver.floats(points)?, vectors(carver, points)?);
        scan.find_normals(normals);
        let mut quads = || carver.quads(padded(vertices));
        let [positions, vertex_normals, albedo_quads, seen] =
            [quads()?, quads()?, quads()?, quads()?];
        seen.fill([0.0; 4]);
        let n = problem.unknowns();
        let registration = Self {
            problem,
            nearest,
            normals,
            rim,
            scan_colors,
            positions,
            vertex_normals,
            albedo: albedo_quads,
            seen,
            colors: vectors(carver, vertices)?,
            slopes: bytemuck::try_cast_slice_mut(carver.groups::<9>(vertices)?).ok()?,
            shape_by_vertex: ByVertex::carve(carver, &model.shape, vertices, shape)?,
            albedo_by_vertex: ByVertex::carve(carver, &model.albedo, vertices, albedo)?,
            shape: carver.floats(shape)?,
            albedo_coefficients: carver.floats(albedo)?,
            rows: [carver.floats(n)?, carver.floats(n)?, carver.floats(n)?],
            step: carver.floats(n)?,
            passing: carver.words(problem.passing_words())?,
            place: Place::HOME,
            tint: [0.0; TINT],
            done: 0,
            best: None,
            share: 1.0,
        };
        registration.shape.fill(0.0);
        registration.albedo_coefficients.fill(0.0);
        let edges = registration.passing.get_mut(..6 * scan.triangles.len())?;
        scan.find_rim(registration.rim, edges.as_chunks_mut().0, RIM);
        Some(registration)
    }

    /// Where the model is.
    pub fn place(&self) -> &Place {
        &self.place
    }

    /// Shape coefficients, standard deviations.
    pub fn shape(&self) -> &[f32] {
        self.shape
    }

    /// Albedo coefficients of the scan, standard deviations; 0 if colours are not looked at.
    pub fn albedo(&self) -> &[f32] {
        self.albedo_coefficients
    }

    /// Where a vertex of the model is in the scan's place, mm.
    pub fn vertex(&self, vertex: u32) -> Vec3 {
        self.place.apply(self.sized(vertex))
    }

    /// How much the foot of a vertex counts as evidence, 0 (not at all) to 1.
    pub fn weight(&self, vertex: u32) -> f32 {
        quad(self.seen, vertex)[3]
    }

    /// A vertex in the model's frame, of the size it has.
    pub(super) fn sized(&self, vertex: u32) -> Vec3 {
        scale(xyz(quad(self.positions, vertex)), self.place.size)
    }

    /// Computes the surface of the coefficients.
    pub(super) fn update(&mut self) {
        let Problem { model, engine, .. } = self.problem;
        (engine.instance)(&model.shape, self.shape, self.positions);
        (engine.normals)(model.triangles, self.positions, self.vertex_normals);
    }
}

/// The next `count` vectors.
pub(super) fn vectors<'w>(carver: &mut Carver<'w>, count: usize) -> Option<&'w mut [Vec3]> {
    carver.groups(count)
}

/// The four numbers of a vertex; zero if there is no such vertex.
pub(super) fn quad(values: &[Quad], v: u32) -> Quad {
    values.get(v as usize).copied().unwrap_or_default()
}
