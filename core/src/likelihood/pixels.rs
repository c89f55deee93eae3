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
use crate::render::shade::{self, Places, Planes, Shader};
use crate::render::{LANES, chunks};
use crate::workspace::Carver;

/// Words of memory [`Target`] needs; while it is made, [`background::HISTOGRAM_LEN`] more.
pub const fn target_words(width: usize, height: usize) -> usize {
    4 * LANES * chunks(width, height)
}

/// Words of memory of three numbers per pixel.
pub const fn planes_words(width: usize, height: usize) -> usize {
    3 * LANES * chunks(width, height)
}

/// Log normaliser of the pixel's Gaussian, three channels.
pub fn ln_normaliser(sd: f64) -> f64 {
    -1.5 * LN_2PI - 3.0 * math::ln(sd)
}

/// The picture to be explained: colours, and the log density of each under the background.
pub struct Target<'w> {
    /// In `[0, 1]`.
    colors: &'w mut [Planes],
    ln_background: &'w mut [[f32; LANES]],
    /// Chunks per row.
    stride: usize,
}

impl<'w> Target<'w> {
    /// Takes the memory and fills it from 8-bit pixels, rows of `width`; `None` if there is too
    /// little.
    pub fn carve(carver: &mut Carver<'w>, pixels: &[[u8; 3]], width: usize) -> Option<Self> {
        let height = pixels.len().checked_div(width)?;
        let colors = carver.planes(width, height)?;
        let (ln_background, _) =
            carver.floats(LANES * chunks(width, height))?.as_chunks_mut::<LANES>();
        let histogram = carver.scratch(background::HISTOGRAM_LEN)?;
        histogram.fill(0);
        background::count(pixels, histogram);
        colors.fill([[0.0; LANES]; 3]);
        ln_background.fill([0.0; LANES]);
        let stride = chunks(width, 1);
        for (y, row) in pixels.chunks_exact(width).enumerate() {
            for (x, &pixel) in row.iter().enumerate() {
                let (chunk, lane) = (y * stride + x / LANES, x % LANES);
                for (plane, c) in colors[chunk].iter_mut().zip(pixel) {
                    plane[lane] = f32::from(c) / 255.0;
                }
                let count = histogram[background::bin(pixel)];
                ln_background[chunk][lane] = background::ln_density(count, pixels.len());
            }
        }
        Some(Self { colors, ln_background, stride })
    }

    /// Colour of a pixel; black outside the picture.
    pub fn color(&self, x: usize, y: usize) -> [f32; 3] {
        match self.colors.get(y * self.stride + x / LANES) {
            Some(planes) => planes.map(|plane| plane[x % LANES]),
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

    /// The residual at which the log likelihood is `floor`.
    pub fn limit(&self, floor: f64, sd: f32) -> f64 {
        let sd = f64::from(sd);
        (self.ln_likelihood(0.0, sd as f32) - floor) * (2.0 * sd * sd)
    }

    /// Root mean square colour difference per channel over the covered pixels, `[0, 1]` units.
    pub fn rmse(&self, residual: f64) -> f64 {
        math::sqrt_f64(residual / (3 * self.pixels.max(1)) as f64)
    }
}

/// What of a surface's attributes per pixel is out of date.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stale {
    /// Nothing: only light or colour transform have changed.
    Nothing,
    /// The albedo.
    Albedo,
    /// Normals and albedo.
    Everything,
}

/// A visible surface.
pub struct Surface<'s, 'w> {
    /// What is visible where.
    pub frame: &'s Frame<'w>,
    /// The mesh's faces.
    pub triangles: Triangles<'s>,
    /// Unit normals (model frame) and albedo of the vertices.
    pub vertices: [&'s [[f32; 4]]; 2],
}

/// Sum of squared colour differences between a surface and the picture over the covered pixels,
/// all channels. `pixels` are its normals and albedo, whose `stale` part is computed on the way.
///
/// Gives up with `None` as soon as the sum is certain to exceed `limit`: differences only add up.
/// Then some of `pixels` are still stale.
#[inline(always)]
pub fn residual(
    surface: &Surface<'_, '_>,
    stale: Stale,
    pixels: [&mut [Planes]; 2],
    shader: &Shader,
    target: &Target<'_>,
    limit: f64,
) -> Option<f64> {
    match surface.triangles {
        Triangles::U16(t) => residual_of(t, surface, stale, pixels, shader, target, limit),
        Triangles::U32(t) => residual_of(t, surface, stale, pixels, shader, target, limit),
    }
}

#[inline(always)]
fn residual_of<I: Index>(
    triangles: &[[I; 3]],
    &Surface { frame, vertices, .. }: &Surface<'_, '_>,
    stale: Stale,
    [normals, albedo]: [&mut [Planes]; 2],
    shader: &Shader,
    target: &Target<'_>,
    limit: f64,
) -> Option<f64> {
    let mut residual = 0.0_f64;
    for y in frame.rows() {
        // A loop of its own: what is stored piecemeal here has arrived when the next loop loads it
        // in wide vectors.
        if stale != Stale::Nothing {
            for index in frame.row(y) {
                let (Some(normals), Some(albedo)) = (normals.get_mut(index), albedo.get_mut(index))
                else {
                    continue;
                };
                if frame.covered(index) == 0 {
                    continue;
                }
                let places = Places::new(triangles, frame.chunk(index));
                if stale == Stale::Everything {
                    places.interpolate(vertices[0], normals);
                }
                places.interpolate(vertices[1], albedo);
            }
        }
        let mut sums = [0.0_f32; LANES];
        for index in frame.row(y) {
            let covered = frame.covered(index);
            let (Some(normals), Some(albedo), Some(observed)) =
                (normals.get_mut(index), albedo.get(index), target.colors.get(index))
            else {
                continue;
            };
            if covered == 0 {
                continue;
            }
            if stale == Stale::Everything {
                *normals = shade::normalize(*normals);
            }
            // Values, not references: what does not overlap needs no proof of it.
            let squares = differences(*normals, *albedo, shader, *observed);
            for l in 0..LANES {
                sums[l] += if covered >> l & 1 != 0 { squares[l] } else { 0.0 };
            }
        }
        residual += f64::from(sum(sums));
        if residual > limit {
            return None;
        }
    }
    (residual <= limit).then_some(residual)
}

/// Squared differences of a chunk's colours from the picture's.
#[inline(always)]
fn differences(
    [nx, ny, nz]: Planes,
    [ar, ag, ab]: Planes,
    shader: &Shader,
    [r, g, b]: Planes,
) -> [f32; LANES] {
    let mut squares = [0.0; LANES];
    for l in 0..LANES {
        let color = shader.color([nx[l], ny[l], nz[l]], [ar[l], ag[l], ab[l]]);
        let d = [color[0] - r[l], color[1] - g[l], color[2] - b[l]];
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
