//! The slow, obvious twins of the optimised stages: oracles of the tests, yardsticks of the
//! benches. Nothing in a fit calls them.

use crate::basis::Basis;
use crate::light;
use crate::likelihood::background;
use crate::likelihood::pixels::ln_normaliser;
use crate::math;
use crate::model::Model;
use crate::render::rasterize::Frame;
use crate::render::shade::{self, Attributes};
use crate::scene::{Camera, Scene, View};

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn normalize(a: [f64; 3]) -> [f64; 3] {
    let n = math::sqrt_f64(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]);
    if n > 0.0 { a.map(|x| x / n) } else { a }
}

/// Twin of [`crate::basis::Basis::instance`], for shape: number by number.
pub fn instance(basis: &Basis<'_>, coefficients: &[f32], vertices: &mut [[f32; 4]]) {
    for (v, out) in vertices.iter_mut().enumerate() {
        for (axis, out) in out.iter_mut().take(3).enumerate() {
            let entry = axis * basis.mean().len() / 3 + v;
            *out = basis.mean()[entry];
            for (k, &c) in coefficients.iter().enumerate().take(basis.rank()) {
                *out += basis.term(entry, k, c);
            }
        }
    }
}

fn xyz([x, y, z, _]: [f32; 4]) -> [f32; 3] {
    [x, y, z]
}

/// Twin of [`crate::mesh::vertex_normals`], in double precision.
pub fn vertex_normals(model: &Model<'_>, positions: &[[f32; 4]], normals: &mut [[f32; 4]]) {
    normals.fill([0.0; 4]);
    for corners in (0..model.triangles.len()).filter_map(|t| model.triangles.get(t)) {
        let [a, b, c] = corners.map(|v| xyz(positions[v as usize]).map(f64::from));
        let n = normalize(cross(sub(b, a), sub(c, a)));
        for v in corners {
            for (sum, n) in normals[v as usize].iter_mut().zip(n) {
                *sum += n as f32;
            }
        }
    }
    for normal in normals {
        let [x, y, z] = normalize(xyz(*normal).map(f64::from)).map(|n| n as f32);
        *normal = [x, y, z, 0.0];
    }
}

/// Twin of [`crate::render::project::project`] without its grid: vertex by vertex.
pub fn project(view: &View, positions: &[[f32; 4]], window: &mut [[f32; 4]]) {
    for (out, &position) in window.iter_mut().zip(positions) {
        let world = view.pose.to_world(xyz(position));
        let (x, y, d) = view.camera.project(world);
        *out = [x, y, if d > view.camera.near { 1.0 / d } else { 0.0 }, 0.0];
    }
}

/// Twin of [`crate::render::shade::Shader::color`]: the normal turned to the world, every basis
/// function evaluated.
pub fn color(view: &View, normal: [f32; 3], albedo: [f32; 3]) -> [f32; 3] {
    let world =
        view.pose.rotation().map(|r| r[0] * normal[0] + r[1] * normal[1] + r[2] * normal[2]);
    let radiance = light::radiance(&view.light, world);
    view.color.apply([0, 1, 2].map(|c| albedo[c] * radiance[c]))
}

/// Twin of [`crate::likelihood::pixels::residual`]'s shading: every visible pixel of a frame with
/// its own interpolated, normalised normal and albedo, in double precision. `pixels` are the rows of
/// the picture.
pub fn shade(
    model: &Model<'_>,
    scene: &Scene,
    frame: &Frame<'_>,
    vertices: &[Attributes],
    pixels: &mut [[f32; 3]],
) {
    let width = scene.view.camera.image_size[0] as usize;
    for (i, pixel) in pixels.iter_mut().enumerate() {
        let Some(hit) = frame.hit(i % width, i / width) else { continue };
        let Some(corners) = model.triangles.get(hit.triangle) else { continue };
        let [b, c] = hit.weights.map(f64::from);
        let weights = [1.0 - b - c, b, c];
        let corners = corners.map(|i| vertices[i as usize]);
        let normal = blend(weights, corners.map(shade::normal_of));
        let albedo = blend(weights, corners.map(shade::albedo_of));
        *pixel = color(&scene.view, normalize(normal).map(|x| x as f32), albedo.map(|x| x as f32));
    }
}

/// Weighted sum of three vertices' attributes.
fn blend(weights: [f64; 3], corners: [[f32; 4]; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| (0..3).map(|i| weights[i] * f64::from(corners[i][axis])).sum())
}

/// Twin of the whole rendering: every covered pixel shaded with its own interpolated, normalised
/// normal and albedo, in double precision.
///
/// `depth` (the inverse distance, 0 where nothing is visible) and `pixels` have one entry per
/// pixel of the scene's camera; the rest is the instance's, per vertex.
pub fn draw(
    model: &Model<'_>,
    scene: &Scene,
    [positions, normals, albedo]: [&[[f32; 4]]; 3],
    depth: &mut [f32],
    pixels: &mut [[f32; 3]],
) {
    depth.fill(0.0);
    let [width, height] = scene.view.camera.image_size.map(|side| side as usize);
    for corners in (0..model.triangles.len()).filter_map(|t| model.triangles.get(t)) {
        let corners = corners.map(|v| v as usize);
        let world = corners.map(|v| scene.view.pose.to_world(xyz(positions[v])).map(f64::from));
        if world.iter().any(|p| -p[2] <= f64::from(scene.view.camera.near)) {
            continue;
        }
        let n = cross(sub(world[1], world[0]), sub(world[2], world[0]));
        if n[0] * world[0][0] + n[1] * world[0][1] + n[2] * world[0][2] > 0.0 {
            continue;
        }
        let p = world.map(|w| window(&scene.view.camera, w));
        let side = |axis: usize, limit: usize| {
            let low = p.iter().map(|p| p[axis]).fold(f64::INFINITY, f64::min);
            let high = p.iter().map(|p| p[axis]).fold(f64::NEG_INFINITY, f64::max);
            (low.max(0.0) as usize)..((high + 2.0).max(0.0) as usize).min(limit)
        };
        for y in side(1, height) {
            for x in side(0, width) {
                let at = [x as f64, y as f64];
                let edge = |a: [f64; 3], b: [f64; 3]| {
                    (b[0] - a[0]) * (at[1] - a[1]) - (b[1] - a[1]) * (at[0] - a[0])
                };
                let e = [edge(p[1], p[2]), edge(p[2], p[0]), edge(p[0], p[1])];
                if e.iter().any(|&e| e > 0.0) || e.iter().sum::<f64>() == 0.0 {
                    continue;
                }
                let b = [0, 1, 2].map(|i| e[i] * p[i][2]);
                let sum = b[0] + b[1] + b[2];
                let inverse = (sum / (e[0] + e[1] + e[2])) as f32;
                if inverse <= depth[y * width + x] {
                    continue;
                }
                depth[y * width + x] = inverse;
                let weights = b.map(|b| b / sum);
                let attribute =
                    |vertices: &[[f32; 4]]| blend(weights, corners.map(|v| vertices[v]));
                let normal = normalize(attribute(normals)).map(|x| x as f32);
                pixels[y * width + x] =
                    color(&scene.view, normal, attribute(albedo).map(|x| x as f32));
            }
        }
    }
}

/// Window coordinates and inverse distance, in double precision.
fn window(camera: &Camera, [x, y, z]: [f64; 3]) -> [f64; 3] {
    let f = f64::from(camera.focal_length);
    let [w, h] = camera.image_size.map(f64::from);
    let [sx, sy] = camera.sensor.map(f64::from);
    let [cx, cy] = camera.principal_point.map(f64::from);
    let d = -z;
    [
        0.5 * w * (2.0 * f / sx * x / d + cx + 1.0),
        0.5 * h * (1.0 - 2.0 * f / sy * y / d - cy),
        1.0 / d,
    ]
}

/// Twin of the image likelihood: foreground minus background, pixel by pixel, in double
/// precision. `depth` and `pixels` are [`draw`]'s; `histogram` is scratch of
/// [`background::HISTOGRAM_LEN`].
pub fn ln_likelihood(
    depth: &[f32],
    pixels: &[[f32; 3]],
    target: &[[u8; 3]],
    histogram: &mut [u32],
    sd: f64,
) -> f64 {
    histogram.fill(0);
    background::count(target, histogram);
    let mut sum = 0.0;
    let mut covered = 0;
    for ((&depth, pixel), &observed) in depth.iter().zip(pixels).zip(target) {
        if depth > 0.0 {
            covered += 1;
            let squares: f64 = (0..3)
                .map(|c| {
                    let d = f64::from(pixel[c]) - f64::from(observed[c]) / 255.0;
                    d * d
                })
                .sum();
            let count = histogram[background::bin(observed)];
            sum += ln_normaliser(sd)
                - squares / (2.0 * sd * sd)
                - f64::from(background::ln_density(count, target.len()));
        }
    }
    if covered > 0 { sum } else { f64::NEG_INFINITY }
}

/// Twin of [`crate::least_squares::add_normal_equations`]: equation by equation, with the same bits.
/// Rows and matrix are as long as the vector.
pub fn normal_equations(
    rows: &[f32],
    equations: &[(f32, f32)],
    matrix: &mut [f32],
    vector: &mut [f32],
) {
    let n = vector.len();
    for (row, (weight, y)) in rows.chunks_exact(n).zip(equations) {
        for i in 0..n {
            vector[i] += weight * row[i] * y;
            for j in i..n {
                matrix[n * i + j] += weight * row[i] * row[j];
            }
        }
    }
}

/// Twin of [`crate::least_squares::cholesky`]: row by row, with the same bits. Rows of the matrix are
/// as long as the vector.
pub fn cholesky(matrix: &mut [f32], vector: &mut [f32]) -> Option<()> {
    let n = vector.len();
    for k in 0..n {
        if !(matrix[n * k + k] > 0.0) {
            return None;
        }
        let inverse = 1.0 / math::sqrt(matrix[n * k + k]);
        for j in k..n {
            matrix[n * k + j] *= inverse;
        }
        vector[k] *= inverse;
        for i in k + 1..n {
            let factor = matrix[n * k + i];
            for j in i..n {
                matrix[n * i + j] -= factor * matrix[n * k + j];
            }
            vector[i] -= factor * vector[k];
        }
    }
    for i in (0..n).rev() {
        let dot: f32 = (i + 1..n).map(|j| matrix[n * i + j] * vector[j]).sum();
        vector[i] = (vector[i] - dot) / matrix[n * i + i];
    }
    vector.iter().all(|x| x.is_finite()).then_some(())
}
