//! The posterior around a mode, with the mask held as the mode has it: what a sampler samples.
//!
//! `E = priors + landmarks − W/Σω_p m_p · 1/patch · Σ_p ω_p m_p ℓ_p`
//!
//! over the covered pixels. `m_p` is a pixel's mask at the mode and stays; a mask that followed the
//! state would make it no sampler. `ℓ_p` is the log ratio of face and background, bounded, and of a
//! rendering with shade, as in `image_term.rs`; the shade is made with the weights `ω_p m_p`. `ω_p` is what a pixel of the surface has to say: little where it is seen from the
//! side, and less towards the mesh's open edge, so that pixels come and go quietly. `W` is
//! `Σ ω_p m_p` at the mode: to cover less is no gain. `E` is thus smooth but for pixels that one part
//! of the surface hides from another, and its gradient is what [`Held::force`] gives, where the
//! outline runs included.

use super::common::Common;
use super::evidence::{Evidence, Hold, Planes};
use super::gradient::Pixel;
use super::image_term::{FACING, LogRatio, bounded, says};
use super::occlusion::WHOLE;
use super::shading::{Shading, slopes};
use super::state::ModeSearch;
use super::surface::at;
use super::unknowns::Layout;
use super::vector::{add, sub};
use crate::least_squares::Slope;
use crate::scene::{Subject, View};

/// Part of the mode's weight that a scene must cover.
const COVERED: f64 = 0.5;
/// Rings of vertices over which the surface fades out at its open edge.
const RINGS: u8 = 4;
/// `ω` below which a pixel of the mode has no mask: it was hardly seen.
const HARDLY: f32 = 0.05;

/// A search at its end, whose memory serves the sampler: of every photo `mask` holds `m`, `weights`
/// holds `ω`, NaN where nothing is covered, and `hidden` how much vertices fade.
pub(crate) struct Held<'a, 'w, const OTHERS: usize> {
    search: ModeSearch<'a, 'w, OTHERS>,
    mode: Subject,
}

impl<'a, 'w, const OTHERS: usize> Held<'a, 'w, OTHERS> {
    /// Holds the masks of what a search has found.
    pub(crate) fn new(mut search: ModeSearch<'a, 'w, OTHERS>) -> Self {
        search.make_judged();
        for evidence in core::iter::once(&mut search.first).chain(&mut search.others) {
            evidence.hold(&search.common, search.passing);
        }
        let mode = search.common.subject.clone();
        Self { search, mode }
    }

    /// The unknowns.
    pub(crate) fn layout(&self) -> Layout {
        self.search.common.layout
    }

    /// The subject a step away from the mode.
    pub(crate) fn subject(&self, step: &mut [f32]) -> Subject {
        let mut subject = self.mode.clone();
        if let Some(parts) = self.layout().split(step, 0) {
            parts.advance_subject(&mut subject);
        }
        subject
    }

    /// Its views there.
    pub(crate) fn views(&self, mut step: impl AsMut<[f32]>) -> impl Iterator<Item = View> {
        let layout = self.layout();
        self.search.evidence().map(move |evidence| {
            let mut view = evidence.held.mode;
            if let Some(parts) = layout.split(step.as_mut(), evidence.number) {
                parts.advance_view(&mut view);
            }
            view
        })
    }

    /// Goes a step away from the mode, and gives the energy there; `None` where the density is
    /// nought.
    pub(crate) fn energy(&mut self, step: &mut [f32]) -> Option<f64> {
        let subject = self.subject(step);
        let ModeSearch { common, first, others, rendered, judged, .. } = &mut self.search;
        (*rendered, *judged) = (false, false);
        common.subject = subject;
        let mut sum = common.priors().energy_of_subject(&common.subject);
        for evidence in core::iter::once(&mut *first).chain(&mut *others) {
            evidence.view = evidence.held.mode;
            evidence.advance(common.layout, step);
            sum +=
                evidence.landmark_energy(common) + common.priors().energy_of_view(&evidence.view);
        }
        if !sum.is_finite() {
            return None;
        }
        self.search.render();
        let ModeSearch { common, first, others, passing, .. } = &mut self.search;
        for evidence in core::iter::once(first).chain(others) {
            sum += evidence.held_energy(common, passing)?;
        }
        Some(sum)
    }

    /// `−∂E/∂δ` of a step `δ` from where it has gone.
    pub(crate) fn force(&mut self) -> &[f32] {
        let ModeSearch { common, first, others, scratch, passing, gradient, .. } = &mut self.search;
        gradient.fill(0.0);
        for evidence in core::iter::once(&*first).chain(&*others) {
            evidence.add_force(common, passing, gradient);
        }
        let [row, ..] = &mut scratch.rows;
        let row = row.get_mut(..common.layout.len()).unwrap_or_default();
        let mut slope = Slope { row, gradient };
        common.priors().add_of_subject(&common.subject, common.layout, &mut slope);
        for evidence in core::iter::once(&*first).chain(&*others) {
            evidence.add_landmarks_and_priors(common, scratch.components, &mut slope);
        }
        gradient
    }
}

impl Evidence<'_, '_> {
    /// Holds the mask as it is.
    fn hold(&mut self, common: &Common<'_, '_>, memory: &mut [f32]) {
        self.fade(common);
        let (width, shading) = (self.width(), Shading::new(&self.view));
        for y in self.frame.rows() {
            for x in self.frame.columns() {
                let Some(hit) = self.frame.hit(x, y) else { continue };
                let Some((_, point)) = common.point(&shading, &hit) else { continue };
                let index = y * width + x;
                let says = says(shading.facing(&point));
                let weight = at(self.planes.weights, index);
                if let Some(mask) = self.planes.mask.get_mut(index) {
                    *mask = if says > HARDLY { (weight / says).min(1.5) } else { 0.0 };
                }
            }
        }
        self.held = Hold::new(self.view);
        self.held.whole = self.compare_held(common, memory).0;
    }

    /// The image term of what has been rendered.
    fn held_energy(&mut self, common: &Common<'_, '_>, memory: &mut [f32]) -> Option<f64> {
        let (weight, sum) = self.compare_held(common, memory);
        let held = &mut self.held;
        if !(weight > COVERED * held.whole) {
            return None;
        }
        held.mean = (sum / weight) as f32;
        held.share = (held.whole / weight) as f32;
        let patch = f64::from(common.patch());
        Some(-held.whole * sum / (weight * patch))
    }

    /// Fills `ω`; gives `Σωm` and `Σωmℓ`.
    fn compare_held(&mut self, common: &Common<'_, '_>, memory: &mut [f32]) -> (f64, f64) {
        let (width, shading) = (self.width(), Shading::new(&self.view));
        let ln = LogRatio::new(common.sd());
        self.draw(common);
        self.planes.weights.fill(f32::NAN);
        for y in self.frame.rows() {
            for x in self.frame.columns() {
                let Some(hit) = self.frame.hit(x, y) else { continue };
                let Some((_, point)) = common.point(&shading, &hit) else { continue };
                let says = says(shading.facing(&point)) * self.hidden(common, &hit);
                if let Some(to) = self.planes.weights.get_mut(y * width + x) {
                    *to = says;
                }
            }
        }
        let Some(shade) = self.held_shade(memory, common) else { return (0.0, 0.0) };
        let (mut weight, mut sum) = (0.0, 0.0);
        for y in self.frame.rows() {
            let (mut row_weight, mut row_sum) = (0.0, 0.0);
            for x in self.frame.columns() {
                let index = y * width + x;
                let w = at(self.planes.mask, index) * at(self.planes.weights, index);
                if !(w > 0.0) {
                    continue;
                }
                let ratio = ln.of(self.difference(index), at(self.planes.ln_background, index))
                    + ln.of_shade(self.shaded(common, index) * at(shade, index));
                row_weight += w;
                row_sum += w * bounded(ratio).0;
            }
            weight += f64::from(row_weight);
            sum += f64::from(row_sum);
        }
        (weight, sum)
    }

    /// The shade by the pixels' `ωm`; `None` if the memory is shorter than four planes.
    fn held_shade<'m>(&self, memory: &'m mut [f32], common: &Common<'_, '_>) -> Option<&'m [f32]> {
        let pixels = self.planes.mask.len();
        let (shade, rest) = memory.split_at_mut_checked(pixels)?;
        let (weights, rest) = rest.split_at_mut_checked(pixels)?;
        let (shares, spare) = rest.split_at_mut_checked(pixels)?;
        let Planes { mask, weights: says, .. } = &self.planes;
        for (w, (m, says)) in weights.iter_mut().zip(mask.iter().zip(&**says)) {
            *w = if says.is_nan() { 0.0 } else { m * says };
        }
        self.find_shares(|_| 1.0, weights, shares, spare);
        self.find_shade(common, weights, shares, shade, spare);
        Some(shade)
    }

    /// Adds minus the image term's derivative.
    fn add_force(&self, common: &Common<'_, '_>, memory: &mut [f32], gradient: &mut [f32]) {
        let Hold { share, mean, .. } = self.held;
        let width = self.width();
        let shading = Shading::new(&self.view);
        let unit = share * common.pixel_weight();
        let by_ratio = share / common.patch();
        let ln = LogRatio::new(common.sd());
        if self.held_shade(memory, common).is_none() {
            return;
        }
        let Some((shade, memory)) = memory.split_at_mut_checked(self.planes.mask.len()) else {
            return;
        };
        self.add_gradient_of(common, memory, gradient, |[x, y], hit| {
            let index = y * width + x;
            let (mask, says) = (at(self.planes.mask, index), at(self.planes.weights, index));
            if !(mask > 0.0) {
                return None;
            }
            let (corners, point) = common.point(&shading, hit)?;
            let difference = sub(self.photo_at(index), point.color);
            let shade = at(shade, index);
            let ratio = ln.of(difference, at(self.planes.ln_background, index))
                + ln.of_shade(self.shaded(common, index) * shade);
            let (ratio, own) = bounded(ratio);
            let shade = if self.is_shaded(common, index) { shade } else { 0.0 };
            let cost = difference.map(|d| unit * mask * says * own * (d - shade));
            let mut adjoint = shading.adjoint(&point, cost);
            let window = corners.map(|v| {
                let [x, y, ..] = at(self.window, v);
                [x, y]
            });
            let mut by_place = adjoint.motion(&point, &slopes(window));
            // To say more, of what says more than the mean, is a gain.
            let by_says = by_ratio * mask * (ratio - mean);
            for (place, change) in by_place.iter_mut().zip(self.says_along(index, says)) {
                *place -= by_says * change;
            }
            let cosine = shading.facing(&point);
            if cosine > 0.0 && cosine < FACING {
                let cost = by_says * self.hidden(common, hit) * (1.0 / FACING);
                adjoint.normal = add(adjoint.normal, shading.facing_adjoint(&point, cost));
            }
            Some(Pixel { corners, weights: point.weights, adjoint, by_place })
        });
    }

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
    fn fade(&mut self, common: &Common<'_, '_>) {
        let triangles = common.problem.model.triangles;
        let all = (0..triangles.len()).filter_map(|t| Some(triangles.get(t)?.map(|v| v as usize)));
        self.hidden.fill(RINGS);
        for corners in all.clone() {
            let [a, b, c] = corners;
            for edge in [[a, b], [b, c], [c, a]] {
                if common.surface.faces_of(triangles, edge) == 1 {
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
}

fn lower(values: &mut [u8], index: usize, to: u8) {
    if let Some(value) = values.get_mut(index) {
        *value = to.min(*value);
    }
}
