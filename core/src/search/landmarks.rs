//! The landmarks: their energy and their equations.
//!
//! A landmark's error has a t distribution in the plane, `½(ν + 2) ln(1 + q/ν)` with
//! `q = ‖Δ‖²/σ²`: like a Gaussian's nearby, but one that is far off has little to say. Its
//! equations count with `(ν + 2)/(ν + q)`, the weight of iteratively reweighted least squares.

use super::common::Common;
use super::window::Window;
use crate::least_squares::Equations;
use crate::likelihood::landmarks::Landmarks;
use crate::math;
use crate::scene::{Subject, View};
use crate::vector::dot;

/// Degrees of freedom ν. Chosen, not measured.
const LANDMARK_FREEDOM: f64 = 8.0;

/// Negative log density of the landmarks, up to a constant; `sd` is in pixels.
pub(super) fn energy(landmarks: &Landmarks<'_>, subject: &Subject, view: &View, sd: f32) -> f64 {
    let sd = f64::from(sd);
    landmarks
        .residuals(view, &landmarks.points(&subject.shape))
        .map(|landmark| {
            let [x, y] = landmark.residual.map(f64::from);
            let q = (x * x + y * y) / (sd * sd);
            0.5 * (LANDMARK_FREEDOM + 2.0) * math::ln(1.0 + q / LANDMARK_FREEDOM)
        })
        .sum()
}

/// Adds the landmarks' equations in the view of this number.
pub(super) fn add_equations(
    common: &Common<'_, '_>,
    landmarks: &Landmarks<'_>,
    view: &View,
    number: usize,
    system: &mut impl Equations,
) {
    let Common { layout, subject, .. } = common;
    let sd = common.problem.config.landmark_sd;
    let window = Window::new(view);
    for landmark in landmarks.residuals(view, &landmarks.points(&subject.shape)) {
        let [x, y] = landmark.residual;
        let q = (x * x + y * y) / (sd * sd);
        let freedom = LANDMARK_FREEDOM as f32;
        let weight = (freedom + 2.0) / (freedom + q) / (sd * sd);
        for (axis, residual) in [x, y].into_iter().enumerate() {
            let mut cost = [0.0; 2];
            cost[axis] = 1.0;
            let (moved, pose) = window.adjoint(landmark.point, cost);
            let row = system.row();
            row.fill(0.0);
            for (out, b) in row.iter_mut().take(layout.shape_rank).zip(landmark.components) {
                *out = dot(moved, *b);
            }
            for (out, p) in
                row.get_mut(layout.pose(number)).unwrap_or_default().iter_mut().zip(pose)
            {
                *out = p;
            }
            system.add(weight, residual);
        }
    }
}
