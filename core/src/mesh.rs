//! Vertex normals of an instance, in the caller's buffers.
//!
//! A vertex normal is the normalised, unweighted mean of the unit normals of the faces around it
//! (FACTS §3.3). Isolated vertices and vertices of degenerate faces only get the zero vector.

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
    core::array::from_fn(|i| rows.map(|row| row[i]))
}

/// Fills `normals` with the unit vertex normals of `positions`, in the same frame; four numbers
/// per vertex, the last zero.
#[inline(always)]
pub fn vertex_normals(triangles: Triangles<'_>, positions: &[[f32; 4]], normals: &mut [[f32; 4]]) {
    normals.fill([0.0; 4]);
    match triangles {
        Triangles::U16(t) => sum_face_normals(t, positions, normals),
        Triangles::U32(t) => sum_face_normals(t, positions, normals),
    }
    for normals in normals.as_chunks_mut::<CHUNK>().0 {
        let mut lengths = [0.0_f32; CHUNK];
        for (k, [a, b, c, _]) in lengths.iter_mut().zip(&*normals) {
            *k = math::rsqrt(a * a + b * b + c * c);
        }
        for (normal, k) in normals.iter_mut().zip(lengths) {
            *normal = normal.map(|x| x * k);
        }
    }
}

/// Faces handled together: gather, a loop without branches, which vectorises, and scatter.
const CHUNK: usize = 32;

/// Adds every face's unit normal to its three corners.
#[inline(always)]
fn sum_face_normals<I: Index>(triangles: &[[I; 3]], positions: &[[f32; 4]], sums: &mut [[f32; 4]]) {
    // `[axis][corner][face]`; faces past the end of the last chunk are of no consequence.
    let mut p = [[[0.0_f32; CHUNK]; 3]; 3];
    let mut normals = [[0.0_f32; CHUNK]; 3];
    for faces in triangles.chunks(CHUNK) {
        for (t, face) in faces.iter().enumerate().take(CHUNK) {
            for i in 0..3 {
                [p[0][i][t], p[1][i][t], p[2][i][t], _] = positions[face[i].index()];
            }
        }
        let [x, y, z] = &p;
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
        for (t, face) in faces.iter().enumerate().take(CHUNK) {
            let normal = [normals[0][t], normals[1][t], normals[2][t], 0.0];
            for corner in face {
                let sum = &mut sums[corner.index()];
                for l in 0..4 {
                    sum[l] += normal[l];
                }
            }
        }
    }
}
