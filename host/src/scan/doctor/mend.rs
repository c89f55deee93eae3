//! A mesh mended, as far as that takes no guess.

use super::surface::{components, distinct, orient, thinned};
use crate::mesh::{Mesh, weld};
use serde::Serialize;
use std::fmt;

/// What [`mend`] did; displays as a line.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Mended {
    /// Vertices joined to an equal one.
    pub joined: usize,
    /// Triangles without area dropped.
    pub degenerate: usize,
    /// Repeated triangles dropped.
    pub duplicate: usize,
    /// Triangles dropped because their edge had two already.
    pub crowded: usize,
    /// Triangles dropped with all but the largest component.
    pub smaller: usize,
    /// Triangles turned over.
    pub turned: usize,
    /// Vertices dropped that no triangle uses.
    pub unused: usize,
}

impl fmt::Display for Mended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let done: Vec<_> = [
            (self.joined, "joined", "equal vertex", "equal vertices"),
            (self.degenerate, "dropped", "triangle without area", "triangles without area"),
            (self.duplicate, "dropped", "repeated triangle", "repeated triangles"),
            (self.crowded, "dropped", "triangle on a crowded edge", "triangles on crowded edges"),
            (self.smaller, "dropped", "triangle of a smaller piece", "triangles of smaller pieces"),
            (self.turned, "turned", "triangle over", "triangles over"),
            (self.unused, "dropped", "unused vertex", "unused vertices"),
        ]
        .into_iter()
        .filter(|(count, ..)| *count > 0)
        .map(|(n, verb, one, many)| format!("{verb} {n} {}", if n == 1 { one } else { many }))
        .collect();
        f.write_str(if done.is_empty() { "nothing to mend" } else { "" })?;
        f.write_str(&done.join(", "))
    }
}

/// Joins equal vertices (their colours are averaged). Drops triangles without area, repeated ones, the smallest
/// of those that crowd an edge, if asked all components but the largest, and vertices that no triangle uses.
/// Turns triangles so that neighbours agree, and closed pieces and the surface as a whole look outwards. Order
/// is kept. Doing it again changes nothing.
///
/// A mesh that has no triangle with area is given back without triangles.
pub fn mend(mesh: &Mesh, largest_only: bool) -> (Mesh, Mended) {
    let mut mended = Mended::default();
    let (map, points) = weld(&mesh.points);
    mended.joined = mesh.points.len() - points.len();
    let mut shown = vec![false; mesh.points.len()];
    for &v in mesh.triangles.as_flattened() {
        shown[v as usize] = true;
    }
    let mut colors = vec![[0.0_f64; 4]; points.len()];
    // No triangle shows the colours of the others.
    for ((&v, color), _) in map.iter().zip(&mesh.colors).zip(&shown).filter(|(_, shown)| **shown) {
        let sum = &mut colors[v as usize];
        for i in 0..3 {
            sum[i] += f64::from(color[i]);
        }
        sum[3] += 1.0;
    }
    let exact: Vec<[f64; 3]> = points.iter().map(|p| p.map(f64::from)).collect();
    let joined: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.map(|v| map[v as usize])).collect();
    let (kept, degenerate, duplicate) = distinct(&exact, &joined);
    (mended.degenerate, mended.duplicate) = (degenerate, duplicate);
    let roomy = thinned(&exact, &kept);
    mended.crowded = kept.len() - roomy.len();
    let mut triangles = roomy;
    if largest_only {
        let pieces = components(exact.len(), &triangles);
        let mut largest = pieces.into_iter().next().unwrap_or_default();
        largest.sort_unstable();
        mended.smaller = triangles.len() - largest.len();
        triangles = largest.into_iter().map(|t| triangles[t as usize]).collect();
    }
    mended.turned = orient(&exact, &mut triangles);

    let mut used = vec![false; points.len()];
    for &v in triangles.as_flattened() {
        used[v as usize] = true;
    }
    let mut place = vec![0_u32; points.len()];
    let mut out = Mesh { points: Vec::new(), colors: Vec::new(), triangles };
    for (v, (&point, [r, g, b, count])) in points.iter().zip(colors).enumerate() {
        if used[v] {
            place[v] = out.points.len() as u32;
            out.points.push(point);
            out.colors.push([r, g, b].map(|sum| (sum / count) as f32));
        }
    }
    mended.unused = points.len() - out.points.len();
    for triangle in &mut out.triangles {
        *triangle = triangle.map(|v| place[v as usize]);
    }
    (out, mended)
}
