//! The metric of a step: the Gauss–Newton matrix of some of the pixels.

use super::shading::{Adjoint, Point, Shading};
use super::state::ModeSearch;
use super::surface::at;
use super::unknowns::POSE;
use super::vector::{Vec3, add, apply, cross, scale, xyz};
use super::window::Window;
use crate::least_squares::System;
use core::array::from_fn;

/// Pixels whose rows make the matrix.
const SAMPLES: usize = 1500;
/// Vertices whose positions a pixel's colour may depend on.
const MAX_AROUND: usize = 40;

impl ModeSearch<'_, '_> {
    /// Adds the Gauss–Newton matrix of evenly drawn pixels.
    #[inline(never)]
    pub(super) fn add_curvature(
        &mut self,
        shading: &Shading,
        covered: usize,
        system: &mut System<'_>,
    ) {
        let width = self.problem.image.width as usize;
        let stride = (covered as f64 / SAMPLES as f64).max(1.0);
        let mut next = self.rng.uniform() * stride;
        let weight = self.pixel_weight() * stride as f32;
        let view = Window::new(&self.scene);
        let mut seen = 0.0;
        for y in self.frame.rows() {
            for x in self.frame.columns() {
                let Some(hit) = self.frame.hit(x, y) else { continue };
                seen += 1.0;
                if seen <= next {
                    continue;
                }
                next += stride;
                let mask = at(self.planes.mask, y * width + x);
                if mask < 1e-2 {
                    continue;
                }
                let Some((corners, point)) = self.point(shading, &hit) else { continue };
                self.add_pixel(shading, &view, corners, &point, weight * mask, system);
            }
        }
    }

    /// Adds one pixel's three rows.
    pub(super) fn add_pixel(
        &mut self,
        shading: &Shading,
        view: &Window,
        corners: [usize; 3],
        point: &Point,
        weight: f32,
        system: &mut System<'_>,
    ) {
        let slopes = self.slopes(corners);
        let adjoints: [Adjoint; 3] = from_fn(|channel| {
            let mut gradient = [0.0; 3];
            gradient[channel] = 1.0;
            shading.adjoint(point, gradient)
        });
        // What each channel's colour costs each position around, and the pose.
        let mut around = heapless::Vec::<(usize, [Vec3; 3]), MAX_AROUND>::new();
        let mut pose = [[0.0_f32; POSE]; 3];
        for (channel, adjoint) in adjoints.iter().enumerate() {
            let mut put = |vertex: usize, cost: Vec3| {
                let known = around.iter_mut().find(|(v, _)| *v == vertex);
                if let Some((_, costs)) = known {
                    if let Some(sum) = costs.get_mut(channel) {
                        *sum = add(*sum, cost);
                    }
                } else {
                    let costs = from_fn(|c| if c == channel { cost } else { [0.0; 3] });
                    // A corner of very many faces: what does not fit is left out of the matrix.
                    let _ = around.push((vertex, costs));
                }
            };
            let motion = adjoint.motion(point, &slopes);
            for (i, vertex) in corners.into_iter().enumerate() {
                let w = point.weights[i];
                let cost = scale(adjoint.normal, w);
                let turned = apply(&view.rotation, cross(point.normals[i], cost));
                for (sum, t) in pose[channel].iter_mut().zip(turned) {
                    *sum += t;
                }
                self.surface.normal_adjoint(self.problem.model, vertex, cost, &mut put);
                let position = xyz(at(self.surface.positions, vertex));
                let (moved, by_pose) = view.adjoint(position, [w * motion[0], w * motion[1]]);
                put(vertex, moved);
                for (sum, p) in pose[channel].iter_mut().zip(by_pose) {
                    *sum += p;
                }
            }
        }
        let model = self.problem.model;
        let [shape, albedo] = &mut self.components;
        let rows = &mut self.rows;
        for row in rows.iter_mut() {
            row.fill(0.0);
        }
        for (vertex, costs) in &around {
            model.shape.at(*vertex, shape);
            for (row, cost) in rows.iter_mut().zip(costs) {
                let part = row.get_mut(POSE..).unwrap_or_default();
                for (out, b) in part.iter_mut().zip(&**shape) {
                    *out += cost[0] * b[0] + cost[1] * b[1] + cost[2] * b[2];
                }
            }
        }
        let first_albedo = POSE + self.layout.shape_rank;
        for (vertex, w) in corners.into_iter().zip(point.weights) {
            model.albedo.at(vertex, albedo);
            for (row, adjoint) in rows.iter_mut().zip(&adjoints) {
                let [r, g, b] = scale(adjoint.albedo, w);
                let part = row.get_mut(first_albedo..).unwrap_or_default();
                for (out, c) in part.iter_mut().zip(&**albedo) {
                    *out += r * c[0] + g * c[1] + b * c[2];
                }
            }
        }
        for ((row, adjoint), pose) in rows.iter_mut().zip(&adjoints).zip(&pose) {
            let Some(parts) = self.layout.split(row) else { continue };
            *parts.pose = *pose;
            for (out, y) in parts.light.iter_mut().zip(adjoint.harmonics) {
                *out = scale(adjoint.radiance, y);
            }
            *parts.color = adjoint.color;
        }
        for row in rows {
            system.add_row(row, weight, 0.0);
        }
    }
}
