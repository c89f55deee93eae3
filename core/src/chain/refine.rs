//! Gauss–Newton search moves: linearise the picture at visible vertices, solve, go part of the way.
//!
//! Random walks need tens of thousands of steps to bring a hundred coefficients to a picture;
//! these moves point them. Both minimise the negative log target with everything else held:
//!
//! * albedo and light: colours are linear in either, so the step ends near the optimum of the
//!   sampled vertices;
//! * shape and pose: vertices move in the picture, `I(u + U δ) ≈ I(u) + ∇I·U δ` is to match the
//!   vertex's colour; landmarks add their rows.
//!
//! The step is scaled by a random factor and judged by the chain's tests like any proposal.

use crate::basis::Basis;
use crate::color::color_matrix;
use crate::least_squares::{NormalEquations, System, system_words};
use crate::likelihood::landmarks::LandmarkSample;
use crate::likelihood::prior::Prior;
use crate::math;
use crate::scene::{MAX_RANK, PixelCamera, Pose, Scene};

/// Pose parameters refined together with the shape: rotation vector, translation in x and y, and
/// the logarithms of the focal length and of the distance at constant size.
const POSE_PARAMETERS: usize = 7;
/// Light parameters refined together with the albedo.
const LIGHT_PARAMETERS: usize = 27;

/// Words of memory the search moves need: for the larger of the two systems.
pub(super) const fn search_words(shape_rank: usize, albedo_rank: usize) -> usize {
    let (shape, albedo) = (shape_rank + POSE_PARAMETERS, albedo_rank + LIGHT_PARAMETERS);
    system_words(if shape > albedo { shape } else { albedo })
}

/// A visible vertex and what the picture shows there.
pub(super) struct Sample {
    /// The vertex.
    pub(super) vertex: usize,
    /// Picture minus model colour.
    pub(super) residual: [f32; 3],
    /// Change of the picture's colour per pixel to the right, and down.
    pub(super) gradient: [[f32; 3]; 2],
    /// Albedo of the vertex.
    pub(super) albedo: [f32; 3],
    /// Radiance at the vertex.
    pub(super) radiance: [f32; 3],
    /// `k∘Y` of its normal, see [`crate::light::basis`].
    pub(super) harmonics: [f32; 9],
}

/// How to search, and with what.
pub(super) struct Search<'s> {
    /// Random points to look at; the visible ones among them count.
    pub(super) points: u32,
    /// How much of the way to go.
    pub(super) fraction: f32,
    /// Standard deviation of a colour channel of a pixel.
    pub(super) sd: f32,
    /// The engine's.
    pub(super) normal_equations: NormalEquations,
    /// [`search_words`] of it.
    pub(super) memory: &'s mut [f32],
}

/// Solves for albedo coefficients and light together: brightness that the albedo's prior dislikes
/// goes to the light. Each sample stands for `represented` pixels.
pub(super) fn albedo(
    basis: &Basis<'_>,
    scene: &mut Scene,
    samples: impl Iterator<Item = Sample>,
    represented: f32,
    search: Search<'_>,
) -> Option<()> {
    let Search { fraction, sd, normal_equations, memory, .. } = search;
    let weight = represented / (sd * sd);
    let rank = scene.albedo.len();
    let mut system = System::new(rank + LIGHT_PARAMETERS, normal_equations, memory)?;
    let mix = color_matrix(&scene.color);
    let mut components = [[0.0; 3]; MAX_RANK];
    let components = components.get_mut(..rank)?;
    for sample in samples {
        basis.at(sample.vertex, components);
        for (mix, residual) in mix.iter().zip(sample.residual) {
            let [row, _] = &mut system.rows;
            let (coefficients, light) = row.split_at_mut_checked(rank)?;
            let shading = math::zip(*mix, sample.radiance, |mix, radiance| mix * radiance);
            for (out, b) in coefficients.iter_mut().zip(&*components) {
                *out = shading[0] * b[0] + shading[1] * b[1] + shading[2] * b[2];
            }
            for (out, y) in light.as_chunks_mut::<3>().0.iter_mut().zip(sample.harmonics) {
                *out = math::zip(*mix, sample.albedo, |mix, albedo| mix * albedo * y);
            }
            system.add(0, weight, residual);
        }
    }
    for (k, &c) in scene.albedo.iter().enumerate() {
        system.pull(k, 1.0, c);
    }
    for i in 0..LIGHT_PARAMETERS {
        // Damping only, where no normal points.
        system.pull(rank + i, 1.0, 0.0);
    }
    let (coefficients, light) = system.solve()?.split_at_checked(rank)?;
    for (c, delta) in scene.albedo.iter_mut().zip(coefficients) {
        *c += fraction * delta;
    }
    for (l, delta) in scene.light.iter_mut().flatten().zip(light) {
        *l += fraction * delta;
    }
    Some(())
}

/// Geometry of a scene, for derivatives of window coordinates.
pub(super) struct View {
    rotation: [[f32; 3]; 3],
    pose: Pose,
    pixel: PixelCamera,
}

impl View {
    pub(super) fn new(scene: &Scene) -> Self {
        Self {
            rotation: scene.pose.rotation(),
            pose: scene.pose,
            pixel: scene.camera.pixel_scale(),
        }
    }

    /// Window coordinates of a model point.
    pub(super) fn window(&self, p: [f32; 3]) -> [f32; 2] {
        let [x, y, z] = self.pose.to_world_by(&self.rotation, p);
        [
            self.pixel.centre[0] - self.pixel.focal[0] * x / z,
            self.pixel.centre[1] + self.pixel.focal[1] * y / z,
        ]
    }

    /// Fills two rows with the derivatives of `u` and `v` of a model point: first the shape
    /// coefficients, whose components at the point are given, then the pose parameters.
    fn derivatives(&self, p: [f32; 3], components: &[[f32; 3]], [du, dv]: [&mut [f32]; 2]) {
        let [x, y, z] = self.pose.to_world_by(&self.rotation, p);
        let [fx, fy] = self.pixel.focal;
        // u = c − f x / z, v = c + f y / z.
        let gu = [-fx / z, 0.0, fx * x / (z * z)];
        let gv = [0.0, fy / z, -fy * y / (z * z)];
        let rank = components.len();
        let s = self.pose.scale;
        let turn = |g: [f32; 3]| {
            let r = &self.rotation;
            let mut turned = [0.0; 3];
            for j in 0..3 {
                turned[j] = s * (g[0] * r[0][j] + g[1] * r[1][j] + g[2] * r[2][j]);
            }
            turned
        };
        let (mu, mv) = (turn(gu), turn(gv));
        for ((du, dv), b) in du.iter_mut().zip(&mut *dv).zip(components) {
            *du = mu[0] * b[0] + mu[1] * b[1] + mu[2] * b[2];
            *dv = mv[0] * b[0] + mv[1] * b[1] + mv[2] * b[2];
        }
        // Rotation about the object's origin: dX = ω × (X − t), so g·dX = ω·((X − t) × g).
        let t = self.pose.translation;
        let q = [x - t[0], y - t[1], z - t[2]];
        let arm = |g: [f32; 3]| {
            [q[1] * g[2] - q[2] * g[1], q[2] * g[0] - q[0] * g[2], q[0] * g[1] - q[1] * g[0]]
        };
        for (row, g, scaling) in [(du, gu, -fx * x / z), (dv, gv, fy * y / z)] {
            let w = arm(g);
            // The object recedes by eᶻ and the focal length grows with it.
            let distance = g[2] * t[2] + scaling;
            let pose = [w[0], w[1], w[2], g[0], g[1], scaling, distance];
            for (out, derivative) in row.iter_mut().skip(rank).zip(pose) {
                *out = derivative;
            }
        }
    }
}

/// Landmarks and what the search for the shape needs besides the picture.
pub(super) struct Constraints<'s> {
    /// The observed landmarks.
    pub(super) landmarks: &'s [LandmarkSample],
    /// Their standard deviation, pixels.
    pub(super) landmark_sd: f32,
    /// The prior of the distance.
    pub(super) prior: &'s Prior,
}

/// Solves for shape coefficients and pose; samples come with their model-frame positions.
pub(super) fn shape(
    basis: &Basis<'_>,
    scene: &mut Scene,
    samples: impl Iterator<Item = ([f32; 3], Sample)>,
    represented: f32,
    constraints: &Constraints<'_>,
    search: Search<'_>,
) -> Option<()> {
    let Search { fraction, sd, normal_equations, memory, .. } = search;
    let weight = represented / (sd * sd);
    let rank = scene.shape.len();
    let mut system = System::new(rank + POSE_PARAMETERS, normal_equations, memory)?;
    let view = View::new(scene);
    let mut components = [[0.0; 3]; MAX_RANK];
    let components = components.get_mut(..rank)?;
    for (position, sample) in samples {
        basis.at(sample.vertex, components);
        let [du, dv] = &mut system.rows;
        view.derivatives(position, components, [du, dv]);
        // Three channels, two directions: G = Σ g gᵀ = L Lᵀ gives two equations instead of three.
        let [gx, gy] = sample.gradient;
        let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let (xx, xy, yy) = (dot(gx, gx), dot(gx, gy), dot(gy, gy));
        // The model's colour stays with the vertex: moving it by δ changes the picture's by ∇I δ.
        let (rx, ry) = (-dot(gx, sample.residual), -dot(gy, sample.residual));
        let l0 = math::sqrt(xx);
        if !(l0 > 1e-4) {
            continue;
        }
        let l1 = xy / l0;
        let l2 = math::sqrt((yy - l1 * l1).max(0.0));
        let [du, dv] = &mut system.rows;
        for (u, v) in du.iter_mut().zip(dv.iter_mut()) {
            *u = l0 * *u + l1 * *v;
            *v *= l2;
        }
        let r0 = rx / l0;
        system.add(0, weight, r0);
        if l2 > 1e-4 {
            system.add(1, weight, (ry - l1 * r0) / l2);
        }
    }
    let landmark_weight = 1.0 / (constraints.landmark_sd * constraints.landmark_sd);
    for landmark in constraints.landmarks {
        basis.at(landmark.vertex, components);
        let [du, dv] = &mut system.rows;
        view.derivatives(landmark.point, components, [du, dv]);
        system.add(0, landmark_weight, landmark.residual[0]);
        system.add(1, landmark_weight, landmark.residual[1]);
    }
    for (k, &c) in scene.shape.iter().enumerate() {
        system.pull(k, 1.0, c);
    }
    // Damping only: half a radian, 100 mm, half the focal length.
    for (i, sd) in [0.5_f32, 0.5, 0.5, 100.0, 100.0, 0.5].into_iter().enumerate() {
        system.pull(rank + i, 1.0 / (sd * sd), 0.0);
    }
    let prior = constraints.prior;
    let distance = -scene.pose.translation[2] / prior.distance;
    let (sd, ln) = (prior.distance_sd, math::ln(f64::from(distance)) as f32);
    system.pull(rank + POSE_PARAMETERS - 1, 1.0 / (sd * sd), ln);
    let (coefficients, pose) = system.solve()?.split_at_checked(rank)?;
    for (c, d) in scene.shape.iter_mut().zip(coefficients) {
        *c += fraction * d;
    }
    let [wx, wy, wz, tx, ty, zoom, recede] =
        pose.first_chunk::<POSE_PARAMETERS>()?.map(|delta| fraction * delta);
    scene.pose.turn([wx, wy, wz]);
    scene.pose.translation[0] += tx;
    scene.pose.translation[1] += ty;
    let factor = |x: f32| math::exp(f64::from(x)) as f32;
    scene.pose.translation[2] *= factor(recede);
    scene.camera.focal_length *= factor(zoom + recede);
    Some(())
}
