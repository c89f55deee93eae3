//! Coloured triangle meshes in memory; beside them landmarks, PLY, and glTF and OBJ out.

#[cfg(feature = "full")]
pub(crate) mod far;
pub mod glb;
pub mod landmarks;
pub mod obj;
pub mod ply;
pub(crate) mod polygon;
pub mod skin;

use crate::vector::{length, normal};
use std::collections::HashMap;
use std::fmt;

/// A triangle mesh with a colour per vertex.
///
/// Guarantees, established by the readers: as many colours as points, all numbers finite,
/// every index of a triangle below the number of points, at least one triangle.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// Vertex positions, millimetres.
    pub points: Vec<[f32; 3]>,
    /// Vertex colours, RGB in `[0, 1]` as stored in files (sRGB, never linearised).
    pub colors: Vec<[f32; 3]>,
    /// Corner indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// [`Mesh::normals`] for files, in which every normal has length one: +z if a vertex has none.
    pub fn whole_normals(&self) -> Vec<[f32; 3]> {
        let whole = |n| if n == [0.0; 3] { [0.0, 0.0, 1.0] } else { n };
        self.normals().into_iter().map(whole).collect()
    }

    /// Unit normals of the vertices: the mean of the unit normals of a vertex's triangles, as the renderer
    /// has it; zero where there is none.
    pub fn normals(&self) -> Vec<[f32; 3]> {
        let mut sums = vec![[0.0_f32; 3]; self.points.len()];
        for corners in &self.triangles {
            let along = normal(corners.map(|i| self.points[i as usize]));
            let Some(normal) = unit(along) else { continue };
            for i in corners {
                let sum = &mut sums[*i as usize];
                *sum = std::array::from_fn(|k| sum[k] + normal[k]);
            }
        }
        sums.into_iter().map(|sum| unit(sum).unwrap_or_default()).collect()
    }
}

/// `v / |v|`; `None` where the length is zero or overflows.
fn unit(v: [f32; 3]) -> Option<[f32; 3]> {
    let v = v.map(f64::from);
    let length = length(v);
    (length > 0.0).then(|| v.map(|x| (x / length) as f32))
}

/// How far beyond 0 and 1 a stored colour may lie by rounding. Chosen, not measured.
const OVERSHOOT: f32 = 0.01;

/// A colour brought into `[0, 1]`, where it lies but for rounding; else none.
pub(crate) fn in_range(color: [f32; 3]) -> Option<[f32; 3]> {
    let near = color.iter().all(|c| (-OVERSHOOT..=1.0 + OVERSHOOT).contains(c));
    near.then(|| color.map(|c| c.clamp(0.0, 1.0)))
}

/// A coordinate axis; as a mirror it names the plane through the origin normal to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// The plane x = 0: left and right of a face.
    X,
    /// The plane y = 0.
    Y,
    /// The plane z = 0.
    Z,
}

impl Axis {
    /// The coordinates a reflection along this axis negates.
    pub fn negates(self) -> [bool; 3] {
        std::array::from_fn(|i| i == self as usize)
    }
}

impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(["x", "y", "z"][*self as usize])
    }
}

/// Joins points that are exactly equal: for each point the index of the joined one, and the joined points in
/// order of first appearance. Exporters split vertices for texture seams and flat shading.
pub fn weld(points: &[[f32; 3]]) -> (Vec<u32>, Vec<[f32; 3]>) {
    let mut known = HashMap::new();
    let mut kept = Vec::new();
    let map = points
        .iter()
        .map(|&p| {
            // Adding 0 makes −0 an ordinary zero.
            *known.entry(p.map(|c| (c + 0.0).to_bits())).or_insert_with(|| {
                kept.push(p);
                kept.len() as u32 - 1
            })
        })
        .collect();
    (map, kept)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_points_are_joined_in_order() {
        let points = [[1.0; 3], [0.0; 3], [1.0; 3], [-0.0, 0.0, 0.0], [2.0; 3]];
        assert_eq!(weld(&points), (vec![0, 1, 0, 1, 2], vec![[1.0; 3], [0.0; 3], [2.0; 3]]));
    }
}
