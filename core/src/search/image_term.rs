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
//! Light is not as simple as the model has it: shadows are cast, folds are dark, skin shines. So `ℓ` is of
//! a rendering that may be brighter or darker by a smooth shade `t`: of the mean difference `m` of the
//! channels `m² − m t` counts in place of `m²`, with `t = SHADE_SHARE · v/√B · G'(ω v m/√B)`, where
//! `v = 1 − ε` and `B = G'(ω v)` by the wider Gaussian `G'`. (It is what is left of a normal prior over smooth
//! shades when their best value is put in.) Without it, what the light cannot explain bends the surface
//! and paints the skin. Large differences, beyond `SHADE_MOST`, are no shade.
//!
//! A lone pixel may show anything, unless it is never hidden: `ℓ` is `ln(exp ℓ + exp −HOPELESS)`,
//! and `w` times the first summand's share.

use super::common::Common;
use super::evidence::{Evidence, Planes};
use super::instance::at;
use super::occlusion;
use super::picture;
use super::shading::Shading;
use crate::likelihood::background::HISTOGRAM_LEN;
use crate::likelihood::pixels::ln_normaliser;
use crate::math;
use crate::render::rasterize::Hit;
use crate::vector::{Vec3, dot, sub};

/// Standard deviation, pixels, over which neighbouring pixels are judged together whether they show
/// the face: some hundred pixels, the order of the patch that shares one error (docs/accuracy.md, "What is
/// minimised").
const COHERENCE: f32 = 3.0;
/// Log of the odds against the face, at most, that one pixel's colour can be (docs/accuracy.md, there too).
pub(super) const HOPELESS: f32 = 12.0;
/// `ℓ` from which on that makes no difference: `exp −HOPELESS` is then less than the last digit of `exp ℓ`.
const CERTAIN: f32 = 6.0;
/// Standard deviation, pixels, over which light and surface may be too bright or too dark together; at
/// most [`picture::MAX_BLUR`]. Measured, like the next two (docs/accuracy.md, "Shade").
pub(super) const SHADE: f32 = 5.7;
/// Share of such a difference that is no fault of what is sought.
pub(super) const SHADE_SHARE: f32 = 0.8;
/// The most of a pixel's difference that counts towards it, in standard deviations of a channel.
const SHADE_MOST: f32 = 1.5;
/// Cosine of the angle to the line of sight from which on a surface has its full say. Chosen, not measured.
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

    /// What a shade adds, given the product of it and of the mean difference it is made of.
    #[inline(always)]
    pub(super) fn of_shade(self, product: f32) -> f32 {
        3.0 * self.k * product
    }
}

/// How much a surface says that is seen at an angle of this cosine.
#[inline(always)]
pub(super) fn says(cosine: f32) -> f32 {
    (cosine * (1.0 / FACING)).clamp(0.0, 1.0)
}

impl Evidence<'_, '_> {
    /// The background is what the picture holds outside of where the landmarks put the face.
    #[inline(never)]
    pub(super) fn look_outside(&mut self, memory: &mut [f32]) {
        let width = self.width();
        let frame = &self.frame;
        let outside = |i: usize| {
            let (x, y) = (i % width.max(1), i / width.max(1));
            frame.hit(x, y).is_none()
        };
        let ln = &mut *self.planes.ln_background;
        ln.fill(0.0);
        if let Some(histogram) = memory.get_mut(..HISTOGRAM_LEN) {
            picture::ln_background(self.photo.image.pixels, outside, histogram, ln);
        }
    }

    /// Log density of the whole picture, were all of it background.
    pub(super) fn ln_background(&self) -> f64 {
        self.planes.ln_background.iter().map(|&x| f64::from(x)).sum()
    }

    /// Compares what has been rendered with the photo: fills mask and weights, and gives the image
    /// term; `None` if nothing is covered. `memory` has room for three planes.
    #[inline(never)]
    pub(super) fn compare(&mut self, common: &Common<'_, '_>, memory: &mut [f32]) -> Option<f64> {
        let pixels = self.planes.mask.len();
        let (ratios, rest) = memory.split_at_mut_checked(pixels)?;
        let (near, spare) = rest.split_at_mut_checked(pixels)?;
        let width = self.width();
        let covered = self.compare_pixels(common, ratios, near, spare);
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
                let hidden = self.hidden(common, &hit);
                let say = at(self.planes.weights, index);
                let around = at(near, index).max(1e-6);
                let ratio = at(ratios, index) / around;
                let (ln, mask) = mixture(ratio, hidden);
                row += f64::from(say) * f64::from(ln);
                row_says += say;
                set(near, index, say * mask / around);
                let mask = mask * self.photo.open_at(index);
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
        Some(-sum * f64::from(share / common.patch()))
    }

    /// Fills the rendering, the weights with what the covered pixels have to say, the mask with the
    /// share of the face in it, and two planes with `ωℓ` and `ω`; gives the number of covered pixels.
    #[inline(never)]
    fn compare_pixels(
        &mut self,
        common: &Common<'_, '_>,
        ratios: &mut [f32],
        near: &mut [f32],
        spare: &mut [f32],
    ) -> usize {
        let covered = self.draw(common);
        let seen = |hit: &Hit| 1.0 - self.hidden(common, hit);
        self.find_shares(seen, self.planes.weights, near, spare);
        self.find_shade(common, self.planes.weights, near, ratios, spare);
        near.fill(0.0);
        self.planes.mask.fill(0.0);
        let (width, ln) = (self.width(), LogRatio::new(common.sd()));
        for y in self.frame.rows() {
            for x in self.frame.columns() {
                let index = y * width + x;
                let Some(hit) = self.frame.hit(x, y) else {
                    set(ratios, index, 0.0);
                    continue;
                };
                let say = at(self.planes.weights, index);
                let shade = at(ratios, index);
                let difference = self.difference(index);
                let ratio = ln.of(difference, at(self.planes.ln_background, index))
                    + ln.of_shade(self.shaded(common, index) * shade);
                let doubtful = ratio < CERTAIN && self.hidden(common, &hit) > 0.0;
                let (ratio, own) = if doubtful { bounded(ratio) } else { (ratio, 1.0) };
                set(ratios, index, say * ratio);
                set(near, index, say);
                // Never nought: that is where nothing is covered.
                set(self.planes.mask, index, own.max(f32::MIN_POSITIVE));
            }
        }
        covered
    }

    /// Fills the rendering, and the weights with what the covered pixels have to say; gives the
    /// number of covered pixels.
    #[inline(never)]
    pub(super) fn draw(&mut self, common: &Common<'_, '_>) -> usize {
        let (width, shading) = (self.width(), Shading::new(&self.view));
        let Planes { rendering, weights, .. } = &mut self.planes;
        weights.fill(0.0);
        for plane in rendering {
            plane.fill(f32::NAN);
        }
        let mut covered = 0;
        for y in self.frame.rows() {
            for x in self.frame.columns() {
                let Some(hit) = self.frame.hit(x, y) else { continue };
                let index = y * width + x;
                let Some((_, point)) = common.point(&shading, &hit) else { continue };
                let Planes { weights, rendering, .. } = &mut self.planes;
                for (plane, value) in rendering.iter_mut().zip(point.color) {
                    set(plane, index, value);
                }
                set(weights, index, self.photo.open_at(index) * says(shading.facing(&point)));
                covered += 1;
            }
        }
        covered
    }

    /// Photo minus rendering at a pixel.
    #[inline(always)]
    pub(super) fn difference(&self, index: usize) -> Vec3 {
        let [r, g, b] = &self.planes.rendering;
        sub(self.photo_at(index), [at(r, index), at(g, index), at(b, index)])
    }

    /// What a pixel's mean difference counts towards shade.
    #[inline(always)]
    pub(super) fn shaded(&self, common: &Common<'_, '_>, index: usize) -> f32 {
        let most = shade_most(common.sd());
        mean(self.difference(index)).max(-most).min(most)
    }

    /// Whether that is all of it.
    #[inline(always)]
    pub(super) fn is_shaded(&self, common: &Common<'_, '_>, index: usize) -> bool {
        mean(self.difference(index)).abs() < shade_most(common.sd())
    }

    /// Calls `f` with the pixels of the face's box, and what is visible there.
    #[inline(never)]
    fn pixels(&self, f: &mut dyn FnMut(usize, Option<Hit>)) {
        let width = self.width();
        for y in self.frame.rows() {
            for x in self.frame.columns() {
                f(y * width + x, self.frame.hit(x, y));
            }
        }
    }

    /// `ω` of a pixel of what has been rendered.
    #[inline(never)]
    fn said(&self, common: &Common<'_, '_>, shading: &Shading, index: usize, hit: &Hit) -> f32 {
        let point = common.point(shading, hit);
        let says = point.map_or(0.0, |(_, point)| says(shading.facing(&point)));
        self.photo.open_at(index) * says
    }

    /// Blurs a plane by shade's width.
    fn spread(&self, plane: &mut [f32], spare: &mut [f32]) {
        let face = [self.frame.columns(), self.frame.rows()];
        picture::blur_box(plane, spare, self.width(), face, SHADE);
    }

    /// Fills `shares` with `v/√B`, given `ω`; 0 where nothing is covered.
    #[inline(never)]
    pub(super) fn find_shares(
        &self,
        seen: impl Fn(&Hit) -> f32,
        said: &[f32],
        shares: &mut [f32],
        spare: &mut [f32],
    ) {
        let seen = |hit: Option<Hit>| hit.map_or(0.0, |hit| seen(&hit));
        self.pixels(&mut |index, hit| set(shares, index, at(said, index) * seen(hit)));
        self.spread(shares, spare);
        self.pixels(&mut |index, hit| {
            let sum = at(shares, index).max(1e-6);
            set(shares, index, seen(hit) * math::rsqrt(sum));
        });
    }

    /// Fills `to` with `SHADE_SHARE · v/√B · G'(weight · v m/√B)`.
    #[inline(never)]
    pub(super) fn find_shade(
        &self,
        common: &Common<'_, '_>,
        weights: &[f32],
        shares: &[f32],
        to: &mut [f32],
        spare: &mut [f32],
    ) {
        self.pixels(&mut |index, hit| {
            let difference = hit.map_or(0.0, |_| self.shaded(common, index));
            set(to, index, at(weights, index) * at(shares, index) * difference);
        });
        self.spread(to, spare);
        self.pixels(&mut |index, _| {
            set(to, index, SHADE_SHARE * at(shares, index) * at(to, index));
        });
    }

    /// Fills the first plane with what shade takes off a pixel's weighted difference; what it takes
    /// from the others' is half of it, so `½ (w t + ω t')`, where `t'` is made with `w` for `ω`. The
    /// other planes are scratch.
    #[inline(never)]
    pub(super) fn find_taken(&self, common: &Common<'_, '_>, planes: [&mut [f32]; 5]) {
        let [taken, said, shares, other, spare] = planes;
        let shading = Shading::new(&self.view);
        self.pixels(&mut |index, hit| {
            let said_here = hit.map_or(0.0, |hit| self.said(common, &shading, index, &hit));
            set(said, index, said_here);
        });
        let seen = |hit: &Hit| 1.0 - self.hidden(common, hit);
        self.find_shares(seen, said, shares, spare);
        let weights = &*self.planes.weights;
        self.find_shade(common, said, shares, taken, spare);
        self.find_shade(common, weights, shares, other, spare);
        self.pixels(&mut |index, _| {
            let [w, said] = [at(weights, index), at(said, index)];
            let both = 0.5 * (w * at(taken, index) + said * at(other, index));
            set(taken, index, if self.is_shaded(common, index) { both } else { 0.0 });
        });
    }

    /// Prior probability that the surface is hidden at a pixel.
    pub(super) fn hidden(&self, common: &Common<'_, '_>, hit: &Hit) -> f32 {
        let Some(corners) = common.problem.model.triangles.get(hit.triangle) else { return 0.5 };
        let [a, b, c] = corners.map(|v| f32::from(at(self.hidden, v as usize)));
        let [second, third] = hit.weights;
        ((1.0 - second - third) * a + second * b + third * c) * (1.0 / occlusion::WHOLE)
    }

    /// Eyes around which most is seen, by the mask as it is, are never hidden.
    #[inline(never)]
    pub(super) fn look_at_eyes(&mut self, common: &Common<'_, '_>) {
        let model = common.problem.model;
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

/// The most of a difference that counts towards shade, given a channel's standard deviation.
pub(super) fn shade_most(sd: f32) -> f32 {
    SHADE_MOST * sd
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

pub(super) fn mean([r, g, b]: Vec3) -> f32 {
    (1.0 / 3.0) * (r + g + b)
}

pub(super) fn set(plane: &mut [f32], index: usize, value: f32) {
    if let Some(to) = plane.get_mut(index) {
        *to = value;
    }
}
