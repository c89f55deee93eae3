//! The subject's instance of the model: positions, normals, albedo, and how normals follow positions.
//!
//! A vertex normal is `n = S/‖S‖`, `S` the sum of the unit normals `N/‖N‖`, `N = e₁ × e₂`, of the
//! faces around it. Backwards, with `σ = (I − n nᵀ)/‖S‖ · ∂E/∂n`, each of these faces passes on
//! `ν = (I − n_f n_fᵀ)/‖N‖ · σ`, and its corners get `∂E/∂e₁ = e₂ × ν`, `∂E/∂e₂ = ν × e₁`.

use crate::basis::padded;
use crate::engine::{Engine, Quad};
use crate::math;
use crate::memory::Carver;
use crate::model::Model;
use crate::render::rasterize::Hit;
use crate::scene::Subject;
use crate::vector::{Vec3, add, cross, dot, scale, sub, xyz};

/// Words of memory an [`Instance`] needs.
pub(crate) const fn instance_words(vertices: usize, triangles: usize) -> usize {
    3 * 4 * padded(vertices) + (padded(vertices) + 1) + 3 * triangles
}

/// The surface of the subject, as its coefficients have it.
pub(super) struct Instance<'w> {
    /// Model frame, mm.
    pub(super) positions: &'w mut [Quad],
    /// Unit normals, and `1/‖S‖`.
    pub(super) normals: &'w mut [Quad],
    /// RGB.
    pub(super) albedo: &'w mut [Quad],
    /// Where each vertex's faces begin in `around`.
    starts: &'w mut [u32],
    around: &'w mut [u32],
}

/// What is at an index, or the neutral value: indices of a checked model have all.
#[inline(always)]
pub(super) fn at<T: Copy + Default>(values: &[T], index: usize) -> T {
    values.get(index).copied().unwrap_or_default()
}

/// Coefficients without the zeros at the end, which a coarse level does not seek.
fn sought(coefficients: &[f32]) -> &[f32] {
    let count = coefficients.iter().rposition(|&c| c != 0.0).map_or(0, |last| last + 1);
    coefficients.get(..count).unwrap_or_default()
}

/// Unit normal of a face and `1/‖N‖`: kept nowhere, since memory would be slower and is scarce.
#[inline(always)]
fn face_normal([a, b, c]: [Vec3; 3]) -> (Vec3, f32) {
    let normal = cross(sub(b, a), sub(c, a));
    let inverse = math::rsqrt(dot(normal, normal));
    (scale(normal, inverse), inverse)
}

/// `σ` of a vertex, whose unit normal and `1/‖S‖` are given, from what its normal costs.
#[inline(always)]
fn by_sum([x, y, z, inverse]: Quad, cost: Vec3) -> Vec3 {
    let n = [x, y, z];
    scale(sub(cost, scale(n, dot(n, cost))), inverse)
}

/// How what a face's unit normal costs is passed on to its corners.
struct FaceAdjoint {
    normal: Vec3,
    inverse: f32,
    to_b: Vec3,
    to_c: Vec3,
}

impl FaceAdjoint {
    #[inline(always)]
    fn new([a, b, c]: [Vec3; 3]) -> Self {
        let (normal, inverse) = face_normal([a, b, c]);
        Self { normal, inverse, to_b: sub(b, a), to_c: sub(c, a) }
    }

    /// What the corners cost.
    #[inline(always)]
    fn of(&self, sum: Vec3) -> [Vec3; 3] {
        let n = self.normal;
        let passed = scale(sub(sum, scale(n, dot(n, sum))), self.inverse);
        let by_b = cross(self.to_c, passed);
        let by_c = cross(passed, self.to_b);
        [scale(add(by_b, by_c), -1.0), by_b, by_c]
    }
}

impl<'w> Instance<'w> {
    /// Takes the memory and lists the faces around every vertex; `None` if there is too little.
    pub(super) fn carve(carver: &mut Carver<'w>, model: &Model<'_>) -> Option<Self> {
        let n = padded(model.vertices());
        let triangles = model.triangles;
        let mut quads = || carver.quads(n);
        let [positions, normals, albedo] = [quads()?, quads()?, quads()?];
        let starts = carver.words(n + 1)?;
        let around = carver.words(3 * triangles.len())?;
        starts.fill(0);
        let corners = || (0..triangles.len()).filter_map(|t| Some((t as u32, triangles.get(t)?)));
        for vertex in corners().flat_map(|(_, corners)| corners) {
            *starts.get_mut(vertex as usize)? += 1;
        }
        // Ends of the vertices' ranges; filled from behind, they become the beginnings.
        let mut end = 0;
        for start in starts.iter_mut() {
            end += *start;
            *start = end;
        }
        for (t, corners) in corners() {
            for vertex in corners {
                let start = starts.get_mut(vertex as usize)?;
                *start -= 1;
                *around.get_mut(*start as usize)? = t;
            }
        }
        Some(Self { positions, normals, albedo, starts, around })
    }

    /// Computes everything of a subject's coefficients.
    pub(super) fn update(&mut self, model: &Model<'_>, engine: &Engine, subject: &Subject) {
        (engine.instance)(&model.shape, sought(&subject.shape), self.positions);
        (engine.instance)(&model.albedo, sought(&subject.albedo), self.albedo);
        self.normals.fill([0.0; 4]);
        for t in 0..model.triangles.len() {
            let Some(corners) = model.triangles.get(t) else { continue };
            let ([x, y, z], _) = face_normal(corners.map(|v| xyz(at(self.positions, v as usize))));
            for vertex in corners {
                if let Some(sum) = self.normals.get_mut(vertex as usize) {
                    *sum = [sum[0] + x, sum[1] + y, sum[2] + z, 0.0];
                }
            }
        }
        for normal in self.normals.iter_mut() {
            let sum = xyz(*normal);
            let inverse = math::rsqrt(dot(sum, sum));
            let [x, y, z] = scale(sum, inverse);
            *normal = [x, y, z, inverse];
        }
    }

    /// Where the point of a triangle with these corners is that has been hit.
    #[inline(always)]
    pub(super) fn place(&self, corners: [usize; 3], hit: &Hit) -> Vec3 {
        let [a, b, c] = corners.map(|v| xyz(at(self.positions, v)));
        let [second, third] = hit.weights;
        add(a, add(scale(sub(b, a), second), scale(sub(c, a), third)))
    }

    /// Passes what vertices' normals cost back to the positions around them, face by face; leaves `σ` in
    /// the former.
    pub(super) fn add_normals_adjoint(
        &self,
        model: &Model<'_>,
        normals: &mut [Quad],
        positions: &mut [Quad],
    ) {
        for (cost, normal) in normals.iter_mut().zip(&*self.normals) {
            let [x, y, z] = by_sum(*normal, xyz(*cost));
            *cost = [x, y, z, 0.0];
        }
        for t in 0..model.triangles.len() {
            let Some(corners) = model.triangles.get(t) else { continue };
            let corners = corners.map(|v| v as usize);
            let [a, b, c] = corners.map(|v| xyz(at(normals, v)));
            let sum = add(add(a, b), c);
            if sum == [0.0; 3] {
                continue;
            }
            let costs = FaceAdjoint::new(corners.map(|v| xyz(at(self.positions, v)))).of(sum);
            for (corner, cost) in corners.into_iter().zip(costs) {
                if let Some(to) = positions.get_mut(corner) {
                    *to = [to[0] + cost[0], to[1] + cost[1], to[2] + cost[2], 0.0];
                }
            }
        }
    }

    /// Passes what a vertex's normal costs several functions back to the positions around it: calls
    /// `each` with vertices and what is to be added to their positions' costs.
    #[inline(always)]
    pub(super) fn normal_adjoint<const N: usize>(
        &self,
        model: &Model<'_>,
        vertex: usize,
        costs: [Vec3; N],
        mut each: impl FnMut(usize, [Vec3; N]),
    ) {
        let normal = at(self.normals, vertex);
        let sums = costs.map(|cost| by_sum(normal, cost));
        let mut own = [[0.0; 3]; N];
        let range = at(self.starts, vertex) as usize..at(self.starts, vertex + 1) as usize;
        for &face in self.around.get(range).unwrap_or_default() {
            let Some(corners) = model.triangles.get(face as usize) else { continue };
            let corners = corners.map(|v| v as usize);
            let face = FaceAdjoint::new(corners.map(|v| xyz(at(self.positions, v))));
            let mut by = [[[0.0; 3]; N]; 3];
            for (i, sum) in sums.into_iter().enumerate() {
                for (to, cost) in by.iter_mut().zip(face.of(sum)) {
                    if let Some(to) = to.get_mut(i) {
                        *to = cost;
                    }
                }
            }
            for (corner, costs) in corners.into_iter().zip(by) {
                if corner == vertex {
                    for (own, cost) in own.iter_mut().zip(costs) {
                        *own = add(*own, cost);
                    }
                } else {
                    each(corner, costs);
                }
            }
        }
        each(vertex, own);
    }
}
