//! Pictures and meshes of a model, in owned memory.

use crate::error::{Error, Result};
use crate::mesh::Mesh;
#[cfg(feature = "full")]
use crate::model::layout;
use crate::photo::picture::Picture;
use crate::vector::turned;
use onescan_core::basis::{Basis, padded};
use onescan_core::draw;
use onescan_core::engine::Engine;
use onescan_core::lanes::{LANES, chunks};
use onescan_core::memory::Carver;
use onescan_core::model::Model;
use onescan_core::render::rasterize::{Frame, frame_words};
use onescan_core::rng::Rng;
use onescan_core::scene::{Camera, Pose, Scene};
use std::hint::black_box;

/// What stands behind a model drawn alone.
pub const GROUND: [u8; 3] = [255; 3];

/// Draws the model under a hypothesis over `background`, which has the size of the scene's
/// camera. Colours are clamped to `[0, 1]`.
///
/// # Errors
/// A background of another size.
pub fn draw_over(model: &Model<'_>, scene: &Scene, background: &Picture) -> Result<Picture> {
    let [width, height] = scene.view.camera.image_size;
    let mut pixels = background.to_unit();
    let words = draw::draw_words(model.vertices(), width as usize, height as usize);
    let mut memory = vec![0; words];
    draw::draw(model, scene, &mut memory, &mut pixels).ok_or_else(|| {
        Error::new(format_args!(
            "the camera's picture is {width}×{height}, the background {}×{}",
            background.width, background.height
        ))
    })?;
    Ok(Picture::from_unit(width, height, &pixels))
}

/// Draws the model over a plain colour.
pub fn draw_on(model: &Model<'_>, scene: &Scene, ground: [u8; 3]) -> Picture {
    let [width, height] = scene.view.camera.image_size;
    let background = Picture::filled(width, height, ground);
    // The background was made to the camera's size.
    draw_over(model, scene, &background).unwrap_or(background)
}

/// A picture with smooth edges, for people to look at: a pixel is the mean of nine that `draw` makes,
/// or in larger pictures of four or one. `draw` gets how many lie along each side of a pixel, and the
/// scene with a camera for so many.
///
/// # Errors
/// Those of `draw`.
pub fn smooth(scene: &Scene, draw: impl FnOnce(&Scene, u32) -> Result<Picture>) -> Result<Picture> {
    let [width, height] = scene.view.camera.image_size;
    // Of a picture of four megapixels nine times as many would take gigabytes.
    let fine = match (u64::from(width) * u64::from(height)) >> 19 {
        0 => 3,
        1..4 => 2,
        _ => 1,
    };
    let mut scene = scene.clone();
    scene.view.camera =
        resampled_camera(&scene.view.camera, [width, height].map(|side| fine * side));
    Ok(draw(&scene, fine)?.resized(width, height))
}

/// [`draw_over`] with smooth edges, see [`smooth`].
///
/// # Errors
/// A background of another size.
pub fn smooth_over(model: &Model<'_>, scene: &Scene, background: &Picture) -> Result<Picture> {
    smooth(scene, |scene, fine| draw_over(model, scene, &background.enlarged(fine)))
}

/// [`draw_on`] with smooth edges, see [`smooth`].
pub fn smooth_on(model: &Model<'_>, scene: &Scene, ground: [u8; 3]) -> Picture {
    let [width, height] = scene.view.camera.image_size;
    let background = Picture::filled(width, height, ground);
    // The background was made to the camera's size.
    smooth_over(model, scene, &background).unwrap_or(background)
}

/// The inverse distance (1/mm) of what the camera sees of the model at each pixel, row by row; 0 where it
/// sees nothing of it.
pub fn inverse_distances(model: &Model<'_>, scene: &Scene) -> Vec<f32> {
    let [width, height] = scene.view.camera.image_size.map(|side| side as usize);
    let mut distances = vec![0.0; width * height];
    let look = |frame: &Frame<'_>| {
        for (y, row) in distances.chunks_exact_mut(width.max(1)).enumerate() {
            for (row, chunk) in row.chunks_mut(LANES).zip(y * chunks(width, 1)..) {
                let pixels = frame.chunk(chunk).into_iter().flatten();
                row.iter_mut().zip(pixels).for_each(|(distance, pixel)| *distance = pixel[0]);
            }
        }
    };
    visible(model, scene, look).unwrap_or_default();
    distances
}

/// Hands over what is visible of the model.
pub(crate) fn visible<T>(
    model: &Model<'_>,
    scene: &Scene,
    look: impl FnOnce(&Frame<'_>) -> T,
) -> Option<T> {
    let [width, height] = scene.view.camera.image_size.map(|side| side as usize);
    let vertices = padded(model.vertices());
    let mut memory = vec![0; 2 * 4 * vertices + frame_words(width, height)];
    // As much memory as they take: always some.
    let mut carve = Carver::new(&mut memory);
    let (positions, window) = (carve.quads(vertices)?, carve.quads(vertices)?);
    let mut frame = Frame::carve(&mut carve, width, height)?;
    // Called, as drawing is, where it would be compiled in once more.
    let engine = black_box(Engine::PORTABLE);
    (engine.instance)(&model.shape, &scene.subject.shape, positions);
    (engine.project)(&scene.view, positions, window);
    (engine.rasterize)(model.triangles, window, &mut frame);
    Some(look(&frame))
}

/// Draws a mesh over a plain colour, with smooth edges. The scene's coefficients are not looked at.
///
/// # Errors
/// A mesh that breaks its guarantees.
#[cfg(feature = "full")]
pub fn draw_mesh(mesh: &Mesh, scene: &Scene, ground: [u8; 3]) -> Result<Picture> {
    let rigid = layout::rigid(mesh, &[])?;
    let mut scene = scene.clone();
    scene.subject.shape.clear();
    scene.subject.albedo.clear();
    Ok(smooth_on(&rigid.view(), &scene, ground))
}

/// Draws a mesh upright, turned by yaw and pitch in radians, with smooth edges.
///
/// # Errors
/// A mesh that breaks its guarantees.
#[cfg(feature = "full")]
pub fn mesh_portrait(mesh: &Mesh, size: [u32; 2], [yaw, pitch]: [f32; 2]) -> Result<Picture> {
    let rigid = layout::rigid(mesh, &[])?;
    Ok(smooth_on(&rigid.view(), &portrait(&rigid.view(), size, yaw, pitch), GROUND))
}

/// Standard normal coefficients.
pub fn random_coefficients(count: usize, rng: &mut Rng) -> Vec<f32> {
    (0..count).map(|_| rng.normal() as f32).collect()
}

/// The camera for a picture of another size: the same view across the shorter side, pixels square.
pub fn resize_camera(camera: &Camera, size: [u32; 2]) -> Camera {
    // Focal length in units of half the shorter side stays.
    let short = |size: [u32; 2]| size[0].min(size[1]) as f32;
    let per_pixel = camera.sensor[0] / camera.image_size[0] as f32 * short(camera.image_size);
    Camera {
        sensor: size.map(|side| per_pixel * side as f32 / short(size)),
        image_size: size,
        ..*camera
    }
}

/// The camera that sees in a picture resampled to another size, [`Picture::resized`], what `camera` sees
/// in the picture before: `x' = (x + ½)·s − ½`, so `c' = c + (s − 1)/W'`, and the other sign for y,
/// which points down in pictures.
pub fn resampled_camera(camera: &Camera, size: [u32; 2]) -> Camera {
    let shift = |i: usize| {
        let [old, new] = [camera.image_size[i], size[i]].map(|side| side.max(1) as f32);
        (new / old - 1.0) / new
    };
    let [x, y] = camera.principal_point;
    Camera { principal_point: [x + shift(0), y - shift(1)], image_size: size, ..*camera }
}

/// A scene that shows the whole model upright under frontal light, turned by `yaw` and `pitch`
/// radians, in a picture of the given size.
///
/// The object's bounding sphere fills most of the shorter side, whatever its size.
pub fn portrait(model: &Model<'_>, size: [u32; 2], yaw: f32, pitch: f32) -> Scene {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for (axis, plane) in model.shape.mean().chunks_exact(padded(model.vertices())).enumerate() {
        for &x in &plane[..model.vertices()] {
            low[axis] = low[axis].min(x);
            high[axis] = high[axis].max(x);
        }
    }
    let centre: [f32; 3] = std::array::from_fn(|i| 0.5 * (low[i] + high[i]));
    let half = (0..3).map(|i| 0.5 * (high[i] - low[i])).fold(1e-3, f32::max);
    centered(centre, half, size, [yaw, pitch])
}

/// The same for what lies within `half` of a point, mm.
pub fn centered(centre: [f32; 3], half: f32, size: [u32; 2], [yaw, pitch]: [f32; 2]) -> Scene {
    let mut scene = Scene::initial(size[0], size[1], 0, 0);
    scene.view.pose = Pose { yaw, pitch, ..Pose::AWAY_1M };
    // Ten half-sizes away, the reference engine's 7.5 mm lens sees 1.33 half-sizes each way.
    let turned = turned(&scene.view.pose.rotation(), centre);
    scene.view.pose.translation = [-turned[0], -turned[1], -turned[2] - 10.0 * half];
    scene.view.camera = Camera { focal_length: 8.8, near: half, ..scene.view.camera };
    scene
}

/// A half of a model, its first three numbers of every vertex.
fn field(model: &Model<'_>, basis: &Basis<'_>, coefficients: &[f32]) -> Vec<[f32; 3]> {
    let mut vertices = vec![[0.0; 4]; padded(model.vertices())];
    basis.instance(coefficients, &mut vertices);
    vertices.truncate(model.vertices());
    vertices.into_iter().map(|[a, b, c, _]| [a, b, c]).collect()
}

/// The vertex positions that shape coefficients give, in the model's frame.
#[cfg(feature = "full")]
pub fn points(model: &Model<'_>, shape: &[f32]) -> Vec<[f32; 3]> {
    field(model, &model.shape, shape)
}

/// The mesh that coefficients give: vertex positions in the model's frame, albedo as colours (clamped to
/// `[0, 1]`).
pub fn instance(model: &Model<'_>, shape: &[f32], albedo: &[f32]) -> Mesh {
    let colors = field(model, &model.albedo, albedo);
    Mesh {
        points: field(model, &model.shape, shape),
        colors: colors.into_iter().map(|c| c.map(|x| x.clamp(0.0, 1.0))).collect(),
        triangles: (0..model.triangles.len()).filter_map(|t| model.triangles.get(t)).collect(),
    }
}

#[cfg(test)]
#[cfg(feature = "full")]
mod tests {
    use super::*;
    use crate::model_file::OwnedModel;

    #[test]
    fn smooth_pictures_differ_from_plain_ones_at_edges() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../fixtures/golden/small.3dmm");
        let file = OwnedModel::read(std::path::Path::new(path)).unwrap();
        let model = file.view();
        let scene = portrait(&model, [60, 48], 0.4, 0.1);
        let ground = Picture::from_fn(60, 48, |x, y| [x as u8, y as u8, 200]);
        let plain = draw_over(&model, &scene, &ground).unwrap();
        let smooth = smooth_over(&model, &scene, &ground).unwrap();
        let far = |a: &[u8; 3], b: &[u8; 3]| (0..3).map(|i| a[i].abs_diff(b[i])).max() > Some(24);
        let all = plain.rgb.len();
        let changed = plain.rgb.iter().zip(&smooth.rgb).filter(|(a, b)| far(a, b)).count();
        assert!(changed > 20 && changed < all / 8, "{changed} of {all}");
        let still =
            |picture: &Picture| picture.rgb.iter().zip(&ground.rgb).filter(|(a, b)| a == b).count();
        // Covered by the model but for the rim, and what is not covered is the ground as it was.
        assert!(still(&smooth) <= still(&plain) && still(&smooth) > all / 4);
        assert!(smooth_over(&model, &scene, &Picture::filled(60, 47, GROUND)).is_err());
    }
}
