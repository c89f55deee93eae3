//! The posterior around a mode, with the mask held as the mode has it: what a sampler samples.
//!
//! `E = priors + landmarks − W/Σω_p m_p · 1/patch · Σ_p ω_p m_p ℓ_p`
//!
//! over the covered pixels. `m_p` is a pixel's mask at the mode and stays; a mask that followed the
//! state would make it no sampler. `ℓ_p` is the log ratio of face and background, bounded as in
//! `image_term.rs`. `ω_p` is what a pixel of the surface has to say: little where it is seen from the
//! side, and less towards the mesh's open edge, so that pixels come and go quietly. `W` is
//! `Σ ω_p m_p` at the mode: to cover less is no gain. `E` is thus smooth but for pixels that one part
//! of the surface hides from another, and its gradient is what [`Held::force`] gives, where the
//! outline runs included.

use super::gradient::Pixel;
use super::image_term::{FACING, LogRatio, bounded, says};
use super::landmarks;
use super::occlusion::WHOLE;
use super::shading::{Shading, slopes};
use super::state::ModeSearch;
use super::surface::at;
use super::vector::{add, scale, sub};
use crate::least_squares::Slope;
use crate::scene::Scene;

/// Part of the mode's weight that a scene must cover.
const COVERED: f64 = 0.5;
/// Rings of vertices over which the surface fades out at its open edge.
const RINGS: u8 = 4;
/// `ω` below which a pixel of the mode has no mask: it was hardly seen.
const HARDLY: f32 = 0.05;

/// A search at its end, whose memory serves the sampler: `mask` holds `m`, `weights` holds `ω`, NaN
/// where nothing is covered, and `hidden` how much vertices fade.
pub(crate) struct Held<'a, 'w> {
    pub(crate) search: ModeSearch<'a, 'w>,
    /// `W`.
    whole: f64,
    /// Of the scene gone to: `W/Σωm`, and the mean of `ℓ`.
    share: f32,
    mean: f32,
}

impl<'a, 'w> Held<'a, 'w> {
    /// Holds the mask of a search's scene.
    pub(crate) fn new(mut search: ModeSearch<'a, 'w>) -> Self {
        search.make_judged();
        search.fade();
        let (width, shading) = (search.width(), Shading::new(&search.scene));
        for y in search.frame.rows() {
            for x in search.frame.columns() {
                let Some(hit) = search.frame.hit(x, y) else { continue };
                let Some((_, point)) = search.point(&shading, &hit) else { continue };
                let index = y * width + x;
                let says = says(shading.facing(&point));
                let weight = at(search.planes.weights, index);
                if let Some(mask) = search.planes.mask.get_mut(index) {
                    *mask = if says > HARDLY { (weight / says).min(1.5) } else { 0.0 };
                }
            }
        }
        let mut held = Self { search, whole: 0.0, share: 1.0, mean: 0.0 };
        held.whole = held.compare().0;
        held
    }

    /// Goes to a scene, and gives its energy; `None` where the density is nought.
    pub(crate) fn energy(&mut self, scene: &Scene) -> Option<f64> {
        let search = &mut self.search;
        let rest = search.priors().energy(scene) + search.landmark_energy(scene);
        if !rest.is_finite() {
            return None;
        }
        search.render_other(scene);
        search.scene.clone_from(scene);
        let (weight, sum) = self.compare();
        if !(weight > COVERED * self.whole) {
            return None;
        }
        self.mean = (sum / weight) as f32;
        self.share = (self.whole / weight) as f32;
        let patch = f64::from(self.search.problem.config.pixel_patch);
        Some(rest - self.whole * sum / (weight * patch))
    }

    /// Fills `ω`; gives `Σωm` and `Σωmℓ`.
    fn compare(&mut self) -> (f64, f64) {
        let search = &mut self.search;
        let (width, shading) = (search.width(), Shading::new(&search.scene));
        let ln = LogRatio::new(search.sd());
        search.planes.weights.fill(f32::NAN);
        let (mut weight, mut sum) = (0.0, 0.0);
        for y in search.frame.rows() {
            let (mut row_weight, mut row_sum) = (0.0, 0.0);
            for x in search.frame.columns() {
                let Some(hit) = search.frame.hit(x, y) else { continue };
                let Some((_, point)) = search.point(&shading, &hit) else { continue };
                let index = y * width + x;
                let says = says(shading.facing(&point)) * search.hidden(&hit);
                if let Some(to) = search.planes.weights.get_mut(index) {
                    *to = says;
                }
                let w = at(search.planes.mask, index) * says;
                let difference = sub(search.photo(index), point.color);
                let ratio = ln.of(difference, at(search.planes.ln_background, index));
                row_weight += w;
                row_sum += w * bounded(ratio).0;
            }
            weight += f64::from(row_weight);
            sum += f64::from(row_sum);
        }
        (weight, sum)
    }

    /// `−∂E/∂δ` of a step `δ` from the scene gone to.
    pub(crate) fn force(&mut self) -> &[f32] {
        let Self { search, share, mean, .. } = self;
        let (share, mean, width) = (*share, *mean, search.width());
        search.gradient.fill(0.0);
        let shading = Shading::new(&search.scene);
        let unit = share * search.pixel_weight();
        let by_ratio = share / search.problem.config.pixel_patch;
        let ln = LogRatio::new(search.sd());
        search.add_gradient_of(|search, [x, y], hit| {
            let index = y * width + x;
            let (mask, says) = (at(search.planes.mask, index), at(search.planes.weights, index));
            if !(mask > 0.0) {
                return None;
            }
            let (corners, point) = search.point(&shading, hit)?;
            let difference = sub(search.photo(index), point.color);
            let ratio = ln.of(difference, at(search.planes.ln_background, index));
            let (ratio, own) = bounded(ratio);
            let mut adjoint = shading.adjoint(&point, scale(difference, unit * mask * says * own));
            let window = corners.map(|v| {
                let [x, y, ..] = at(search.surface.window, v);
                [x, y]
            });
            let mut by_place = adjoint.motion(&point, &slopes(window));
            // To say more, of what says more than the mean, is a gain.
            let by_says = by_ratio * mask * (ratio - mean);
            for (place, change) in by_place.iter_mut().zip(search.says_along(index, says)) {
                *place -= by_says * change;
            }
            let cosine = shading.facing(&point);
            if cosine > 0.0 && cosine < FACING {
                let cost = by_says * search.hidden(hit) * (1.0 / FACING);
                adjoint.normal = add(adjoint.normal, shading.facing_adjoint(&point, cost));
            }
            Some(Pixel { corners, weights: point.weights, adjoint, by_place })
        });
        search.add_rest()
    }
}

impl ModeSearch<'_, '_> {
    /// How `ω` changes from pixel to pixel, along x and y.
    fn says_along(&self, index: usize, here: f32) -> [f32; 2] {
        let says = |index: Option<usize>| {
            index.map(|index| at(self.planes.weights, index)).filter(|says| !says.is_nan())
        };
        let along = |step: usize| {
            let (less, more) = (says(index.checked_sub(step)), says(index.checked_add(step)));
            let k = if less.is_some() && more.is_some() { 0.5 } else { 1.0 };
            k * (more.unwrap_or(here) - less.unwrap_or(here))
        };
        [along(1), along(self.width())]
    }

    /// Fills `hidden` with how much is left of vertices: all but for [`RINGS`] rings at the mesh's
    /// open edge.
    fn fade(&mut self) {
        let triangles = self.problem.model.triangles;
        let all = (0..triangles.len()).filter_map(|t| Some(triangles.get(t)?.map(|v| v as usize)));
        self.hidden.fill(RINGS);
        for corners in all.clone() {
            let [a, b, c] = corners;
            for edge in [[a, b], [b, c], [c, a]] {
                if self.surface.faces_of(triangles, edge) == 1 {
                    for vertex in edge {
                        lower(self.hidden, vertex, 0);
                    }
                }
            }
        }
        for _ in 0..RINGS {
            for corners in all.clone() {
                let least = corners.iter().map(|&v| at(self.hidden, v)).min().unwrap_or(RINGS);
                for vertex in corners {
                    lower(self.hidden, vertex, least + 1);
                }
            }
        }
        for vertex in self.hidden.iter_mut() {
            *vertex = (WHOLE * f32::from(*vertex) / f32::from(RINGS)) as u8;
        }
    }

    /// Adds what landmarks and priors say to the gradient.
    fn add_rest(&mut self) -> &[f32] {
        let gradient = core::mem::take(&mut self.gradient);
        let [row, ..] = &mut self.rows;
        let mut slope = Slope { row: core::mem::take(row), gradient };
        let (model, sd) = (self.problem.model, self.problem.config.landmark_sd);
        let components = self.components.get_mut(..self.layout.shape_rank).unwrap_or_default();
        let scene = &self.scene;
        landmarks::add_equations(model, &self.landmarks, scene, sd, components, &mut slope);
        self.priors().add(scene, self.layout, &mut slope);
        self.gradient = slope.gradient;
        let [row, ..] = &mut self.rows;
        *row = slope.row;
        self.gradient
    }
}

fn lower(values: &mut [u8], index: usize, to: u8) {
    if let Some(value) = values.get_mut(index) {
        *value = to.min(*value);
    }
}
