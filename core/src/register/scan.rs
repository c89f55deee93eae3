//! A scan, and what is known of its surface: normals, where its rim is, colours more or less blurred.

use crate::engine::Quad;
use crate::math::{less, sqrt};
use crate::model::MAX_TRIANGLES;
use crate::vector::{Vec3, add, cross, dot, scale, sub};
use core::fmt;

/// Variance that colours are blurred by at a time, mm²; about half the square of an edge.
const BLUR_STEP: f32 = 0.5;
/// Passes after which distances to the rim are taken as they are. Chosen, not measured.
const RIM_PASSES: usize = 32;

/// Why a scan cannot be registered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum RegisterError {
    /// There are not as many colours as points.
    Colors { points: usize, colors: usize },
    /// A coordinate or a colour that is not a finite number.
    Point { index: usize },
    /// A triangle with a corner beyond the last point.
    Triangle { index: usize },
    /// No triangle with an area, or more than 2²³ triangles.
    Triangles { found: usize },
    /// A landmark that is not a vertex of the model, or whose place is not finite.
    Landmark { index: usize },
    /// Too little memory; both in words.
    Memory { needed: usize, found: usize },
}

impl fmt::Display for RegisterError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Colors { points, colors } => {
                write!(f, "{points} points and {colors} colours; give a colour for each point")
            }
            Self::Point { index } => write!(f, "point {index}: not a finite place and colour"),
            Self::Triangle { index } => write!(f, "triangle {index}: a corner is no point"),
            Self::Triangles { found } => write!(
                f,
                "{found} triangles, none or too many that have an area; expected 1 to {MAX_TRIANGLES}"
            ),
            Self::Landmark { index } => {
                write!(f, "landmark {index}: no vertex of the model, or not a finite place")
            }
            Self::Memory { needed, found } => {
                write!(f, "{found} words of memory, {needed} are needed")
            }
        }
    }
}

impl core::error::Error for RegisterError {}

/// A triangle mesh with a colour per vertex, of any topology, in millimetres.
#[derive(Clone, Copy, Debug)]
pub struct Scan<'a> {
    pub(super) points: &'a [Vec3],
    pub(super) colors: &'a [Vec3],
    pub(super) triangles: &'a [[u32; 3]],
}

impl<'a> Scan<'a> {
    /// Checks a mesh: places in mm, colours RGB in `[0, 1]`, corners counter-clockwise seen from
    /// outside.
    ///
    /// # Errors
    /// [`RegisterError::Colors`], [`RegisterError::Point`], [`RegisterError::Triangle`],
    /// [`RegisterError::Triangles`].
    pub fn new(
        points: &'a [Vec3],
        colors: &'a [Vec3],
        triangles: &'a [[u32; 3]],
    ) -> Result<Self, RegisterError> {
        if points.len() != colors.len() {
            return Err(RegisterError::Colors { points: points.len(), colors: colors.len() });
        }
        let finite =
            |(p, c): (&Vec3, &Vec3)| p.iter().chain(c).all(|x| x.is_finite() && x.abs() < 1e6);
        if let Some(index) = points.iter().zip(colors).position(|pair| !finite(pair)) {
            return Err(RegisterError::Point { index });
        }
        let inside = |t: &[u32; 3]| t.iter().all(|&v| (v as usize) < points.len());
        if let Some(index) = triangles.iter().position(|t| !inside(t)) {
            return Err(RegisterError::Triangle { index });
        }
        let scan = Self { points, colors, triangles };
        let area = |t: u32| dot(scan.face(t), scan.face(t)) > 0.0;
        if triangles.len() > MAX_TRIANGLES || !(0..triangles.len() as u32).any(area) {
            return Err(RegisterError::Triangles { found: triangles.len() });
        }
        Ok(scan)
    }

    /// A place; the origin if there is no such point.
    pub(super) fn point(&self, v: u32) -> Vec3 {
        self.points.get(v as usize).copied().unwrap_or_default()
    }

    /// Corners of a triangle.
    pub(super) fn corners(&self, triangle: u32) -> [u32; 3] {
        self.triangles.get(triangle as usize).copied().unwrap_or_default()
    }

    /// Normal of a triangle, as long as twice its area.
    fn face(&self, triangle: u32) -> Vec3 {
        let [a, b, c] = self.corners(triangle).map(|v| self.point(v));
        cross(sub(b, a), sub(c, a))
    }

    /// A number per vertex at a point of a triangle.
    pub(super) fn interpolate(&self, values: &[Vec3], triangle: u32, weights: [f32; 3]) -> Vec3 {
        let [a, b, c] = self.corners(triangle).map(|v| at(values, v));
        let [u, v, w] = weights;
        add(add(scale(a, u), scale(b, v)), scale(c, w))
    }

    /// How the three colours change with the place along a triangle, per mm: a vector each.
    pub(super) fn slopes(&self, colors: &[Vec3], triangle: u32) -> [Vec3; 3] {
        let corners = self.corners(triangle);
        slopes(corners.map(|v| self.point(v)), corners.map(|v| at(colors, v))).0
    }

    /// Fills `normals` with unit normals of the vertices, faces counted by their areas.
    pub(super) fn find_normals(&self, normals: &mut [Vec3]) {
        normals.fill([0.0; 3]);
        for t in 0..self.triangles.len() as u32 {
            let face = self.face(t);
            for v in self.corners(t) {
                if let Some(sum) = normals.get_mut(v as usize) {
                    *sum = add(*sum, face);
                }
            }
        }
        for normal in normals {
            let squared = dot(*normal, *normal);
            *normal = if squared > 0.0 { scale(*normal, 1.0 / sqrt(squared)) } else { [0.0; 3] };
        }
    }

    /// Fills `rim` with distances of vertices along edges to the nearest border, be it the scan's or a
    /// hole's, as far as they are below `reach`; `edges` holds two words for each of three edges per
    /// triangle.
    pub(super) fn find_rim(&self, rim: &mut [f32], edges: &mut [[u32; 2]], reach: f32) {
        rim.fill(reach);
        let sides = |[a, b, c]: [u32; 3]| [[a, b], [b, c], [c, a]];
        let all = self.triangles.iter().flat_map(|&t| sides(t));
        for (to, [a, b]) in edges.iter_mut().zip(all) {
            *to = if a < b { [a, b] } else { [b, a] };
        }
        edges.sort_unstable();
        for [a, b] in edges.chunk_by(|x, y| x == y).filter(|same| same.len() == 1).flatten() {
            for v in [a, b] {
                if let Some(distance) = rim.get_mut(*v as usize) {
                    *distance = 0.0;
                }
            }
        }
        for _ in 0..RIM_PASSES {
            let mut changed = false;
            for &[a, b] in &*edges {
                let length = distance(self.point(a), self.point(b));
                let [to_a, to_b] = [a, b].map(|v| rim.get(v as usize).copied().unwrap_or(reach));
                for (v, own, other) in [(a, to_a, to_b), (b, to_b, to_a)] {
                    if other + length < own {
                        changed = true;
                        if let Some(to) = rim.get_mut(v as usize) {
                            *to = other + length;
                        }
                    }
                }
            }
            if !changed {
                return;
            }
        }
    }
}

/// How three numbers change along a triangle with these corners and their values, a vector each (zero
/// if it has no area); and twice its area.
pub(super) fn slopes([a, b, c]: [Vec3; 3], values: [Vec3; 3]) -> ([Vec3; 3], f32) {
    let normal = cross(sub(b, a), sub(c, a));
    let squared = dot(normal, normal);
    let inverse = if squared > 0.0 { 1.0 / squared } else { 0.0 };
    // What is 1 at a corner and 0 at the others.
    let hats = [(b, c), (c, a), (a, b)].map(|(p, q)| scale(cross(normal, sub(q, p)), inverse));
    let slopes = [0, 1, 2].map(|channel| {
        let [u, v, w] = values.map(|value| value[channel]);
        add(add(scale(hats[0], u), scale(hats[1], v)), scale(hats[2], w))
    });
    (slopes, sqrt(squared))
}

/// A value at a vertex; zero if there is none.
pub(super) fn at(values: &[Vec3], v: u32) -> Vec3 {
    values.get(v as usize).copied().unwrap_or_default()
}

fn distance(a: Vec3, b: Vec3) -> f32 {
    let d = sub(b, a);
    sqrt(dot(d, d))
}

/// Blurs numbers at vertices along the surface, as heat spreads, by about this standard deviation in
/// mm. Each step mixes a vertex with the mean of its neighbours, as much as their squared distance
/// tells. `triangle` gives corners by number, as long as there are any; `sums` has room for eight
/// numbers per vertex.
pub(super) fn blur(
    values: &mut [Vec3],
    triangle: impl Fn(usize) -> Option<[u32; 3]>,
    point: impl Fn(u32) -> Vec3,
    deviation: f32,
    sums: &mut [[Quad; 2]],
) {
    let mut left = deviation * deviation;
    while left > 0.0 {
        let step = less(left, BLUR_STEP);
        left -= BLUR_STEP;
        sums.fill([[0.0; 4]; 2]);
        for [a, b, c] in (0..).map_while(&triangle) {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                let apart = sub(point(to), point(from));
                for (v, neighbour) in [(from, to), (to, from)] {
                    let [x, y, z] = at(values, neighbour);
                    if let Some([sum, edge]) = sums.get_mut(v as usize) {
                        *sum = [sum[0] + x, sum[1] + y, sum[2] + z, sum[3] + 1.0];
                        edge[0] += dot(apart, apart);
                    }
                }
            }
        }
        for (value, [[x, y, z, count], [squares, ..]]) in values.iter_mut().zip(&*sums) {
            if *squares > 0.0 {
                // A step along an edge adds half its square to the variance along either axis.
                let part = less(2.0 * step * count / squares, 1.0);
                let mean = scale([*x, *y, *z], 1.0 / count);
                *value = add(*value, scale(sub(mean, *value), part));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;
    use std::vec::Vec;

    /// A plane of n × n vertices 1 mm apart.
    fn plane(n: u32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let points = (0..n * n).map(|v| [(v % n) as f32, (v / n) as f32, 0.0]).collect();
        let cells = (0..n - 1).flat_map(|y| (0..n - 1).map(move |x| y * n + x));
        let triangles = cells.flat_map(|v| [[v, v + 1, v + n], [v + 1, v + n + 1, v + n]]);
        (points, triangles.collect())
    }

    #[test]
    fn what_is_no_surface_is_refused() {
        let (points, triangles) = plane(3);
        let colors = vec![[0.5; 3]; 9];
        let error = |p: &[Vec3], c: &[Vec3], t: &[[u32; 3]]| Scan::new(p, c, t).unwrap_err();
        assert!(Scan::new(&points, &colors, &triangles).is_ok());
        let few = RegisterError::Colors { points: 9, colors: 8 };
        assert_eq!(error(&points, &colors[1..], &triangles), few);
        let far = RegisterError::Triangle { index: 0 };
        assert_eq!(error(&points, &colors, &[[0, 1, 9]]), far);
        let none = RegisterError::Triangles { found: 1 };
        assert_eq!(error(&points, &colors, &[[0, 1, 2]]), none);
        let mut bad = points.clone();
        bad[4][1] = f32::NAN;
        assert_eq!(error(&bad, &colors, &triangles), RegisterError::Point { index: 4 });
    }

    #[test]
    fn the_rim_is_as_far_as_its_edges_are_long_and_holes_have_one() {
        let (points, mut triangles) = plane(21);
        let colors = vec![[0.5; 3]; points.len()];
        let mut rim = vec![0.0; points.len()];
        let mut edges = vec![[0; 2]; 3 * triangles.len()];
        let scan = Scan::new(&points, &colors, &triangles).unwrap();
        scan.find_rim(&mut rim, &mut edges, 6.0);
        assert_eq!((rim[0], rim[2 * 21 + 10], rim[10 * 21 + 10]), (0.0, 2.0, 6.0));
        triangles.retain(|t| !t.contains(&(10 * 21 + 10)));
        let scan = Scan::new(&points, &colors, &triangles).unwrap();
        let mut edges = vec![[0; 2]; 3 * triangles.len()];
        scan.find_rim(&mut rim, &mut edges, 6.0);
        assert_eq!((rim[10 * 21 + 9], rim[10 * 21 + 7]), (0.0, 2.0));
    }

    #[test]
    fn slopes_of_a_plane_of_colours_are_its_own() {
        let (points, triangles) = plane(4);
        let color = |p: &Vec3| [0.1 * p[0], 0.2 * p[1] - 0.1 * p[0], 0.5];
        let colors: Vec<Vec3> = points.iter().map(color).collect();
        let scan = Scan::new(&points, &colors, &triangles).unwrap();
        for t in 0..triangles.len() as u32 {
            let expected = [[0.1, 0.0, 0.0], [-0.1, 0.2, 0.0], [0.0; 3]];
            for (slope, expected) in scan.slopes(&colors, t).iter().zip(expected) {
                assert!(sub(*slope, expected).iter().all(|x| x.abs() < 1e-5), "{slope:?}");
            }
        }
    }

    #[test]
    fn a_blurred_point_has_the_variance_that_was_asked_for() {
        let (points, triangles) = plane(61);
        let middle = 30 * 61 + 30;
        let mut values = vec![[0.0; 3]; points.len()];
        values[middle][0] = 1.0;
        let mut sums = vec![[[0.0; 4]; 2]; points.len()];
        let triangle = |t: usize| triangles.get(t).copied();
        blur(&mut values, triangle, |v| points[v as usize], 4.0, &mut sums);
        let moment = |axis: usize| -> f32 {
            let far = |p: &Vec3| (p[axis] - 30.0) * (p[axis] - 30.0);
            points.iter().zip(&values).map(|(p, v)| v[0] * far(p)).sum()
        };
        let sum: f32 = values.iter().map(|v| v[0]).sum();
        for axis in 0..2 {
            let deviation = (moment(axis) / sum).sqrt();
            assert!((deviation - 4.0).abs() < 0.3, "{deviation}");
        }
    }
}
