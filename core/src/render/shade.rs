//! Normals and albedo to colours, pixel by pixel: spherical-harmonics light and the colour
//! transform.

use crate::color::color_matrix;
use crate::lanes::LANES;
pub use crate::lanes::Planes;
use crate::light::ModelLight;
use crate::math;
use crate::mesh::{Index, transpose};
use crate::render::rasterize::{self, Visible};
use crate::scene::View;

/// Light and colour transform of a view, ready to be applied:
/// `colour = M·(albedo ∘ radiance(n)) + offset`.
#[derive(Clone, Copy, Debug)]
pub struct Shader {
    light: ModelLight,
    mix: [[f32; 3]; 3],
    offset: [f32; 3],
}

impl Shader {
    /// Takes what it needs from a view.
    pub fn new(view: &View) -> Self {
        Self {
            light: ModelLight::new(&view.light, &view.pose.rotation()),
            mix: color_matrix(&view.color),
            offset: view.color.offset,
        }
    }

    /// Colour of a surface with this unit normal (of the model's frame) and albedo.
    #[inline(always)]
    pub fn color(&self, normal: [f32; 3], albedo: [f32; 3]) -> [f32; 3] {
        let radiance = self.light.radiance(normal);
        let [r, g, b] = math::zip(albedo, radiance, |albedo, radiance| albedo * radiance);
        let m = &self.mix;
        let mut color = self.offset;
        for c in 0..3 {
            color[c] += m[c][0] * r + m[c][1] * g + m[c][2] * b;
        }
        color
    }

    /// The same, with colours `k` times as large.
    #[must_use]
    pub fn scaled(&self, k: f32) -> Self {
        let mix = self.mix.map(|row| row.map(|m| k * m));
        Self { light: self.light, mix, offset: self.offset.map(|o| k * o) }
    }

    /// Radiance at a unit normal of the model's frame.
    pub fn radiance(&self, normal: [f32; 3]) -> [f32; 3] {
        self.light.radiance(normal)
    }
}

/// Unit normal (model frame) and albedo of a vertex: `[x, y, z, 0, R, G, B, 0]`. They lie side by side,
/// since what needs the one mostly needs the other.
pub type Attributes = [f32; 8];

/// The normal among a vertex's attributes.
#[inline(always)]
pub fn normal_of([x, y, z, w, ..]: Attributes) -> [f32; 4] {
    [x, y, z, w]
}

/// The albedo among a vertex's attributes.
#[inline(always)]
pub fn albedo_of([.., r, g, b, w]: Attributes) -> [f32; 4] {
    [r, g, b, w]
}

/// Puts normals and albedo side by side.
pub fn join(
    normals: impl IntoIterator<Item = [f32; 4]>,
    albedo: impl IntoIterator<Item = [f32; 4]>,
    attributes: &mut [Attributes],
) {
    for (out, ([x, y, z, w], [r, g, b, v])) in
        attributes.iter_mut().zip(normals.into_iter().zip(albedo))
    {
        *out = [x, y, z, w, r, g, b, v];
    }
}

/// Replaces the normals among attributes.
pub fn set_normals(normals: &[[f32; 4]], attributes: &mut [Attributes]) {
    for ([x, y, z, w, ..], normal) in attributes.iter_mut().zip(normals) {
        [*x, *y, *z, *w] = *normal;
    }
}

/// Replaces the albedo among attributes.
pub fn set_albedo(albedo: &[[f32; 4]], attributes: &mut [Attributes]) {
    for ([.., r, g, b, w], albedo) in attributes.iter_mut().zip(albedo) {
        [*r, *g, *b, *w] = *albedo;
    }
}

/// Interpolates the last `WIDTH` numbers of the vertices' attributes at the pixels of a chunk: four
/// of them for each of `planes`, of which the first three are kept. They are zero where nothing is visible.
#[inline(always)]
pub fn interpolate<I: Index, const WIDTH: usize>(
    triangles: &[[I; 3]],
    visible: &Visible,
    vertices: &[Attributes],
    planes: &mut [&mut Planes],
) {
    // In memory between two loops: the first is one vector per pixel, not three numbers.
    let mut pixels = [[0.0_f32; WIDTH]; LANES];
    let vertex = |corner: I| vertices.get(corner.index())?.last_chunk::<WIDTH>();
    for (out, pixel) in pixels.iter_mut().zip(visible) {
        let (triangle, [v, w]) = rasterize::triangle(*pixel);
        let Some(&[p, q, r]) = triangles.get(triangle) else { continue };
        let Some(p) = vertex(p) else { continue };
        let Some(q) = vertex(q) else { continue };
        let Some(r) = vertex(r) else { continue };
        let u = 1.0 - v - w;
        for i in 0..WIDTH {
            out[i] = u * p[i] + v * q[i] + w * r[i];
        }
    }
    for (n, [x, y, z]) in planes.iter_mut().map(|planes| &mut **planes).enumerate() {
        let quad = |pixel: [f32; WIDTH]| pixel.as_chunks().0.get(n).copied().unwrap_or_default();
        let lanes = x.as_chunks_mut().0.iter_mut().zip(y.as_chunks_mut().0);
        let lanes = lanes.zip(z.as_chunks_mut().0);
        for (&[a, b, c, d], ((x, y), z)) in pixels.as_chunks().0.iter().zip(lanes) {
            [*x, *y, *z, _] = transpose([quad(a), quad(b), quad(c), quad(d)]);
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
