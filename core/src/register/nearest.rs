//! The point of a surface nearest to another, by a tree of boxes in the caller's memory.
//!
//! The tree is whole: each of its `2^depth` leaves holds as many triangles as the others, give or take
//! one, so that no links are kept.

use super::scan::Scan;
use crate::math::{less, more};
use crate::memory::Carver;
use crate::vector::{Vec3, add, dot, scale, sub};

/// The most triangles of a leaf: testing so few is cheaper than another box.
const LEAF: usize = 4;
/// Levels of the largest tree there can be, one node of each to be seen later.
const STACK: usize = 32;

/// Lowest and highest corner of a box, mm.
type Bounds = [Vec3; 2];

/// Levels of the tree below its root.
const fn depth(triangles: usize) -> u32 {
    let leaves = triangles.div_ceil(LEAF);
    if leaves > 1 { usize::BITS - (leaves - 1).leading_zeros() } else { 0 }
}

/// Words of memory a [`Nearest`] needs: the triangles' order, and 6 per node.
pub(super) const fn nearest_words(triangles: usize) -> usize {
    triangles + (6 << (depth(triangles) + 1))
}

/// A surface to be asked many times.
pub(super) struct Nearest<'w> {
    /// Triangles in the order of the leaves.
    order: &'w mut [u32],
    /// Nodes; the root is number 1, children of `i` are `2i` and `2i + 1`.
    boxes: &'w mut [Bounds],
    depth: u32,
}

/// The nearest point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Foot {
    /// Number of its triangle.
    pub(super) triangle: u32,
    /// Weights of the triangle's corners, not negative, of sum 1.
    pub(super) weights: [f32; 3],
    /// Square of the distance, mm².
    pub(super) squared: f32,
}

/// Weights of the corners of a triangle at its point nearest to `p` (Ericson, Real-Time Collision
/// Detection, 5.1.5).
fn nearest_of_triangle(p: Vec3, [a, b, c]: [Vec3; 3]) -> [f32; 3] {
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let bp = sub(p, b);
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let v = d1 / more(d1 - d3, f32::MIN_POSITIVE);
        return [1.0 - v, v, 0.0];
    }
    let cp = sub(p, c);
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let w = d2 / more(d2 - d6, f32::MIN_POSITIVE);
        return [1.0 - w, 0.0, w];
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let w = (d4 - d3) / more(d4 - d3 + (d5 - d6), f32::MIN_POSITIVE);
        return [0.0, 1.0 - w, w];
    }
    let sum = more(va + vb + vc, f32::MIN_POSITIVE);
    let (v, w) = (vb / sum, vc / sum);
    [1.0 - v - w, v, w]
}

impl<'w> Nearest<'w> {
    /// Builds the tree of a scan; `None` if there is too little memory.
    pub(super) fn carve(carver: &mut Carver<'w>, scan: &Scan<'_>) -> Option<Self> {
        let count = scan.triangles.len();
        let depth = depth(count);
        let order = carver.words(count)?;
        for (t, order) in (0..).zip(&mut *order) {
            *order = t;
        }
        for level in 0..depth {
            for k in 0..1 << level {
                let first = leaves(count, level + 1, 2 * k).len();
                split(scan, order.get_mut(leaves(count, level, k))?, first);
            }
        }
        let boxes: &mut [[f32; 6]] = carver.groups(2 << depth)?;
        let boxes: &mut [Bounds] = bytemuck::try_cast_slice_mut(boxes).ok()?;
        let (mut above, leaf_boxes) = boxes.split_at_mut_checked(1 << depth)?;
        for (k, to) in leaf_boxes.iter_mut().enumerate() {
            *to = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
            for &t in order.get(leaves(count, depth, k)).unwrap_or_default() {
                for p in scan.corners(t).map(|v| scan.point(v)) {
                    *to = union(to, &[p, p]);
                }
            }
        }
        // Level by level up to the root, number 1; number 0 is no node.
        let mut below: &[Bounds] = leaf_boxes;
        while below.len() > 1 {
            let half = below.len() / 2;
            let (rest, level) = core::mem::take(&mut above).split_at_mut_checked(half)?;
            for (to, pair) in level.iter_mut().zip(below.as_chunks::<2>().0) {
                *to = union(&pair[0], &pair[1]);
            }
            (above, below) = (rest, level);
        }
        Some(Self { order, boxes, depth })
    }

    /// The point nearest to `p` if its squared distance is below `bound`; of several the one on the
    /// first triangle.
    pub(super) fn find(&self, scan: &Scan<'_>, p: Vec3, bound: f32) -> Option<Foot> {
        let mut best = Foot { triangle: u32::MAX, weights: [0.0; 3], squared: bound };
        let mut later = heapless::Vec::<(usize, f32), STACK>::new();
        let far = |node: usize| self.boxes.get(node).map_or(0.0, |b| squared_distance(b, p));
        let first_leaf = 1 << self.depth;
        let _ = later.push((1, far(1)));
        while let Some((node, distance)) = later.pop() {
            // Not `>=`: of equally near triangles the first is taken.
            if distance > best.squared {
                continue;
            }
            if node < first_leaf {
                let [a, b] = [2 * node, 2 * node + 1].map(|node| (node, far(node)));
                // The nearer one is seen first. There is room: a level leaves one behind.
                let _ = later.extend_from_slice(&if a.1 < b.1 { [b, a] } else { [a, b] });
                continue;
            }
            let leaf = leaves(self.order.len(), self.depth, node - first_leaf);
            for &triangle in self.order.get(leaf).unwrap_or_default() {
                let corners = scan.corners(triangle).map(|v| scan.point(v));
                let weights = nearest_of_triangle(p, corners);
                let [a, b, c] = [0, 1, 2].map(|i| scale(corners[i], weights[i]));
                let apart = sub(add(add(a, b), c), p);
                let squared = dot(apart, apart);
                let first = squared == best.squared && triangle < best.triangle;
                if squared < best.squared || (first && best.triangle != u32::MAX) {
                    best = Foot { triangle, weights, squared };
                }
            }
        }
        (best.triangle != u32::MAX).then_some(best)
    }
}

/// Places in the order of triangles that node `k` of a level holds.
fn leaves(count: usize, level: u32, k: usize) -> core::ops::Range<usize> {
    // Up to 2²³ triangles and 2²¹ leaves.
    let bound = |k: usize| ((count as u64 * k as u64) >> level) as usize;
    bound(k)..bound(k + 1)
}

fn union([a, b]: &Bounds, [c, d]: &Bounds) -> Bounds {
    [[0, 1, 2].map(|i| less(a[i], c[i])), [0, 1, 2].map(|i| more(b[i], d[i]))]
}

fn squared_distance([low, high]: &Bounds, p: Vec3) -> f32 {
    let out = [0, 1, 2].map(|i| more(more(low[i] - p[i], p[i] - high[i]), 0.0));
    dot(out, out)
}

/// Sorts triangles into two parts, the first of `count`, along the axis on which their centres lie
/// farthest apart.
fn split(scan: &Scan<'_>, triangles: &mut [u32], count: usize) {
    let centre = |t: u32| {
        let [a, b, c] = scan.corners(t).map(|v| scan.point(v));
        add(add(a, b), c)
    };
    let mut bounds = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    for &t in &*triangles {
        bounds = union(&bounds, &[centre(t); 2]);
    }
    let [x, y, z] = sub(bounds[1], bounds[0]);
    let key = |t: u32| {
        let [a, b, c] = centre(t);
        if x >= y && x >= z {
            a
        } else if y >= z {
            b
        } else {
            c
        }
    };
    if count < triangles.len() {
        triangles.select_nth_unstable_by(count, |&s, &t| key(s).total_cmp(&key(t)).then(s.cmp(&t)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;
    use std::vec;
    use std::vec::Vec;

    #[test]
    fn the_tree_finds_what_looking_at_every_triangle_finds() {
        let mut rng = Rng::new(9, 0);
        for count in [1, 2, 4, 5, 9, 37, 400] {
            let mut place = |reach: f32| [0; 3].map(|_| rng.normal_sd(reach));
            let points: Vec<Vec3> = (0..count + 2).map(|_| place(20.0)).collect();
            let colors = vec![[0.5; 3]; points.len()];
            let triangles: Vec<[u32; 3]> = (0..count as u32).map(|t| [t, t + 1, t + 2]).collect();
            let scan = Scan::new(&points, &colors, &triangles).unwrap();
            let mut memory = vec![u32::MAX; nearest_words(count)];
            let nearest = Nearest::carve(&mut Carver::new(&mut memory), &scan).unwrap();
            for _ in 0..100 {
                let p = place(40.0);
                let found = nearest.find(&scan, p, f32::INFINITY).unwrap();
                let squared = |t: u32| {
                    let corners = scan.corners(t).map(|v| scan.point(v));
                    let w = nearest_of_triangle(p, corners);
                    let [a, b, c] = [0, 1, 2].map(|i| scale(corners[i], w[i]));
                    let apart = sub(add(add(a, b), c), p);
                    dot(apart, apart)
                };
                let least = (0..count as u32).map(squared).fold(f32::INFINITY, f32::min);
                assert_eq!(found.squared, least, "{count}");
                assert!((found.weights.iter().sum::<f32>() - 1.0).abs() < 1e-5);
                assert_eq!(nearest.find(&scan, p, 0.5 * least), None);
            }
        }
    }

    #[test]
    fn no_point_of_a_triangle_is_nearer() {
        let mut rng = Rng::new(4, 0);
        for _ in 0..300 {
            let [a, b, c, p] = [0; 4].map(|_| [0; 3].map(|_| rng.normal_sd(1.0)));
            let far = |w: [f32; 3]| {
                let d = sub(add(add(scale(a, w[0]), scale(b, w[1])), scale(c, w[2])), p);
                dot(d, d)
            };
            let found = far(nearest_of_triangle(p, [a, b, c]));
            for i in 0..=20 {
                for j in 0..=20 - i {
                    let (u, v) = (i as f32 / 20.0, j as f32 / 20.0);
                    assert!(found <= far([1.0 - u - v, u, v]) + 1e-5);
                }
            }
        }
    }
}
