//! The point of a surface nearest to another point, by a tree of boxes that is kept.

use crate::mesh::Mesh;
use crate::vector::{cross, dot, minus};

/// Triangles of a leaf: testing so few is cheaper than another box.
const LEAF: usize = 4;

/// A triangle mesh that is asked for nearest points, many times.
pub struct Surface {
    corners: Vec<[[f64; 3]; 3]>,
    triangles: Vec<[u32; 3]>,
    /// Children of `i` are `i + 1` and the index it names.
    nodes: Vec<Node>,
}

/// A box about a range of triangles.
struct Node {
    low: [f64; 3],
    high: [f64; 3],
    first: u32,
    count: u32,
    /// The second child; 0 in a leaf.
    second: u32,
}

/// A point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// The point.
    pub point: [f64; 3],
    /// Corners of the triangle it lies on.
    pub triangle: [u32; 3],
    /// Their weights, not negative, of sum 1.
    pub weights: [f64; 3],
    /// Square of the distance.
    pub squared: f64,
}

impl Nearest {
    /// A value per vertex, interpolated.
    pub fn interpolate(&self, values: &[[f32; 3]]) -> [f32; 3] {
        std::array::from_fn(|k| {
            let terms = self.triangle.iter().zip(self.weights);
            terms.map(|(&v, w)| w * f64::from(values[v as usize][k])).sum::<f64>() as f32
        })
    }
}

impl Surface {
    /// The surface of a mesh.
    pub fn new(mesh: &Mesh) -> Self {
        let mut order: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
        let corners: Vec<[[f64; 3]; 3]> = mesh
            .triangles
            .iter()
            .map(|t| t.map(|v| mesh.points[v as usize].map(f64::from)))
            .collect();
        let mut nodes = Vec::with_capacity(corners.len());
        grow(&corners, &mut order, 0, &mut nodes);
        Self {
            corners: order.iter().map(|&t| corners[t as usize]).collect(),
            triangles: order.iter().map(|&t| mesh.triangles[t as usize]).collect(),
            nodes,
        }
    }

    /// The point nearest to `p`; of several at the same distance, any.
    ///
    /// # Panics
    /// Never of a mesh that keeps its guarantees: it has a triangle.
    pub fn nearest(&self, p: [f64; 3]) -> Nearest {
        self.nearest_within(p, f64::INFINITY).expect("a mesh has a triangle, and points are finite")
    }

    /// The nearest point whose squared distance is below a bound, if there is one.
    pub fn nearest_within(&self, p: [f64; 3], mut squared: f64) -> Option<Nearest> {
        let mut best = None;
        // Depth of the tree is at most log2 of the number of triangles, which is below 2³².
        let mut stack = [(0_u32, 0.0_f64); 40];
        let mut top = 1;
        stack[0] = (0, self.nodes[0].squared_distance(p));
        while top > 0 {
            top -= 1;
            let (index, bound) = stack[top];
            if bound >= squared {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.second == 0 {
                for t in node.first..node.first + node.count {
                    let corners = &self.corners[t as usize];
                    let (point, weights) = nearest_of_triangle(p, corners);
                    let found = squared_norm(minus(p, point));
                    if found < squared {
                        squared = found;
                        let triangle = self.triangles[t as usize];
                        best = Some(Nearest { point, triangle, weights, squared });
                    }
                }
                continue;
            }
            let child = |c: u32| (c, self.nodes[c as usize].squared_distance(p));
            let (mut near, mut far) = (child(index + 1), child(node.second));
            if far.1 < near.1 {
                std::mem::swap(&mut near, &mut far);
            }
            // The nearer one is on top.
            stack[top] = far;
            stack[top + 1] = near;
            top += 2;
        }
        best
    }
}

impl Surface {
    /// Where the line through `p` along the unit vector `n`, to both sides, first meets the surface
    /// within `reach`.
    pub fn along(&self, p: [f64; 3], n: [f64; 3], reach: f64) -> Option<Nearest> {
        let mut best: Option<Nearest> = None;
        let mut nearest = reach;
        let mut stack = vec![0_u32];
        while let Some(index) = stack.pop() {
            let node = &self.nodes[index as usize];
            if !node.is_met(p, n, nearest) {
                continue;
            }
            if node.second != 0 {
                stack.extend([index + 1, node.second]);
                continue;
            }
            for t in node.first..node.first + node.count {
                let Some((s, weights)) = meet(p, n, &self.corners[t as usize]) else { continue };
                if s.abs() < nearest {
                    nearest = s.abs();
                    let point = std::array::from_fn(|k| p[k] + s * n[k]);
                    let triangle = self.triangles[t as usize];
                    best = Some(Nearest { point, triangle, weights, squared: s * s });
                }
            }
        }
        best
    }
}

/// How far along a line a triangle is met, and the weights of its corners there (Möller and Trumbore
/// 1997).
fn meet(p: [f64; 3], n: [f64; 3], [a, b, c]: &[[f64; 3]; 3]) -> Option<(f64, [f64; 3])> {
    let (ab, ac, ap) = (minus(*b, *a), minus(*c, *a), minus(p, *a));
    let q = cross(n, ac);
    let volume = dot(ab, q);
    let v = dot(ap, q) / volume;
    let r = cross(ap, ab);
    let w = dot(n, r) / volume;
    let s = dot(ac, r) / volume;
    // Not finite of a line along the triangle, or of one without area: then nothing is met.
    (v >= 0.0 && w >= 0.0 && v + w <= 1.0 && s.is_finite()).then_some((s, [1.0 - v - w, v, w]))
}

impl Node {
    /// Whether a line comes into the box within `reach` of `p`.
    fn is_met(&self, p: [f64; 3], n: [f64; 3], reach: f64) -> bool {
        let (mut from, mut to) = (-reach, reach);
        for k in 0..3 {
            let (a, b) = ((self.low[k] - p[k]) / n[k], (self.high[k] - p[k]) / n[k]);
            // NaN, of a line within a side, bounds nothing.
            from = from.max(a.min(b));
            to = to.min(a.max(b));
        }
        from <= to + 1e-9
    }

    fn squared_distance(&self, p: [f64; 3]) -> f64 {
        (0..3).map(|k| (self.low[k] - p[k]).max(p[k] - self.high[k]).max(0.0).powi(2)).sum()
    }
}

/// Appends the tree of `order`, whose first triangle is number `first` of all.
fn grow(corners: &[[[f64; 3]; 3]], order: &mut [u32], first: u32, nodes: &mut Vec<Node>) {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for &t in order.iter() {
        for corner in &corners[t as usize] {
            for k in 0..3 {
                low[k] = low[k].min(corner[k]);
                high[k] = high[k].max(corner[k]);
            }
        }
    }
    let at = nodes.len();
    nodes.push(Node { low, high, first, count: order.len() as u32, second: 0 });
    if order.len() <= LEAF {
        return;
    }
    let axis = (1..3).fold(0, |a, k| if high[k] - low[k] > high[a] - low[a] { k } else { a });
    let centre = |t: &u32| corners[*t as usize].iter().map(|corner| corner[axis]).sum::<f64>();
    let half = order.len() / 2;
    order.select_nth_unstable_by(half, |a, b| centre(a).total_cmp(&centre(b)).then(a.cmp(b)));
    let (left, right) = order.split_at_mut(half);
    grow(corners, left, first, nodes);
    nodes[at].second = nodes.len() as u32;
    grow(corners, right, first + half as u32, nodes);
}

/// The nearest point and its weights (Ericson, "Real-Time Collision Detection", section 5.1.5).
fn nearest_of_triangle(p: [f64; 3], [a, b, c]: &[[f64; 3]; 3]) -> ([f64; 3], [f64; 3]) {
    let (ab, ac) = (minus(*b, *a), minus(*c, *a));
    let part = |x: f64, y: f64| if x + y > 0.0 { x / (x + y) } else { 0.0 };
    let weights = 'found: {
        let ap = minus(p, *a);
        let (d1, d2) = (dot(ab, ap), dot(ac, ap));
        if d1 <= 0.0 && d2 <= 0.0 {
            break 'found [1.0, 0.0, 0.0];
        }
        let bp = minus(p, *b);
        let (d3, d4) = (dot(ab, bp), dot(ac, bp));
        if d3 >= 0.0 && d4 <= d3 {
            break 'found [0.0, 1.0, 0.0];
        }
        let vc = d1 * d4 - d3 * d2;
        if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
            let v = part(d1, -d3);
            break 'found [1.0 - v, v, 0.0];
        }
        let cp = minus(p, *c);
        let (d5, d6) = (dot(ab, cp), dot(ac, cp));
        if d6 >= 0.0 && d5 <= d6 {
            break 'found [0.0, 0.0, 1.0];
        }
        let vb = d5 * d2 - d1 * d6;
        if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
            let w = part(d2, -d6);
            break 'found [1.0 - w, 0.0, w];
        }
        let va = d3 * d6 - d5 * d4;
        if va <= 0.0 && d4 >= d3 && d5 >= d6 {
            let w = part(d4 - d3, d5 - d6);
            break 'found [0.0, 1.0 - w, w];
        }
        let sum = va + vb + vc;
        [va / sum, vb / sum, vc / sum]
    };
    let point = std::array::from_fn(|k| weights[0] * a[k] + weights[1] * b[k] + weights[2] * c[k]);
    (point, weights)
}

fn squared_norm(a: [f64; 3]) -> f64 {
    dot(a, a)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_meets_what_no_other_triangle_hides() {
        let mesh = crate::demo::template().unwrap().0;
        let surface = Surface::new(&mesh);
        let normals = mesh.normals();
        for (p, n) in mesh.points.iter().zip(&normals).step_by(97) {
            let (p, n) = (p.map(f64::from), n.map(f64::from));
            let start = std::array::from_fn(|k| p[k] + 2.0 * n[k]);
            let found = surface.along(start, n, 5.0);
            let brute = surface
                .corners
                .iter()
                .filter_map(|corners| meet(start, n, corners))
                .map(|(s, _)| s.abs())
                .fold(5.0, f64::min);
            assert!((found.map_or(5.0, |f| f.squared.sqrt()) - brute).abs() < 1e-9);
        }
        assert_eq!(surface.along([0.0, 0.0, 900.0], [0.0, 0.0, 1.0], 10.0), None);
    }
    use onescan_core::rng::Rng;
    use proptest::prelude::*;

    fn soup(triangles: u32, seed: u64) -> Mesh {
        let mut rng = Rng::new(seed, 0);
        let points = (0..3 * triangles)
            .map(|i| [0; 3].map(|_| (i / 9) as f32 + rng.normal_sd(2.0)))
            .collect::<Vec<_>>();
        let triangles = (0..triangles).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        Mesh { colors: points.clone(), points, triangles }
    }

    proptest! {
        #[test]
        fn the_tree_finds_what_looking_at_all_triangles_finds(
            triangles in 1_u32..60, seed in 0_u64..1000,
            at in [-9.0..30.0, -9.0..30.0, -9.0..30.0_f64],
        ) {
            let mesh = soup(triangles, seed);
            let found = Surface::new(&mesh).nearest(at);
            let brute = mesh
                .triangles
                .iter()
                .map(|t| t.map(|v| mesh.points[v as usize].map(f64::from)))
                .map(|corners| squared_norm(minus(at, nearest_of_triangle(at, &corners).0)))
                .fold(f64::INFINITY, f64::min);
            prop_assert_eq!(found.squared, brute);
            prop_assert!(found.weights.iter().all(|w| *w >= 0.0));
            prop_assert!((found.weights.iter().sum::<f64>() - 1.0).abs() < 1e-9);
            // The colours are the points, so interpolating them gives the point.
            let color = found.interpolate(&mesh.colors);
            for (color, x) in color.iter().zip(found.point) {
                prop_assert!((f64::from(*color) - x).abs() < 1e-4);
            }
        }

        #[test]
        fn no_point_of_the_triangle_is_nearer(
            seed in 0_u64..1000, u in 0.0..1.0, v in 0.0..1.0_f64,
        ) {
            let mesh = soup(1, seed);
            let at = [1.0, -2.0, 0.5];
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let [a, b, c] = [0, 1, 2].map(|i| mesh.points[i].map(f64::from));
            let other = std::array::from_fn(|k| (1.0 - u - v) * a[k] + u * b[k] + v * c[k]);
            let found = Surface::new(&mesh).nearest(at);
            prop_assert!(found.squared <= squared_norm(minus(at, other)) + 1e-9);
        }
    }

    #[test]
    fn a_point_is_nearest_to_a_face_an_edge_or_a_corner() {
        let points = vec![[0.0; 3], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]];
        let mesh = Mesh { colors: points.clone(), points, triangles: vec![[0, 1, 2]] };
        let surface = Surface::new(&mesh);
        for (from, to) in [
            ([1.0, 1.0, 3.0], [1.0, 1.0, 0.0]),
            ([1.0, -2.0, 0.0], [1.0, 0.0, 0.0]),
            ([9.0, -1.0, 1.0], [4.0, 0.0, 0.0]),
            ([3.0, 3.0, 0.0], [2.0, 2.0, 0.0]),
        ] {
            assert_eq!(surface.nearest(from).point, to);
        }
        assert_eq!(surface.nearest_within([0.0, 0.0, 3.0], 8.9), None);
        let flat = Mesh { triangles: vec![[1, 1, 1], [0, 1, 1]], ..mesh };
        assert_eq!(Surface::new(&flat).nearest([2.0, 1.0, 0.0]).point, [2.0, 0.0, 0.0]);
    }
}
