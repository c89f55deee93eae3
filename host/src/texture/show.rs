//! Pictures of an object in its skin.

use super::canvas::{between, pixel};
use crate::mesh::skin::{Colors, Skin};
use crate::photo::picture::{Picture, Rgb};
use crate::render;
use crate::vector::length;
use onescan_core::model::Model;
use onescan_core::render::shade::Shader;
use onescan_core::scene::Scene;

/// Draws the model in its skin over a plain colour: in the skin's own colours, or, if it is to be lit, under
/// the scene's light and colour transform. `scene` gives the shape, but not the albedo.
pub fn show(model: &Model<'_>, scene: &Scene, skin: &Skin, ground: Rgb) -> Picture {
    let [width, height] = scene.view.camera.image_size;
    let shader = Shader::new(&scene.view);
    let normals = if skin.lit {
        render::instance(model, &scene.subject.shape, &[]).normals()
    } else {
        Vec::new()
    };
    let picture = render::visible(model, scene, |frame| {
        let (rows, columns) = (frame.rows(), frame.columns());
        Picture::from_fn(width, height, |x, y| {
            if !rows.contains(&(y as usize)) || !columns.contains(&(x as usize)) {
                return ground;
            }
            let Some(hit) = frame.hit(x as usize, y as usize) else { return ground };
            let Some(corners) = model.triangles.get(hit.triangle) else { return ground };
            let [v, w] = hit.weights;
            let weights = [1.0 - v - w, v, w];
            let color = color(skin, corners, weights);
            let color = if skin.lit {
                let n: [f32; 3] = mix(&normals, corners, weights);
                let length = length(n).max(f32::MIN_POSITIVE);
                shader.color(n.map(|x| x / length), color)
            } else {
                color
            };
            color.map(|c| (255.0 * c + 0.5) as u8)
        })
    });
    picture.unwrap_or_else(|| Picture::filled(width, height, ground))
}

fn color(skin: &Skin, corners: [u32; 3], weights: [f32; 3]) -> [f32; 3] {
    match &skin.colors {
        Colors::Vertices(colors) => mix(colors, corners, weights),
        Colors::Texture(texture) => {
            let at = pixel(mix(&texture.uvs, corners, weights), texture.picture.width as usize);
            let size = [texture.picture.width, texture.picture.height].map(|side| side as usize);
            let [r, g, b, _] = between(size, at, &|i| {
                let [r, g, b] = texture.picture.rgb[i].map(|c| f32::from(c) / 255.0);
                [r, g, b, 0.0]
            });
            [r, g, b]
        }
    }
}

fn mix<const N: usize>(field: &[[f32; N]], corners: [u32; 3], weights: [f32; 3]) -> [f32; N] {
    let values = corners.map(|i| field.get(i as usize).copied().unwrap_or([0.0; N]));
    std::array::from_fn(|k| {
        values.iter().zip(weights).map(|(value, weight)| weight * value[k]).sum()
    })
}
