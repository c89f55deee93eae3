//! Background model: the picture's own colour histogram (Schönborn et al. 2015).

/// Bins per channel, the reference engine's.
pub const BINS: usize = 25;
/// Bins of the whole histogram.
pub const HISTOGRAM_LEN: usize = BINS * BINS * BINS;

/// The bin of an 8-bit colour: `min(⌊25 c/255⌋, 24)` per channel, red-major.
pub fn bin(rgb: [u8; 3]) -> usize {
    let [r, g, b] = rgb.map(|c| (usize::from(c) * BINS / 255).min(BINS - 1));
    (r * BINS + g) * BINS + b
}

/// Adds a picture's pixels to `histogram` (length [`HISTOGRAM_LEN`]).
pub fn count(pixels: &[[u8; 3]], histogram: &mut [u32]) {
    for &pixel in pixels {
        if let Some(count) = histogram.get_mut(bin(pixel)) {
            *count += 1;
        }
    }
}

/// Log density of a colour in `[0, 1]³`: `log count − log total + 3 log 25`.
pub fn ln_density(count: u32, total: usize) -> f32 {
    use crate::math::ln;
    (ln(f64::from(count)) - ln(total as f64) + 3.0 * ln(BINS as f64)) as f32
}

#[cfg(test)]
mod tests {
    #[test]
    fn golden_one_bin_picture() {
        assert!((super::ln_density(9, 9) - 9.656_627_5).abs() < 1e-6);
    }

    #[test]
    fn brightest_colour_has_the_last_bin() {
        assert_eq!(super::bin([255; 3]), super::HISTOGRAM_LEN - 1);
        assert_eq!(super::bin([0; 3]), 0);
    }
}
