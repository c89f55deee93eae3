//! The metric of a step: the Gauss–Newton matrix of some of the pixels.

use super::common::{Common, Scratch};
use super::evidence::Evidence;
use super::image_term::{SHADE, SHADE_SHARE};
use super::instance::at;
use super::shading::{Adjoint, Shading};
use super::unknowns::POSE;
use super::window::Window;
use crate::basis::Costs;
use crate::least_squares::System;
use crate::math;
use crate::vector::{Vec3, add, apply, cross, scale, xyz};
use core::array::from_fn;

/// Each iteration's first pixel is this share of a stride behind the last one's: by the golden ratio no two
/// are alike, and all are as far apart as can be.
const GOLDEN: f64 = 0.618_033_988_749_895;
/// Vertices whose positions a pixel's colour may depend on: of more, as of a fan's hub, the rest is left out.
const MAX_AROUND: usize = 40;

/// Pixels between the columns and rows of points that tell a pixel's shade: less than the standard deviation
/// of its Gaussian.
const APART: usize = 4;
/// How many of them a pixel reaches, along both axes: three standard deviations.
const REACHED: usize = 7;

/// Words of memory that [`Shades`] need.
pub(super) const fn shades_words(n: usize, width: usize) -> usize {
    REACHED * (width / APART + 2) * n
}

/// What shade takes from the Gauss–Newton matrix: `Σ_pq r_p G'_pq r_qᵀ`, of rows `r` of mean differences.
///
/// A Gaussian `G'` is the sum, over the points `c` of a lattice, of products of two that are narrower by
/// `√2`: so it is `Σ_c z_c z_cᵀ`, up to a factor, with `z_c = Σ_p g(p − c) r_p`. Rows of `c` are kept as
/// long as pixels reach them.
pub(super) struct Shades<'m> {
    n: usize,
    columns: usize,
    sums: &'m mut [f32],
    /// The first row that is kept.
    first: usize,
}

impl<'m> Shades<'m> {
    /// None yet, of so many unknowns; `None` if there is too little memory.
    pub(super) fn new(n: usize, width: usize, memory: &'m mut [f32]) -> Option<Self> {
        let sums = memory.get_mut(..shades_words(n, width))?;
        sums.fill(0.0);
        Some(Self { n, columns: width / APART + 2, sums, first: 0 })
    }

    /// The factor.
    fn share() -> f32 {
        let k = APART as f32 / SHADE;
        k * k * (2.0 / core::f32::consts::PI)
    }

    /// Adds a pixel's row. Pixels come row by row, and those that earlier ones reach alone are added to the
    /// system, so many times.
    fn add(&mut self, [x, y]: [usize; 2], times: f32, row: &[f32], out: (f32, &mut System<'_>)) {
        let tap = |pixel: usize, centre: usize| {
            let off = pixel as f32 - (centre * APART) as f32;
            math::exp_f32(-off * off / (SHADE * SHADE))
        };
        let around = |pixel: usize| {
            let nearest = (pixel + APART / 2) / APART;
            nearest.saturating_sub(REACHED / 2)..nearest + REACHED / 2 + 1
        };
        let (across, down) = (around(x), around(y));
        self.leave(down.start, out);
        for j in down {
            for i in across.start..across.end.min(self.columns) {
                let k = times * tap(y, j) * tap(x, i);
                let at = (j % REACHED * self.columns + i) * self.n;
                let sum = self.sums.get_mut(at..at + self.n).unwrap_or_default();
                for (sum, r) in sum.iter_mut().zip(row) {
                    *sum += k * r;
                }
            }
        }
    }

    /// Adds the rows before row `first` to the system, so many times.
    fn leave(&mut self, first: usize, (times, system): (f32, &mut System<'_>)) {
        let all = first.min(self.first + REACHED);
        for j in self.first..all {
            let at = j % REACHED * self.columns * self.n;
            let sums = self.sums.get_mut(at..at + self.columns * self.n).unwrap_or_default();
            for sum in sums.chunks_exact_mut(self.n.max(1)) {
                if sum.iter().any(|x| *x != 0.0) {
                    system.add_row(sum, times * Self::share(), 0.0);
                    sum.fill(0.0);
                }
            }
        }
        self.first = self.first.max(first);
    }
}

impl Evidence<'_, '_> {
    /// Adds the Gauss–Newton matrix of pixels with what they count, in all and towards shade, so many
    /// times. `pull` may change their rows.
    pub(super) fn add_whole(
        &self,
        common: &Common<'_, '_>,
        (pixels, times): (impl Iterator<Item = ([usize; 2], f32, f32)>, f32),
        mut pull: impl FnMut(&mut [f32]),
        scratch: &mut Scratch<'_>,
        mut shades: Shades<'_>,
        system: &mut System<'_>,
    ) {
        let n = common.layout.len();
        let weight = times * common.pixel_weight();
        let shade = -3.0 * SHADE_SHARE * weight;
        let looking = (Shading::new(&self.view), Window::new(&self.view));
        for row in &mut scratch.rows {
            // Of another view's unknowns.
            row.fill(0.0);
        }
        for (pixel, a, towards_shade) in pixels {
            if self.fill_rows(common, &looking, pixel, scratch).is_none() {
                continue;
            }
            let [r, g, b] = scratch.rows.each_mut().map(|row| row.get_mut(..n).unwrap_or_default());
            for row in [&mut *r, &mut *g, &mut *b] {
                pull(row);
                system.add_row(row, weight * a, 0.0);
            }
            for ((mean, g), b) in r.iter_mut().zip(&*g).zip(&*b) {
                *mean = (1.0 / 3.0) * (*mean + g + b);
            }
            shades.add(pixel, towards_shade, r, (shade, &mut *system));
        }
        shades.leave(usize::MAX, (shade, system));
    }

    /// Adds the Gauss–Newton matrix of evenly drawn pixels.
    #[inline(never)]
    pub(super) fn add_curvature(
        &self,
        common: &Common<'_, '_>,
        pixels: usize,
        iteration: u32,
        scratch: &mut Scratch<'_>,
        system: &mut System<'_>,
    ) {
        let width = self.width();
        let stride = (self.seen.0 as f64 / pixels as f64).max(1.0);
        let turn = GOLDEN * f64::from(iteration);
        let mut next = (turn - f64::from(turn as u32)) * stride;
        let weight = common.pixel_weight() * stride as f32;
        let looking = (Shading::new(&self.view), Window::new(&self.view));
        for row in &mut scratch.rows {
            // Of another view's unknowns.
            row.fill(0.0);
        }
        let mut seen = 0.0;
        for y in self.frame.rows() {
            for x in self.frame.columns() {
                if self.frame.hit(x, y).is_none() {
                    continue;
                }
                seen += 1.0;
                if seen <= next {
                    continue;
                }
                next += stride;
                let pixel = at(self.planes.weights, y * width + x);
                if pixel < 1e-2 {
                    continue;
                }
                if self.fill_rows(common, &looking, [x, y], scratch).is_none() {
                    continue;
                }
                for row in &scratch.rows {
                    let row = row.get(..common.layout.len()).unwrap_or_default();
                    system.add_row(row, weight * pixel, 0.0);
                }
            }
        }
    }

    /// Fills in a covered pixel's three rows.
    pub(super) fn fill_rows(
        &self,
        common: &Common<'_, '_>,
        (shading, window): &(Shading, Window),
        [x, y]: [usize; 2],
        scratch: &mut Scratch<'_>,
    ) -> Option<()> {
        let Common { problem, instance, layout, .. } = common;
        let (model, engine) = (problem.model, problem.engine);
        let hit = self.frame.hit(x, y);
        let (corners, point) = hit.and_then(|hit| common.point(shading, &hit))?;
        let [along_x, along_y] = self.differences(x, y);
        let adjoints: [Adjoint; 3] = from_fn(|channel| {
            let mut gradient = [0.0; 3];
            gradient[channel] = 1.0;
            shading.adjoint(&point, gradient)
        });
        // What each channel's colour costs each position around, and the pose.
        let mut around = heapless::Vec::<Costs, MAX_AROUND>::new();
        let mut put = |vertex: usize, cost: [Vec3; 3]| {
            let known = around.iter_mut().find(|(v, _)| *v == vertex);
            if let Some((_, costs)) = known {
                for (sum, cost) in costs.iter_mut().zip(cost) {
                    *sum = add(*sum, cost);
                }
            } else {
                // A corner of very many faces: what does not fit is left out of the matrix.
                let _ = around.push((vertex, cost));
            }
        };
        let mut pose = [[0.0_f32; POSE]; 3];
        for (i, vertex) in corners.into_iter().enumerate() {
            let w = point.weights[i];
            let position = xyz(at(instance.positions, vertex));
            let costs = adjoints.map(|adjoint| scale(adjoint.normal, w));
            let mut moved = [[0.0; 3]; 3];
            for channel in 0..3 {
                let turned = apply(&window.rotation, cross(point.normals[i], costs[channel]));
                let motion = [-w * along_x[channel], -w * along_y[channel]];
                let (by_motion, by_pose) = window.adjoint(position, motion);
                moved[channel] = by_motion;
                for (sum, t) in pose[channel].iter_mut().zip(turned) {
                    *sum += t;
                }
                for (sum, p) in pose[channel].iter_mut().zip(by_pose) {
                    *sum += p;
                }
            }
            put(vertex, moved);
            instance.normal_adjoint(model, vertex, costs, &mut put);
        }
        let mut colors = [(0, [[0.0; 3]; 3]); 3];
        for (color, (vertex, w)) in colors.iter_mut().zip(corners.into_iter().zip(point.weights)) {
            *color = (vertex, adjoints.map(|adjoint| scale(adjoint.albedo, w)));
        }
        let [shape, albedo] = &scratch.by_vertex;
        let parts = scratch.rows.each_mut().map(|row| layout.split(row, self.number));
        let [Some(r), Some(g), Some(b)] = parts else { return None };
        (engine.rows)(&model.shape, shape.as_ref(), &around, [r.shape, g.shape, b.shape]);
        (engine.rows)(&model.albedo, albedo.as_ref(), &colors, [r.albedo, g.albedo, b.albedo]);
        let others =
            [(r.pose, r.light, r.color), (g.pose, g.light, g.color), (b.pose, b.light, b.color)];
        for (((to_pose, light, color), adjoint), pose) in
            others.into_iter().zip(&adjoints).zip(pose)
        {
            *to_pose = pose;
            for (out, y) in light.iter_mut().zip(adjoint.harmonics) {
                *out = scale(adjoint.radiance, y);
            }
            *color = adjoint.color;
        }
        Some(())
    }
}
