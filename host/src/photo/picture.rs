//! RGB pictures in memory: resampling, marks, montages, heat maps, PNG.
//!
//! Pixel `(x, y)` samples the point `(x, y)`, y down: a pixel covers half a pixel to each side.
//! All arithmetic is on integers, so a picture has the same bytes on every machine.

use crate::error::{Error, Result};
#[cfg(feature = "full")]
use crate::files::write_atomically;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
#[cfg(feature = "full")]
use std::{io::Write, path::Path};

/// A colour as stored in files: sRGB, 8 bits per channel.
pub type Rgb = [u8; 3];

/// White, the ground of montages.
pub const WHITE: Rgb = [255; 3];

/// Dark outline of marks, so that they are seen on any ground.
const OUTLINE: Rgb = [16, 16, 16];

/// An 8-bit RGB picture.
///
/// Guarantee of every constructor: `rgb.len() == width · height`, row by row from the top left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// The pixels, `rgb[y · width + x]`.
    pub rgb: Vec<Rgb>,
}

impl Picture {
    /// A picture of one colour.
    pub fn filled(width: u32, height: u32, color: Rgb) -> Self {
        Self { width, height, rgb: vec![color; width as usize * height as usize] }
    }

    /// A picture whose pixel `(x, y)` is `color(x, y)`.
    pub fn from_fn(width: u32, height: u32, mut color: impl FnMut(u32, u32) -> Rgb) -> Self {
        let mut rgb = Vec::with_capacity(width as usize * height as usize);
        for y in 0..height {
            rgb.extend((0..width).map(|x| color(x, y)));
        }
        Self { width, height, rgb }
    }

    /// A picture from colours in `[0, 1]`, row by row: clamped, scaled to 255, rounded; NaN
    /// becomes 0. Pixels that `colors` lacks are black, surplus ones are dropped.
    pub fn from_unit(width: u32, height: u32, colors: &[[f32; 3]]) -> Self {
        let mut rgb: Vec<Rgb> = colors.iter().map(|c| c.map(to_byte)).collect();
        rgb.resize(width as usize * height as usize, [0; 3]);
        Self { width, height, rgb }
    }

    /// Pixel `(x, y)`; `None` outside.
    pub fn pixel(&self, x: u32, y: u32) -> Option<Rgb> {
        if x < self.width { self.rgb.get(self.index(x, y)).copied() } else { None }
    }

    /// The pixels as `3 · width · height` bytes, the form the core takes.
    pub fn bytes(&self) -> &[u8] {
        self.rgb.as_flattened()
    }

    /// Colours in `[0, 1]`, row by row.
    pub fn to_unit(&self) -> Vec<[f32; 3]> {
        self.rgb.iter().map(|c| c.map(|v| f32::from(v) / 255.0)).collect()
    }

    /// The part of the picture in the box with top left `(x, y)`, cut at the border.
    #[must_use]
    pub fn cropped(&self, x: u32, y: u32, width: u32, height: u32) -> Self {
        let width = width.min(self.width.saturating_sub(x));
        let height = height.min(self.height.saturating_sub(y));
        let mut rgb = Vec::with_capacity(width as usize * height as usize);
        for row in y..y + height {
            let start = self.index(x, row);
            rgb.extend_from_slice(&self.rgb[start..start + width as usize]);
        }
        Self { width, height, rgb }
    }

    /// Copies `other` into this picture with its top left at `(x, y)`, cut at the border.
    pub fn paste(&mut self, other: &Self, x: u32, y: u32) {
        let width = other.width.min(self.width.saturating_sub(x));
        let height = other.height.min(self.height.saturating_sub(y));
        for row in 0..height {
            let from = other.index(0, row);
            let to = self.index(x, y + row);
            self.rgb[to..to + width as usize]
                .copy_from_slice(&other.rgb[from..from + width as usize]);
        }
    }

    /// Resampled to `width × height`: per axis, shrinking averages the area a new pixel covers,
    /// growing interpolates linearly between pixel centres. Sums are exact, rounded once.
    ///
    /// The covered area stays the same, so centres map as `x' = (x + ½)·s − ½`.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        if (width, height) == (self.width, self.height) {
            return self.clone();
        }
        if self.rgb.is_empty() {
            return Self::filled(width, height, [0; 3]);
        }
        let columns = taps(self.width, width);
        let rows = taps(self.height, height);
        let narrow: Vec<[u64; 3]> = self
            .rgb
            .chunks_exact(self.width as usize)
            .flat_map(|row| columns.iter().map(|tap| tap.sum(|x| row[x].map(u64::from))))
            .collect();
        let width_px = width as usize;
        let mut rgb = Vec::with_capacity(width_px * height as usize);
        for row in &rows {
            for (x, column) in columns.iter().enumerate() {
                let sum = row.sum(|y| narrow[y * width_px + x]);
                let total = row.total() * column.total();
                rgb.push(sum.map(|v| ((v + total / 2) / total) as u8));
            }
        }
        Self { width, height, rgb }
    }

    /// Every pixel repeated `factor × factor` times; factor 0 counts as 1.
    #[must_use]
    pub fn enlarged(&self, factor: u32) -> Self {
        let factor = factor.max(1);
        Self::from_fn(self.width * factor, self.height * factor, |x, y| {
            self.rgb[self.index(x / factor, y / factor)]
        })
    }

    /// Draws an upright cross with arms of `arm` pixels at a point of the picture, outlined.
    pub fn cross(&mut self, at: [f32; 2], arm: i32, color: Rgb) {
        let arms = || (-arm..=arm).flat_map(|i| [(i, 0), (0, i)]);
        let border = |(x, y)| (-1..=1).flat_map(move |i| (-1..=1).map(move |j| (x + i, y + j)));
        self.draw(at, arms().flat_map(border), OUTLINE);
        self.draw(at, arms(), color);
    }

    /// Draws a disc of `radius` pixels at a point of the picture, outlined.
    pub fn dot(&mut self, at: [f32; 2], radius: i32, color: Rgb) {
        let disc = |r: i32| {
            (-r..=r).flat_map(move |y| (-r..=r).map(move |x| (x, y))).filter(move |(x, y)| {
                // r(r + 1) instead of r² rounds small discs off.
                x * x + y * y <= r * (r + 1)
            })
        };
        self.draw(at, disc(radius + 1), OUTLINE);
        self.draw(at, disc(radius), color);
    }

    /// Encodes as PNG; the same picture always gives the same bytes.
    ///
    /// # Errors
    /// A picture without pixels.
    pub fn to_png(&self) -> Result<Vec<u8>> {
        let mut out = Vec::new();
        PngEncoder::new_with_quality(&mut out, CompressionType::Fast, FilterType::Adaptive)
            .write_image(self.bytes(), self.width, self.height, ExtendedColorType::Rgb8)
            .map_err(|e| {
                Error::new(format_args!("cannot write a {}×{} PNG: {e}", self.width, self.height))
            })?;
        Ok(out)
    }

    /// Writes a PNG file, whole or not at all.
    ///
    /// # Errors
    /// A picture without pixels, a file that cannot be written.
    #[cfg(feature = "full")]
    pub fn write_png(&self, path: &Path) -> Result<()> {
        let bytes = self.to_png()?;
        write_atomically(path, |out| out.write_all(&bytes))
    }

    fn index(&self, x: u32, y: u32) -> usize {
        y as usize * self.width as usize + x as usize
    }

    /// Paints pixels at offsets from the one nearest to `at`; what falls outside is dropped.
    fn draw(&mut self, at: [f32; 2], offsets: impl Iterator<Item = (i32, i32)>, color: Rgb) {
        let [x, y] = at.map(|v| v.round() as i32);
        for (dx, dy) in offsets {
            let at = (u32::try_from(x.saturating_add(dx)), u32::try_from(y.saturating_add(dy)));
            if let (Ok(x), Ok(y)) = at
                && x < self.width
                && y < self.height
            {
                let index = self.index(x, y);
                self.rgb[index] = color;
            }
        }
    }
}

/// Pictures side by side, `gap` pixels apart, centred vertically, on a ground of one colour.
pub fn montage(pictures: &[&Picture], gap: u32, ground: Rgb) -> Picture {
    let height = pictures.iter().map(|p| p.height).max().unwrap_or(0);
    let gaps = gap * (pictures.len() as u32).saturating_sub(1);
    let width = pictures.iter().map(|p| p.width).sum::<u32>() + gaps;
    let mut sheet = Picture::filled(width, height, ground);
    let mut x = 0;
    for picture in pictures {
        sheet.paste(picture, x, (height - picture.height) / 2);
        x += picture.width + gap;
    }
    sheet
}

/// Pictures in rows of `columns` (at least one), `gap` pixels apart.
pub fn contact_sheet(pictures: &[&Picture], columns: usize, gap: u32, ground: Rgb) -> Picture {
    let rows: Vec<Picture> =
        pictures.chunks(columns.max(1)).map(|row| montage(row, gap, ground)).collect();
    let width = rows.iter().map(|p| p.width).max().unwrap_or(0);
    let gaps = gap * (rows.len() as u32).saturating_sub(1);
    let height = rows.iter().map(|p| p.height).sum::<u32>() + gaps;
    let mut sheet = Picture::filled(width, height, ground);
    let mut y = 0;
    for row in &rows {
        sheet.paste(row, 0, y);
        y += row.height + gap;
    }
    sheet
}

/// The overview of a fit: `photo | model on photo | model alone | side views`, all brought to the
/// photo's height, doubled until that is at least 384 pixels, on white with thin gaps.
pub fn overlay(photo: &Picture, on_photo: &Picture, alone: &Picture, sides: &[Picture]) -> Picture {
    let mut height = photo.height.max(1);
    while height < 384 {
        height *= 2;
    }
    let panels: Vec<Picture> = [photo, on_photo, alone]
        .into_iter()
        .chain(sides)
        .map(|p| {
            let width = u64::from(p.width) * u64::from(height) / u64::from(p.height.max(1));
            p.resized(u32::try_from(width).unwrap_or(height), height)
        })
        .collect();
    montage(&panels.iter().collect::<Vec<_>>(), 8, WHITE)
}

/// Heat map of the mean absolute difference over the channels: black is none, then violet, red,
/// yellow, and white is `full_scale` (in `[0, 1]` of the colour range) or more.
///
/// # Errors
/// Pictures of different size.
pub fn difference(a: &Picture, b: &Picture, full_scale: f32) -> Result<Picture> {
    if (a.width, a.height) != (b.width, b.height) {
        return Err(Error::new(format_args!(
            "a {}×{} and a {}×{} picture cannot be compared; resize one",
            a.width, a.height, b.width, b.height
        )));
    }
    let full = (full_scale * 3.0 * 255.0).max(1.0) as u32;
    let heat = |(a, b): (&Rgb, &Rgb)| {
        let sum: u32 = (0..3).map(|c| u32::from(a[c].abs_diff(b[c]))).sum();
        heat_color((sum * 1024 / full).min(1024))
    };
    let rgb = a.rgb.iter().zip(&b.rgb).map(heat).collect();
    Ok(Picture { width: a.width, height: a.height, rgb })
}

/// Colour of `level / 1024`, `level ≤ 1024`: the "inferno" colour map at five points.
pub(crate) fn heat_color(level: u32) -> Rgb {
    const MAP: [[u32; 3]; 5] =
        [[0, 0, 4], [87, 16, 110], [188, 55, 84], [249, 142, 9], [252, 255, 220]];
    let from = (level / 256).min(3) as usize;
    let part = level - 256 * from as u32;
    std::array::from_fn(|c| {
        ((MAP[from][c] * (256 - part) + MAP[from + 1][c] * part + 128) / 256) as u8
    })
}

/// `[0, 1]` to a byte: clamped, rounded; NaN gives 0.
fn to_byte(value: f32) -> u8 {
    // The cast saturates at both ends and takes NaN to 0.
    (value * 255.0 + 0.5) as u8
}

/// What one new pixel takes from a row: integer weights of consecutive old pixels.
struct Tap {
    first: usize,
    weights: Vec<u32>,
}

impl Tap {
    fn sum(&self, value: impl Fn(usize) -> [u64; 3]) -> [u64; 3] {
        self.weights.iter().enumerate().fold([0; 3], |sum, (i, &w)| {
            let v = value(self.first + i);
            std::array::from_fn(|c| sum[c] + u64::from(w) * v[c])
        })
    }

    fn total(&self) -> u64 {
        self.weights.iter().map(|&w| u64::from(w)).sum()
    }
}

/// Taps of every new pixel when `old` pixels become `new`, see [`Picture::resized`].
fn taps(old: u32, new: u32) -> Vec<Tap> {
    let (old, new) = (u64::from(old), u64::from(new));
    let area = |i: u64| {
        // In units of 1/new old pixels: the new pixel covers [i·old, (i+1)·old).
        let (start, end) = (i * old, (i + 1) * old);
        let first = start / new;
        let weights = (first..end.div_ceil(new))
            .map(|j| (end.min((j + 1) * new) - start.max(j * new)) as u32)
            .collect();
        Tap { first: first as usize, weights }
    };
    let linear = |i: u64| {
        // In units of 1/(2·new) old pixels: the centre of the new pixel, kept between centres.
        let unit = 2 * new;
        let centre = ((2 * i + 1) * old).saturating_sub(new).min((old - 1) * unit);
        let (first, part) = (centre / unit, (centre % unit) as u32);
        let weights = if part == 0 { vec![1] } else { vec![unit as u32 - part, part] };
        Tap { first: first as usize, weights }
    };
    (0..new).map(|i| if new <= old { area(i) } else { linear(i) }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ramp(width: u32, height: u32) -> Picture {
        Picture::from_fn(width, height, |x, y| [(10 * x) as u8, (10 * y) as u8, 200])
    }

    #[test]
    fn floats_are_clamped_and_rounded() {
        let picture = Picture::from_unit(2, 1, &[[-1.0, 2.0, f32::NAN], [0.5, 0.001, 0.999]]);
        assert_eq!(picture.rgb, [[0, 255, 0], [128, 0, 255]]);
        assert_eq!(Picture::from_unit(1, 1, &picture.to_unit()).rgb[0], picture.rgb[0]);
    }

    #[test]
    fn shrinking_averages_areas() {
        let picture =
            Picture { width: 3, height: 1, rgb: vec![[0, 0, 9], [90, 30, 9], [30, 0, 9]] };
        // The middle pixel is shared by both halves.
        assert_eq!(picture.resized(2, 1).rgb, [[30, 10, 9], [50, 10, 9]]);
    }

    #[test]
    fn growing_keeps_centres_where_the_affine_map_says() {
        // Value 10·x at centre x becomes 10·((x' + ½)/4 − ½), constant beyond the outer centres.
        let grown = ramp(8, 1).resized(32, 1);
        for (x, color) in grown.rgb.iter().enumerate() {
            let expected = (10.0 * ((x as f64 + 0.5) / 4.0 - 0.5)).clamp(0.0, 70.0);
            assert!((f64::from(color[0]) - expected).abs() <= 0.5, "{x}: {color:?}");
        }
    }

    #[test]
    fn montages_paste_side_by_side() {
        let (a, b) = (Picture::filled(2, 1, [1; 3]), Picture::filled(1, 3, [2; 3]));
        let sheet = montage(&[&a, &b], 1, [9; 3]);
        let rows: Vec<Vec<u8>> =
            sheet.rgb.chunks(4).map(|row| row.iter().map(|c| c[0]).collect()).collect();
        assert_eq!(rows, [[9, 9, 9, 2], [1, 1, 9, 2], [9, 9, 9, 2]]);
        assert_eq!(contact_sheet(&[&a, &b, &a], 2, 1, WHITE).height, 5);
        assert!(montage(&[], 3, WHITE).rgb.is_empty());
    }

    #[test]
    fn overlay_brings_all_panels_to_one_height() {
        let photo = ramp(20, 16);
        let sheet = overlay(&photo, &photo, &ramp(10, 32), &[ramp(8, 8)]);
        assert_eq!((sheet.width, sheet.height), (640 + 640 + 160 + 512 + 3 * 8, 512));
    }

    #[test]
    fn marks_are_outlined_and_cut_at_the_border() {
        let mut picture = Picture::filled(5, 5, WHITE);
        picture.cross([2.2, 1.8], 1, [255, 0, 0]);
        assert_eq!(picture.pixel(2, 2), Some([255, 0, 0]));
        assert_eq!(picture.pixel(3, 2), Some([255, 0, 0]));
        assert_eq!(picture.pixel(3, 3), Some(OUTLINE));
        assert_eq!(picture.pixel(4, 4), Some(WHITE));
        for far in [[-3.0, 1e30], [f32::NAN, f32::NEG_INFINITY]] {
            picture.cross(far, 2, WHITE);
            picture.dot(far, 2, WHITE);
        }
    }

    #[test]
    fn heat_maps_go_from_black_to_full_scale() {
        let a = Picture::filled(1, 1, [100; 3]);
        let b = Picture::filled(1, 1, [151; 3]);
        assert_eq!(difference(&a, &a, 0.2).unwrap().rgb, [[0, 0, 4]]);
        assert_eq!(difference(&a, &b, 0.2).unwrap().rgb, [[252, 255, 220]]);
        assert!(difference(&a, &ramp(2, 1), 0.2).is_err());
    }

    #[test]
    fn png_gives_back_the_pixels() {
        let picture = ramp(7, 5);
        let read = image::load_from_memory(&picture.to_png().unwrap()).unwrap().into_rgb8();
        assert_eq!(read.as_raw(), picture.bytes());
        assert!(Picture::filled(0, 3, WHITE).to_png().is_err());
    }

    proptest! {
        #[test]
        fn resizing_keeps_a_constant_picture(w in 1_u32..40, h in 1_u32..40, v: u8,
                                             w2 in 1_u32..90, h2 in 1_u32..90) {
            let picture = Picture::filled(w, h, [v; 3]);
            prop_assert_eq!(picture.resized(w2, h2), Picture::filled(w2, h2, [v; 3]));
        }

        #[test]
        fn enlarging_and_averaging_is_the_identity(w in 1_u32..9, h in 1_u32..9, k in 1_u32..6) {
            let picture = ramp(w, h);
            prop_assert_eq!(picture.enlarged(k).resized(w, h), picture);
        }
    }
}
