//! Vertex normals of an instance, in the caller's buffers.
//!
//! A vertex normal is the normalised, unweighted mean of the unit normals of the faces around it
//! (FACTS §3.3). Isolated vertices and vertices of degenerate faces only get the zero vector.

use crate::basis::padded;
use crate::math;
use crate::model::{Model, Triangles};

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

/// Splits a field into its three planes.
#[inline]
pub fn planes(field: &[f32]) -> [&[f32]; 3] {
    let n = field.len() / 3;
    let (x, rest) = field.split_at(n);
    let (y, z) = rest.split_at(n);
    [x, y, z]
}

/// Splits a field into its three planes, mutably.
#[inline]
pub fn planes_mut(field: &mut [f32]) -> [&mut [f32]; 3] {
    let n = field.len() / 3;
    let (x, rest) = field.split_at_mut(n);
    let (y, z) = rest.split_at_mut(n);
    [x, y, z]
}

/// The three numbers of one vertex.
#[inline]
pub fn vertex(field: &[f32], index: usize) -> [f32; 3] {
    let [x, y, z] = planes(field);
    [x[index], y[index], z[index]]
}

/// Fills `normals` (a field) with the unit vertex normals of `positions` (a field), in the same
/// frame. `sums` is scratch, four numbers per vertex.
pub fn vertex_normals(
    model: &Model<'_>,
    positions: &[f32],
    sums: &mut [[f32; 4]],
    normals: &mut [f32],
) {
    sums.fill([0.0; 4]);
    match model.triangles {
        Triangles::U16(t) => sum_face_normals(t, positions, sums),
        Triangles::U32(t) => sum_face_normals(t, positions, sums),
    }
    let [nx, ny, nz] = planes_mut(normals);
    for (((sum, x), y), z) in sums.iter().zip(nx).zip(ny).zip(nz) {
        let [a, b, c, _] = *sum;
        let k = math::rsqrt(a * a + b * b + c * c);
        (*x, *y, *z) = (a * k, b * k, c * k);
    }
}

/// Faces handled together: gather, a loop without branches, which vectorises, and scatter.
const CHUNK: usize = 32;

/// Adds every face's unit normal to its three corners.
fn sum_face_normals<I: Index>(triangles: &[[I; 3]], positions: &[f32], sums: &mut [[f32; 4]]) {
    let [x, y, z] = planes(positions);
    // `[axis][corner][face]`; faces past the end of the last chunk are of no consequence.
    let mut p = [[[0.0_f32; CHUNK]; 3]; 3];
    let mut normals = [[0.0_f32; CHUNK]; 3];
    for faces in triangles.chunks(CHUNK) {
        for (t, face) in faces.iter().enumerate().take(CHUNK) {
            for i in 0..3 {
                let v = face[i].index();
                p[0][i][t] = x[v];
                p[1][i][t] = y[v];
                p[2][i][t] = z[v];
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

/// Length of the `sums` scratch of [`vertex_normals`].
pub const fn sums_len(vertices: usize) -> usize {
    padded(vertices)
}
