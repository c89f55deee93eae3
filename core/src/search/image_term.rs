//! The image term, and what of a picture shows the face.
//!
//! The pixels around a covered pixel `p` show the face, `N(colour, σ²)`, or something before it,
//! distributed as the picture outside the face is (Egger et al. 2018; the paper's supplement). With
//! `ℓ = ln N − ln background` and `L = G(ωℓ)/Gω` its mean over the neighbours by a Gaussian `G`,
//! since what hides a face is larger than a pixel,
//!
//! `E = −N/Σω · 1/patch · Σ_p ω_p ln[(1 − ε_p) exp L_p + ε_p]`
//!
//! over the covered pixels. `ω` is what a pixel has to say: nothing where the caller knows that the
//! face is hidden, and less where the surface is seen from the side, so that pixels come and go
//! quietly at the outline. `N` is what `Σω` is by the landmarks' pose: to cover less is no gain.
//! The derivative weighs a pixel's squared difference by its neighbours' mask:
//!
//! `m_p = (1 − ε_p) exp L_p / [(1 − ε_p) exp L_p + ε_p]`, `w = N/Σω · ω G(ωm/Gω)`,
//!
//! at held coverage: `ω` and `ε` belong to the pixel, not to the surface that moves under it. What
//! lies beside the face has no model of its own, and much of it looks like the face (neck, ears,
//! hair), so the derivative by where the outline runs leads to faces that are larger or smaller
//! than the person's (docs/accuracy.md).
//!
//! A lone pixel may show anything, unless it is never hidden: `ℓ` is `ln(exp ℓ + exp −HOPELESS)`,
//! and `w` times the first summand's share.

use super::occlusion;
use super::picture;
use super::shading::Shading;
use super::state::{ModeSearch, Planes};
use super::surface::at;
use super::vector::{Vec3, dot, sub};
use crate::likelihood::background::HISTOGRAM_LEN;
use crate::likelihood::pixels::ln_normaliser;
use crate::math;
use crate::render::rasterize::Hit;
use crate::scene::Scene;

/// Standard deviation, pixels, over which neighbouring pixels are judged together whether they show
/// the face: some hundred pixels, the order of the patch that shares one error.
const COHERENCE: f32 = 3.0;
/// Log of the odds against the face, at most, that one pixel's colour can be.
const HOPELESS: f32 = 12.0;
/// `ℓ` from which on that makes no difference.
const CERTAIN: f32 = 6.0;
/// Cosine of the angle to the line of sight from which on a surface has its full say.
pub(super) const FACING: f32 = 0.3;

/// `ℓ` of pixels, by how far their colours are off.
#[derive(Clone, Copy)]
pub(super) struct LogRatio {
    /// `1/2σ²`.
    k: f32,
    normaliser: f32,
}

impl LogRatio {
    /// For a standard deviation per channel.
    pub(super) fn new(sd: f32) -> Self {
        Self { k: 1.0 / (2.0 * sd * sd), normaliser: ln_normaliser(f64::from(sd)) as f32 }
    }

    /// `ℓ` of a pixel with this difference of colours, and this log density under the background.
    #[inline(always)]
    pub(super) fn of(self, difference: Vec3, ln_background: f32) -> f32 {
        self.normaliser - self.k * dot(difference, difference) - ln_background
    }
}

/// How much a surface says that is seen at an angle of this cosine.
#[inline(always)]
pub(super) fn says(cosine: f32) -> f32 {
    (cosine * (1.0 / FACING)).clamp(0.0, 1.0)
}

impl ModeSearch<'_, '_> {
    /// The background is what the picture holds outside of where the landmarks put the face.
    #[inline(never)]
    pub(super) fn look_outside(&mut self) {
        let width = self.width();
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

    /// Compares what has been rendered of a scene with the photo: fills mask and weights, and gives
    /// the image term; `None` if the scene shows nothing. `memory` has room for three planes.
    #[inline(never)]
    pub(super) fn compare(&mut self, scene: &Scene, memory: &mut [f32]) -> Option<f64> {
        let pixels = self.planes.mask.len();
        let (ratios, rest) = memory.split_at_mut_checked(pixels)?;
        let (near, spare) = rest.split_at_mut_checked(pixels)?;
        let width = self.width();
        let covered = self.compare_pixels(scene, ratios, near);
        let face = [self.frame.columns(), self.frame.rows()];
        picture::blur_box(ratios, spare, width, face.clone(), COHERENCE);
        picture::blur_box(near, spare, width, face.clone(), COHERENCE);
        let (mut sum, mut says, mut visible) = (0.0, 0.0, 0.0);
        for y in self.frame.rows() {
            let (mut row, mut row_says, mut row_visible) = (0.0, 0.0, 0.0);
            for x in self.frame.columns() {
                let index = y * width + x;
                let Some(hit) = self.frame.hit(x, y) else {
                    set(near, index, 0.0);
                    continue;
                };
                let hidden = self.hidden(&hit);
                let say = at(self.planes.weights, index);
                let around = at(near, index).max(1e-6);
                let ratio = at(ratios, index) / around;
                let (ln, mask) = mixture(ratio, hidden);
                row += f64::from(say) * f64::from(ln);
                row_says += say;
                set(near, index, say * mask / around);
                let mask = mask * self.options.open_at(index);
                row_visible += mask;
                set(ratios, index, mask);
            }
            sum += row;
            says += row_says;
            visible += row_visible;
        }
        if !(says > 0.0) {
            return None;
        }
        if self.expected == 0.0 {
            self.expected = says;
        }
        self.seen = (covered, visible);
        let share = self.expected / says;
        picture::blur_box(near, spare, width, face, COHERENCE);
        let Planes { mask, weights, .. } = &mut self.planes;
        for ((weight, mask), (near, visible)) in
            weights.iter_mut().zip(mask.iter_mut()).zip(near.iter().zip(&*ratios))
        {
            *weight *= near * *mask * share;
            *mask = if *mask > 0.0 { *visible } else { 0.0 };
        }
        Some(-sum * f64::from(share / self.problem.config.pixel_patch))
    }

    /// Fills the rendering, the weights with what the covered pixels have to say, the mask with the
    /// share of the face in it, and two planes with `ωℓ` and `ω`; gives the number of covered pixels.
    fn compare_pixels(&mut self, scene: &Scene, ratios: &mut [f32], near: &mut [f32]) -> usize {
        let width = self.width();
        let ln = LogRatio::new(self.sd());
        let shading = Shading::new(scene);
        let Planes { mask, weights, rendering, .. } = &mut self.planes;
        for plane in [&mut **mask, weights, ratios, near] {
            plane.fill(0.0);
        }
        for plane in rendering {
            plane.fill(f32::NAN);
        }
        let mut covered = 0;
        for y in self.frame.rows() {
            for x in self.frame.columns() {
                let Some(hit) = self.frame.hit(x, y) else { continue };
                let index = y * width + x;
                let Some((_, point)) = self.point(&shading, &hit) else { continue };
                let difference = sub(self.photo(index), point.color);
                let ratio = ln.of(difference, at(self.planes.ln_background, index));
                let doubtful = ratio < CERTAIN && self.hidden(&hit) > 0.0;
                let (ratio, own) = if doubtful { bounded(ratio) } else { (ratio, 1.0) };
                let say = self.options.open_at(index) * says(shading.facing(&point));
                let Planes { mask, weights, rendering, .. } = &mut self.planes;
                for (plane, value) in rendering.iter_mut().zip(point.color) {
                    set(plane, index, value);
                }
                set(ratios, index, say * ratio);
                set(near, index, say);
                set(weights, index, say);
                // Never nought: that is where nothing is covered.
                set(mask, index, own.max(f32::MIN_POSITIVE));
                covered += 1;
            }
        }
        covered
    }

    /// Prior probability that the surface is hidden at a pixel.
    pub(super) fn hidden(&self, hit: &Hit) -> f32 {
        let Some(corners) = self.problem.model.triangles.get(hit.triangle) else { return 0.5 };
        let [a, b, c] = corners.map(|v| f32::from(at(self.hidden, v as usize)));
        let [second, third] = hit.weights;
        ((1.0 - second - third) * a + second * b + third * c) * (1.0 / occlusion::WHOLE)
    }

    /// Eyes around which most is seen, by the mask as it is, are never hidden.
    #[inline(never)]
    pub(super) fn look_at_eyes(&mut self) {
        let model = self.problem.model;
        let width = self.width();
        let eyes = occlusion::eyes(model);
        let mut balance = [0.0_f32; 2];
        for y in self.frame.rows() {
            for x in self.frame.columns() {
                let Some(hit) = self.frame.hit(x, y) else { continue };
                let Some([a, b, c]) = model.triangles.get(hit.triangle) else { continue };
                // A corner nearby will do.
                let [second, third] = hit.weights;
                let corner = if second > 0.5 {
                    b
                } else if third > 0.5 {
                    c
                } else {
                    a
                };
                let point = model.shape.mean_at(corner as usize);
                let seen = at(self.planes.mask, y * width + x);
                for (balance, eye) in balance.iter_mut().zip(eyes) {
                    if eye.is_some_and(|eye| eye.is_near(point)) {
                        *balance += seen - 0.5;
                    }
                }
            }
        }
        for (eye, balance) in eyes.into_iter().zip(balance) {
            let Some(eye) = eye.filter(|_| balance > 0.0) else { continue };
            for (vertex, hidden) in self.hidden.iter_mut().enumerate() {
                if eye.holds(model.shape.mean_at(vertex)) {
                    *hidden = occlusion::NEVER;
                }
            }
        }
    }
}

/// `ln(exp ℓ + exp −HOPELESS)` and the first summand's share.
pub(super) fn bounded(ratio: f32) -> (f32, f32) {
    let small = math::exp_f32(-(ratio + HOPELESS).abs());
    let (face, anything) = if ratio > -HOPELESS { (1.0, small) } else { (small, 1.0) };
    (ratio.max(-HOPELESS) + math::ln_f32(face + anything), face / (face + anything))
}

/// `ln[(1 − ε) exp L + ε]` and the first summand's share.
fn mixture(ratio: f32, hidden: f32) -> (f32, f32) {
    if hidden <= 0.0 {
        return (ratio, 1.0);
    }
    // Relative to the larger exponential.
    let small = math::exp_f32(-ratio.abs());
    let (face, other) =
        if ratio > 0.0 { (1.0 - hidden, hidden * small) } else { ((1.0 - hidden) * small, hidden) };
    (ratio.max(0.0) + math::ln_f32(face + other), face / (face + other))
}

fn set(plane: &mut [f32], index: usize, value: f32) {
    if let Some(to) = plane.get_mut(index) {
        *to = value;
    }
}
