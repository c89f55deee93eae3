//! Words on pictures.

use super::picture::{Picture, WHITE};
use embedded_graphics::Drawable as _;
use embedded_graphics::mono_font::MonoTextStyle;
use embedded_graphics::mono_font::ascii::FONT_8X13;
use embedded_graphics::pixelcolor::{Rgb888, RgbColor as _};
use embedded_graphics::prelude::{DrawTarget, OriginDimensions, Pixel, Point, Size};
use embedded_graphics::text::{Baseline, Text};
use std::convert::Infallible;

/// Height of a line of text with some room, pixels.
const LINE: u32 = 19;

/// The picture below a line of text, of ASCII characters 8 pixels wide; what does not fit is cut off.
#[must_use]
pub fn captioned(picture: &Picture, text: &str) -> Picture {
    let mut all = Picture::filled(picture.width, picture.height + LINE, WHITE);
    let style = MonoTextStyle::new(&FONT_8X13, Rgb888::new(60, 60, 60));
    let line = Text::with_baseline(text, Point::new(4, 3), style, Baseline::Top);
    let Ok(_) = line.draw(&mut Canvas(&mut all));
    all.paste(picture, 0, LINE);
    all
}

/// A picture to draw on; what is outside is left out.
struct Canvas<'a>(&'a mut Picture);

impl OriginDimensions for Canvas<'_> {
    fn size(&self) -> Size {
        Size::new(self.0.width, self.0.height)
    }
}

impl DrawTarget for Canvas<'_> {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(
        &mut self,
        pixels: I,
    ) -> Result<(), Infallible> {
        let [width, height] = [self.0.width, self.0.height];
        for Pixel(Point { x, y }, color) in pixels {
            if let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y))
                && x < width
                && y < height
                && let Some(pixel) = self.0.rgb.get_mut((y * width + x) as usize)
            {
                *pixel = [color.r(), color.g(), color.b()];
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_caption_stands_above_and_is_cut_at_the_edge() {
        let picture = Picture::from_fn(40, 10, |x, y| [x as u8, y as u8, 7]);
        let above = |text: &str| {
            let all = captioned(&picture, text);
            assert_eq!((all.width, all.height), (40, 10 + LINE));
            let (line, below) = all.rgb.split_at((40 * LINE) as usize);
            assert_eq!(below, picture.rgb);
            line.iter().filter(|pixel| **pixel != WHITE).count()
        };
        assert_eq!(above(""), 0);
        assert!(above("shap") > 40);
        assert_eq!(above("shape and more"), above("shape"));
    }
}
