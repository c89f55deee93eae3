//! Image likelihood over the pixels the model covers, from visible fragments.
//!
//! `L = Σ_covered [ N_σ − ‖ΔRGB‖²/(2σ²) − log background ]`, `N_σ = −3/2·log 2π − 3 log σ`
//! (the reference engine's coded normaliser lacks the ½ in front of the third `log 2π`; this is
//! the density's own). Terms are summed per row in f32 and across rows in f64.

use super::background;
use super::normal::LN_2PI;
use crate::lanes::{LANES, Planes, chunks};
use crate::math;
use crate::memory::Carver;
use crate::mesh::Index;
use crate::model::Triangles;
use crate::render::rasterize::Frame;
use crate::render::shade::{self, Attributes, Shader};

/// Words of memory [`Target`] needs; while it is made, [`background::HISTOGRAM_LEN`] more.
pub const fn target_words(width: usize, height: usize) -> usize {
    (LANES + 3 * LANES / 4) * chunks(width, height)
}

/// Log normaliser of the pixel's Gaussian, three channels.
pub fn ln_normaliser(sd: f64) -> f64 {
    -1.5 * LN_2PI - 3.0 * math::ln(sd)
}

/// The 8-bit value of the colour 1.
const WHITE: f32 = 255.0;

/// The picture to be explained: colours, and the log density of each under the background.
pub struct Target<'w> {
    /// 8-bit.
    colors: &'w mut [[[u8; LANES]; 3]],
    ln_background: &'w mut [[f32; LANES]],
    /// Chunks per row.
    stride: usize,
}

impl<'w> Target<'w> {
    /// Takes the memory and fills it from 8-bit pixels, rows of `width`; `None` if there is too
    /// little.
    pub fn carve(carver: &mut Carver<'w>, pixels: &[[u8; 3]], width: usize) -> Option<Self> {
        let height = pixels.len().checked_div(width)?;
        let count = chunks(width, height);
        let colors = carver.bytes(3 * LANES / 4 * count)?.as_chunks_mut().0.as_chunks_mut().0;
        let ln_background = carver.floats(LANES * count)?.as_chunks_mut().0;
        let histogram = carver.scratch(background::HISTOGRAM_LEN)?;
        histogram.fill(0);
        background::count(pixels, histogram);
        colors.fill([[0; LANES]; 3]);
        ln_background.fill([0.0; LANES]);
        let stride = chunks(width, 1);
        for (y, row) in pixels.chunks_exact(width).enumerate() {
            for (x, pixels_of_chunk) in row.chunks(LANES).enumerate() {
                let at = y * stride + x;
                let chunk = (colors.get_mut(at), ln_background.get_mut(at));
                let (Some(planes), Some(ln_background)) = chunk else { continue };
                for (lane, &pixel) in (0..LANES).zip(pixels_of_chunk) {
                    for (plane, c) in planes.iter_mut().zip(pixel) {
                        plane[lane] = c;
                    }
                    let count = histogram.get(background::bin(pixel)).copied().unwrap_or(0);
                    ln_background[lane] = background::ln_density(count, pixels.len());
                }
            }
        }
        Some(Self { colors, ln_background, stride })
    }

    /// Colour of a pixel; black outside the picture.
    pub fn color(&self, x: usize, y: usize) -> [f32; 3] {
        match self.colors.get(y * self.stride + x / LANES) {
            Some(planes) => planes.map(|plane| f32::from(plane[x % LANES]) / WHITE),
            None => [0.0; 3],
        }
    }
}

/// How much of the picture something covers, and what the background would have said there.
#[derive(Clone, Copy, Debug, Default)]
pub struct Coverage {
    /// Covered pixels.
    pub pixels: usize,
    /// Their log density under the background.
    ln_background: f64,
}

impl Coverage {
    /// Counts the covered pixels of a frame.
    #[inline(always)]
    pub fn of(frame: &Frame<'_>, target: &Target<'_>) -> Self {
        let mut coverage = Self::default();
        for y in frame.rows() {
            let mut sums = [0.0_f32; LANES];
            for index in frame.row(y) {
                let covered = frame.covered(index);
                let Some(ln_background) = target.ln_background.get(index) else { continue };
                for l in 0..LANES {
                    sums[l] += if covered >> l & 1 != 0 { ln_background[l] } else { 0.0 };
                }
                coverage.pixels += covered.count_ones() as usize;
            }
            coverage.ln_background += f64::from(sum(sums));
        }
        coverage
    }

    /// Log likelihood of a picture that differs from the model by `residual`, see [`residual`].
    /// −∞ if nothing is covered.
    pub fn ln_likelihood(&self, residual: f64, sd: f32) -> f64 {
        let sd = f64::from(sd);
        if self.pixels == 0 {
            return f64::NEG_INFINITY;
        }
        self.pixels as f64 * ln_normaliser(sd) - self.ln_background - residual / (2.0 * sd * sd)
    }

    /// The residual at which the log likelihood is `floor`: a larger one is less likely than that.
    pub fn limit(&self, floor: f64, sd: f32) -> f64 {
        let sd = f64::from(sd);
        (self.ln_likelihood(0.0, sd as f32) - floor) * (2.0 * sd * sd)
    }

    /// Root mean square colour difference per channel over the covered pixels, `[0, 1]` units.
    pub fn rmse(&self, residual: f64) -> f64 {
        math::sqrt_f64(residual / (3 * self.pixels.max(1)) as f64)
    }
}

/// A mesh as it was rasterized.
pub struct Rasterized<'s, 'w> {
    /// What is visible where.
    pub frame: &'s Frame<'w>,
    /// The mesh's faces.
    pub triangles: Triangles<'s>,
    /// The vertices' normals and albedo.
    pub vertices: &'s [Attributes],
}

/// Normals and albedo of a mesh at every pixel of the picture, as far as they are known.
#[derive(Clone, Copy, Default)]
pub struct Known<'s> {
    /// Unit normals, model frame.
    pub normals: Option<&'s [Planes]>,
    /// Albedo.
    pub albedo: Option<&'s [Planes]>,
}

/// Interpolates a mesh's normals, if given a place for them, and its albedo.
#[inline(always)]
pub fn interpolate(
    rasterized: &Rasterized<'_, '_>,
    normals: Option<&mut [Planes]>,
    albedo: &mut [Planes],
) {
    match rasterized.triangles {
        Triangles::U16(t) => interpolate_of(t, rasterized, normals, albedo),
        Triangles::U32(t) => interpolate_of(t, rasterized, normals, albedo),
    }
}

#[inline(always)]
fn interpolate_of<I: Index>(
    triangles: &[[I; 3]],
    &Rasterized { frame, vertices, .. }: &Rasterized<'_, '_>,
    mut normals: Option<&mut [Planes]>,
    albedo: &mut [Planes],
) {
    for index in frame.rows().flat_map(|y| frame.row(y)) {
        let (Some(albedo), Some(visible)) = (albedo.get_mut(index), frame.chunk(index)) else {
            continue;
        };
        if let Some(normals) = normals.as_deref_mut().and_then(|normals| normals.get_mut(index)) {
            shade::interpolate::<_, 8>(triangles, visible, vertices, &mut [normals, albedo]);
            *normals = shade::normalize(*normals);
        } else {
            shade::interpolate::<_, 4>(triangles, visible, vertices, &mut [albedo]);
        }
    }
}

/// Sum of squared colour differences between a mesh and the picture over the covered pixels,
/// all channels. What of its attributes is not known is interpolated on the way.
///
/// Gives up with `None` as soon as the sum is certain to exceed `limit`: differences only add up.
#[inline(always)]
pub fn residual(
    rasterized: &Rasterized<'_, '_>,
    known: Known<'_>,
    shader: &Shader,
    target: &Target<'_>,
    limit: f64,
) -> Option<f64> {
    match rasterized.triangles {
        Triangles::U16(t) => residual_of(t, rasterized, known, shader, target, limit),
        Triangles::U32(t) => residual_of(t, rasterized, known, shader, target, limit),
    }
}

/// Chunks that are interpolated before they are shaded: enough that what is stored piecemeal has
/// arrived when it is loaded in wide vectors.
const BATCH: usize = 8;

#[inline(always)]
fn residual_of<I: Index>(
    triangles: &[[I; 3]],
    &Rasterized { frame, vertices, .. }: &Rasterized<'_, '_>,
    known: Known<'_>,
    shader: &Shader,
    target: &Target<'_>,
    limit: f64,
) -> Option<f64> {
    // In the picture's 8-bit units.
    let shader = &shader.scaled(WHITE);
    let unit = f64::from(WHITE * WHITE);
    let limit = limit * unit;
    let mut residual = 0.0_f64;
    let mut normals = [Planes::default(); BATCH];
    let mut albedo = [Planes::default(); BATCH];
    for y in frame.rows() {
        let row = frame.row(y);
        let mut sums = [0.0_f32; LANES];
        for first in row.clone().step_by(BATCH) {
            let batch = || (first..row.end).take(BATCH).enumerate();
            if known.albedo.is_none() {
                for (i, index) in batch() {
                    let Some(visible) = frame.chunk(index) else { continue };
                    let albedo = &mut albedo[i];
                    if known.normals.is_none() {
                        let planes = &mut [&mut normals[i], albedo];
                        shade::interpolate::<_, 8>(triangles, visible, vertices, planes);
                    } else {
                        shade::interpolate::<_, 4>(triangles, visible, vertices, &mut [albedo]);
                    }
                }
            }
            for (i, index) in batch() {
                let (covered, Some(observed)) = (frame.covered(index), target.colors.get(index))
                else {
                    continue;
                };
                if covered == 0 {
                    continue;
                }
                if known.normals.is_none() {
                    normals[i] = shade::normalize(normals[i]);
                }
                let n = known.normals.map_or(Some(&normals[i]), |known| known.get(index));
                let a = known.albedo.map_or(Some(&albedo[i]), |known| known.get(index));
                let (Some(n), Some(a)) = (n, a) else { continue };
                let squares = differences(n, a, shader, observed);
                for l in 0..LANES {
                    sums[l] += if covered >> l & 1 != 0 { squares[l] } else { 0.0 };
                }
            }
        }
        residual += f64::from(sum(sums));
        if residual > limit {
            return None;
        }
    }
    (residual <= limit).then_some(residual / unit)
}

/// Squared differences of a chunk's colours from the picture's.
#[inline(always)]
fn differences(
    [nx, ny, nz]: &Planes,
    [ar, ag, ab]: &Planes,
    shader: &Shader,
    [r, g, b]: &[[u8; LANES]; 3],
) -> [f32; LANES] {
    let mut squares = [0.0; LANES];
    for l in 0..LANES {
        let color = shader.color([nx[l], ny[l], nz[l]], [ar[l], ag[l], ab[l]]);
        let observed = [r[l], g[l], b[l]].map(f32::from);
        let d = [color[0] - observed[0], color[1] - observed[1], color[2] - observed[2]];
        squares[l] = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    }
    squares
}

/// Sum of the lanes, halves first.
#[inline(always)]
fn sum(mut lanes: [f32; LANES]) -> f32 {
    let mut half = LANES / 2;
    while half > 0 {
        for l in 0..half {
            lanes[l] += lanes[l + half];
        }
        half /= 2;
    }
    lanes[0]
}
