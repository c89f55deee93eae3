//! Photos: reading PNG and JPEG, cutting out the part a fit looks at, and mapping back.

#[cfg(feature = "full")]
pub mod caption;
pub mod picture;
pub mod tlms;

use crate::error::{Error, Result};
use crate::files::{self, FileKind};
use image::metadata::Orientation;
use image::{ImageDecoder, ImageFormat, ImageReader, Limits};
use onescan_core::scene::Camera;
use picture::Picture;
use serde::{Deserialize, Serialize};
use std::io::Cursor;
use std::path::Path;

/// Longest side of a photo that is read, pixels. Like the next a bound on memory, chosen.
pub const MAX_SIDE: u32 = 30_000;
/// Most pixels of a photo that is read.
pub const MAX_PIXELS: u64 = 200_000_000;

/// Reads a PNG or JPEG file.
///
/// # Errors
/// As [`decode`], naming the file; a file that cannot be read.
pub fn read(path: &Path) -> Result<Picture> {
    let bytes = files::read(path).map_err(|e| Error::file(path, e))?;
    decode(&bytes).map_err(|e| FileKind::Photo.or_misplaced(path, e))
}

/// Decodes a PNG or JPEG, told apart by content, into 8-bit RGB as stored (no linearisation).
///
/// EXIF orientation is applied, so the picture stands as viewers show it and landmarks refer to
/// that. Grey becomes RGB, 16 bits are rounded to 8, transparent parts are laid over black (what
/// lies hidden under full transparency is arbitrary, black is at least the same everywhere).
///
/// # Errors
/// Other formats, damaged files, no pixels, a side above [`MAX_SIDE`] or more than
/// [`MAX_PIXELS`]: the header alone decides on the size, before memory is taken.
pub fn decode(bytes: &[u8]) -> Result<Picture> {
    let stored = Stored::decode(bytes)?;
    Ok(upright(stored.picture(over_black), stored.orientation))
}

/// Decodes the picture of a texture: as [`decode`], but the way its rows are stored, whatever EXIF
/// says, and without regard to transparency, whose colours texture coordinates may well mean.
///
/// # Errors
/// Those of [`decode`].
#[cfg(feature = "full")]
pub fn decode_stored(bytes: &[u8]) -> Result<Picture> {
    Ok(Stored::decode(bytes)?.picture(|[r, g, b, _]| [r, g, b]))
}

/// A picture as its file has it.
struct Stored {
    width: u32,
    height: u32,
    /// Channels of a pixel: grey, grey and alpha, RGB, or RGBA.
    channels: usize,
    /// Row by row, pixel by pixel, 8 bits each.
    samples: Vec<u8>,
    orientation: Orientation,
}

impl Stored {
    fn decode(bytes: &[u8]) -> Result<Self> {
        let format = match image::guess_format(bytes) {
            Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => format,
            Ok(other) => {
                let name = other.extensions_str().first().copied().unwrap_or("other");
                return Err(Error::new(format_args!(
                    "this is a .{name} picture; convert it to PNG or JPEG"
                )));
            }
            Err(_) => {
                return Err(Error::new("not a picture this program reads; give a PNG or JPEG"));
            }
        };
        if format == ImageFormat::Jpeg && !jpeg_ends(bytes) {
            return Err(Error::new("the JPEG is cut off; copy or download it again"));
        }
        let damaged = |e: image::ImageError| {
            Error::new(format_args!("{e}; save the picture again and retry"))
        };
        let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
        let mut limits = Limits::default();
        limits.max_alloc = Some(match format {
            // What a PNG's decoder takes besides the pixels: rows, and profiles and texts unpacked.
            ImageFormat::Png => 1 << 26,
            _ => 8 * MAX_PIXELS,
        });
        reader.limits(limits);
        let mut decoder = reader.into_decoder().map_err(damaged)?;
        let (width, height) = decoder.dimensions();
        check_size(width, height)?;
        // A damaged EXIF block is no reason to refuse the pixels.
        let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
        let color = decoder.color_type();
        let channels = usize::from(color.channel_count());
        let mut samples = vec![0; decoder.total_bytes() as usize];
        decoder.read_image(&mut samples).map_err(damaged)?;
        if usize::from(color.bytes_per_pixel()) == 2 * channels {
            let deep =
                samples.as_chunks().0.iter().map(|&deep| u32::from(u16::from_ne_bytes(deep)));
            // Rounded: 65535 / 255 is 257.
            samples = deep.map(|deep| ((deep + 128) / 257) as u8).collect();
        }
        Ok(Self { width, height, channels, samples, orientation })
    }

    /// The picture whose pixels are `color` of red, green, blue and alpha.
    fn picture(&self, color: impl Fn([u8; 4]) -> [u8; 3]) -> Picture {
        let rgba = |pixel: &[u8]| match *pixel {
            [grey] => [grey, grey, grey, 255],
            [grey, alpha] => [grey, grey, grey, alpha],
            [r, g, b] => [r, g, b, 255],
            [r, g, b, alpha, ..] => [r, g, b, alpha],
            [] => [0; 4],
        };
        let pixels = self.samples.chunks_exact(self.channels.max(1));
        let rgb = pixels.map(|pixel| color(rgba(pixel))).collect();
        Picture { width: self.width, height: self.height, rgb }
    }
}

/// The picture as viewers show it.
fn upright(picture: Picture, orientation: Orientation) -> Picture {
    // Whether rows become columns, and whether a column and a row of the old picture count from the
    // right and from below.
    let (turned, right, below) = match orientation {
        Orientation::NoTransforms => return picture,
        Orientation::FlipHorizontal => (false, true, false),
        Orientation::Rotate180 => (false, true, true),
        Orientation::FlipVertical => (false, false, true),
        Orientation::Rotate90FlipH => (true, false, false),
        Orientation::Rotate90 => (true, false, true),
        Orientation::Rotate270FlipH => (true, true, true),
        Orientation::Rotate270 => (true, true, false),
    };
    let (w, h) = (picture.width, picture.height);
    let [width, height] = if turned { [h, w] } else { [w, h] };
    Picture::from_fn(width, height, |x, y| {
        let (x, y) = if turned { (y, x) } else { (x, y) };
        let (x, y) = (if right { w - 1 - x } else { x }, if below { h - 1 - y } else { y });
        picture.pixel(x, y).unwrap_or_default()
    })
}

/// Whether an end-of-image marker follows the start of the first scan. Decoders take a file that
/// was cut off without a word and paint the rest grey; a fit would explain the grey.
fn jpeg_ends(bytes: &[u8]) -> bool {
    let mut at = 2;
    while let Some(&[0xff, marker, high, low]) = bytes.get(at..at + 4) {
        at += match marker {
            // Compressed data hides its 0xff bytes, so it holds no marker by chance.
            0xda => return bytes[at..].windows(2).any(|pair| pair == [0xff, 0xd9]),
            // A fill byte.
            0xff => 1,
            _ => 2 + usize::from(u16::from_be_bytes([high, low])),
        };
    }
    // No scan at all: the decoder's error says more.
    true
}

fn check_size(width: u32, height: u32) -> Result<()> {
    if width == 0 || height == 0 {
        return Err(Error::new(format_args!("the picture is {width}×{height}: it has no pixels")));
    }
    if width.max(height) > MAX_SIDE || u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(Error::new(format_args!(
            "the picture is {width}×{height}; shrink it to sides of at most {MAX_SIDE} and \
             {} megapixels",
            MAX_PIXELS / 1_000_000
        )));
    }
    Ok(())
}

fn over_black([r, g, b, a]: [u8; 4]) -> [u8; 3] {
    [r, g, b].map(|v| ((u16::from(v) * u16::from(a) + 127) / 255) as u8)
}

/// The part of a photo a fit looks at: a box of whole pixels, resampled.
///
/// Coordinates are pixel centres on both sides, so with `s = scaled_to / (width, height)` per
/// axis a photo point maps as `x' = (x − x₀ + ½)·s − ½`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Crop {
    /// Width and height of the whole photo.
    pub photo: [u32; 2],
    /// Left and top of the box, photo pixels.
    pub origin: [u32; 2],
    /// Width and height of the box, photo pixels.
    pub size: [u32; 2],
    /// Width and height it is resampled to.
    pub scaled_to: [u32; 2],
}

impl Crop {
    /// How much larger than the landmarks' box a fit looks, by default: from the chin and brows
    /// to the hair and neck. Chosen, not measured.
    pub const ENLARGE: f64 = 2.2;
    /// Longer side of what a fit looks at, pixels, by default: that of all pictures in docs/accuracy.md.
    pub const LONGER_SIDE: u32 = 256;

    /// The square around the landmarks, `enlarge` times the longer side of their box, about its
    /// centre, cut at the photo's border and scaled (up, too) to `longer_side` pixels.
    ///
    /// # Errors
    /// No landmark, a number that is not finite, or a square that misses the photo.
    pub fn around(
        landmarks: &[[f64; 2]],
        photo: [u32; 2],
        enlarge: f64,
        longer_side: u32,
    ) -> Result<Self> {
        let range = |axis: usize| {
            let values = landmarks.iter().map(|p| p[axis]);
            (values.clone().fold(f64::INFINITY, f64::min), values.fold(f64::NEG_INFINITY, f64::max))
        };
        let (x, y) = (range(0), range(1));
        let half = 0.5 * enlarge * (x.1 - x.0).max(y.1 - y.0);
        // No landmark leaves infinities; a NaN would hide from min and max.
        if !half.is_finite() || landmarks.as_flattened().iter().any(|v| !v.is_finite()) {
            return Err(Error::new("no finite landmarks to look around; give at least two"));
        }
        let side = |range: (f64, f64), limit: u32| {
            let centre = 0.5 * (range.0 + range.1);
            // Pixel x reaches from x − ½ to x + ½; the casts saturate.
            let start = ((centre - half + 0.5).floor() as u32).min(limit);
            let end = ((centre + half + 0.5).ceil() as u32).min(limit);
            (start, end - start)
        };
        let ((x, width), (y, height)) = (side(x, photo[0]), side(y, photo[1]));
        if width == 0 || height == 0 {
            return Err(Error::new(format_args!(
                "the landmarks lie outside the {}×{} picture; are they for another one?",
                photo[0], photo[1]
            )));
        }
        let scaled = |side: u32| {
            let (side, longer) = (u64::from(side), u64::from(width.max(height)));
            ((side * u64::from(longer_side) + longer / 2) / longer).max(1) as u32
        };
        Ok(Self {
            photo,
            origin: [x, y],
            size: [width, height],
            scaled_to: [scaled(width), scaled(height)],
        })
    }

    /// The whole photo at its own size.
    pub fn whole(photo: [u32; 2]) -> Self {
        Self { photo, origin: [0, 0], size: photo, scaled_to: photo }
    }

    /// Cuts the crop out of the photo it was made for.
    ///
    /// # Errors
    /// A photo of another size, and a box (from a file) that does not fit it.
    pub fn cut(&self, photo: &Picture) -> Result<Picture> {
        let fits = |axis: usize| {
            self.size[axis] > 0
                && u64::from(self.origin[axis]) + u64::from(self.size[axis])
                    <= u64::from(self.photo[axis])
                && (1..=MAX_SIDE).contains(&self.scaled_to[axis])
        };
        if [photo.width, photo.height] != self.photo || !fits(0) || !fits(1) {
            return Err(Error::new(format_args!(
                "crop {:?} + {:?} of a {:?} photo does not fit this {}×{} one",
                self.origin, self.size, self.photo, photo.width, photo.height
            )));
        }
        let [x, y] = self.origin;
        let [width, height] = self.size;
        let [new_width, new_height] = self.scaled_to;
        Ok(photo.cropped(x, y, width, height).resized(new_width, new_height))
    }

    /// Crop pixels per photo pixel, per axis: alike but for the rounding to whole pixels.
    pub fn scale(&self) -> [f64; 2] {
        [0, 1].map(|i| f64::from(self.scaled_to[i]) / f64::from(self.size[i]))
    }

    /// Photo point to crop point.
    pub fn to_crop(&self, point: [f64; 2]) -> [f64; 2] {
        let s = self.scale();
        [0, 1].map(|i| (point[i] - f64::from(self.origin[i]) + 0.5) * s[i] - 0.5)
    }

    /// Crop point to photo point.
    pub fn to_photo(&self, point: [f64; 2]) -> [f64; 2] {
        let s = self.scale();
        [0, 1].map(|i| (point[i] + 0.5) / s[i] - 0.5 + f64::from(self.origin[i]))
    }

    /// The camera that sees in the whole photo what `camera` sees in the crop, pose unchanged.
    ///
    /// Projection is `u = f·x/d + c` in pixels, so the affine map of the crop takes `f` to `f/s`
    /// and maps `c` like any point; `f/s = W·focal/sensor'` makes the sensor grow by photo over
    /// box size. Near and far stay.
    pub fn camera_in_photo(&self, camera: &Camera) -> Camera {
        let [w, h] = camera.image_size.map(f64::from);
        let [cx, cy] = camera.principal_point.map(f64::from);
        let [x, y] = self.to_photo([0.5 * w * (1.0 + cx), 0.5 * h * (1.0 - cy)]);
        let [photo_w, photo_h] = self.photo.map(f64::from);
        Camera {
            sensor: [0, 1].map(|i| {
                // image_size is scaled_to for a camera of this crop; the general form costs nothing.
                let pixels = f64::from(self.photo[i]) * self.scale()[i];
                (f64::from(camera.sensor[i]) * pixels / f64::from(camera.image_size[i])) as f32
            }),
            principal_point: [(2.0 * x / photo_w - 1.0) as f32, (1.0 - 2.0 * y / photo_h) as f32],
            image_size: self.photo,
            ..*camera
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::DynamicImage;
    use proptest::prelude::*;

    /// JPEG of one colour per quadrant (large enough to survive compression).
    fn quadrants() -> Vec<u8> {
        let image = image::RgbImage::from_fn(64, 32, |x, y| {
            image::Rgb(match (x < 32, y < 16) {
                (true, true) => [255, 0, 0],
                (false, true) => [0, 255, 0],
                (true, false) => [0, 0, 255],
                (false, false) => [255, 255, 255],
            })
        });
        let mut out = Cursor::new(Vec::new());
        image.write_to(&mut out, ImageFormat::Jpeg).unwrap();
        out.into_inner()
    }

    /// The JPEG with an EXIF block that says nothing but the orientation.
    fn with_orientation(jpeg: &[u8], value: u8) -> Vec<u8> {
        let mut app1 = vec![0xff, 0xe1, 0, 34];
        app1.extend(b"Exif\0\0MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0");
        app1.extend([value, 0, 0, 0, 0, 0, 0]);
        [&jpeg[..2], &app1, &jpeg[2..]].concat()
    }

    fn png(image: &DynamicImage) -> Vec<u8> {
        let mut out = Cursor::new(Vec::new());
        image.write_to(&mut out, ImageFormat::Png).unwrap();
        out.into_inner()
    }

    /// A PNG that claims a size, with correct checksums and no pixels.
    fn png_header(width: u32, height: u32) -> Vec<u8> {
        let mut chunk = b"IHDR".to_vec();
        chunk.extend(width.to_be_bytes());
        chunk.extend(height.to_be_bytes());
        chunk.extend([8, 2, 0, 0, 0]);
        let crc = !chunk.iter().fold(u32::MAX, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |c, _| (c >> 1) ^ (0xedb8_8320 * (c & 1)))
        });
        let mut out = b"\x89PNG\r\n\x1a\n\0\0\0\x0d".to_vec();
        out.extend(chunk);
        out.extend(crc.to_be_bytes());
        out.extend(b"\0\0\0\0IDAT\x35\xaf\x06\x1e");
        out
    }

    #[test]
    fn every_exif_orientation_puts_the_picture_upright() {
        // Which of (red, green, blue, white) comes to the top left, top right, bottom left.
        let corners = ["rgb", "grw", "wbg", "bwr", "rbg", "brw", "wgb", "gwr"];
        for (expected, value) in corners.into_iter().zip(1..) {
            let picture = decode(&with_orientation(&quadrants(), value)).unwrap();
            let (w, h) = (picture.width, picture.height);
            assert_eq!((w, h), if value < 5 { (64, 32) } else { (32, 64) });
            let letter = |x, y| match picture.pixel(x, y).unwrap().map(|v| v > 128) {
                [true, false, false] => 'r',
                [false, true, false] => 'g',
                [false, false, true] => 'b',
                _ => 'w',
            };
            let found: String =
                [letter(4, 4), letter(w - 5, 4), letter(4, h - 5)].into_iter().collect();
            assert_eq!(found, expected, "orientation {value}");
        }
    }

    #[test]
    fn grey_deep_and_transparent_pictures_become_rgb() {
        let grey = DynamicImage::ImageLuma8(image::GrayImage::from_pixel(2, 1, image::Luma([7])));
        assert_eq!(decode(&png(&grey)).unwrap().rgb, [[7; 3]; 2]);
        let deep = image::ImageBuffer::from_pixel(1, 1, image::Rgb([0_u16, 32_896, 65_535]));
        assert_eq!(decode(&png(&DynamicImage::ImageRgb16(deep))).unwrap().rgb, [[0, 128, 255]]);
        let half = image::RgbaImage::from_pixel(1, 1, image::Rgba([200, 100, 0, 128]));
        assert_eq!(decode(&png(&DynamicImage::ImageRgba8(half))).unwrap().rgb, [[100, 50, 0]]);
    }

    #[test]
    fn sixteen_bits_are_rounded_as_the_image_crate_does() {
        let all = || (0..=u16::MAX).rev();
        let grey = DynamicImage::ImageLuma16(
            image::ImageBuffer::from_raw(256, 256, all().collect()).unwrap(),
        );
        let color = DynamicImage::ImageRgba16(
            image::ImageBuffer::from_raw(128, 128, all().collect()).unwrap(),
        );
        for image in [grey, color] {
            let found = decode_stored(&png(&image)).unwrap();
            assert_eq!(found.bytes(), image.into_rgb8().as_raw());
        }
    }

    #[test]
    fn a_boastful_header_is_refused_by_its_size() {
        let message = decode(&png_header(100_000, 100_000)).unwrap_err().to_string();
        assert!(message.contains("100000×100000") && message.contains("30000"), "{message}");
        let message = decode(&png_header(29_000, 29_000)).unwrap_err().to_string();
        assert!(message.contains("200 megapixels"), "{message}");
        assert!(decode(&png_header(0, 5)).is_err());
    }

    #[test]
    fn other_formats_and_damage_are_named() {
        assert!(decode(b"GIF89a\x01\0\x01\0").unwrap_err().to_string().contains(".gif picture"));
        assert!(decode(b"").unwrap_err().to_string().contains("PNG or JPEG"));
        let jpeg = with_orientation(&quadrants(), 1);
        for length in (2..jpeg.len()).step_by(7) {
            assert!(decode(&jpeg[..length]).is_err(), "{length} of {} bytes", jpeg.len());
        }
        assert!(decode(&[&jpeg[..], b"trailing"].concat()).is_ok());
        assert!(!decode(&png_header(5, 5)).unwrap_err().to_string().contains('\n'));
    }

    #[test]
    fn a_crop_is_the_enlarged_square_cut_at_the_border() {
        let crop = Crop::around(&[[90.0, 40.0], [110.0, 80.0]], [400, 120], 2.0, 256).unwrap();
        // Centre (100, 60), half side 40: pixels 60 to 140 inclusive, 20 to 100 inclusive.
        assert_eq!((crop.origin, crop.size), ([60, 20], [81, 81]));
        assert_eq!(crop.scaled_to, [256, 256]);
        let crop = Crop::around(&[[5.0, 40.0], [35.0, 80.0]], [400, 70], 2.0, 256).unwrap();
        assert_eq!((crop.origin, crop.size), ([0, 20], [61, 50]));
        assert_eq!(crop.scaled_to, [256, 210]);
        assert_eq!(crop.cut(&Picture::filled(400, 70, [1; 3])).unwrap().height, 210);
        assert!(crop.cut(&Picture::filled(70, 400, [1; 3])).is_err());
    }

    #[test]
    fn landmarks_that_give_no_crop_are_refused() {
        for points in [&[][..], &[[f64::NAN, 1.0], [2.0, 2.0]], &[[500.0, 5.0], [501.0, 6.0]]] {
            assert!(Crop::around(points, [100, 100], 2.2, 256).is_err(), "{points:?}");
        }
    }

    #[test]
    fn cutting_moves_a_mark_to_where_the_map_says() {
        let mut photo = Picture::filled(300, 200, [0; 3]);
        for (x, y) in [(150, 100), (151, 100), (150, 101), (151, 101)] {
            photo.rgb[y * 300 + x] = [255; 3];
        }
        let crop = Crop::around(&[[130.0, 90.0], [165.0, 110.0]], [300, 200], 2.2, 256).unwrap();
        let cut = crop.cut(&photo).unwrap();
        let (mut sum, mut weight) = ([0.0; 2], 0.0);
        for y in 0..cut.height {
            for x in 0..cut.width {
                let v = f64::from(cut.pixel(x, y).unwrap()[0]);
                sum = [sum[0] + v * f64::from(x), sum[1] + v * f64::from(y)];
                weight += v;
            }
        }
        let expected = crop.to_crop([150.5, 100.5]);
        assert!((sum[0] / weight - expected[0]).abs() < 0.01, "{sum:?} / {weight}, {expected:?}");
        assert!((sum[1] / weight - expected[1]).abs() < 0.01);
    }

    proptest! {
        #[test]
        fn the_cropped_camera_and_the_photo_camera_see_the_same(
            points in prop::collection::vec([-0.5..4000.0, -0.5..3000.0_f64], 2..9),
            x in -80.0..80.0_f32, y in -80.0..80.0_f32, d in 400.0..2000.0_f32,
            centre in [-0.3..0.3_f32, -0.3..0.3_f32],
        ) {
            let Ok(crop) = Crop::around(&points, [4000, 3000], Crop::ENLARGE, Crop::LONGER_SIDE)
            else { return Ok(()) };
            let [w, h] = crop.scaled_to;
            let camera = Camera { principal_point: centre, ..Camera::for_image(w, h) };
            let whole = crop.camera_in_photo(&camera);
            prop_assert_eq!(whole.image_size, crop.photo);
            let (u, v, _) = camera.project([x, y, -d]);
            let (whole_u, whole_v, _) = whole.project([x, y, -d]);
            let mapped = crop.to_photo([f64::from(u), f64::from(v)]);
            // 1e-3 pixels of the crop, or f32's own rounding at coordinates of thousands.
            let s = crop.scale();
            for (mapped, whole, s) in
                [(mapped[0], whole_u, s[0]), (mapped[1], whole_v, s[1])]
            {
                let error = (mapped - f64::from(whole)).abs();
                prop_assert!(error < 1e-3_f64.max(1e-3 / s), "{mapped} {whole}");
            }
        }

        #[test]
        fn mapping_there_and_back_changes_nothing(x in -9.0..900.0, y in -9.0..900.0) {
            let crop = Crop::around(&[[10.0, 20.0], [300.0, 333.0]], [640, 480], 2.2, 256).unwrap();
            let back = crop.to_photo(crop.to_crop([x, y]));
            prop_assert!((back[0] - x).abs() < 1e-9 && (back[1] - y).abs() < 1e-9);
        }

        #[test]
        fn damaged_files_never_panic(at in 0_usize..600, byte: u8, cut in 0_usize..700) {
            let mut jpeg = with_orientation(&quadrants(), 6);
            let mut png = png(&DynamicImage::new_rgba8(9, 7));
            for bytes in [&mut jpeg, &mut png] {
                let at = at % bytes.len();
                bytes[at] = byte;
                bytes.truncate(cut.max(8));
                let _ = decode(bytes);
            }
        }
    }
}
