//! Fewer vertices for a mesh, all of them vertices it had: what is known per vertex stays true.
//!
//! Half-edge collapses in order of their quadric error (Garland & Heckbert, "Surface
//! Simplification Using Quadric Error Metrics", 1997; with colour as further dimensions as in
//! their "Simplifying Surfaces with Color and Texture", 1998). A collapse moves a vertex onto a
//! neighbour, so nothing is interpolated.

use crate::mesh::Mesh;
use crate::vector;
use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};

/// Position and weighted colour.
const DIMENSIONS: usize = 6;
/// How many millimetres a colour difference of one counts. Chosen, not measured, as are the next.
const COLOR_MILLIMETRES: f64 = 60.0;
/// Weight of a border edge's distance beside that of a surface.
const BORDER_WEIGHT: f64 = 10.0;
/// Least cosine between a face's normals before and after a collapse.
const TURN: f64 = 0.3;

type Point = [f64; DIMENSIONS];

/// The faces that are left of a mesh with about `target` vertices: as many as could be had without
/// moving a vertex of `keep`, turning a face over, or changing the topology. Deterministic.
pub fn decimate(mesh: &Mesh, keep: &[u32], target: usize) -> Vec<[u32; 3]> {
    let mut simplifier = Simplifier::new(mesh, keep);
    simplifier.collapse_to(target);
    simplifier.faces.into_iter().flatten().collect()
}

/// Sum of squared distances to planes: `pᵀ A p + 2 bᵀ p + c`.
#[derive(Clone, Default)]
struct Quadric {
    a: [[f64; DIMENSIONS]; DIMENSIONS],
    b: Point,
    c: f64,
}

impl Quadric {
    /// Weighted squared distance to the plane through `p` spanned by orthonormal directions.
    fn plane(p: &Point, directions: &[Point], weight: f64) -> Self {
        let mut q = Self::default();
        let along = directions.iter().map(|e| dot(e, p)).collect::<Vec<_>>();
        for i in 0..DIMENSIONS {
            for j in 0..DIMENSIONS {
                let identity = if i == j { 1.0 } else { 0.0 };
                let spanned: f64 = directions.iter().map(|e| e[i] * e[j]).sum();
                q.a[i][j] = weight * (identity - spanned);
            }
            let spanned: f64 = directions.iter().zip(&along).map(|(e, s)| e[i] * s).sum();
            q.b[i] = weight * (spanned - p[i]);
        }
        q.c = weight * (dot(p, p) - along.iter().map(|s| s * s).sum::<f64>());
        q
    }

    fn add(&mut self, other: &Self) {
        for (row, other) in self.a.iter_mut().zip(&other.a) {
            row.iter_mut().zip(other).for_each(|(x, y)| *x += y);
        }
        self.b.iter_mut().zip(&other.b).for_each(|(x, y)| *x += y);
        self.c += other.c;
    }

    fn at(&self, p: &Point) -> f64 {
        let quadratic: f64 = self.a.iter().zip(p).map(|(row, x)| x * dot(row, p)).sum();
        quadratic + 2.0 * dot(&self.b, p) + self.c
    }
}

fn dot(a: &Point, b: &Point) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// The direction of `to − from` without its part along `others`; `None` if nothing is left.
fn direction(from: &Point, to: &Point, others: &[Point]) -> Option<Point> {
    let mut e: Point = std::array::from_fn(|i| to[i] - from[i]);
    for other in others {
        let along = dot(&e, other);
        e.iter_mut().zip(other).for_each(|(x, o)| *x -= along * o);
    }
    let length = dot(&e, &e).sqrt();
    (length > 1e-9).then(|| e.map(|x| x / length))
}

/// Moving the first vertex onto the second; the cost's bits, which order like the cost.
type Collapse = Reverse<(u64, u32, u32, [u32; 2])>;

/// What is left of a mesh, and what may be collapsed next.
struct Simplifier {
    points: Vec<Point>,
    faces: Vec<Option<[u32; 3]>>,
    /// Faces around each vertex.
    around: Vec<Vec<u32>>,
    quadrics: Vec<Quadric>,
    kept: Vec<bool>,
    /// How often a vertex has changed: outdates collapses.
    version: Vec<u32>,
    vertices: usize,
    queue: BinaryHeap<Collapse>,
}

impl Simplifier {
    fn new(mesh: &Mesh, keep: &[u32]) -> Self {
        let points: Vec<Point> = mesh
            .points
            .iter()
            .zip(&mesh.colors)
            .map(|(p, c)| {
                let (p, c) = (p.map(f64::from), c.map(|c| COLOR_MILLIMETRES * f64::from(c)));
                [p[0], p[1], p[2], c[0], c[1], c[2]]
            })
            .collect();
        let mut around = vec![Vec::new(); points.len()];
        for (f, face) in mesh.triangles.iter().enumerate() {
            for &v in face {
                around[v as usize].push(f as u32);
            }
        }
        let mut kept = vec![false; points.len()];
        for &v in keep {
            kept[v as usize] = true;
        }
        let mut simplifier = Self {
            faces: mesh.triangles.iter().copied().map(Some).collect(),
            quadrics: vec![Quadric::default(); points.len()],
            version: vec![0; points.len()],
            vertices: around.iter().filter(|faces| !faces.is_empty()).count(),
            queue: BinaryHeap::new(),
            points,
            around,
            kept,
        };
        for face in &mesh.triangles {
            simplifier.add_quadrics(*face);
        }
        for v in 0..simplifier.points.len() as u32 {
            simplifier.queue_from(v);
        }
        simplifier
    }

    fn add_quadrics(&mut self, face: [u32; 3]) {
        let [p, q, r] = face.map(|v| self.points[v as usize]);
        let Some(e1) = direction(&p, &q, &[]) else { return };
        let Some(e2) = direction(&p, &r, &[e1]) else { return };
        let area = 0.5
            * (0..DIMENSIONS).map(|i| (q[i] - p[i]) * e1[i]).sum::<f64>()
            * (0..DIMENSIONS).map(|i| (r[i] - p[i]) * e2[i]).sum::<f64>();
        let quadric = Quadric::plane(&p, &[e1, e2], area.abs());
        for v in face {
            self.quadrics[v as usize].add(&quadric);
        }
        for [u, v] in [[face[0], face[1]], [face[1], face[2]], [face[2], face[0]]] {
            if self.shared(u, v).count() == 1 {
                // Along the border nothing changes the outline.
                let (p, q) = (self.points[u as usize], self.points[v as usize]);
                let Some(e) = direction(&p, &q, &[]) else { continue };
                let length2: f64 = (0..DIMENSIONS).map(|i| (q[i] - p[i]).powi(2)).sum();
                let border = Quadric::plane(&p, &[e], BORDER_WEIGHT * length2);
                self.quadrics[u as usize].add(&border);
                self.quadrics[v as usize].add(&border);
            }
        }
    }

    /// Faces with both vertices.
    fn shared(&self, u: u32, v: u32) -> impl Iterator<Item = u32> {
        let with = move |&f: &u32| self.faces[f as usize].is_some_and(|face| face.contains(&v));
        self.around[u as usize].iter().copied().filter(with)
    }

    fn neighbours(&self, v: u32) -> BTreeSet<u32> {
        let faces = self.around[v as usize].iter().filter_map(|&f| self.faces[f as usize]);
        faces.flatten().filter(|&other| other != v).collect()
    }

    fn on_border(&self, v: u32) -> bool {
        self.neighbours(v).into_iter().any(|other| self.shared(v, other).count() == 1)
    }

    /// Queues the collapses of a vertex onto its neighbours.
    fn queue_from(&mut self, u: u32) {
        if self.kept[u as usize] {
            return;
        }
        for v in self.neighbours(u) {
            let at = &self.points[v as usize];
            let cost = self.quadrics[u as usize].at(at) + self.quadrics[v as usize].at(at);
            let versions = [u, v].map(|v| self.version[v as usize]);
            self.queue.push(Reverse((cost.max(0.0).to_bits(), u, v, versions)));
        }
    }

    fn collapse_to(&mut self, target: usize) {
        while self.vertices > target {
            let Some(Reverse((_, u, v, versions))) = self.queue.pop() else { break };
            if [u, v].map(|v| self.version[v as usize]) == versions && self.allowed(u, v) {
                self.collapse(u, v);
            }
        }
    }

    /// Whether moving `u` onto `v` leaves the surface a surface.
    fn allowed(&self, u: u32, v: u32) -> bool {
        let shared: Vec<[u32; 3]> =
            self.shared(u, v).filter_map(|f| self.faces[f as usize]).collect();
        let opposite: BTreeSet<u32> =
            shared.iter().flatten().copied().filter(|&w| w != u && w != v).collect();
        let common: BTreeSet<u32> =
            self.neighbours(u).intersection(&self.neighbours(v)).copied().collect();
        let border_edge = shared.len() == 1;
        // The link condition; and a border moves only along itself.
        common == opposite
            && (1..=2).contains(&shared.len())
            && (border_edge || !self.on_border(u))
            && self.around[u as usize].len() > shared.len()
            && self.around[u as usize].iter().all(|&f| {
                self.faces[f as usize].is_none_or(|face| {
                    let moved = face.map(|w| if w == u { v } else { w });
                    face.contains(&v) || !self.turns(face, moved)
                })
            })
    }

    fn turns(&self, before: [u32; 3], after: [u32; 3]) -> bool {
        let normal = |face: [u32; 3]| {
            vector::normal(face.map(|v| self.points[v as usize]).map(|[x, y, z, ..]| [x, y, z]))
        };
        let (a, b) = (normal(before), normal(after));
        vector::dot(a, b) <= TURN * (vector::dot(a, a) * vector::dot(b, b)).sqrt()
    }

    fn collapse(&mut self, u: u32, v: u32) {
        let quadric = std::mem::take(&mut self.quadrics[u as usize]);
        self.quadrics[v as usize].add(&quadric);
        for f in std::mem::take(&mut self.around[u as usize]) {
            let Some(face) = self.faces[f as usize] else { continue };
            if face.contains(&v) {
                self.faces[f as usize] = None;
                for w in face {
                    self.around[w as usize].retain(|&g| g != f);
                }
            } else {
                self.faces[f as usize] = Some(face.map(|w| if w == u { v } else { w }));
                self.around[v as usize].push(f);
            }
        }
        self.vertices -= 1;
        self.version[u as usize] += 1;
        self.version[v as usize] += 1;
        let neighbours = self.neighbours(v);
        for &w in &neighbours {
            self.version[w as usize] += 1;
        }
        self.queue_from(v);
        for w in neighbours {
            self.queue_from(w);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wavy sheet of `side × side` vertices, a millimetre apart; its middle column is dark.
    fn sheet(side: u32) -> Mesh {
        let places = || (0..side).flat_map(move |y| (0..side).map(move |x| (x, y)));
        let triangles = (0..side - 1)
            .flat_map(|y| (0..side - 1).map(move |x| y * side + x))
            .flat_map(|v| [[v, v + 1, v + side], [v + 1, v + side + 1, v + side]])
            .collect();
        Mesh {
            points: places().map(|(x, y)| [x as f32, y as f32, (0.3 * x as f32).sin()]).collect(),
            colors: places().map(|(x, _)| [if x == side / 2 { 0.1 } else { 0.8 }; 3]).collect(),
            triangles,
        }
    }

    fn area(mesh: &Mesh, faces: &[[u32; 3]]) -> f32 {
        let corner = |v: u32| mesh.points[v as usize];
        faces
            .iter()
            .map(|face| {
                let [p, q, r] = face.map(corner);
                0.5 * ((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))
            })
            .sum()
    }

    #[test]
    fn a_sheet_keeps_its_outline_its_stripe_and_what_it_is_told_to() {
        let mesh = sheet(21);
        let keep = [5 * 21 + 5, 20 * 21 + 7];
        let faces = decimate(&mesh, &keep, 120);
        let used: BTreeSet<u32> = faces.iter().flatten().copied().collect();
        assert_eq!(used.len(), 120);
        assert!(keep.iter().all(|v| used.contains(v)));
        // Seen from above it still is the square, covered once.
        assert!((area(&mesh, &faces) - 400.0).abs() < 1e-3);
        let dark = |v: &&u32| mesh.colors[**v as usize][0] < 0.5;
        assert!(used.iter().filter(dark).count() >= 2);
        let mixed = faces.iter().filter(|f| (1..3).contains(&f.iter().filter(dark).count()));
        assert!(mixed.count() > 2);
        assert_eq!(decimate(&mesh, &keep, 120), faces);
    }

    #[test]
    fn what_cannot_go_stays() {
        let mesh = sheet(6);
        let all: Vec<u32> = (0..36).collect();
        assert_eq!(decimate(&mesh, &all, 3), mesh.triangles);
        assert_eq!(decimate(&mesh, &[], 36), mesh.triangles);
        assert!(!decimate(&mesh, &[], 0).is_empty());
    }
}
