//! Polygons cut into triangles.

use earcut::Earcut;
use earcut::utils3d::project3d_to_2d;

/// Cross product of two edges, as a fraction of the polygon's area, down to which a corner counts
/// as straight.
const STRAIGHT: f64 = 1e-6;
/// Beyond so many corners a polygon is cut as a fan: no program writes such, but damage does.
const LARGEST: usize = 1 << 16;

/// Cuts polygons, one after the other, with the same memory.
#[derive(Default)]
pub(crate) struct Cutter {
    ears: Earcut<f64>,
    flat: Vec<[f64; 2]>,
    triangles: Vec<u32>,
}

impl Cutter {
    /// The triangles of a polygon, as numbers of its corners, in its winding: a fan from the first
    /// corner if the polygon is convex, seen along its normal, else by cutting off its ears.
    pub(crate) fn cut(&mut self, corners: &[[f64; 3]], mut take: impl FnMut([usize; 3])) {
        let count = corners.len();
        if (4..LARGEST).contains(&count)
            && project3d_to_2d(corners, count, &mut self.flat)
            && !convex(&self.flat)
        {
            self.ears.earcut(self.flat.iter().copied(), &[], &mut self.triangles);
            let triangles = self.triangles.as_chunks().0;
            for &[a, b, c] in triangles {
                let [a, b, c] = [a, b, c].map(|i| i as usize);
                // The projection looks against the normal: the polygon runs counter-clockwise.
                take(if turn(&self.flat, [a, b, c]) < 0.0 { [a, c, b] } else { [a, b, c] });
            }
            if !triangles.is_empty() {
                return;
            }
        }
        (1..count.saturating_sub(1)).for_each(|i| take([0, i, i + 1]));
    }
}

/// Twice the area of a triangle, negative if it runs clockwise.
fn turn(flat: &[[f64; 2]], triangle: [usize; 3]) -> f64 {
    let [a, b, c] = triangle.map(|i| flat.get(i).copied().unwrap_or_default());
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Whether no corner of a polygon that runs counter-clockwise turns to the right.
fn convex(flat: &[[f64; 2]]) -> bool {
    let count = flat.len();
    let turns = (0..count).map(|i| turn(flat, [i, (i + 1) % count, (i + 2) % count]));
    let area: f64 = (2..count).map(|i| turn(flat, [0, i - 1, i])).sum();
    !turns.into_iter().any(|turn| turn < -STRAIGHT * area)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vector::{dot, length, normal};

    fn cut(corners: &[[f64; 3]]) -> Vec<[usize; 3]> {
        let mut triangles = Vec::new();
        Cutter::default().cut(corners, |triangle| triangles.push(triangle));
        triangles
    }

    #[test]
    fn a_convex_polygon_is_a_fan_and_a_concave_one_stays_inside() {
        let square = [[0., 0., 5.], [1., 0., 5.], [1., 1., 5.], [0., 1., 5.]];
        assert_eq!(cut(&square), [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(cut(&square[..3]), [[0, 1, 2]]);
        assert_eq!(cut(&[[0.0; 3]; 4]), [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(cut(&[]), [[0; 3]; 0]);
        // An arrow head, turned into each plane and wound either way.
        let arrow = [[0., 0.], [50., 30.], [100., 0.], [50., 80.]];
        for plane in 0..6 {
            let place = |[x, y]: [f64; 2]| match plane {
                0 => [x, y, 7.0],
                1 => [y, x, 7.0],
                2 => [7.0, x, y],
                3 => [7.0, y, x],
                4 => [x, -y, x + y],
                _ => [x, y, x - y],
            };
            let corners = arrow.map(place);
            let normal = |triangle: [usize; 3]| normal(triangle.map(|i| corners[i]));
            let triangles = cut(&corners);
            assert_eq!(triangles.len(), 2);
            // The polygon's own area vector, by Newell; triangles inside it add up to the same length.
            let whole: [f64; 3] = (1..3)
                .map(|i| normal([0, i, i + 1]))
                .fold([0.0; 3], |sum, n| std::array::from_fn(|k| sum[k] + n[k]));
            let sum: f64 = triangles.iter().map(|t| length(normal(*t))).sum();
            assert!((sum - length(whole)).abs() < 1e-6 * sum, "{sum} {whole:?}");
            for triangle in triangles {
                assert!(dot(normal(triangle), whole) > 0.0, "turned over");
            }
        }
    }

    #[test]
    fn wild_polygons_never_panic() {
        let _ = cut(&[[f64::MAX; 3], [f64::MIN; 3], [0.0; 3], [f64::MAX, 0.0, 1.0]]);
        let star = (0..50).map(|i| f64::from(i * 19 % 50)).map(|a| [a.sin(), a.cos(), 0.0]);
        assert!(!cut(&star.collect::<Vec<_>>()).is_empty());
    }
}
