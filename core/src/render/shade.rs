//! Albedo and normals to colours: spherical-harmonics light and the colour transform per vertex.

use crate::light::{ModelLight, color_matrix};
use crate::mesh::planes;
use crate::scene::Scene;

/// Vertices handled together; the loop over them has no branches and vectorises.
const BATCH: usize = 8;

/// Fills `shaded` with `[R, G, B, 0]` per vertex: `gain ∘ mix(albedo ∘ radiance(R·n)) + offset`.
/// `normals` are unit vectors of the model's frame.
pub fn shade(scene: &Scene, normals: &[f32], albedo: &[f32], shaded: &mut [[f32; 4]]) {
    let light = ModelLight::new(&scene.light, &scene.pose.rotation());
    let mix = color_matrix(&scene.color);
    let offset = scene.color.offset;
    let [nx, ny, nz] = planes(normals).map(|plane| plane.as_chunks::<BATCH>().0);
    let [ar, ag, ab] = planes(albedo).map(|plane| plane.as_chunks::<BATCH>().0);
    let batches = shaded
        .as_chunks_mut::<BATCH>()
        .0
        .iter_mut()
        .zip(nx.iter().zip(ny).zip(nz))
        .zip(ar.iter().zip(ag).zip(ab));
    for ((out, ((x, y), z)), ((r, g), b)) in batches {
        let mut red = [0.0_f32; BATCH];
        let mut green = [0.0_f32; BATCH];
        let mut blue = [0.0_f32; BATCH];
        for l in 0..BATCH {
            let radiance = light.radiance([x[l], y[l], z[l]]);
            let c = [r[l] * radiance[0], g[l] * radiance[1], b[l] * radiance[2]];
            red[l] = mix[0][0] * c[0] + mix[0][1] * c[1] + mix[0][2] * c[2] + offset[0];
            green[l] = mix[1][0] * c[0] + mix[1][1] * c[1] + mix[1][2] * c[2] + offset[1];
            blue[l] = mix[2][0] * c[0] + mix[2][1] * c[1] + mix[2][2] * c[2] + offset[2];
        }
        for l in 0..BATCH {
            out[l] = [red[l], green[l], blue[l], 0.0];
        }
    }
}

/// Interpolates a vertex attribute inside a triangle: weight `1 − w₁ − w₂` for the first corner.
#[inline]
pub fn interpolate(values: &[[f32; 4]], corners: [u32; 3], [w1, w2]: [f32; 2]) -> [f32; 4] {
    let [a, b, c] = corners.map(|v| values[v as usize]);
    let w0 = 1.0 - w1 - w2;
    core::array::from_fn(|l| w0 * a[l] + w1 * b[l] + w2 * c[l])
}
