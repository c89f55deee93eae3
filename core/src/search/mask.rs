//! What of a picture shows the face, and what something before it.
//!
//! A covered pixel shows the face, `N(colour, σ²)`, or something before it, distributed as the
//! picture outside the face is (Egger et al. 2018; the paper's supplement). The log ratio of the
//! two is averaged over neighbours, since what hides a face is larger than a pixel.

use super::picture;
use super::shading::Shading;
use super::state::ModeSearch;
use super::surface::at;
use super::vector::{add, dot, scale, sub};
use crate::likelihood::background::HISTOGRAM_LEN;
use crate::likelihood::pixels::ln_normaliser;
use crate::math;
use crate::render::rasterize::Hit;

/// Standard deviation, pixels, over which neighbouring pixels are judged together whether they show
/// the face: some 50 pixels, the order of the patch that shares one error.
const COHERENCE: f32 = 2.0;
/// Least log density a pixel's colour may have under the face, relative to the background: beyond
/// it, one pixel's error is no more evidence.
const HOPELESS: f32 = 60.0;

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
        let ln = &mut *self.planes.ln_background;
        ln.fill(0.0);
        if let Some(histogram) = self.passing.get_mut(..HISTOGRAM_LEN) {
            picture::ln_background(self.problem.image.pixels, outside, histogram, ln);
        }
    }

    /// Estimates the mask of what has been rendered, and gives covered pixels and the mask's sum.
    #[inline(never)]
    pub(super) fn estimate_mask(&mut self) -> (usize, f32) {
        self.in_passing(Self::estimate_mask_in)
    }

    fn estimate_mask_in(&mut self, memory: &mut [f32]) -> (usize, f32) {
        let pixels = self.planes.mask.len();
        let (ratios, rest) = memory.split_at_mut(pixels.min(memory.len()));
        let count = rest.get_mut(..pixels).unwrap_or_default();
        let width = self.problem.image.width as usize;
        let sd = self.sd();
        let k = 1.0 / (2.0 * sd * sd);
        let normaliser = ln_normaliser(f64::from(sd)) as f32;
        let shading = Shading::new(&self.scene);
        ratios.fill(0.0);
        count.fill(0.0);
        self.planes.mask.fill(0.0);
        let mut covered = 0;
        for y in self.frame.rows() {
            for x in self.frame.columns() {
                let Some(hit) = self.frame.hit(x, y) else { continue };
                let index = y * width + x;
                let Some((_, point)) = self.point(&shading, &hit) else { continue };
                let difference = sub(self.photo(index), point.color);
                let face = normaliser - k * dot(difference, difference);
                let ratio = (face - at(self.planes.ln_background, index)).max(-HOPELESS);
                covered += 1;
                let (Some(r), Some(c)) = (ratios.get_mut(index), count.get_mut(index)) else {
                    continue;
                };
                *r = ratio;
                *c = 1.0;
            }
        }
        if !self.options.occlusion {
            for (mask, covers) in self.planes.mask.iter_mut().zip(count) {
                *mask = *covers;
            }
            return (covered, covered as f32);
        }
        picture::blur(ratios, self.planes.mask, width, COHERENCE);
        picture::blur(count, self.planes.mask, width, COHERENCE);
        self.planes.mask.fill(0.0);
        let mut sum = 0.0;
        for y in self.frame.rows() {
            let mut row = 0.0;
            for x in self.frame.columns() {
                let Some(hit) = self.frame.hit(x, y) else { continue };
                let index = y * width + x;
                let ratio = at(ratios, index) / at(count, index).max(1e-6);
                let hidden = self.hidden(&hit);
                // face (1 − ε) against background ε.
                let odds = f64::from(hidden / (1.0 - hidden)) * math::exp(f64::from(-ratio));
                let mask = (1.0 / (1.0 + odds)) as f32;
                row += mask;
                if let Some(out) = self.planes.mask.get_mut(index) {
                    *out = mask;
                }
            }
            sum += row;
        }
        (covered, sum)
    }

    /// Prior probability that the surface is hidden at a pixel.
    fn hidden(&self, hit: &Hit) -> f32 {
        let model = self.problem.model;
        let Some(corners) = model.triangles.get(hit.triangle) else { return 0.5 };
        let [second, third] = hit.weights;
        let [a, b, c] = corners.map(|v| model.shape.mean_at(v as usize));
        let place = add(add(scale(a, 1.0 - second - third), scale(b, second)), scale(c, third));
        self.hiding.at(place)
    }
}
