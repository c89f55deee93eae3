//! Vertex normals of an instance, in the caller's buffers.
//!
//! A vertex normal is the normalised, unweighted mean of the unit normals of the faces around
//! it, as in the reference engine. Isolated vertices and vertices of degenerate faces only get the zero vector.

use crate::math;
use crate::model::Triangles;

/// A vertex index as stored in a model.
pub trait Index: Copy {
    /// The index as a number.
    fn index(self) -> usize;
}

impl Index for u16 {
    #[inline]
    fn index(self) -> usize {
        usize::from(self)
    }
}

impl Index for u32 {
    #[inline]
    fn index(self) -> usize {
        self as usize
    }
}

/// Rows to columns.
#[inline(always)]
pub(crate) fn transpose(rows: [[f32; 4]; 4]) -> [[f32; 4]; 4] {
    let [a, b, c, d] = rows;
    let mut columns = [[0.0; 4]; 4];
    for i in 0..4 {
        columns[i] = [a[i], b[i], c[i], d[i]];
    }
    columns
}

/// Vertices normalised together.
const BATCH: usize = 32;

/// Fills `normals` with the unit vertex normals of `positions`, in the same frame; four numbers
/// per vertex, the last zero.
#[inline(always)]
pub fn vertex_normals(triangles: Triangles<'_>, positions: &[[f32; 4]], normals: &mut [[f32; 4]]) {
    normals.fill([0.0; 4]);
    match triangles {
        Triangles::U16(t) => sum_face_normals(t, positions, normals),
        Triangles::U32(t) => sum_face_normals(t, positions, normals),
    }
    for normals in normals.as_chunks_mut::<BATCH>().0 {
        let mut lengths = [0.0_f32; BATCH];
        for (k, [a, b, c, _]) in lengths.iter_mut().zip(&*normals) {
            *k = math::rsqrt(a * a + b * b + c * c);
        }
        for (normal, k) in normals.iter_mut().zip(lengths) {
            *normal = normal.map(|x| x * k);
        }
    }
}

/// One number of every corner of [`CHUNK`] triangles, `[corner][triangle]`.
pub(crate) type Corners = [[f32; CHUNK]; 3];

/// Triangles handled together: enough that what one loop stores has arrived when the next loads it
/// in wide vectors, few enough for the fastest cache.
pub(crate) const CHUNK: usize = 64;

/// Triangles in chunks.
pub(crate) struct Chunks<'t, I> {
    whole: &'t [[[I; 3]; CHUNK]],
    /// What is left, filled up with triangles without area.
    last: Option<[[I; 3]; CHUNK]>,
}

impl<'t, I: Index> Chunks<'t, I> {
    #[inline(always)]
    pub(crate) fn new(triangles: &'t [[I; 3]]) -> Self {
        let (whole, rest) = triangles.as_chunks();
        let last = rest.first().map(|[corner, ..]| {
            let mut last = [[*corner; 3]; CHUNK];
            for (last, triangle) in last.iter_mut().zip(rest) {
                *last = *triangle;
            }
            last
        });
        Self { whole, last }
    }

    #[inline(always)]
    pub(crate) fn iter(&self) -> impl Iterator<Item = &[[I; 3]; CHUNK]> {
        self.whole.iter().chain(&self.last)
    }
}

/// The first three numbers of the triangles' corners, which a checked model has all of.
#[inline(always)]
pub(crate) fn gather<I: Index>(
    triangles: &[[I; 3]; CHUNK],
    vertices: &[[f32; 4]],
    [x, y, z]: [&mut Corners; 3],
) {
    let vertex = |corner: I| vertices.get(corner.index());
    for (group, [p, q, r, s]) in triangles.as_chunks::<4>().0.iter().enumerate() {
        for i in 0..3 {
            // One after the other: together they cost a tenth more instructions.
            let Some(&a) = vertex(p[i]) else { return };
            let Some(&b) = vertex(q[i]) else { return };
            let Some(&c) = vertex(r[i]) else { return };
            let Some(&d) = vertex(s[i]) else { return };
            let columns = transpose([a, b, c, d]);
            for (axis, column) in [&mut *x, &mut *y, &mut *z].into_iter().zip(columns) {
                if let Some(lanes) = axis[i].as_chunks_mut().0.get_mut(group) {
                    *lanes = column;
                }
            }
        }
    }
}

/// Adds every face's unit normal to its three corners.
#[inline(always)]
fn sum_face_normals<I: Index>(triangles: &[[I; 3]], positions: &[[f32; 4]], sums: &mut [[f32; 4]]) {
    let [mut x, mut y, mut z] = [[[0.0; CHUNK]; 3]; 3];
    let mut normals = [[0.0_f32; CHUNK]; 3];
    for faces in Chunks::new(triangles).iter() {
        gather(faces, positions, [&mut x, &mut y, &mut z]);
        for t in 0..CHUNK {
            let e1 = [x[1][t] - x[0][t], y[1][t] - y[0][t], z[1][t] - z[0][t]];
            let e2 = [x[2][t] - x[0][t], y[2][t] - y[0][t], z[2][t] - z[0][t]];
            let n = [
                e1[1] * e2[2] - e1[2] * e2[1],
                e1[2] * e2[0] - e1[0] * e2[2],
                e1[0] * e2[1] - e1[1] * e2[0],
            ];
            let k = math::rsqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
            for axis in 0..3 {
                normals[axis][t] = n[axis] * k;
            }
        }
        let [x, y, z] = normals.each_ref().map(|axis| axis.as_chunks::<4>().0);
        for (four, ((x, y), z)) in faces.as_chunks::<4>().0.iter().zip(x.iter().zip(y).zip(z)) {
            for (face, normal) in four.iter().zip(transpose([*x, *y, *z, [0.0; 4]])) {
                for corner in face {
                    let Some(sum) = sums.get_mut(corner.index()) else { return };
                    *sum = math::zip(*sum, normal, |sum, n| sum + n);
                }
            }
        }
    }
}
