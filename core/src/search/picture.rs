//! The photo as planes of numbers, at the resolution a level of the search looks at.

use crate::likelihood::background::{BINS, HISTOGRAM_LEN, bin};
use crate::math;
use core::ops::Range;

/// The widest blur, pixels: room for the levels' and for the shade's.
pub(super) const MAX_BLUR: f32 = 6.0;
/// Taps to each side of the widest blur: three standard deviations.
const REACH: usize = 18;

/// One half of a Gaussian, the centre first.
struct Kernel {
    taps: [f32; REACH + 1],
    reach: usize,
}

impl Kernel {
    fn new(sd: f32) -> Self {
        let mut taps = [0.0; REACH + 1];
        let reach = (math::ceil(3.0 * sd.min(MAX_BLUR)).max(0) as usize).min(REACH);
        for (i, tap) in taps.iter_mut().enumerate().take(reach + 1) {
            let x = i as f32 / sd;
            *tap = math::exp_f32(-0.5 * x * x);
        }
        Self { taps, reach }
    }

    /// `1 / Σ tap` of the taps that are on a line.
    fn scale(&self, place: usize, count: usize) -> f32 {
        let mut sum = self.taps[0];
        for (i, &tap) in self.taps.iter().enumerate().take(self.reach + 1).skip(1) {
            sum += if place >= i { tap } else { 0.0 };
            sum += if place + i < count { tap } else { 0.0 };
        }
        1.0 / sum
    }
}

/// Blurs a plane of `width`-long rows by a Gaussian of standard deviation `sd` pixels (at most
/// [`MAX_BLUR`]), leaving out what lies beyond the border. `scratch` is as long, or longer.
pub(super) fn blur(plane: &mut [f32], scratch: &mut [f32], width: usize, sd: f32) {
    let Some(height) = plane.len().checked_div(width) else { return };
    if !(sd > 0.0) || height == 0 {
        return;
    }
    blur_box(plane, scratch, width, [0..width, 0..height], sd);
    let kernel = Kernel::new(sd);
    let inside = kernel.scale(kernel.reach, 2 * kernel.reach + 1);
    let scale = |place: usize, count: usize| {
        let all = place >= kernel.reach && place + kernel.reach < count;
        if all { inside } else { kernel.scale(place, count) }
    };
    for (y, row) in plane.chunks_exact_mut(width).enumerate() {
        let k = scale(y, height);
        for (x, value) in row.iter_mut().enumerate() {
            *value *= k * scale(x, width);
        }
    }
}

/// `out = Σ tap · values` within a box of a plane, beyond which all is zero; the largest tap is 1. Only
/// the box is written. `scratch` is as long as the box has pixels, or longer.
#[inline(never)]
pub(super) fn blur_box(
    plane: &mut [f32],
    scratch: &mut [f32],
    width: usize,
    [columns, rows]: [Range<usize>; 2],
    sd: f32,
) {
    let Kernel { taps, reach } = Kernel::new(sd);
    let taps = taps.get(..=reach).unwrap_or_default();
    let count = columns.len();
    if count == 0 {
        return;
    }
    let line = |y: usize| y * width + columns.start..y * width + columns.end;
    for (y, out) in rows.clone().zip(scratch.chunks_exact_mut(count)) {
        let values = plane.get(line(y)).unwrap_or_default();
        out.fill(0.0);
        for (i, &tap) in taps.iter().enumerate() {
            add(out, values.get(i..).unwrap_or_default(), tap);
            if i > 0 {
                add(out.get_mut(i..).unwrap_or_default(), values, tap);
            }
        }
    }
    let blurred = |row: usize| scratch.get(row * count..(row + 1) * count).unwrap_or_default();
    for (row, y) in rows.clone().enumerate() {
        let Some(out) = plane.get_mut(line(y)) else { return };
        out.fill(0.0);
        for (i, &tap) in taps.iter().enumerate() {
            if row + i < rows.len() {
                add(out, blurred(row + i), tap);
            }
            if i > 0 && row >= i {
                add(out, blurred(row - i), tap);
            }
        }
    }
}

/// Adds `tap` times a line.
#[inline(never)]
fn add(to: &mut [f32], from: &[f32], tap: f32) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += tap * from;
    }
}

/// Share of the background's density that is uniform: it may have colours that were not seen outside the
/// face. Chosen, not measured.
const UNSEEN: f32 = 0.2;

/// Fills `ln_density` with the log density of each pixel's colour under the histogram of those
/// for which `outside` holds, smoothed by a bin, with a uniform part. Densities are over
/// `[0, 1]³`. `histogram` is scratch of [`HISTOGRAM_LEN`].
pub(super) fn ln_background(
    pixels: &[[u8; 3]],
    outside: impl Fn(usize) -> bool,
    histogram: &mut [f32],
    ln_density: &mut [f32],
) {
    histogram.fill(0.0);
    let mut total = 0.0_f32;
    for (_, &pixel) in pixels.iter().enumerate().filter(|&(i, _)| outside(i)) {
        if let Some(count) = histogram.get_mut(bin(pixel)) {
            *count += 1.0;
            total += 1.0;
        }
    }
    for step in [BINS * BINS, BINS, 1] {
        // Never 0, which the compiler does not see.
        for block in histogram.chunks_exact_mut((step * BINS).max(1)) {
            for offset in 0..step {
                let mut before = block.get(offset).copied().unwrap_or(0.0);
                for i in 0..BINS {
                    let here = block.get(offset + i * step).copied().unwrap_or(0.0);
                    let next = if i + 1 < BINS { block.get(offset + (i + 1) * step) } else { None };
                    let next = next.copied().unwrap_or(here);
                    if let Some(count) = block.get_mut(offset + i * step) {
                        *count = 0.5 * here + 0.25 * (before + next);
                    }
                    before = here;
                }
            }
        }
    }
    let seen = (1.0 - UNSEEN) * HISTOGRAM_LEN as f32 / total.max(1.0);
    for (ln, &pixel) in ln_density.iter_mut().zip(pixels) {
        let count = histogram.get(bin(pixel)).copied().unwrap_or(0.0);
        *ln = math::ln_f32(UNSEEN + seen * count);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;

    const WIDTH: usize = 40;
    const HEIGHT: usize = 30;

    #[test]
    fn a_blur_keeps_a_plain_picture_and_spreads_a_dot_by_its_width() {
        let mut scratch = vec![0.0; WIDTH * HEIGHT];
        let mut plain = vec![0.7; WIDTH * HEIGHT];
        blur(&mut plain, &mut scratch, WIDTH, 2.0);
        assert!(plain.iter().all(|x| (x - 0.7).abs() < 1e-6));
        let mut dot = vec![0.0; WIDTH * HEIGHT];
        let centre = [20, 15];
        dot[centre[1] * WIDTH + centre[0]] = 1.0;
        blur(&mut dot, &mut scratch, WIDTH, 2.0);
        let (mut sum, mut spread) = (0.0, [0.0; 2]);
        for (i, &x) in dot.iter().enumerate() {
            sum += x;
            for (spread, (at, centre)) in
                spread.iter_mut().zip([i % WIDTH, i / WIDTH].into_iter().zip(centre))
            {
                let distance = at as f32 - centre as f32;
                *spread += x * distance * distance;
            }
        }
        assert!((sum - 1.0).abs() < 1e-5, "{sum}");
        // Three standard deviations of a Gaussian of variance 4: 3.95 or so.
        assert!(spread.iter().all(|v| (v - 3.95).abs() < 0.1), "{spread:?}");
    }

    #[test]
    fn a_box_is_blurred_like_the_picture_but_for_scale() {
        let mut scratch = vec![0.0; WIDTH * HEIGHT];
        let (columns, rows) = (12..29, 9..21);
        let mut whole = vec![0.0; WIDTH * HEIGHT];
        for (i, value) in whole.iter_mut().enumerate() {
            if columns.contains(&(i % WIDTH)) && rows.contains(&(i / WIDTH)) {
                *value = (i * 37 % 101) as f32;
            }
        }
        let mut part = whole.clone();
        blur(&mut whole, &mut scratch, WIDTH, 2.0);
        blur_box(&mut part, &mut scratch, WIDTH, [columns.clone(), rows.clone()], 2.0);
        let kernel = Kernel::new(2.0);
        let scale = kernel.scale(kernel.reach, 2 * kernel.reach + 1);
        for (i, (part, whole)) in part.iter().zip(&whole).enumerate() {
            let inside = columns.contains(&(i % WIDTH)) && rows.contains(&(i / WIDTH));
            let expected = if inside { *whole } else { 0.0 };
            assert!((part * scale * scale - expected).abs() < 1e-4, "{i}: {part} {whole}");
        }
    }

    #[test]
    fn the_background_is_a_density_of_what_lies_outside() {
        // Two colours in bins far apart, the second only inside.
        let pixels: std::vec::Vec<_> =
            (0..100).map(|i| if i < 60 { [20, 20, 20] } else { [200, 30, 90] }).collect();
        let mut histogram = vec![0.0; HISTOGRAM_LEN];
        let mut ln = vec![0.0; 100];
        ln_background(&pixels, |i| i < 60, &mut histogram, &mut ln);
        let total: f32 = histogram.iter().sum();
        assert!((total - 60.0).abs() < 1e-3, "{total}");
        assert!((ln[99] - math::ln(f64::from(UNSEEN)) as f32).abs() < 1e-6);
        // The bin's own share after smoothing is an eighth.
        let expected = f64::from(UNSEEN) + 0.8 * HISTOGRAM_LEN as f64 / 8.0;
        assert!((f64::from(ln[0]) - math::ln(expected)).abs() < 1e-4, "{}", ln[0]);
    }
}
