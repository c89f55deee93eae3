//! Finding an object's plane of symmetry, and moving the object so that this is a coordinate plane: kernels
//! mirror at those alone.

use crate::error::{Error, Result};
use crate::mesh::{Axis, Mesh};
use crate::scan::surface::Surface;
use crate::vector::{dot, length};
use faer::{Mat, Side};
use std::f64::consts::PI;
use std::fmt;

/// A plane `n·p = d`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// `n`, of length one.
    pub normal: [f64; 3],
    /// `d`, in the points' unit.
    pub offset: f64,
}

impl Plane {
    /// The plane `a·p = b`, unless `a` has no direction or a number is not finite.
    pub fn new(a: [f64; 3], b: f64) -> Option<Self> {
        let length = a[0].hypot(a[1]).hypot(a[2]);
        let plane = Self { normal: a.map(|x| x / length), offset: b / length };
        let finite = plane.normal.iter().chain([&plane.offset]).all(|x| x.is_finite());
        (finite && length.is_finite()).then_some(plane)
    }

    /// The plane after a rotation about the origin.
    #[must_use]
    pub fn turned(self, rotation: impl FnOnce([f32; 3]) -> [f32; 3]) -> Self {
        let normal = rotation(self.normal.map(|x| x as f32)).map(f64::from);
        Self { normal, ..self }
    }

    /// The plane after something is added to the coordinates of all points.
    #[must_use]
    pub fn moved(self, by: [f64; 3]) -> Self {
        Self { offset: self.offset + dot(self.normal, by), ..self }
    }
}

impl fmt::Display for Plane {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([x, y, z], d) = (self.normal, self.offset);
        write!(f, "{x:.5} x {y:+.5} y {z:+.5} z = {d:.3}")
    }
}

/// A plane of symmetry and how good it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Symmetry {
    /// The plane.
    pub plane: Plane,
    /// Root mean square distance of a mirrored vertex from the surface, in the mesh's unit.
    pub error: f64,
}

/// Points that are looked at while searching; the error is that of all. Chosen, not measured, as are the next.
const SAMPLE: usize = 1500;
/// Directions tried: one per 8° or so of a hemisphere.
const DIRECTIONS: usize = 300;
/// Of these so many are improved.
const REFINED: usize = 8;
const ITERATIONS: usize = 60;
/// Share of the points whose mirror images may have no counterpart: holes, a fringe.
const OUTLIERS: f64 = 0.15;

/// Finds the plane at which the mesh mirrors best: the best of many directions, each improved by
/// pairing mirrored points with their nearest points of the surface and solving for the plane that swaps the
/// pairs best.
///
/// # Errors
/// Fewer than ten points, or all at one place.
pub fn find(mesh: &Mesh) -> Result<Symmetry> {
    let mirror = Mirror::new(mesh)?;
    let mut candidates: Vec<(f64, Plane)> = directions()
        .map(|normal| {
            let plane = Plane { normal, offset: dot(normal, mirror.centre) };
            (mirror.trimmed_error(&plane), plane)
        })
        .collect();
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
    let refined = candidates.into_iter().take(REFINED).map(|(_, plane)| mirror.refine(plane));
    let best = refined
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .ok_or_else(|| Error::new("no direction to look along"))?;
    Ok(mirror.judge(best.1))
}

/// How well the mesh mirrors at a plane.
///
/// # Errors
/// See [`find`].
pub fn judge(mesh: &Mesh, plane: Plane) -> Result<Symmetry> {
    Ok(Mirror::new(mesh)?.judge(plane))
}

/// Moves points by the least rotation, and along the normal, so that the plane becomes that
/// coordinate plane through the origin which it is nearest to.
pub fn align(points: &mut [[f32; 3]], plane: &Plane) -> Axis {
    let n = plane.normal;
    let axis = (0..3).max_by(|&a, &b| n[a].abs().total_cmp(&n[b].abs())).unwrap_or(0);
    let sign = n[axis].signum();
    let (n, offset) = (n.map(|x| sign * x), sign * plane.offset);
    // The rotation that takes n to e is the reflection at the plane across n, which turns n round,
    // and then that across n + e.
    let mut half = n;
    half[axis] += 1.0;
    let size = length(half);
    let half = half.map(|x| x / size);
    for p in points {
        let mut q = reflected(reflected(p.map(f64::from), n, 0.0), half, 0.0);
        q[axis] -= offset;
        *p = q.map(|x| x as f32);
    }
    [Axis::X, Axis::Y, Axis::Z][axis]
}

/// A point, and what is nearest to its mirror image.
type Pair = ([f64; 3], [f64; 3]);

/// A mesh, to be compared with its mirror images.
struct Mirror {
    all: Vec<[f64; 3]>,
    sample: Vec<[f64; 3]>,
    surface: Surface,
    centre: [f64; 3],
}

impl Mirror {
    fn new(mesh: &Mesh) -> Result<Self> {
        let all: Vec<[f64; 3]> = mesh.points.iter().map(|p| p.map(f64::from)).collect();
        if all.len() < 10 || all.iter().all(|p| *p == all[0]) {
            return Err(Error::new("too few different points to be symmetric"));
        }
        let mut centre = [0.0; 3];
        for p in &all {
            for k in 0..3 {
                centre[k] += p[k] / all.len() as f64;
            }
        }
        let sample = all.iter().step_by(all.len().div_ceil(SAMPLE)).copied().collect();
        Ok(Self { all, sample, surface: Surface::new(mesh), centre })
    }

    /// Squared distance of a point's mirror image from the surface, and the point there.
    fn nearest(&self, p: [f64; 3], plane: &Plane) -> (f64, [f64; 3]) {
        let image = reflected(p, plane.normal, plane.offset);
        let found = self.surface.nearest(image);
        (found.squared, found.point)
    }

    /// Pairs of points and what is nearest to their images, without the worst.
    fn pairs(&self, plane: &Plane) -> (f64, Vec<Pair>) {
        let mut pairs: Vec<_> = self
            .sample
            .iter()
            .map(|&p| {
                let (distance, q) = self.nearest(p, plane);
                (distance, (p, q))
            })
            .collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        pairs.truncate((pairs.len() as f64 * (1.0 - OUTLIERS)) as usize);
        let mean = pairs.iter().map(|(d, _)| d).sum::<f64>() / pairs.len() as f64;
        (mean.sqrt(), pairs.into_iter().map(|(_, pair)| pair).collect())
    }

    fn trimmed_error(&self, plane: &Plane) -> f64 {
        self.pairs(plane).0
    }

    fn refine(&self, mut plane: Plane) -> (f64, Plane) {
        let (mut error, mut pairs) = self.pairs(&plane);
        for _ in 0..ITERATIONS {
            let Some(next) = swapping(&pairs) else { break };
            let (next_error, next_pairs) = self.pairs(&next);
            if next_error >= error {
                break;
            }
            (plane, error, pairs) = (next, next_error, next_pairs);
        }
        (error, plane)
    }

    fn judge(&self, plane: Plane) -> Symmetry {
        let sum: f64 = self.all.iter().map(|&p| self.nearest(p, &plane).0).sum();
        Symmetry { plane, error: (sum / self.all.len() as f64).sqrt() }
    }
}

/// The plane whose reflection takes the first of each pair nearest to the second, in the least
/// squares sense: `Σ ‖p − 2(n·p)n − q‖²` about the common centre is least for the eigenvector of
/// `Σ p qᵀ + q pᵀ` with the smallest eigenvalue.
fn swapping(pairs: &[Pair]) -> Option<Plane> {
    let count = pairs.len() as f64;
    let mut centre = [0.0; 3];
    for (p, q) in pairs {
        for k in 0..3 {
            centre[k] += 0.5 * (p[k] + q[k]) / count;
        }
    }
    let mut sums = [[0.0; 3]; 3];
    for (p, q) in pairs {
        for (i, row) in sums.iter_mut().enumerate() {
            for (j, sum) in row.iter_mut().enumerate() {
                let product = |i: usize, j: usize| (p[i] - centre[i]) * (q[j] - centre[j]);
                *sum += product(i, j) + product(j, i);
            }
        }
    }
    let matrix = Mat::from_fn(3, 3, |i, j| sums[i][j]);
    let eigen = matrix.self_adjoint_eigen(Side::Lower).ok()?;
    let normal = [0, 1, 2].map(|k| eigen.U()[(k, 0)]);
    Some(Plane { normal, offset: dot(normal, centre) })
}

/// Directions over a hemisphere, the axes first, then a Fibonacci spiral.
fn directions() -> impl Iterator<Item = [f64; 3]> {
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let golden = PI * (3.0 - 5.0_f64.sqrt());
    axes.into_iter().chain((0..DIRECTIONS).map(move |i| {
        let z = (i as f64 + 0.5) / DIRECTIONS as f64;
        let (sin, cos) = (golden * i as f64).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        [radius * cos, radius * sin, z]
    }))
}

fn reflected(p: [f64; 3], n: [f64; 3], offset: f64) -> [f64; 3] {
    let t = 2.0 * (dot(n, p) - offset);
    [0, 1, 2].map(|k| p[k] - t * n[k])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::template;
    use crate::vector::{cross, minus};

    /// The template, turned about y and z and moved.
    fn moved() -> (Mesh, Plane) {
        let (a, b) = (0.4_f64, -0.3_f64);
        let turn = |[x, y, z]: [f64; 3]| {
            let [x, z] = [a.cos() * x + a.sin() * z, a.cos() * z - a.sin() * x];
            [b.cos() * x - b.sin() * y, b.sin() * x + b.cos() * y, z]
        };
        let shift = [12.0, -40.0, 7.0];
        let mut mesh = template().unwrap().0;
        let place = |p: &[f32; 3]| {
            let q = turn(p.map(f64::from));
            [0, 1, 2].map(|k| (q[k] + shift[k]) as f32)
        };
        let normal = turn([1.0, 0.0, 0.0]);
        mesh.points = mesh.points.iter().map(place).collect();
        (mesh, Plane { normal, offset: dot(normal, shift) })
    }

    #[test]
    fn a_moved_face_shows_its_plane_of_symmetry() {
        let (mesh, truth) = moved();
        let found = find(&mesh).unwrap();
        let sign = dot(found.plane.normal, truth.normal).signum();
        for k in 0..3 {
            assert!((sign * found.plane.normal[k] - truth.normal[k]).abs() < 1e-3, "{found:?}");
        }
        assert!((sign * found.plane.offset - truth.offset).abs() < 0.02, "{found:?} {truth:?}");
        assert!(found.error < 0.02, "{found:?}");
        assert!(judge(&mesh, Plane { offset: truth.offset + 5.0, ..truth }).unwrap().error > 0.5);
    }

    #[test]
    fn aligning_puts_the_plane_through_the_origin_and_keeps_distances() {
        let (mut mesh, truth) = moved();
        let before = mesh.points.clone();
        assert_eq!(align(&mut mesh.points, &truth), Axis::X);
        let x = Plane { normal: [1.0, 0.0, 0.0], offset: 0.0 };
        assert!(judge(&mesh, x).unwrap().error < 1e-3);
        let distance = |points: &[[f32; 3]], i: usize, j: usize| {
            length(minus(points[i], points[j]).map(f64::from))
        };
        for (i, j) in [(0, 100), (7, 4000), (8000, 3)] {
            assert!((distance(&mesh.points, i, j) - distance(&before, i, j)).abs() < 1e-3);
        }
        // Turned, not mirrored: the triple product of three edges keeps its sign.
        let volume = |points: &[[f32; 3]]| {
            let [a, b, c, o] = [10, 2000, 5000, 8000].map(|i| points[i].map(f64::from));
            dot(minus(a, o), cross(minus(b, o), minus(c, o)))
        };
        assert!((volume(&mesh.points) / volume(&before) - 1.0).abs() < 1e-3);
    }
}
