//! Words under pictures.

use super::picture::{Picture, WHITE};
use embedded_graphics::Drawable;
use embedded_graphics::geometry::{OriginDimensions, Point, Size};
use embedded_graphics::mono_font::iso_8859_1::{FONT_6X10, FONT_9X15};
use embedded_graphics::mono_font::{MonoFont, MonoTextStyle};
use embedded_graphics::pixelcolor::{Rgb888, RgbColor};
use embedded_graphics::prelude::{DrawTarget, Pixel};
use embedded_graphics::text::{Alignment, Baseline, Text};
use std::convert::Infallible;

/// A picture as a display.
struct Display<'a>(&'a mut Picture);

impl OriginDimensions for Display<'_> {
    fn size(&self) -> Size {
        Size::new(self.0.width, self.0.height)
    }
}

impl DrawTarget for Display<'_> {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I>(&mut self, pixels: I) -> Result<(), Infallible>
    where
        I: IntoIterator<Item = Pixel<Rgb888>>,
    {
        let width = self.0.width;
        for Pixel(at, color) in pixels {
            if let (Ok(x), Ok(y)) = (u32::try_from(at.x), u32::try_from(at.y))
                && x < width
                && let Some(pixel) = self.0.rgb.get_mut(y as usize * width as usize + x as usize)
            {
                *pixel = [color.r(), color.g(), color.b()];
            }
        }
        Ok(())
    }
}

/// The font whose letters so many of fit into a width.
fn font(letters: usize, width: u32) -> &'static MonoFont<'static> {
    let fits = letters as u32 * FONT_9X15.character_size.width <= width;
    if fits { &FONT_9X15 } else { &FONT_6X10 }
}

/// A picture with a line of Latin letters below it, on white; what is too long is cut off.
#[must_use]
pub fn captioned(picture: &Picture, text: &str) -> Picture {
    let font = font(text.chars().count(), picture.width);
    let line = font.character_size.height;
    let mut sheet = Picture::filled(picture.width, picture.height + line + line / 2, WHITE);
    sheet.paste(picture, 0, 0);
    let at =
        Point::new((picture.width / 2).cast_signed(), (picture.height + line / 4).cast_signed());
    let style = MonoTextStyle::new(font, Rgb888::BLACK);
    let mut text = Text::with_alignment(text, at, style, Alignment::Center);
    text.text_style.baseline = Baseline::Top;
    let Ok(_) = text.draw(&mut Display(&mut sheet));
    sheet
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_stand_below_and_nothing_falls_off() {
        let picture = Picture::filled(120, 40, [200, 0, 0]);
        let sheet = captioned(&picture, "shape 1");
        assert_eq!(sheet.cropped(0, 0, 120, 40), picture);
        let below = sheet.cropped(0, 40, 120, sheet.height - 40);
        let ink: Vec<u32> = (0..below.rgb.len() as u32)
            .filter(|i| below.rgb[*i as usize] == [0; 3])
            .map(|i| i % 120)
            .collect();
        assert!(ink.len() > 50);
        let middle = ink.iter().sum::<u32>() as f32 / ink.len() as f32;
        assert!((middle - 60.0).abs() < 6.0, "{middle}");
        assert_eq!(captioned(&Picture::filled(8, 8, WHITE), "too long for it").width, 8);
    }
}
