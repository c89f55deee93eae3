//! Pictures on any display that embedded-graphics knows.

use embedded_graphics_core::Pixel;
use embedded_graphics_core::draw_target::DrawTarget;
use embedded_graphics_core::geometry::Point;
use embedded_graphics_core::pixelcolor::Rgb888;

/// Puts colours in `[0, 1]`, rows of `width`, onto a display, from its top left corner on. Clamps.
///
/// # Errors
/// Those of the display.
pub fn show<D>(pixels: &[[f32; 3]], width: usize, display: &mut D) -> Result<(), D::Error>
where
    D: DrawTarget,
    D::Color: From<Rgb888>,
{
    let byte = |x: f32| (x.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    let rows = pixels.chunks(width.max(1)).zip(0..);
    display.draw_iter(rows.flat_map(|(row, y)| {
        row.iter().zip(0..).map(move |(pixel, x)| {
            let [r, g, b] = pixel.map(byte);
            Pixel(Point::new(x, y), Rgb888::new(r, g, b).into())
        })
    }))
}
