//! From vertices to pixels: project, rasterize, shade.
//!
//! Each stage is a function from slices to slices, so that the chain reruns only what a move has
//! touched. Rasterizing finds the visible triangle of every pixel; shading interpolates normal and
//! albedo there and lights them. What is visible is kept, so that new albedo and new light need no
//! new geometry; the chain also keeps what was interpolated, for new light.
//!
//! A picture's rows are padded to whole chunks of [`LANES`] pixels, and everything per pixel is
//! computed a chunk at a time.

pub mod project;
pub mod rasterize;
pub mod shade;

use crate::basis::padded;
pub use crate::lanes::{LANES, chunks};
use crate::memory::Carver;
use crate::mesh::{self, Index};
use crate::model::{Model, Triangles};
use crate::scene::Scene;
use rasterize::{Frame, frame_words};
use shade::{Attributes, Shader};

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
    let [width, height] = scene.camera.image_size.map(|side| side as usize);
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

    model.shape.instance(&scene.shape, positions);
    // Normals and albedo pass through the memory of the window coordinates, which come last.
    mesh::vertex_normals(model.triangles, positions, window);
    shade::set_normals(window, attributes);
    model.albedo.instance(&scene.albedo, window);
    shade::set_albedo(window, attributes);
    project::project(scene, positions, window);
    rasterize::rasterize(model.triangles, window, &mut frame);
    let shader = Shader::new(scene);
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
