//! Landmark likelihood: isotropic Gaussian error in the picture.

use super::normal::LN_2PI;
use crate::math;
use crate::memory::Carver;
use crate::model::Model;
use crate::scene::{Scene, View};

/// The most landmarks of a photo: room for the template's 42 and some more.
pub const MAX_LANDMARKS: usize = 64;

/// Model-frame positions of the observed landmarks, mm.
pub type Points = heapless::Vec<[f32; 3], MAX_LANDMARKS>;

/// Where a named landmark of the model is in the picture, window pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservedLandmark<'a> {
    /// Name as in the model.
    pub name: &'a str,
    /// `(u, v)`, y down; pixel `(x, y)` is the point `(x, y)`.
    pub position: [f32; 2],
}

/// Words of memory [`Landmarks`] needs.
pub const fn rows_words(landmarks: usize, shape_rank: usize) -> usize {
    3 * landmarks * (1 + shape_rank)
}

/// Points of a landmark's row, at least one.
fn row_len(rank: usize) -> usize {
    rank.saturating_add(1)
}

/// An observed landmark: model point, how it follows the coefficients, and observed minus model position.
pub(crate) struct LandmarkResidual<'l> {
    /// Model-frame position.
    pub(crate) point: [f32; 3],
    /// Per component.
    pub(crate) components: &'l [[f32; 3]],
    /// Window pixels.
    pub(crate) residual: [f32; 2],
}

/// Observed landmarks with the rows of the shape basis at their vertices, so that a shape is
/// judged by its landmarks before the whole instance is computed.
pub struct Landmarks<'w> {
    /// Per landmark: the mean, then each component.
    rows: &'w mut [[f32; 3]],
    /// Observed positions.
    observed: heapless::Vec<[f32; 2], MAX_LANDMARKS>,
    rank: usize,
    sd: f32,
}

impl<'w> Landmarks<'w> {
    /// Gathers the rows of the vertices. Returns `None` if the memory is too short, a vertex is
    /// out of range or there are more than [`MAX_LANDMARKS`].
    pub fn gather(
        carver: &mut Carver<'w>,
        model: &Model<'_>,
        landmarks: &[(u32, [f32; 2])],
        rank: usize,
        sd: f32,
    ) -> Option<Self> {
        let rows = carver.floats(rows_words(landmarks.len(), rank))?.as_chunks_mut().0;
        let rank = rank.min(model.shape.rank());
        let mut observed = heapless::Vec::new();
        for (row, &(vertex, position)) in rows.chunks_exact_mut(row_len(rank)).zip(landmarks) {
            let vertex = vertex as usize;
            if vertex >= model.vertices() {
                return None;
            }
            observed.push(position).ok()?;
            let (mean, components) = row.split_first_mut()?;
            *mean = model.shape.mean_at(vertex);
            model.shape.at(vertex, components);
        }
        Some(Self { rows, observed, rank, sd })
    }

    /// Has them observed elsewhere.
    #[cfg(test)]
    pub(crate) fn observe(&mut self, places: &[[f32; 2]]) {
        for (observed, place) in self.observed.iter_mut().zip(places) {
            *observed = *place;
        }
    }

    /// Positions of the landmarks in the model's frame: the instance's, to rounding.
    pub fn points(&self, coefficients: &[f32]) -> Points {
        let mut points = Points::new();
        for row in self.rows.chunks_exact(row_len(self.rank)) {
            let Some((&(mut p), components)) = row.split_first() else { continue };
            for (&c, column) in coefficients.iter().zip(components) {
                for axis in 0..3 {
                    p[axis] += c * column[axis];
                }
            }
            // As many as were gathered, at most the capacity.
            let _ = points.push(p);
        }
        points
    }

    /// `Σ −log 2π − 2 log σ − ‖u − u_observed‖²/(2σ²)`; −∞ if a landmark is behind the camera.
    pub fn ln_likelihood(&self, scene: &Scene, points: &Points) -> f64 {
        let normaliser = -LN_2PI - 2.0 * math::ln(f64::from(self.sd));
        let mut sum = 0.0;
        for (distance2, in_front) in self.squared_errors(scene, points) {
            if !in_front {
                return f64::NEG_INFINITY;
            }
            sum += normaliser - distance2 / (2.0 * f64::from(self.sd) * f64::from(self.sd));
        }
        sum
    }

    /// Root mean square distance between model and observed landmarks, pixels.
    pub fn rmse(&self, scene: &Scene, points: &Points) -> f64 {
        let sum: f64 = self.squared_errors(scene, points).map(|(d2, _)| d2).sum();
        math::sqrt_f64(sum / (self.observed.len().max(1) as f64))
    }

    fn squared_errors<'s>(
        &'s self,
        scene: &'s Scene,
        points: &'s Points,
    ) -> impl Iterator<Item = (f64, bool)> + 's {
        let rotation = scene.view.pose.rotation();
        points.iter().zip(&self.observed).map(move |(&p, observed)| {
            let world = scene.view.pose.to_world_by(&rotation, p);
            let (u, v, d) = scene.view.camera.project(world);
            let (du, dv) = (f64::from(u - observed[0]), f64::from(v - observed[1]));
            (du * du + dv * dv, d > scene.view.camera.near)
        })
    }

    /// The landmarks and how far off they are, given their model-frame positions.
    pub(crate) fn residuals(
        &self,
        view: &View,
        points: &Points,
    ) -> impl Iterator<Item = LandmarkResidual<'_>> {
        let rows = self.rows.chunks_exact(row_len(self.rank));
        points.iter().zip(&self.observed).zip(rows).map(|((&point, observed), row)| {
            let (u, v, _) = view.camera.project(view.pose.to_world(point));
            let components = row.get(1..).unwrap_or_default();
            LandmarkResidual { point, components, residual: [observed[0] - u, observed[1] - v] }
        })
    }
}
