//! Triangles split at the middles of their edges, so that there are vertices for what a texture shows.
//!
//! The surface stays where it is. An edge is split by its length alone, so that triangles of one edge agree,
//! even where a texture's seam keeps their corners apart.

use super::doctor::surface::distance;
use crate::error::{Error, Result};
use crate::vector::{length, normal};
use onescan_core::model::MAX_TRIANGLES;
use std::collections::HashMap;

/// Which edges are split.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Subdivision {
    /// All of them, so many times; each time a triangle becomes four.
    Times(u32),
    /// Those longer than this, in the points' unit, until there are none.
    Edge(f64),
}

impl Subdivision {
    /// No more triangles than it makes of these, to be known before they are made.
    fn least(self, points: &[[f64; 3]], triangles: &[[u32; 3]]) -> f64 {
        let most = match self {
            Self::Times(times) => return triangles.len() as f64 * 4_f64.powf(times.into()),
            Self::Edge(most) => most,
        };
        // None has more area than if its edges are all as long as they may be, and none has more of an
        // old edge than that.
        let area = 0.25 * 3_f64.sqrt() * most * most;
        let parts = triangles.iter().map(|&[a, b, c]| {
            let longest = [(a, b), (b, c), (c, a)].map(|(a, b)| distance(points, a, b));
            let longest = longest.into_iter().fold(0.0, f64::max);
            let own = 0.5 * length(normal([a, b, c].map(|v| points[v as usize])));
            (own / area).max(longest / most).max(1.0)
        });
        parts.sum()
    }
}

fn too_many(least: f64) -> Error {
    Error::new(format_args!(
        "would be split into {least:.0} triangles or more, of which a model holds {MAX_TRIANGLES}; split \
         less by --subdivide or --edge"
    ))
}

/// What triangles become.
pub struct Finer {
    /// For each new vertex the two older ones that it lies midway between.
    pub middles: Vec<[u32; 2]>,
    /// The new triangles, those of one old triangle side by side.
    pub pieces: Vec<Piece>,
}

/// A part of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Piece {
    /// Its corners, counter-clockwise as those of the triangle.
    pub corners: [u32; 3],
    /// The triangle it is a part of.
    pub of: u32,
    /// The weights of that triangle's corners in each of its own.
    pub weights: [[f32; 3]; 3],
}

/// A corner to be: a vertex, and the weights of the old triangle's corners in it.
type Node = (u32, [f32; 3]);

impl Piece {
    fn node(&self, k: usize) -> Node {
        (self.corners[k % 3], self.weights[k % 3])
    }

    fn with(&self, nodes: [Node; 3]) -> Self {
        Self { corners: nodes.map(|n| n.0), of: self.of, weights: nodes.map(|n| n.1) }
    }

    /// Values at its corners, by those at the corners of the triangle it is a part of.
    pub fn mix<const N: usize>(&self, values: [[f32; N]; 3]) -> [[f32; N]; 3] {
        let mixed = |w: [f32; 3], i: usize| (0..3).map(|k| w[k] * values[k][i]).sum();
        self.weights.map(|w| std::array::from_fn(|i| mixed(w, i)))
    }
}

impl Finer {
    /// Splits triangles of these points.
    ///
    /// # Errors
    /// More triangles than a model holds.
    pub fn of(points: &[[f64; 3]], triangles: &[[u32; 3]], how: Subdivision) -> Result<Self> {
        const WHOLE: [[f32; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let least = how.least(points, triangles);
        if least > MAX_TRIANGLES as f64 {
            return Err(too_many(least));
        }
        let mut points = points.to_vec();
        let mut middles = Vec::new();
        let whole = |(&corners, of)| Piece { corners, of, weights: WHOLE };
        let mut pieces: Vec<Piece> = triangles.iter().zip(0..).map(whole).collect();
        for round in 0.. {
            let mut known = HashMap::new();
            let mut next = Vec::new();
            for piece in &pieces {
                if next.len() > MAX_TRIANGLES {
                    return Err(too_many(next.len() as f64));
                }
                let middle = |k: usize| {
                    let ((a, u), (b, v)) = (piece.node(k), piece.node(k + 1));
                    let long = match how {
                        Subdivision::Times(times) => round < times,
                        Subdivision::Edge(most) => distance(&points, a, b) > most,
                    };
                    let weights = std::array::from_fn(|i| 0.5 * (u[i] + v[i]));
                    long.then_some(([a.min(b), a.max(b)], weights))
                };
                let split = [0, 1, 2].map(middle).map(|middle| {
                    let (edge, weights) = middle?;
                    let vertex = *known.entry(edge).or_insert_with(|| {
                        let [p, q] = edge.map(|v| points[v as usize]);
                        points.push(std::array::from_fn(|i| f64::midpoint(p[i], q[i])));
                        middles.push(edge);
                        points.len() as u32 - 1
                    });
                    Some((vertex, weights))
                });
                cut(piece, split, &points, &mut next);
            }
            pieces = next;
            if known.is_empty() {
                break;
            }
        }
        Ok(Self { middles, pieces })
    }

    /// Appends the new vertices' values to those of the old ones.
    pub fn extend<T: Copy>(&self, values: &mut Vec<T>, middle: impl Fn(T, T) -> T) {
        for [a, b] in self.middles.iter().map(|edge| edge.map(|v| v as usize)) {
            values.push(middle(values[a], values[b]));
        }
    }

    /// The new triangles.
    pub fn triangles(&self) -> Vec<[u32; 3]> {
        self.pieces.iter().map(|piece| piece.corners).collect()
    }
}

/// The mean of two positions.
pub fn mean_point(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| f64::midpoint(a[i], b[i]))
}

/// The mean of two values.
pub fn mean<const N: usize>(a: [f32; N], b: [f32; N]) -> [f32; N] {
    std::array::from_fn(|i| 0.5 * (a[i] + b[i]))
}

/// Cuts a triangle at those of its edges that have a middle.
fn cut(piece: &Piece, middles: [Option<Node>; 3], points: &[[f64; 3]], out: &mut Vec<Piece>) {
    // Turned so that what is special comes last, or first.
    let turned = |k: usize| [0, 1, 2].map(|i| (piece.node(k + i), middles[(k + i) % 3]));
    let last = middles.iter().position(Option::is_none).map_or(0, |k| k + 1);
    match turned(last) {
        [(a, Some(ab)), (b, Some(bc)), (c, Some(ca))] => {
            out.extend(
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]].map(|n| piece.with(n)),
            );
        }
        [(a, Some(ab)), (b, Some(bc)), (c, None)] => {
            let crossing = distance(points, a.0, bc.0) <= distance(points, ab.0, c.0);
            let rest = if crossing { [[a, ab, bc], [a, bc, c]] } else { [[a, ab, c], [ab, bc, c]] };
            out.extend([[ab, b, bc], rest[0], rest[1]].map(|n| piece.with(n)));
        }
        [(a, Some(ab)), (b, None), (c, None)] => {
            out.extend([[a, ab, c], [ab, b, c]].map(|n| piece.with(n)));
        }
        [(a, None), (b, Some(bc)), (c, None)] => {
            out.extend([[a, b, bc], [a, bc, c]].map(|n| piece.with(n)));
        }
        _ => out.push(*piece),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    const SQUARE: [[f64; 3]; 4] = [[0., 0., 0.], [8., 0., 0.], [8., 3., 0.], [0., 3., 0.]];
    const HALVES: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

    fn area(points: &[[f64; 3]], [a, b, c]: [u32; 3]) -> f64 {
        let [a, b, c] = [a, b, c].map(|v| points[v as usize]);
        0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
    }

    #[test]
    fn pieces_cover_the_surface_without_a_gap() {
        for how in [1.0, 2.0, 2.9, 5.0, 8.1].map(Subdivision::Edge).into_iter().chain([
            Subdivision::Times(0),
            Subdivision::Times(1),
            Subdivision::Times(3),
        ]) {
            let finer = Finer::of(&SQUARE, &HALVES, how).unwrap();
            let mut points = SQUARE.to_vec();
            finer.extend(&mut points, mean_point);
            let areas = finer.pieces.iter().map(|piece| area(&points, piece.corners));
            assert!(areas.clone().all(|area| area > 0.0), "{how:?}: one is turned over");
            assert!((areas.sum::<f64>() - 24.0).abs() < 1e-9, "{how:?}");
            // Every edge has its opposite, but for those of the border.
            let edges: HashSet<_> = finer
                .pieces
                .iter()
                .flat_map(|Piece { corners: [a, b, c], .. }| [(*a, *b), (*b, *c), (*c, *a)])
                .collect();
            for &(a, b) in edges.iter().filter(|(a, b)| !edges.contains(&(*b, *a))) {
                let [p, q] = [a, b].map(|v| points[v as usize]);
                let along = |i: usize, at: f64| p[i] == at && q[i] == at;
                assert!(along(0, 0.) || along(0, 8.) || along(1, 0.) || along(1, 3.), "{how:?}");
            }
            if let Subdivision::Edge(most) = how {
                assert!(edges.iter().all(|(a, b)| distance(&points, *a, *b) <= most), "{how:?}");
            }
            for piece in &finer.pieces {
                let places =
                    HALVES[piece.of as usize].map(|v| SQUARE[v as usize].map(|x| x as f32));
                let own = piece.corners.map(|v| points[v as usize].map(|x| x as f32));
                for (p, q) in piece.mix(places).as_flattened().iter().zip(own.as_flattened()) {
                    assert!((p - q).abs() < 1e-5, "{how:?}: {piece:?}");
                }
            }
        }
        assert_eq!(Finer::of(&SQUARE, &HALVES, Subdivision::Times(2)).unwrap().pieces.len(), 32);
    }

    #[test]
    fn too_fine_is_refused_before_it_is_tried() {
        // 24 square millimetres, by triangles of sides of a micrometre; and 2·4⁸; a line that is one edge.
        let line = [[0, 2, 2]];
        for (triangles, how, least) in [
            (&HALVES[..], Subdivision::Edge(1e-3), "55425626"),
            (&HALVES, Subdivision::Times(12), "33554432"),
            (&line, Subdivision::Edge(1e-7), "85440037"),
        ] {
            let start = std::time::Instant::now();
            let error = Finer::of(&SQUARE, triangles, how).err().unwrap().to_string();
            assert!(error.contains(&format!("into {least} triangles")), "{error}");
            assert!(start.elapsed().as_millis() < 100, "{how:?} was tried");
        }
    }
}
