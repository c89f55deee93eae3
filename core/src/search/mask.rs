//! The image term, and what of a picture shows the face.
//!
//! The pixels around a covered pixel `p` show the face, `N(colour, σ²)`, or something before it,
//! distributed as the picture outside the face is (Egger et al. 2018; the paper's supplement). With
//! `ℓ = ln N − ln background` and `L` its mean over the neighbours by a Gaussian `G`, since what
//! hides a face is larger than a pixel,
//!
//! `E = −N/|C| · 1/patch · Σ_{p ∈ C} ln[(1 − ε_p) exp L_p + ε_p]`,
//!
//! summed over the covered pixels `C`; `N` is how many the landmarks' pose covers, so that to cover
//! fewer is no gain. Its derivative weighs a pixel's squared difference by its neighbours' mask:
//!
//! `m_p = (1 − ε_p) exp L_p / ((1 − ε_p) exp L_p + ε_p)`, `w = Gᵀ(m / G1) · N/|C|`.
//!
//! A lone pixel may show anything: `ℓ` is `ln(exp ℓ + exp −HOPELESS)`, and `w` times the first
//! summand's share.

use super::picture;
use super::shading::Shading;
use super::state::{ModeSearch, Planes};
use super::surface::at;
use super::vector::{add, dot, scale, sub};
use crate::likelihood::background::HISTOGRAM_LEN;
use crate::likelihood::pixels::ln_normaliser;
use crate::math;
use crate::render::rasterize::Hit;
use crate::scene::Scene;

/// Standard deviation, pixels, over which neighbouring pixels are judged together whether they show
/// the face: some 50 pixels, the order of the patch that shares one error.
const COHERENCE: f32 = 3.0;
/// Log of the odds against the face, at most, that one pixel's colour can be.
const HOPELESS: f64 = 12.0;

impl ModeSearch<'_, '_> {
    /// The background is what the picture holds outside of where the landmarks put the face.
    #[inline(never)]
    pub(super) fn look_outside(&mut self) {
        let width = self.problem.image.width as usize;
        self.render();
        let frame = &self.frame;
        let outside = |i: usize| {
            let (x, y) = (i % width.max(1), i / width.max(1));
            frame.hit(x, y).is_none()
        };
        // The equations are not in use yet.
        let ln = &mut *self.planes.ln_background;
        ln.fill(0.0);
        let scratch = &mut *self.system;
        if let Some(histogram) = scratch.get_mut(..HISTOGRAM_LEN) {
            picture::ln_background(self.problem.image.pixels, outside, histogram, ln);
        }
    }

    /// Compares what has been rendered of a scene with the photo: fills mask and weights, and gives
    /// the image term. Infinite if the scene covers nothing.
    #[inline(never)]
    pub(super) fn compare(&mut self, scene: &Scene) -> f64 {
        let width = self.problem.image.width as usize;
        let covered = self.compare_pixels(scene);
        let [ratios, near] = &mut self.planes.scratch;
        picture::blur(ratios, self.planes.weights, width, COHERENCE);
        picture::blur(near, self.planes.weights, width, COHERENCE);
        self.planes.weights.fill(0.0);
        let (mut sum, mut visible) = (0.0, 0.0);
        for y in self.frame.rows() {
            let (mut row, mut row_visible) = (0.0, 0.0);
            for x in self.frame.columns() {
                let Some(hit) = self.frame.hit(x, y) else { continue };
                let index = y * width + x;
                let hidden = f64::from(self.hidden(&hit));
                let [ratios, near] = &mut self.planes.scratch;
                let near = at(near, index).max(1e-6);
                let ratio = f64::from(at(ratios, index) / near);
                // Something else against the face.
                let odds = hidden / (1.0 - hidden) * math::exp(-ratio);
                row += ratio + math::ln((1.0 - hidden) * (1.0 + odds));
                let mask = (1.0 / (1.0 + odds)) as f32;
                row_visible += mask;
                set(ratios, index, mask);
                set(self.planes.weights, index, mask / near);
            }
            sum += row;
            visible += row_visible;
        }
        if covered == 0 {
            return f64::INFINITY;
        }
        if self.expected == 0 {
            self.expected = covered;
        }
        self.seen = (covered, visible);
        let share = self.expected as f32 / covered as f32;
        let Planes { mask, weights, scratch: [masks, scratch], .. } = &mut self.planes;
        picture::blur(weights, scratch, width, COHERENCE);
        for (weight, share_of_face) in weights.iter_mut().zip(&**mask) {
            *weight *= share_of_face * share;
        }
        for (mask, visible) in mask.iter_mut().zip(&**masks) {
            *mask = if *mask > 0.0 { *visible } else { 0.0 };
        }
        -sum * f64::from(share / self.problem.config.pixel_patch)
    }

    /// Fills the scratch planes with the covered pixels' log ratios and with ones, and the mask with
    /// the share of the face in them; gives the number of covered pixels.
    fn compare_pixels(&mut self, scene: &Scene) -> usize {
        let width = self.problem.image.width as usize;
        let sd = self.sd();
        let k = 1.0 / (2.0 * sd * sd);
        let normaliser = ln_normaliser(f64::from(sd)) as f32;
        let shading = Shading::new(scene);
        let occlusion = self.options.occlusion;
        let Planes { mask, scratch: [ratios, ones], .. } = &mut self.planes;
        for plane in [&mut **mask, ratios, ones] {
            plane.fill(0.0);
        }
        let mut covered = 0;
        for y in self.frame.rows() {
            for x in self.frame.columns() {
                let Some(hit) = self.frame.hit(x, y) else { continue };
                let index = y * width + x;
                let Some((_, point)) = self.point(&shading, &hit) else { continue };
                let difference = sub(self.photo(index), point.color);
                let face = normaliser - k * dot(difference, difference);
                let ratio = f64::from(face - at(self.planes.ln_background, index));
                let anything = if occlusion { math::exp(-HOPELESS - ratio) } else { 0.0 };
                let Planes { mask, scratch: [ratios, ones], .. } = &mut self.planes;
                set(ratios, index, (ratio + math::ln(1.0 + anything)) as f32);
                set(ones, index, 1.0);
                // Never nought: that is where nothing is covered.
                set(mask, index, ((1.0 / (1.0 + anything)) as f32).max(f32::MIN_POSITIVE));
                covered += 1;
            }
        }
        covered
    }

    /// Prior probability that the surface is hidden at a pixel.
    fn hidden(&self, hit: &Hit) -> f32 {
        if !self.options.occlusion {
            return 0.0;
        }
        let model = self.problem.model;
        let Some(corners) = model.triangles.get(hit.triangle) else { return 0.5 };
        let [second, third] = hit.weights;
        let [a, b, c] = corners.map(|v| model.shape.mean_at(v as usize));
        let place = add(add(scale(a, 1.0 - second - third), scale(b, second)), scale(c, third));
        self.hiding.at(place)
    }
}

fn set(plane: &mut [f32], index: usize, value: f32) {
    if let Some(to) = plane.get_mut(index) {
        *to = value;
    }
}
