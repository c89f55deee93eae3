//! The image term's gradient: what it costs to change anything that colours are made of.

use super::common::{Common, larger};
use super::evidence::Evidence;
use super::instance::at;
use super::shading::{Adjoint, Point, Shading};
use super::unknowns::{COLOR, POSE};
use super::window::Window;
use crate::basis::padded;
use crate::render::rasterize::Hit;
use crate::vector::{Vec3, apply, cross, dot, scale, sub, xyz};

/// What it costs to change what a pixel shows.
pub(super) struct Pixel {
    /// The visible triangle's corners.
    pub(super) corners: [usize; 3],
    /// See [`Point::weights`].
    pub(super) weights: Vec3,
    /// Minus the derivatives by normal, albedo, light and colour transform.
    pub(super) adjoint: Adjoint,
    /// Minus the derivative by the place of the surface in the window.
    pub(super) by_place: [f32; 2],
}

/// Words of memory a gradient needs: a plane of shade, and then four more or what vertices cost.
pub(super) const fn gradient_words(vertices: usize, pixels: usize) -> usize {
    pixels + larger(4 * pixels, Costs::words(vertices))
}

/// Of every vertex, what it costs to change it.
pub(super) struct Costs<'p> {
    normals: &'p mut [[f32; 4]],
    albedo: &'p mut [[f32; 4]],
    /// First of the window coordinates, then of the positions.
    positions: &'p mut [[f32; 4]],
}

impl<'p> Costs<'p> {
    /// Words of the costs.
    const fn words(vertices: usize) -> usize {
        3 * 4 * padded(vertices)
    }

    /// No costs yet; `None` if there is too little memory.
    fn new(vertices: usize, memory: &'p mut [f32]) -> Option<Self> {
        let memory = memory.get_mut(..Self::words(vertices))?;
        memory.fill(0.0);
        let (quads, _) = memory.as_chunks_mut();
        let (normals, rest) = quads.split_at_mut_checked(padded(vertices))?;
        let (albedo, positions) = rest.split_at_mut_checked(padded(vertices))?;
        Some(Self { normals, albedo, positions })
    }
}

impl Common<'_, '_> {
    /// What the subject's surface shows at a visible pixel.
    #[inline(never)]
    pub(super) fn point(&self, shading: &Shading, hit: &Hit) -> Option<([usize; 3], Point)> {
        let corners = self.problem.model.triangles.get(hit.triangle)?.map(|v| v as usize);
        let [second, third] = hit.weights;
        let weights = [1.0 - second - third, second, third];
        let normals = corners.map(|v| xyz(at(self.instance.normals, v)));
        let albedos = corners.map(|v| xyz(at(self.instance.albedo, v)));
        Some((corners, shading.point(weights, normals, albedos)))
    }
}

impl Evidence<'_, '_> {
    /// How the rendering changes from pixel to pixel, along x and y.
    ///
    /// A pixel stays where it is while the surface moves under it: what moves by `δp` in the window
    /// brings the colour of `p − δp`. So `∂c/∂p` is minus this: the derivative of the rendered
    /// picture, not of the photo. (The photo's gradient converges faster, but pulls the face to
    /// whatever edge is near, such as the hair's.) Differences over two pixels see lips, lids and
    /// nostrils as large as the picture does; slopes within a triangle that is smaller than a
    /// pixel are those of a spike.
    #[inline(never)]
    pub(super) fn differences(&self, x: usize, y: usize) -> [Vec3; 2] {
        let width = self.width();
        let index = y * width + x;
        let rendered = |index: usize| {
            let [r, g, b] = &self.planes.rendering;
            let color = [at(r, index), at(g, index), at(b, index)];
            (!color[0].is_nan()).then_some(color)
        };
        let along = |less: Option<usize>, more: Option<usize>| {
            let (less, more) = (less.and_then(rendered), more.and_then(rendered));
            let here = rendered(index).unwrap_or_default();
            let k = if less.is_some() && more.is_some() { 0.5 } else { 1.0 };
            scale(sub(more.unwrap_or(here), less.unwrap_or(here)), k)
        };
        let right = if x + 1 < width { Some(index + 1) } else { None };
        let left = if x > 0 { Some(index.wrapping_sub(1)) } else { None };
        [along(left, right), along(index.checked_sub(width), Some(index + width))]
    }

    /// Adds `−∂E/∂x` of the image term to the gradient; `memory` has [`gradient_words`].
    #[inline(never)]
    pub(super) fn add_gradient(
        &self,
        common: &Common<'_, '_>,
        memory: &mut [f32],
        gradient: &mut [f32],
    ) {
        let (unit, width) = (common.pixel_weight(), self.width());
        let shading = Shading::new(&self.view);
        let pixels = self.planes.mask.len();
        let Some((taken, memory)) = memory.split_at_mut_checked(pixels) else { return };
        let mut planes = memory.chunks_exact_mut(pixels.max(1));
        let mut plane = || planes.next().unwrap_or_default();
        self.find_taken(common, [taken, plane(), plane(), plane(), plane()]);
        let (columns, rows) = (self.frame.columns(), self.frame.rows());
        let all = rows.flat_map(|y| columns.clone().map(move |x| [x, y]));
        let pixels = all.filter_map(|[x, y]| {
            let hit = self.frame.hit(x, y)?;
            let index = y * width + x;
            let weight = at(self.planes.weights, index);
            if weight < 1e-3 {
                return None;
            }
            let (corners, point) = common.point(&shading, &hit)?;
            let cost = self.cost(index, at(taken, index)).map(|cost| unit * cost);
            let adjoint = shading.adjoint(&point, cost);
            let by_place = self.differences(x, y).map(|d| -dot(cost, d));
            Some(Pixel { corners, weights: point.weights, adjoint, by_place })
        });
        self.add_gradient_of(common, memory, gradient, pixels);
    }

    /// A pixel's weighted difference, minus what shade takes off it.
    #[inline(always)]
    pub(super) fn cost(&self, index: usize, taken: f32) -> Vec3 {
        let weight = at(self.planes.weights, index);
        self.difference(index).map(|d| weight * d - taken)
    }

    /// Adds what pixels cost.
    #[inline(always)]
    pub(super) fn add_gradient_of(
        &self,
        common: &Common<'_, '_>,
        memory: &mut [f32],
        gradient: &mut [f32],
        pixels: impl Iterator<Item = Pixel>,
    ) {
        let Common { problem, instance, layout, .. } = common;
        let (model, engine) = (problem.model, problem.engine);
        let Some(costs) = Costs::new(model.vertices(), memory) else { return };
        let mut light = [[0.0_f64; 3]; 9];
        let mut color = [0.0_f64; COLOR];
        for Pixel { corners, weights, adjoint, by_place } in pixels {
            for (vertex, w) in corners.into_iter().zip(weights) {
                let put = |to: Option<&mut [f32; 4]>, [x, y, z]: Vec3| {
                    if let Some(to) = to {
                        *to = [to[0] + w * x, to[1] + w * y, to[2] + w * z, 0.0];
                    }
                };
                put(costs.normals.get_mut(vertex), adjoint.normal);
                put(costs.albedo.get_mut(vertex), adjoint.albedo);
                put(costs.positions.get_mut(vertex), [by_place[0], by_place[1], 0.0]);
            }
            for (sum, y) in light.iter_mut().zip(adjoint.harmonics) {
                for (sum, r) in sum.iter_mut().zip(adjoint.radiance) {
                    *sum += f64::from(y * r);
                }
            }
            for (sum, c) in color.iter_mut().zip(adjoint.color) {
                *sum += f64::from(c);
            }
        }
        let mut pose = [0.0_f64; POSE];
        let window = Window::new(&self.view);
        for (v, cost) in costs.positions.iter_mut().enumerate() {
            let [x, y, ..] = *cost;
            if x != 0.0 || y != 0.0 {
                let (moved, by_pose) = window.adjoint(xyz(at(instance.positions, v)), [x, y]);
                *cost = [moved[0], moved[1], moved[2], 0.0];
                for (sum, p) in pose.iter_mut().zip(by_pose) {
                    *sum += f64::from(p);
                }
            }
        }
        for (normal, cost) in instance.normals.iter().zip(&*costs.normals) {
            let turned = apply(&window.rotation, cross(xyz(*normal), xyz(*cost)));
            for (sum, t) in pose.iter_mut().zip(turned) {
                *sum += f64::from(t);
            }
        }
        instance.add_normals_adjoint(model, costs.normals, costs.positions);
        let Some(parts) = layout.split(gradient, self.number) else { return };
        for (g, p) in parts.pose.iter_mut().zip(pose) {
            *g += p as f32;
        }
        (engine.transposed)(&model.shape, costs.positions, parts.shape);
        (engine.transposed)(&model.albedo, costs.albedo, parts.albedo);
        for (g, l) in parts.light.as_flattened_mut().iter_mut().zip(light.as_flattened()) {
            *g += *l as f32;
        }
        for (g, c) in parts.color.iter_mut().zip(color) {
            *g += c as f32;
        }
    }
}
