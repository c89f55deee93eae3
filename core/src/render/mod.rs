//! From vertex fields to pixels: project, rasterize, shade.
//!
//! Each stage is a function from slices to slices, so that the chain reruns only what a move has
//! touched: a new light needs [`shade`] alone, new albedo needs [`shade`], a new pose needs
//! [`project`] and [`rasterize`] before it.
//!
//! Colours are computed per vertex and interpolated perspective-correctly per pixel. With
//! triangles of one or two pixels this is what shading every pixel gives, but for creases where
//! normals turn within a triangle; the per-pixel twin in the tests is the oracle.

pub mod project;
pub mod rasterize;
pub mod shade;

use crate::basis::{field_len, padded};
use crate::model::Model;
use crate::scene::Scene;
use rasterize::{Frame, frame_words};

/// A picture to draw into, RGB per pixel, row by row; what the mesh does not cover stays as it is.
pub type Pixels<'a> = &'a mut [[f32; 3]];

/// Words of memory [`draw`] needs for a model and a picture.
pub const fn draw_words(vertices: usize, width: usize, height: usize) -> usize {
    3 * field_len(vertices) + 8 * padded(vertices) + frame_words(width, height)
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
    let mut carve = crate::workspace::Carver::new(memory);
    let positions = carve.floats(field_len(vertices))?;
    let normals = carve.floats(field_len(vertices))?;
    let albedo = carve.floats(field_len(vertices))?;
    let window = carve.quads(padded(vertices))?;
    let shaded = carve.quads(padded(vertices))?;
    let mut frame = Frame::carve(&mut carve, width, height)?;

    model.shape.instance(&scene.shape, positions);
    // `shaded` serves as scratch before it is filled.
    crate::mesh::vertex_normals(model, positions, shaded, normals);
    model.albedo.instance(&scene.albedo, albedo);
    project::project(scene, positions, window);
    shade::shade(scene, normals, albedo, shaded);
    rasterize::rasterize(model.triangles, window, &mut frame);

    let mut covered = 0;
    for hit in frame.rows().flat_map(|y| frame.row(y)) {
        if let Some(corners) = model.triangles.get(hit.triangle) {
            let color = shade::interpolate(shaded, corners, hit.weights);
            pixels[hit.pixel] = [color[0], color[1], color[2]];
            covered += 1;
        }
    }
    Some(covered)
}
