//! Normals and albedo to colours, pixel by pixel: spherical-harmonics light and the colour
//! transform.

use super::LANES;
use super::rasterize::{self, Visible};
use crate::light::{ModelLight, color_matrix};
use crate::math;
use crate::mesh::{Index, transpose};
use crate::scene::Scene;

/// One number per channel or axis, for the pixels of a chunk.
pub type Planes = [[f32; LANES]; 3];

/// Light and colour transform of a scene, ready to be applied:
/// `colour = M·(albedo ∘ radiance(n)) + offset`.
#[derive(Clone, Copy, Debug)]
pub struct Shader {
    light: ModelLight,
    mix: [[f32; 3]; 3],
    offset: [f32; 3],
}

impl Shader {
    /// Takes what it needs from a hypothesis.
    pub fn new(scene: &Scene) -> Self {
        Self {
            light: ModelLight::new(&scene.light, &scene.pose.rotation()),
            mix: color_matrix(&scene.color),
            offset: scene.color.offset,
        }
    }

    /// Colour of a surface with this unit normal (of the model's frame) and albedo.
    #[inline(always)]
    pub fn color(&self, normal: [f32; 3], albedo: [f32; 3]) -> [f32; 3] {
        let radiance = self.light.radiance(normal);
        let [r, g, b] = [0, 1, 2].map(|c| albedo[c] * radiance[c]);
        let m = &self.mix;
        [0, 1, 2].map(|c| m[c][0] * r + m[c][1] * g + m[c][2] * b + self.offset[c])
    }

    /// Radiance at a unit normal of the model's frame.
    pub fn radiance(&self, normal: [f32; 3]) -> [f32; 3] {
        self.light.radiance(normal)
    }
}

/// Where the pixels of a chunk are in the mesh.
pub struct Places {
    /// Corners of the visible triangles; any where nothing is visible.
    corners: [[u32; 3]; LANES],
    /// Their weights; zero where nothing is visible.
    weights: [[f32; 3]; LANES],
}

impl Places {
    /// Looks up the triangles.
    #[inline(always)]
    pub fn new<I: Index>(triangles: &[[I; 3]], visible: &Visible) -> Self {
        let mut places = Self { corners: [[0; 3]; LANES], weights: [[0.0; 3]; LANES] };
        for (l, pixel) in visible.iter().enumerate() {
            let (triangle, [w1, w2]) = rasterize::triangle(*pixel);
            if let Some(corners) = triangles.get(triangle) {
                places.corners[l] = corners.map(|v| v.index() as u32);
                places.weights[l] = [1.0 - w1 - w2, w1, w2];
            }
        }
        places
    }

    /// Interpolates an attribute of the vertices.
    #[inline(always)]
    pub fn interpolate(&self, vertices: &[[f32; 4]], planes: &mut Planes) {
        // In memory between two loops: the first is one vector per pixel, not three numbers.
        let mut pixels = [[0.0_f32; 4]; LANES];
        for (pixel, (corners, weights)) in
            pixels.iter_mut().zip(self.corners.iter().zip(&self.weights))
        {
            let [p, q, r] = corners.map(|v| vertices[v as usize]);
            let [u, v, w] = weights;
            *pixel = core::array::from_fn(|i| u * p[i] + v * q[i] + w * r[i]);
        }
        for (group, pixels) in pixels.as_chunks::<4>().0.iter().enumerate() {
            for (plane, axis) in planes.iter_mut().zip(transpose(*pixels)) {
                plane[4 * group..4 * group + 4].copy_from_slice(&axis);
            }
        }
    }
}

/// The same vectors with length one; zero stays zero.
#[inline(always)]
pub fn normalize([mut x, mut y, mut z]: Planes) -> Planes {
    for l in 0..LANES {
        let k = math::rsqrt(x[l] * x[l] + y[l] * y[l] + z[l] * z[l]);
        x[l] *= k;
        y[l] *= k;
        z[l] *= k;
    }
    [x, y, z]
}
