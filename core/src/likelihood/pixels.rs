//! Image likelihood over the pixels the model covers, from visible fragments.
//!
//! `L = Σ_covered [ N_σ − ‖ΔRGB‖²/(2σ²) − log background ]`, `N_σ = −3/2·log 2π − 3 log σ`
//! (the reference engine's coded normaliser lacks the ½ in front of the third `log 2π`; this is
//! the density's own). Terms are summed per row in f32 and across rows in f64.

use super::{LN_2PI, background};
use crate::math;
use crate::mesh::Index;
use crate::model::Triangles;
use crate::render::rasterize::Frame;
use crate::render::shade::interpolate;
use crate::workspace::Carver;

/// Words of memory one [`Fragments`] needs.
pub const fn fragments_words(width: usize, height: usize) -> usize {
    6 * width * height + height
}

/// Words of memory [`Target`] needs; while it is made, [`background::HISTOGRAM_LEN`] more.
pub const fn target_words(width: usize, height: usize) -> usize {
    5 * width * height
}

/// Log normaliser of the pixel's Gaussian, three channels.
pub fn ln_normaliser(sd: f64) -> f64 {
    -1.5 * LN_2PI - 3.0 * math::ln(sd)
}

/// The picture to be explained: colours, and the log density of each under the background.
pub struct Target<'w> {
    /// `[R, G, B, 0]` in `[0, 1]`.
    colors: &'w mut [[f32; 4]],
    ln_background: &'w mut [f32],
}

impl<'w> Target<'w> {
    /// Takes the memory and fills it from 8-bit pixels; `None` if there is too little.
    pub fn carve(carver: &mut Carver<'w>, pixels: &[[u8; 3]]) -> Option<Self> {
        let colors = carver.quads(pixels.len())?;
        let ln_background = carver.floats(pixels.len())?;
        let histogram = carver.scratch(background::HISTOGRAM_LEN)?;
        histogram.fill(0);
        background::count(pixels, histogram);
        for ((&pixel, color), ln) in pixels.iter().zip(&mut *colors).zip(&mut *ln_background) {
            let [r, g, b] = pixel.map(|c| f32::from(c) / 255.0);
            *color = [r, g, b, 0.0];
            *ln = background::ln_density(histogram[background::bin(pixel)], pixels.len());
        }
        Some(Self { colors, ln_background })
    }

    /// Colours, `[R, G, B, 0]` per pixel.
    pub fn colors(&self) -> &[[f32; 4]] {
        self.colors
    }
}

/// One visible surface sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fragment {
    /// Vertices of the visible triangle.
    pub corners: [u32; 3],
    /// Weights of the second and third corner.
    pub weights: [f32; 2],
    /// Index of the pixel.
    pub pixel: u32,
}

/// The covered pixels of one geometry, row by row.
pub struct Fragments<'w> {
    /// Three corners and the pixel.
    indices: &'w mut [[u32; 4]],
    weights: &'w mut [[f32; 2]],
    /// Number of fragments up to and including each row.
    row_ends: &'w mut [u32],
    len: usize,
    /// `Σ (N_σ − log background)`: the image likelihood of a perfect match.
    ceiling: f64,
}

impl<'w> Fragments<'w> {
    /// Takes the memory for a picture; `None` if there is too little. Holds nothing.
    pub fn carve(carver: &mut Carver<'w>, width: usize, height: usize) -> Option<Self> {
        Some(Self {
            indices: carver.word_quads(width * height)?,
            weights: carver.pairs(width * height)?,
            row_ends: carver.words(height)?,
            len: 0,
            ceiling: f64::NEG_INFINITY,
        })
    }

    /// Number of covered pixels.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether nothing is covered.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Fragment number `index`, `None` past the end.
    pub fn get(&self, index: usize) -> Option<Fragment> {
        let &[a, b, c, pixel] = self.indices[..self.len].get(index)?;
        Some(Fragment { corners: [a, b, c], weights: self.weights[index], pixel })
    }

    /// Collects what is visible in `frame`.
    pub fn collect(
        &mut self,
        frame: &Frame<'_>,
        triangles: Triangles<'_>,
        target: &Target<'_>,
        sd: f32,
    ) {
        match triangles {
            Triangles::U16(t) => self.collect_from(frame, t, target, sd),
            Triangles::U32(t) => self.collect_from(frame, t, target, sd),
        }
    }

    fn collect_from<I: Index>(
        &mut self,
        frame: &Frame<'_>,
        triangles: &[[I; 3]],
        target: &Target<'_>,
        sd: f32,
    ) {
        let normaliser = ln_normaliser(f64::from(sd)) as f32;
        self.len = 0;
        self.ceiling = 0.0;
        self.row_ends.fill(0);
        for row in frame.rows() {
            let mut ceiling = 0.0_f32;
            for hit in frame.row(row) {
                let Some(corners) = triangles.get(hit.triangle) else { continue };
                let [a, b, c] = corners.map(|corner| corner.index() as u32);
                self.indices[self.len] = [a, b, c, hit.pixel as u32];
                self.weights[self.len] = hit.weights;
                self.len += 1;
                ceiling += normaliser - target.ln_background[hit.pixel];
            }
            self.ceiling += f64::from(ceiling);
            self.row_ends[row] = self.len as u32;
        }
        if self.len == 0 {
            self.ceiling = f64::NEG_INFINITY;
        }
    }

    /// Log likelihood of the picture given the vertex colours; −∞ if nothing is covered.
    ///
    /// Gives up with `None` as soon as the value is certain to be below `floor`: residuals only
    /// add up, so the rows seen so far bound it. The decision `value ≥ floor` is the same as with
    /// the whole sum.
    pub fn ln_likelihood(
        &self,
        shaded: &[[f32; 4]],
        target: &Target<'_>,
        sd: f32,
        floor: f64,
    ) -> Option<f64> {
        let precision = 0.5 / (f64::from(sd) * f64::from(sd));
        let mut residuals = 0.0_f64;
        let mut start = 0;
        for &end in &*self.row_ends {
            let end = end as usize;
            if end <= start {
                continue;
            }
            residuals += f64::from(row_residual(
                &self.indices[start..end],
                &self.weights[start..end],
                shaded,
                target.colors,
            ));
            start = end;
            if self.ceiling - residuals * precision < floor {
                return None;
            }
        }
        let value = self.ceiling - residuals * precision;
        (value >= floor).then_some(value)
    }

    /// Root mean square colour difference per channel over the covered pixels, `[0, 1]` units.
    pub fn rmse(&self, shaded: &[[f32; 4]], target: &Target<'_>) -> f64 {
        let sum = row_sums(self, shaded, target);
        math::sqrt_f64(sum / (3 * self.len.max(1)) as f64)
    }
}

fn row_sums(fragments: &Fragments<'_>, shaded: &[[f32; 4]], target: &Target<'_>) -> f64 {
    let mut sum = 0.0;
    let mut start = 0;
    for &end in &*fragments.row_ends {
        let end = (end as usize).max(start);
        let (indices, weights) = (&fragments.indices[start..end], &fragments.weights[start..end]);
        sum += f64::from(row_residual(indices, weights, shaded, target.colors));
        start = end;
    }
    sum
}

/// Sum of squared colour differences over the fragments of one row.
fn row_residual(
    indices: &[[u32; 4]],
    weights: &[[f32; 2]],
    shaded: &[[f32; 4]],
    target: &[[f32; 4]],
) -> f32 {
    let [r, g, b, _] = channel_residuals(indices, weights, shaded, target);
    r + g + b
}

/// The same per channel. A function of its own so that the compiler sees four lanes alike, and
/// not three that are going to be added.
#[inline(never)]
fn channel_residuals(
    indices: &[[u32; 4]],
    weights: &[[f32; 2]],
    shaded: &[[f32; 4]],
    target: &[[f32; 4]],
) -> [f32; 4] {
    let mut sums = [0.0_f32; 4];
    for (&[a, b, c, pixel], &w) in indices.iter().zip(weights) {
        let color = interpolate(shaded, [a, b, c], w);
        let observed = target[pixel as usize];
        for l in 0..4 {
            let d = color[l] - observed[l];
            sums[l] += d * d;
        }
    }
    sums
}
