//! Pictures of a scene, and pictures on any display that embedded-graphics knows.

use crate::basis::padded;
use crate::engine::Engine;
use crate::lanes::{LANES, chunks};
use crate::memory::Carver;
use crate::mesh::Index;
use crate::model::{Model, Triangles};
use crate::render::rasterize::{Frame, frame_words};
use crate::render::shade::{self, Attributes, Shader};
use crate::scene::Scene;
use core::hint::black_box;
use embedded_graphics_core::Pixel;
use embedded_graphics_core::draw_target::DrawTarget;
use embedded_graphics_core::geometry::Point;
use embedded_graphics_core::pixelcolor::Rgb888;

/// A picture to draw into, RGB per pixel, row by row; what the mesh does not cover stays as it is.
pub type Pixels<'a> = &'a mut [[f32; 3]];

/// Words of memory [`draw`] needs for a model and a picture.
pub const fn draw_words(vertices: usize, width: usize, height: usize) -> usize {
    4 * 4 * padded(vertices) + frame_words(width, height)
}

/// Draws the model under a hypothesis over `pixels` (width × height of the scene's camera) and
/// tells how many pixels it covers. `None` if `memory` is shorter than [`draw_words`] or `pixels`
/// has the wrong length; then nothing is drawn.
///
/// One-shot and stateless: for pictures of results. The chain keeps its stages instead.
pub fn draw(
    model: &Model<'_>,
    scene: &Scene,
    memory: &mut [u32],
    pixels: Pixels<'_>,
) -> Option<usize> {
    let [width, height] = scene.view.camera.image_size.map(|side| side as usize);
    let vertices = model.vertices();
    if pixels.len() != width.checked_mul(height)?
        || memory.len() < draw_words(vertices, width, height)
    {
        return None;
    }
    let mut carve = Carver::new(memory);
    let positions = carve.quads(padded(vertices))?;
    let attributes = carve.groups(padded(vertices))?;
    let window = carve.quads(padded(vertices))?;
    let mut frame = Frame::carve(&mut carve, width, height)?;

    // Called, where link-time optimisation would compile them in once more: pictures are small.
    let engine = black_box(Engine::PORTABLE);
    (engine.instance)(&model.shape, &scene.subject.shape, positions);
    // Normals and albedo pass through the memory of the window coordinates, which come last.
    (engine.normals)(model.triangles, positions, window);
    shade::set_normals(window, attributes);
    (engine.instance)(&model.albedo, &scene.subject.albedo, window);
    shade::set_albedo(window, attributes);
    (engine.project)(&scene.view, positions, window);
    (engine.rasterize)(model.triangles, window, &mut frame);
    let shader = Shader::new(&scene.view);
    Some(match model.triangles {
        Triangles::U16(t) => fill(&frame, t, attributes, &shader, pixels, width),
        Triangles::U32(t) => fill(&frame, t, attributes, &shader, pixels, width),
    })
}

/// Colours the covered pixels and counts them.
fn fill<I: Index>(
    frame: &Frame<'_>,
    triangles: &[[I; 3]],
    attributes: &[Attributes],
    shader: &Shader,
    pixels: Pixels<'_>,
    width: usize,
) -> usize {
    let stride = chunks(width, 1);
    let mut covered = 0;
    for y in frame.rows() {
        let row = pixels.get_mut(y * width..(y + 1) * width).unwrap_or_default();
        for index in frame.row(y) {
            let Some(visible) = frame.chunk(index) else { continue };
            let (mut n, mut a) = Default::default();
            shade::interpolate::<_, 8>(triangles, visible, attributes, &mut [&mut n, &mut a]);
            let n = shade::normalize(n);
            let x = LANES * (index - y * stride);
            for (l, pixel) in row.iter_mut().skip(x).take(LANES).enumerate() {
                if frame.covered(index) >> l & 1 != 0 {
                    *pixel = shader.color([n[0][l], n[1][l], n[2][l]], [a[0][l], a[1][l], a[2][l]]);
                    covered += 1;
                }
            }
        }
    }
    covered
}

/// Shows a picture, rows of `width` colours in `[0, 1]`, on a display, from its top left corner on. Colours
/// beyond are clamped.
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
