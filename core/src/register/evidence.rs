//! What a vertex says by its foot, the point of the scan nearest to it.
//!
//! With `x` the vertex in the model's frame, `q` its foot, `n` the scan's unit normal, `m` and `s` the
//! colours of model and scan, and `J` how `x` changes with the unknowns, its equations are
//!
//! ```text
//! nᵀ J δ = nᵀ (q − x)             weight  w / (distance_sd² · patch)
//! g_cᵀ J δ = m_c − s_c            weight  w v / (color_sd² · color_patch)     c = R, G, B
//! ```
//!
//! where `g_c` is the slope of a channel along the surface, the mean of the model's and the scan's, for
//! either alone overshoots (Malis 2004), and `w = 1 / (1 + ‖q − x‖²/trust²)²` and `v`, likewise of
//! `‖m − s‖`, let what is far off count for little. The four are summed up as the three rows of
//! Cholesky's factor of `Σ weight · d dᵀ`.

use super::place::{PLACE, Place};
use super::scan::at;
use super::state::{Problem, Registration, quad};
use crate::least_squares::{Equations, System, matrix_words, system_words};
use crate::math;
use crate::vector::{Vec3, add, apply_transposed, cross, dot, scale, sub, xyz};

/// Least cosine between the normals of a vertex and its foot. Found in a prototype, like the next
/// (docs/registration.md).
pub(super) const FACING: f32 = 0.6;
/// Difference of colours, in standard deviations of all channels together, at which they count a
/// quarter.
const FAR_COLOR: f32 = 2.0;

/// What an iteration looks at.
pub(super) struct Look {
    /// The most shape components that change.
    pub(super) components: usize,
    /// Whether the size changes.
    pub(super) size: bool,
    /// Distance to its foot at which a vertex counts a quarter, mm.
    pub(super) trust: f32,
    /// Every which vertex is looked at; 0 for none.
    pub(super) stride: usize,
    /// Whether colours are.
    pub(super) colors: bool,
}

/// A vertex's foot, in the model's frame.
pub(super) struct Foot {
    /// From the vertex to it, mm.
    pub(super) apart: Vec3,
    /// The scan's unit normal there.
    normal: Vec3,
    /// Cosine between that and the vertex's.
    pub(super) facing: f32,
    /// Distance to a border, mm.
    rim: f32,
    triangle: u32,
    weights: [f32; 3],
}

/// What a vertex's equations come to: `½ δᵀ M δ − bᵀ δ` of its motion `δ`.
#[derive(Clone, Copy, Default)]
struct Pull {
    matrix: [Vec3; 3],
    vector: Vec3,
}

impl Pull {
    /// Adds an equation `dᵀ δ = r`.
    fn add(&mut self, d: Vec3, weight: f32, r: f32) {
        for (row, x) in self.matrix.iter_mut().zip(d) {
            *row = add(*row, scale(d, weight * x));
        }
        self.vector = add(self.vector, scale(d, weight * r));
    }

    /// Directions `u` and residuals `y` of three equations of weight 1 that say the same:
    /// `M = Σ u uᵀ`, `b = Σ y u`. A direction that nothing is known of is zero.
    fn rows(&self) -> ([Vec3; 3], Vec3) {
        let m = self.matrix;
        let least = 1e-6 * (m[0][0] + m[1][1] + m[2][2]);
        let inverse = |pivot: f32| if pivot > least { 1.0 / math::sqrt(pivot) } else { 0.0 };
        // L Lᵀ = M.
        let i0 = inverse(m[0][0]);
        let (l00, l10, l20) = (m[0][0] * i0, m[1][0] * i0, m[2][0] * i0);
        let p1 = m[1][1] - l10 * l10;
        let i1 = inverse(p1);
        let (l11, l21) = (p1 * i1, (m[2][1] - l20 * l10) * i1);
        let p2 = m[2][2] - l20 * l20 - l21 * l21;
        let i2 = inverse(p2);
        let l22 = p2 * i2;
        // L y = b.
        let b = self.vector;
        let y0 = b[0] * i0;
        let y1 = (b[1] - l10 * y0) * i1;
        let y2 = (b[2] - l20 * y0 - l21 * y1) * i2;
        ([[l00, l10, l20], [0.0, l11, l21], [0.0, 0.0, l22]], [y0, y1, y2])
    }
}

/// 1 at 0, a quarter at 1, little beyond.
fn doubt(squared: f32) -> f32 {
    let x = 1.0 + squared;
    1.0 / (x * x)
}

impl Registration<'_, '_> {
    /// The foot of a vertex, if its squared distance is below a bound.
    pub(super) fn foot(&self, v: u32, bound: f32) -> Option<Foot> {
        let Problem { scan, .. } = &self.problem;
        let x = self.sized(v);
        let found = self.nearest.find(scan, self.place.apply(x), bound)?;
        let (triangle, weights) = (found.triangle, found.weights);
        let normal = scan.interpolate(self.normals, triangle, weights);
        let squared = dot(normal, normal);
        let inverse = if squared > 0.0 { 1.0 / math::sqrt(squared) } else { 0.0 };
        let normal = apply_transposed(&self.place.rotation, scale(normal, inverse));
        let point = scan.interpolate(scan.points, triangle, weights);
        let rim = scan.corners(triangle).map(|v| self.rim.get(v as usize).copied().unwrap_or(0.0));
        Some(Foot {
            apart: sub(self.place.invert(point), x),
            facing: dot(normal, xyz(quad(self.vertex_normals, v))),
            normal,
            rim: dot(rim, weights),
            triangle,
            weights,
        })
    }

    /// Looks for feet, and goes the step that they say. Gives the part of the vertices looked at that
    /// count, and how far these are from the scan, root mean square along normals, mm.
    pub(super) fn iterate(&mut self, look: &Look) -> [f32; 2] {
        let memory = core::mem::take(&mut self.passing);
        let result = self.iterate_in(look, memory);
        self.passing = memory;
        result.unwrap_or([0.0; 2])
    }

    fn iterate_in(&mut self, look: &Look, memory: &mut [u32]) -> Option<[f32; 2]> {
        let k = self.shape.len().min(look.components);
        let n = k + PLACE;
        let (mut system, matrix) = self.system(n, memory)?;
        let result = self.add_all(look, k, &mut system);
        let step = self.step.get_mut(..n)?;
        system.solve_damped(0.0, |_| 0.0, matrix, step)?;
        let (shape, place) = step.split_at_checked(k)?;
        for (a, d) in self.shape.iter_mut().zip(shape) {
            *a += d;
        }
        self.place.advance(*place.first_chunk()?);
        if k > 0 {
            self.update();
        }
        Some(result)
    }

    /// Empty equations of `n` unknowns, and room for their matrix.
    pub(super) fn system<'m>(
        &self,
        n: usize,
        memory: &'m mut [u32],
    ) -> Option<(System<'m>, &'m mut [f32])> {
        let memory: &mut [f32] = bytemuck::try_cast_slice_mut(memory).ok()?;
        let (equations, rest) = memory.split_at_mut_checked(system_words(n))?;
        let matrix = rest.get_mut(..matrix_words(n))?;
        let system = System::new(n, self.problem.engine.normal_equations, equations)?;
        Some((system, matrix))
    }

    /// Adds what priors, vertices and landmarks say, the shape having `k` unknowns.
    pub(super) fn add_all(&mut self, look: &Look, k: usize, system: &mut System<'_>) -> [f32; 2] {
        let Problem { options, .. } = self.problem;
        for (i, &a) in self.shape.iter().enumerate().take(k) {
            system.pull(i, 1.0 / (options.width * options.width), a);
        }
        let sd = if look.size { options.size_sd } else { 1e-4 };
        system.pull(k, 1.0 / (sd * sd), math::ln_f32(self.place.size));
        for i in 1..PLACE {
            // Nothing is known of the pose; but it is to be found.
            system.pull(k + i, if i < 4 { 1e-2 } else { 1e-6 }, 0.0);
        }
        let result = self.add_feet(look, k, system);
        self.add_landmarks(k, system);
        result
    }

    /// Adds what some vertices say.
    fn add_feet(&mut self, look: &Look, k: usize, system: &mut System<'_>) -> [f32; 2] {
        let Problem { options, model, .. } = self.problem;
        let by_distance = self.share * look.stride as f32
            / (options.distance_sd * options.distance_sd * options.patch);
        let color_sd2 = options.color_sd * options.color_sd;
        let by_color = self.share * look.stride as f32 / (color_sd2 * options.color_patch);
        let (mut looked, mut matched, mut squares) = (0.0_f32, 0.0_f32, 0.0);
        // Beyond ten times the trust nothing counts a ten-thousandth.
        let bound = 100.0 * look.trust * look.trust;
        let last = if look.stride > 0 { model.vertices() as u32 } else { 0 };
        for v in (0..last).step_by(look.stride.max(1)) {
            looked += 1.0;
            let mut sure = 0.0;
            let foot =
                self.foot(v, bound).filter(|foot| foot.facing > FACING && foot.rim > options.rim);
            if let Some(foot) = foot {
                let far = dot(foot.apart, foot.apart) / (look.trust * look.trust);
                sure = doubt(far);
                let along = dot(foot.normal, foot.apart);
                matched += 1.0;
                squares += along * along;
                let mut pull = Pull::default();
                pull.add(foot.normal, sure * by_distance, along);
                if look.colors {
                    self.compare(v, &foot, sure * by_color, &mut pull);
                }
                self.add_pull(v, k, &pull, system);
            }
            if let Some(seen) = self.seen.get_mut(v as usize) {
                seen[3] = sure;
            }
        }
        let some = |x: f32| if x > 0.0 { x } else { 1.0 };
        [matched / some(looked), math::sqrt(squares / some(matched))]
    }

    /// Adds what a vertex's colours say, and notes what it sees.
    fn compare(&mut self, v: u32, foot: &Foot, weight: f32, pull: &mut Pull) {
        let Problem { scan, options, .. } = &self.problem;
        let theirs = scan.interpolate(self.scan_colors, foot.triangle, foot.weights);
        let apart = sub(at(self.colors, v), theirs);
        let far = FAR_COLOR * FAR_COLOR * 3.0 * options.color_sd * options.color_sd;
        let weight = weight * doubt(dot(apart, apart) / far);
        let own = self.slopes.get(v as usize).copied().unwrap_or_default();
        let slopes = scan.slopes(self.scan_colors, foot.triangle);
        for ((own, theirs), r) in own.into_iter().zip(slopes).zip(apart) {
            let theirs = apply_transposed(&self.place.rotation, theirs);
            pull.add(scale(add(own, theirs), 0.5), weight, r);
        }
        let [r, g, b] = scan.interpolate(scan.colors, foot.triangle, foot.weights);
        if let Some(seen) = self.seen.get_mut(v as usize) {
            *seen = [r, g, b, 0.0];
        }
    }

    /// Adds the equations of a vertex, its shape having `k` unknowns.
    fn add_pull(&mut self, v: u32, k: usize, pull: &Pull, system: &mut System<'_>) {
        let (directions, residuals) = pull.rows();
        self.fill_rows(v, k, directions);
        for ((row, d), r) in self.rows.iter().zip(directions).zip(residuals) {
            if d != [0.0; 3]
                && let Some(row) = row.get(..k + PLACE)
            {
                system.add_row(row, 1.0, r);
            }
        }
    }

    /// Fills the rows with how a vertex moves along three directions of the model's frame as the unknowns
    /// change, `k` of them the shape's.
    pub(super) fn fill_rows(&mut self, v: u32, k: usize, directions: [Vec3; 3]) {
        let Problem { model, engine, .. } = self.problem;
        let x = self.sized(v);
        let costs = directions.map(|d| scale(d, self.place.size));
        let [a, b, c] = &mut self.rows;
        let (Some(a), Some(b), Some(c)) = (a.get_mut(..k), b.get_mut(..k), c.get_mut(..k)) else {
            return;
        };
        if k > 0 {
            let entries = Some(&self.shape_by_vertex);
            (engine.rows)(&model.shape, entries, &[(v as usize, costs)], [a, b, c]);
        }
        for (row, d) in self.rows.iter_mut().zip(directions) {
            let [wx, wy, wz] = cross(x, d);
            let place = [dot(d, x), wx, wy, wz, d[0], d[1], d[2]];
            let Some(row) = row.get_mut(..k + PLACE) else { return };
            for (to, from) in row.iter_mut().skip(k).zip(place) {
                *to = from;
            }
        }
    }

    /// Adds what landmarks say.
    fn add_landmarks(&mut self, k: usize, system: &mut System<'_>) {
        let Problem { landmarks, options, .. } = self.problem;
        let weight = 1.0 / (options.landmark_sd * options.landmark_sd);
        for &(v, p) in landmarks {
            let apart = sub(self.place.invert(p), self.sized(v));
            let mut pull = Pull::default();
            for (axis, r) in Place::HOME.rotation.into_iter().zip(apart) {
                pull.add(axis, weight, r);
            }
            self.add_pull(v, k, &pull, system);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    #[test]
    fn three_rows_say_what_the_equations_said() {
        let mut rng = Rng::new(3, 0);
        for count in 1..6 {
            let mut pull = Pull::default();
            for _ in 0..count {
                let [a, b, c, r] = [0; 4].map(|_| rng.normal_sd(1.0));
                pull.add([a, b, c], 2.0, r);
            }
            let (rows, y) = pull.rows();
            let mut again = Pull::default();
            for (row, y) in rows.into_iter().zip(y) {
                again.add(row, 1.0, y);
            }
            for i in 0..3 {
                assert!((again.vector[i] - pull.vector[i]).abs() < 2e-3, "{count}");
                for j in 0..3 {
                    assert!((again.matrix[i][j] - pull.matrix[i][j]).abs() < 2e-3, "{count}");
                }
            }
        }
    }
}
