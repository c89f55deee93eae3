//! A surface laid flat: texture coordinates of a mesh with the topology of a disc, without a seam.

use crate::vector::{cross, distance, dot, length, minus, normal};
use onescan_core::math;

/// Sweeps of a solution, at most, and where it ends: a share of the disc's radius, far below a texel.
const SWEEPS: usize = 600;
const STILL: f64 = 1e-4;
/// How far a sweep goes beyond what each equation wants; 1.9 is about the best for some 10,000
/// vertices.
const OVERSHOOT: f64 = 1.9;
/// How often weights are changed for less stretch, at most. It is the first few that matter
/// (docs/texture.md).
const EVENINGS: usize = 2;
/// Radius of the disc in the texture, whose side is 1: it leaves a margin.
const RADIUS: f64 = 0.49;

/// Texture coordinates in `[0, 1]`, v down, for the vertices of a surface that is one piece with one
/// outer border (holes may be in it); `None` for any other. No two triangles overlap. Vertices without
/// a triangle come to the middle.
///
/// The border goes to a circle, by its length, and turned so that what is up stays up. Every other
/// vertex is a mean of its neighbours with positive weights, and so nothing folds (Tutte): first by
/// mean value coordinates (Floater 2003), which keep angles nearly; then weights towards stretched
/// places are made smaller, again and again as long as the stretch gets less (Yoshizawa, Belyaev,
/// Seidel 2004).
pub(super) fn unwrap(points: &[[f32; 3]], triangles: &[[u32; 3]]) -> Option<Vec<[f32; 2]>> {
    let mut points: Vec<[f64; 3]> = points.iter().map(|p| p.map(f64::from)).collect();
    let count = points.len();
    let mut triangles: Vec<[usize; 3]> = triangles.iter().map(|t| t.map(|i| i as usize)).collect();
    let mut borders = borders(count, &triangles)?;
    let longest = (0..borders.len()).max_by(|&a, &b| {
        let [a, b] = [a, b].map(|i| around(&points, &borders[i]));
        a.total_cmp(&b)
    })?;
    let outer = borders.swap_remove(longest);
    for hole in borders {
        // A vertex in its middle closes it.
        let middle = [0, 1, 2].map(|k| hole.iter().map(|&i| points[i][k]).sum::<f64>());
        points.push(middle.map(|sum| sum / hole.len() as f64));
        let next = hole.iter().cycle().skip(1);
        triangles.extend(hole.iter().zip(next).map(|(&a, &b)| [a, points.len() - 1, b]));
    }
    let used = used(points.len(), &triangles);
    if !is_disc(&used, &triangles, outer.len()) {
        return None;
    }
    let mut at = vec![[0.0; 2]; points.len()];
    place_border(&points, &outer, &mut at);
    let mut free = used;
    for &i in &outer {
        free[i] = false;
    }
    let mut weights = Weights::mean_value(&points, &triangles, &free);
    weights.solve(&mut at);
    let mut best = (stretch(&points, &triangles, &at).1, at.clone());
    for _ in 0..EVENINGS {
        let (of_vertices, _) = stretch(&points, &triangles, &at);
        weights.divide(&of_vertices);
        weights.solve(&mut at);
        let total = stretch(&points, &triangles, &at).1;
        if !(total < best.0) {
            break;
        }
        best = (total, at.clone());
    }
    let at = best.1;
    // Rounding could fold what is squeezed to nothing.
    let flat = triangles.iter().all(|&t| area(t.map(|i| at[i])) > 0.0);
    let uv = |[x, y]: [f64; 2]| [(0.5 + RADIUS * x) as f32, (0.5 - RADIUS * y) as f32];
    flat.then(|| at.into_iter().take(count).map(uv).collect())
}

/// The closed borders of a surface, each with the surface to its left; `None` if an edge has more than
/// two triangles, or two of them in one direction, or if a border touches itself or another.
fn borders(count: usize, triangles: &[[usize; 3]]) -> Option<Vec<Vec<usize>>> {
    let edges = || triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
    // Where edges lead from each vertex.
    let mut known: Vec<Vec<usize>> = vec![Vec::new(); count];
    for (a, b) in edges() {
        if a == b || a >= count || b >= count || known[a].contains(&b) {
            return None;
        }
        known[a].push(b);
    }
    let mut next = vec![usize::MAX; count];
    for (a, b) in edges().filter(|&(a, b)| !known[b].contains(&a)) {
        if next[a] != usize::MAX {
            return None;
        }
        next[a] = b;
    }
    let mut borders = Vec::new();
    for start in 0..count {
        let mut border = Vec::new();
        let mut i = start;
        while next[i] != usize::MAX {
            border.push(i);
            i = std::mem::replace(&mut next[i], usize::MAX);
        }
        if !border.is_empty() {
            borders.push(border);
        }
    }
    Some(borders)
}

fn used(count: usize, triangles: &[[usize; 3]]) -> Vec<bool> {
    let mut used = vec![false; count];
    for &i in triangles.as_flattened() {
        used[i] = true;
    }
    used
}

/// Whether a surface of which one border is left is in one piece and has no handles: vertices − edges +
/// faces is 1.
fn is_disc(used: &[bool], triangles: &[[usize; 3]], border: usize) -> bool {
    let vertices = used.iter().filter(|used| **used).count();
    // Every edge but the border's has two triangles.
    let sides = 3 * triangles.len() + border;
    let mut piece: Vec<usize> = (0..used.len()).collect();
    let find = |piece: &mut Vec<usize>, mut i: usize| {
        while piece[i] != i {
            piece[i] = piece[piece[i]];
            i = piece[i];
        }
        i
    };
    let mut pieces = vertices;
    for &[a, b, c] in triangles {
        for (a, b) in [(a, b), (b, c)] {
            let (a, b) = (find(&mut piece, a), find(&mut piece, b));
            pieces -= usize::from(a != b);
            piece[a] = b;
        }
    }
    pieces == 1 && 2 * (vertices + triangles.len()) == sides + 2
}

/// Puts the border on the circle of radius 1.
fn place_border(points: &[[f64; 3]], border: &[usize], at: &mut [[f64; 2]]) {
    let whole = around(points, border).max(f64::MIN_POSITIVE);
    let mut along = 0.0;
    let mut last = None;
    let mut placed = Vec::new();
    for &i in border {
        along += last.map_or(0.0, |last| distance(points[last], points[i]));
        last = Some(i);
        let (sin, cos) = math::sin_cos((std::f64::consts::TAU * along / whole) as f32);
        placed.push([f64::from(cos), f64::from(sin)]);
    }
    // The turn that takes them nearest to where they are seen from the front: the sum of quotients.
    let middle =
        [0, 1].map(|k| border.iter().map(|&i| points[i][k]).sum::<f64>() / border.len() as f64);
    let mut turn = [0.0; 2];
    for (&i, [x, y]) in border.iter().zip(&placed) {
        let [p, q] = [0, 1].map(|k| points[i][k] - middle[k]);
        turn = [turn[0] + p * x + q * y, turn[1] + q * x - p * y];
    }
    let size = (turn[0] * turn[0] + turn[1] * turn[1]).sqrt();
    let [c, s] = if size > 0.0 { turn.map(|t| t / size) } else { [1.0, 0.0] };
    for (&i, [x, y]) in border.iter().zip(placed) {
        at[i] = [c * x - s * y, s * x + c * y];
    }
}

/// Of every free vertex its neighbours and their weights.
struct Weights {
    of: Vec<(usize, Vec<(usize, f64)>)>,
}

impl Weights {
    /// `w_ij = (t_i + t_j) / |p_j − p_i|`, `t_i = tan(α/2) + tan(β/2)` with α and β the angles at `i` on
    /// both sides of the edge, `t_j` the same at `j`: Floater's, made symmetric.
    fn mean_value(points: &[[f64; 3]], triangles: &[[usize; 3]], free: &[bool]) -> Self {
        let mut of: Vec<Vec<(usize, f64)>> = vec![Vec::new(); points.len()];
        let mut add =
            |i: usize, j: usize, weight: f64| match of[i].iter_mut().find(|(known, _)| *known == j)
            {
                Some((_, sum)) => *sum += weight,
                None => of[i].push((j, weight)),
            };
        for &[a, b, c] in triangles {
            for [i, j, k] in [[a, b, c], [b, c, a], [c, a, b]] {
                let (u, v) = (minus(points[j], points[i]), minus(points[k], points[i]));
                let lengths = [length(u), length(v)];
                let product = lengths[0] * lengths[1];
                // tan(α/2) = (1 − cos α)/sin α, bounded for what is no triangle.
                let sin = length(cross(u, v)).max(1e-3 * product);
                let tan = ((product - dot(u, v)) / sin.max(f64::MIN_POSITIVE)).max(1e-3);
                for (other, length) in [j, k].into_iter().zip(lengths) {
                    let weight = tan / length.max(1e-9);
                    add(i, other, weight);
                    add(other, i, weight);
                }
            }
        }
        let of = of.into_iter().enumerate().filter(|(i, _)| free[*i]).collect();
        Self { of }
    }

    /// Divides the weights towards each vertex. (And all of each vertex by one number, which changes
    /// nothing but keeps them symmetric: so that over-relaxation converges.)
    fn divide(&mut self, by: &[f64]) {
        for (i, neighbours) in &mut self.of {
            for (j, weight) in neighbours {
                *weight /= by[*i] * by[*j];
            }
        }
    }

    /// Moves every free vertex to the mean of its neighbours: successive over-relaxation.
    fn solve(&self, at: &mut [[f64; 2]]) {
        let sums: Vec<f64> =
            self.of.iter().map(|(_, neighbours)| neighbours.iter().map(|(_, w)| w).sum()).collect();
        for _ in 0..SWEEPS {
            let mut most = 0.0_f64;
            for ((i, neighbours), sum) in self.of.iter().zip(&sums) {
                let mut mean = [0.0; 2];
                for (j, weight) in neighbours {
                    mean = [mean[0] + weight * at[*j][0], mean[1] + weight * at[*j][1]];
                }
                for k in 0..2 {
                    let change = OVERSHOOT * (mean[k] / sum - at[*i][k]);
                    at[*i][k] += change;
                    most = most.max(change.abs());
                }
            }
            if most < STILL {
                break;
            }
        }
    }
}

/// How far the surface is stretched from the plane: the root mean square of it over the triangles at
/// each vertex, and over all, by area (Sander et al. 2001), scaled so that 1 is no stretch.
fn stretch(points: &[[f64; 3]], triangles: &[[usize; 3]], at: &[[f64; 2]]) -> (Vec<f64>, f64) {
    let mut of = vec![[0.0; 2]; points.len()];
    let (mut sum, mut whole, mut flat) = (0.0, 0.0, 0.0);
    for &t in triangles {
        let [p, q, r] = t.map(|i| points[i]);
        let [a, b, c] = t.map(|i| at[i]);
        let twice = area([a, b, c]);
        let solid = length(normal([p, q, r]));
        // Partial derivatives of the surface by the plane's coordinates.
        let derivative = |w: [f64; 3]| -> [f64; 3] {
            [0, 1, 2].map(|k| (p[k] * w[0] + q[k] * w[1] + r[k] * w[2]) / twice)
        };
        let s = derivative([b[1] - c[1], c[1] - a[1], a[1] - b[1]]);
        let t_ = derivative([c[0] - b[0], a[0] - c[0], b[0] - a[0]]);
        let squared = if twice > 0.0 { 0.5 * (dot(s, s) + dot(t_, t_)) } else { f64::INFINITY };
        for i in t {
            of[i] = [of[i][0] + solid * squared, of[i][1] + solid];
        }
        sum += solid * squared;
        whole += solid;
        flat += twice;
    }
    let scale = (flat / whole).sqrt();
    let mean = |[sum, area]: [f64; 2]| {
        let value = (sum / area).sqrt() * scale;
        if value.is_finite() { value.clamp(1e-3, 1e3) } else { 1.0 }
    };
    (of.into_iter().map(mean).collect(), (sum / whole).sqrt() * scale)
}

/// Twice the area of a triangle of the plane, positive counter-clockwise.
fn area([a, b, c]: [[f64; 2]; 3]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
}

fn around(points: &[[f64; 3]], border: &[usize]) -> f64 {
    let next = border.iter().cycle().skip(1);
    border.iter().zip(next).map(|(&a, &b)| distance(points[a], points[b])).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::template;

    /// Twice the areas of triangles in the texture, positive if they are not turned over.
    fn areas(uvs: &[[f32; 2]], triangles: &[[u32; 3]]) -> Vec<f64> {
        let at = |i: u32| [uvs[i as usize][0], -uvs[i as usize][1]].map(f64::from);
        triangles.iter().map(|t| area(t.map(at))).collect()
    }

    #[test]
    fn a_face_is_laid_flat_upright_without_a_fold_and_evenly() {
        let mesh = template().unwrap().0;
        let uvs = unwrap(&mesh.points, &mesh.triangles).unwrap();
        let flat = areas(&uvs, &mesh.triangles);
        assert!(flat.iter().all(|area| *area > 0.0));
        assert!(uvs.as_flattened().iter().all(|t| (0.0..=1.0).contains(t)));
        for ([x, y, _], [u, v]) in mesh.points.iter().zip(&uvs) {
            assert!(x.abs() < 40.0 || (*u > 0.5) == (*x > 0.0), "{x} {u}");
            assert!(y.abs() < 70.0 || (*v < 0.5) == (*y > 0.0), "{y} {v}");
        }
        let points: Vec<_> = mesh.points.iter().map(|p| p.map(f64::from)).collect();
        let triangles: Vec<_> = mesh.triangles.iter().map(|t| t.map(|i| i as usize)).collect();
        let at: Vec<_> = uvs.iter().map(|[u, v]| [*u, -v].map(f64::from)).collect();
        let (_, stretch) = stretch(&points, &triangles, &at);
        assert!(stretch < 1.06, "{stretch}");
    }

    /// A sheet of `side × side` squares, of which those that `keep` says.
    fn sheet(side: u32, keep: impl Fn(u32, u32) -> bool) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
        let places = (0..=side).flat_map(|y| (0..=side).map(move |x| (x, y)));
        let points = places.clone().map(|(x, y)| [x as f32, y as f32, 0.3 * (x * y) as f32]);
        let squares = places.filter(|&(x, y)| x < side && y < side && keep(x, y));
        let triangles = squares.flat_map(|(x, y)| {
            let at = |x, y| y * (side + 1) + x;
            let (a, b, c, d) = (at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1));
            [[a, b, c], [a, c, d]]
        });
        (points.collect(), triangles.collect())
    }

    #[test]
    fn holes_are_no_hindrance_and_loose_vertices_neither() {
        let (mut points, triangles) = sheet(6, |x, y| !(2..4).contains(&x) || y != 2);
        points.push([7.0; 3]);
        let uvs = unwrap(&points, &triangles).unwrap();
        assert_eq!(uvs.len(), points.len());
        assert!(areas(&uvs, &triangles).iter().all(|area| *area > 0.0));
    }

    #[test]
    fn what_is_no_disc_is_not_unwrapped() {
        let refused = |(points, triangles): (Vec<_>, Vec<_>)| {
            assert_eq!(unwrap(&points, &triangles), None, "{triangles:?}");
        };
        let corners = || vec![[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
        // Closed, folded over itself, in two pieces, that touch in a point, empty.
        refused((corners(), vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]));
        refused((corners(), vec![[0, 1, 2], [0, 1, 3]]));
        refused(sheet(3, |x, _| x != 1));
        refused(sheet(2, |x, y| x == y));
        refused((corners(), vec![]));
        refused((vec![[0.0; 3]; 3], vec![[0, 1, 2]]));
        // A ring.
        let (points, mut triangles) = sheet(4, |_, _| true);
        for i in triangles.iter_mut().flatten() {
            let (x, y) = (*i % 5 % 4, *i / 5 % 4);
            *i = y * 5 + x;
        }
        refused((points, triangles));
    }
}
