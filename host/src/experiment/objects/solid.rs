//! Solids of rounded, painted parts, and their surfaces as meshes.

use crate::mesh::Mesh;
use std::collections::HashMap;

/// A part of a solid.
#[derive(Clone, Debug)]
pub struct Ellipsoid {
    /// What landmarks call it.
    pub name: &'static str,
    /// Millimetres; of a pair, that of the left one, x > 0.
    pub centre: [f64; 3],
    /// Half axes, millimetres.
    pub radii: [f64; 3],
    /// Turn about x that lifts the front, degrees.
    pub pitch: f64,
    /// Whether there is one on each side of x = 0.
    pub paired: bool,
    /// RGB.
    pub color: [f64; 3],
}

/// Parts that flow into each other; symmetric about x = 0.
#[derive(Clone, Debug)]
pub struct Solid {
    /// Its parts.
    pub parts: Vec<Ellipsoid>,
    /// Dark bands across the first part: their distance along z, or 0 for none.
    pub bands: f64,
}

/// Width of the seam between two parts, millimetres.
const BLEND: f64 = 3.0;
/// The same of their paint.
const BLUR: f64 = 1.2;
/// How dark a band is.
const BAND: f64 = 0.45;

/// A grid point or a cell of the grid.
type Cell = [i32; 3];

impl Ellipsoid {
    /// A point in the part's own axes, and back.
    fn turned(&self, [x, y, z]: [f64; 3], sign: f64) -> [f64; 3] {
        let (sin, cos) = (sign * self.pitch.to_radians()).sin_cos();
        [x, cos * y + sin * z, cos * z - sin * y]
    }

    /// About the distance from the surface, negative inside.
    fn distance(&self, [x, y, z]: [f64; 3]) -> f64 {
        let p = [if self.paired { x.abs() } else { x }, y, z];
        let q = self.turned(std::array::from_fn(|k| p[k] - self.centre[k]), -1.0);
        let length = |power: i32| -> f64 {
            (0..3).map(|k| (q[k] / self.radii[k].powi(power)).powi(2)).sum::<f64>().sqrt()
        };
        let (near, gradient) = (length(1), length(2));
        if gradient > 0.0 { near * (near - 1.0) / gradient } else { -self.radii[0] }
    }

    /// The point of the surface that lies in a direction of the part's own axes; `side` is −1 for
    /// the other one of a pair.
    pub fn tip(&self, direction: [f64; 3], side: f64) -> [f64; 3] {
        let length = direction.iter().map(|d| d * d).sum::<f64>().sqrt();
        let tip = self.turned(std::array::from_fn(|k| self.radii[k] * direction[k] / length), 1.0);
        let [x, y, z] = std::array::from_fn(|k| self.centre[k] + tip[k]);
        [side * x, y, z]
    }
}

impl Solid {
    /// About the distance from the surface, negative inside.
    fn distance(&self, p: [f64; 3]) -> f64 {
        let sum: f64 = self.parts.iter().map(|part| (-part.distance(p) / BLEND).exp()).sum();
        -BLEND * sum.ln()
    }

    fn color(&self, p: [f64; 3]) -> [f32; 3] {
        let nearest = self.parts.iter().map(|part| part.distance(p)).fold(f64::INFINITY, f64::min);
        let (mut sum, mut weights) = ([0.0; 3], 0.0);
        for (i, part) in self.parts.iter().enumerate() {
            let weight = ((nearest - part.distance(p)) / BLUR).exp();
            let wave = if i == 0 && self.bands > 0.0 {
                (std::f64::consts::TAU * p[2] / self.bands).cos()
            } else {
                -1.0
            };
            let shade = 1.0 - BAND * (0.5 + 0.5 * (4.0 * (wave - 0.4)).tanh());
            weights += weight;
            for (sum, c) in sum.iter_mut().zip(part.color) {
                *sum += weight * shade * c;
            }
        }
        sum.map(|c| (c / weights).clamp(0.0, 1.0) as f32)
    }

    /// Its surface: a vertex in every cell of a grid that the surface crosses, at the mean of where
    /// it crosses the cell's edges (surface nets, Gibson 1998). Exactly symmetric about x = 0, and
    /// no edge has more than two triangles.
    pub fn mesh(&self, spacing: f64) -> Mesh {
        let reach = self.parts.iter().fold([0.0_f64; 3], |reach, part| {
            let longest = part.radii.iter().copied().fold(0.0, f64::max);
            std::array::from_fn(|k| reach[k].max(part.centre[k].abs() + longest))
        });
        let count = reach.map(|r| (r / spacing).ceil() as i32 + 3);
        let place = |n: Cell| n.map(|i| f64::from(i) * spacing);
        let mut values: HashMap<Cell, f64> = HashMap::new();
        for x in 0..=count[0] {
            for y in -count[1]..=count[1] {
                for z in -count[2]..=count[2] {
                    let value = self.distance(place([x, y, z]));
                    values.insert([x, y, z], value);
                    values.insert([-x, y, z], value);
                }
            }
        }
        separate(&mut values);
        // Where the surface crosses an edge of the grid, as sums per cell.
        let mut crossings: HashMap<Cell, ([f64; 3], f64)> = HashMap::new();
        let mut quads: Vec<([Cell; 4], bool)> = Vec::new();
        let mut nodes: Vec<Cell> = values.keys().copied().collect();
        nodes.sort_unstable();
        for &node in &nodes {
            let here = values[&node];
            for axis in 0..3 {
                let Some(&there) = values.get(&step(node, axis, 1)) else { continue };
                if (here < 0.0) == (there < 0.0) {
                    continue;
                }
                let mut at = place(node);
                at[axis] += spacing * here / (here - there);
                let [b, c] = [(axis + 1) % 3, (axis + 2) % 3];
                let cells =
                    [node, step(node, b, -1), step(step(node, b, -1), c, -1), step(node, c, -1)];
                for cell in cells {
                    let (sum, count) = crossings.entry(cell).or_insert(([0.0; 3], 0.0));
                    sum.iter_mut().zip(at).for_each(|(sum, x)| *sum += x);
                    *count += 1.0;
                }
                quads.push((cells, here < 0.0));
            }
        }
        let mut mesh = Mesh { points: Vec::new(), colors: Vec::new(), triangles: Vec::new() };
        let mut cells: Vec<Cell> = crossings.keys().copied().collect();
        cells.sort_unstable();
        let mut index: HashMap<Cell, u32> = HashMap::new();
        for cell in cells {
            // Both sides get the bits of the one.
            let side = if cell[0] < 0 { -1.0 } else { 1.0 };
            let right = if cell[0] < 0 { [-1 - cell[0], cell[1], cell[2]] } else { cell };
            let (sum, count) = crossings[&right];
            let [x, y, z] = sum.map(|s| s / count);
            index.insert(cell, mesh.points.len() as u32);
            mesh.points.push([side * x, y, z].map(|x| x as f32));
            mesh.colors.push(self.color([x, y, z]));
        }
        for (cells, outwards) in quads {
            let [a, b, c, d] = cells.map(|cell| index[&cell]);
            let [a, b, c, d] = if outwards { [a, b, c, d] } else { [d, c, b, a] };
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
        mesh
    }
}

fn step(node: Cell, axis: usize, by: i32) -> Cell {
    std::array::from_fn(|k| node[k] + if k == axis { by } else { 0 })
}

/// Sees to it that no square of the grid has two opposite corners inside and two outside: four
/// sheets of the surface would meet in one edge. Of the outer corners the nearer one comes inside,
/// by as much as it was outside.
fn separate(values: &mut HashMap<Cell, f64>) {
    loop {
        let mut nearer = Vec::new();
        for &node in values.keys().filter(|node| node[0] >= 0) {
            for [a, b] in [[0, 1], [1, 2], [2, 0]] {
                let corners =
                    [node, step(node, a, 1), step(step(node, a, 1), b, 1), step(node, b, 1)];
                let [Some(p), Some(q), Some(r), Some(s)] = corners.map(|c| values.get(&c)) else {
                    continue;
                };
                let outside = match [p, q, r, s].map(|&value| value < 0.0) {
                    [true, false, true, false] => [(q, corners[1]), (s, corners[3])],
                    [false, true, false, true] => [(p, corners[0]), (r, corners[2])],
                    _ => continue,
                };
                let [one, other] = outside;
                nearer.push(if one.0 <= other.0 { one.1 } else { other.1 });
            }
        }
        if nearer.is_empty() {
            return;
        }
        for [x, y, z] in nearer {
            for node in [[x, y, z], [-x, y, z]] {
                values.entry(node).and_modify(|value| *value = -value.abs().max(f64::MIN_POSITIVE));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::doctor::Findings;
    use crate::vector::{cross, dot};

    #[test]
    fn a_ball_is_round_closed_and_symmetric() {
        let ball = Ellipsoid {
            name: "ball",
            centre: [0.0; 3],
            radii: [20.0; 3],
            pitch: 30.0,
            paired: false,
            color: [0.5; 3],
        };
        let tip = ball.tip([0.0, 0.0, 1.0], 1.0);
        assert!(tip[1] > 9.0 && tip[2] > 17.0, "the front is lifted: {tip:?}");
        let mesh = Solid { parts: vec![ball], bands: 0.0 }.mesh(2.0);
        for p in &mesh.points {
            let radius = p.iter().map(|x| x * x).sum::<f32>().sqrt();
            assert!((19.0..21.0).contains(&radius), "{radius}");
            assert!(mesh.points.contains(&[-p[0], p[1], p[2]]));
        }
        // Volume by the divergence theorem: positive if triangles look outwards.
        let volume: f32 = mesh
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| mesh.points[v as usize]);
                dot(a, cross(b, c)) / 6.0
            })
            .sum();
        assert!((volume / 33_510.0 - 1.0).abs() < 0.05, "{volume}");
        let found = Findings::of(&mesh, 1.0);
        assert_eq!((found.border_edges, found.crowded_edges, found.clashing_edges), (0, 0, 0));
    }
}
