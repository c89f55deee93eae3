//! A scene in double precision, slow and obvious: how it is drawn before anything is seen, what it looks
//! like, and where it is in the sampler's coordinates.

use super::super::Around;
use crate::basis::padded;
use crate::chain::Problem;
use crate::likelihood::prior::Prior;
use crate::mesh::vertex_normals;
use crate::model::Model;
use crate::rng::Rng;
use crate::scene::{Subject, View};
use crate::search::priors::Widths;
use crate::search::probe::Naive;
use core::array::from_fn;
use std::vec;
use std::vec::Vec;

pub(super) type Vector = [f64; 3];
pub(super) type Matrix = [Vector; 3];

/// The default camera's.
const FOCAL_LENGTH: f64 = 7.5;
/// Weights of luminance.
const LUMINANCE: Vector = [0.3, 0.59, 0.11];
/// Factors of the harmonics' polynomials: Lambert's kernel times the normalisation.
const HARMONICS: [f64; 9] = [
    3.141_593 * 0.282_094_791_8,
    2.094_395 * 0.488_602_511_9,
    2.094_395 * 0.488_602_511_9,
    2.094_395 * 0.488_602_511_9,
    0.785_398 * 1.092_548_430_6,
    0.785_398 * 1.092_548_430_6,
    0.785_398 * 0.315_391_565_3,
    0.785_398 * 1.092_548_430_6,
    0.785_398 * 0.546_274_215_3,
];

/// Somebody's picture's scene.
#[derive(Clone)]
pub(super) struct Face {
    pub(super) subject: Subject,
    pub(super) rotation: Matrix,
    pub(super) place: Vector,
    pub(super) focal: f64,
    pub(super) light: [Vector; 9],
    pub(super) gain: Vector,
    pub(super) contrast: f64,
    pub(super) offset: Vector,
}

/// What a face shows.
pub(super) struct Shown {
    /// Landmarks in the window.
    pub(super) landmarks: Vec<[f64; 2]>,
    /// Held points there.
    pub(super) places: Vec<[f64; 2]>,
    /// Their colours.
    pub(super) colors: Vec<Vector>,
    /// Mean albedo of all vertices.
    pub(super) albedo: Vector,
}

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    from_fn(|i| from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

fn apply(a: &Matrix, v: Vector) -> Vector {
    from_fn(|i| (0..3).map(|k| a[i][k] * v[k]).sum())
}

pub(super) fn mean([r, g, b]: Vector) -> f64 {
    (r + g + b) / 3.0
}

/// Polynomials of the harmonics.
fn polynomials([x, y, z]: Vector) -> [f64; 9] {
    [1.0, y, z, x, x * y, y * z, 2.0 * z * z - x * x - y * y, z * x, x * x - y * y]
}

/// `0.8 + 0.2 z`.
fn frontal(i: usize) -> f64 {
    match i {
        0 => 0.8 / HARMONICS[0],
        2 => 0.2 / HARMONICS[2],
        _ => 0.0,
    }
}

/// How much of every coefficient is in the mean radiance of normals up to 60° from the axis: `∫ z` is 3/4,
/// `∫ 3z² − 1` as well.
fn level(i: usize) -> f64 {
    match i {
        0 => HARMONICS[0],
        2 | 6 => 0.75 * HARMONICS[i],
        _ => 0.0,
    }
}

/// Light as the prior has it.
fn light(rng: &mut Rng, widths: &Widths) -> [Vector; 9] {
    let band = |i: usize| [0, 1, 1, 1, 2, 2, 2, 2, 2][i];
    let scale = |i: usize| HARMONICS[[0, 1, 4][band(i)]];
    let width = |i: usize| f64::from(widths.intensity[band(i)]) / scale(i);
    let mut off: [f64; 9] = from_fn(|i| width(i) * rng.normal());
    // Of these what has been seen, off by some error, to be no change of level.
    let sd = f64::from(widths.level);
    let found = (0..9).map(|i| level(i) * off[i]).sum::<f64>() + sd * rng.normal();
    let variance = (0..9).map(|i| (level(i) * width(i)).powi(2)).sum::<f64>() + sd * sd;
    for (i, off) in off.iter_mut().enumerate() {
        *off -= width(i).powi(2) * level(i) * found / variance;
    }
    from_fn(|i| {
        let sd = f64::from(widths.chroma[band(i)]) / scale(i);
        let apart: Vector = from_fn(|_| sd * rng.normal());
        from_fn(|c| frontal(i) + off[i] + apart[c] - mean(apart))
    })
}

/// A rotation and its vector, uniform but for the factor `exp(−θ²/2s²)` of its angle.
fn rotation(rng: &mut Rng, sd: f64) -> (Matrix, Vector) {
    loop {
        let vector: Vector = from_fn(|_| sd * rng.normal());
        let angle = vector.iter().map(|x| x * x).sum::<f64>().sqrt();
        let sin = (0.5 * angle).sin();
        // The measure of vectors, at most 1 in the middle.
        if angle < core::f64::consts::PI && rng.uniform() < (sin / (0.5 * angle)).powi(2) {
            return (turn(vector.map(|x| x * sin / angle), (0.5 * angle).cos()), vector);
        }
    }
}

/// The rotation matrix of a unit quaternion.
fn turn([x, y, z]: Vector, w: f64) -> Matrix {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

impl Face {
    /// As the search has it.
    pub(super) fn new(subject: &Subject, view: &View) -> Self {
        let View { pose, camera, light, color } = view;
        Self {
            subject: subject.clone(),
            rotation: pose.rotation().map(|row| row.map(f64::from)),
            place: pose.translation.map(f64::from),
            focal: f64::from(camera.focal_length),
            light: light.map(|channels| channels.map(f64::from)),
            gain: color.gain.map(f64::from),
            contrast: f64::from(color.contrast),
            offset: color.offset.map(f64::from),
        }
    }

    /// Drawn from the prior, and its rotation vector from a mode's pose.
    pub(super) fn draw(
        rng: &mut Rng,
        mode: &Self,
        widths: &Widths,
        albedo_sd: impl Fn(usize) -> f32,
        prior: &Prior,
    ) -> (Self, Vector) {
        let mut face = mode.clone();
        for c in &mut face.subject.shape {
            *c = rng.normal_sd(widths.shape);
        }
        for (i, c) in face.subject.albedo.iter_mut().enumerate() {
            *c = rng.normal_sd(albedo_sd(i));
        }
        let (turn, vector) = rotation(rng, super::ROTATION);
        face.rotation = product(&turn, &mode.rotation);
        let mut normal = |sd: f32| f64::from(sd) * rng.normal();
        let distance = f64::from(prior.distance) * normal(prior.distance_sd).exp();
        face.place = [normal(widths.translation), normal(widths.translation), -distance];
        face.focal = FOCAL_LENGTH * normal(widths.focal).exp();
        face.gain = from_fn(|_| 1.0 + normal(prior.gain_sd));
        face.contrast = 1.0 + normal(prior.contrast_sd);
        face.offset = from_fn(|_| normal(prior.offset_sd));
        face.light = light(rng, widths);
        (face, vector)
    }

    /// A point in the window, of a square picture.
    fn project(&self, side: f64, point: Vector) -> [f64; 2] {
        let [x, y, z] = apply(&self.rotation, point);
        let [x, y, z] = [x + self.place[0], y + self.place[1], z + self.place[2]];
        let k = 0.5 * side * self.focal / -z;
        [0.5 * side + k * x, 0.5 * side - k * y]
    }

    /// The colour of a surface.
    fn color(&self, albedo: Vector, normal: Vector) -> Vector {
        let terms = polynomials(apply(&self.rotation, normal));
        let lit: Vector = from_fn(|c| {
            albedo[c] * (0..9).map(|i| HARMONICS[i] * terms[i] * self.light[i][c]).sum::<f64>()
        });
        let grey: f64 = lit.iter().zip(LUMINANCE).map(|(x, k)| k * x).sum();
        from_fn(|c| self.gain[c] * (grey + self.contrast * (lit[c] - grey)) + self.offset[c])
    }

    /// What it shows.
    pub(super) fn show(&self, problem: &Problem<'_>, naive: &Naive, landmarks: &[usize]) -> Shown {
        let (model, side) = (problem.model, f64::from(problem.photo.image.width));
        let [positions, normals, albedos] = fields(model, &self.subject);
        let blend = |field: &[Vector], corners: [usize; 3], weights: [f64; 3]| -> Vector {
            from_fn(|axis| (0..3).map(|k| weights[k] * field[corners[k]][axis]).sum())
        };
        let (mut places, mut colors) = (Vec::new(), Vec::new());
        for point in &naive.points {
            let normal = blend(&normals, point.corners, point.weights);
            let length = normal.iter().map(|x| x * x).sum::<f64>().sqrt();
            let albedo = blend(&albedos, point.corners, point.weights);
            places.push(self.project(side, blend(&positions, point.corners, point.weights)));
            colors.push(self.color(albedo, normal.map(|x| x / length)));
        }
        let landmarks = landmarks.iter().map(|v| self.project(side, positions[*v])).collect();
        let share = 1.0 / model.vertices() as f64;
        let albedo = from_fn(|c| share * albedos.iter().map(|albedo| albedo[c]).sum::<f64>());
        Shown { landmarks, places, colors, albedo }
    }

    /// The step that leads there from a mode, given both mean albedos and the rotation vector.
    pub(super) fn step(&self, turn: Vector, albedo: Vector, mode: (&Self, Vector)) -> Vec<f32> {
        let (mode, mode_albedo) = mode;
        let mut step = Vec::new();
        let both = |f: fn(&Subject) -> &[f32]| f(&self.subject).iter().zip(f(&mode.subject));
        step.extend(both(|subject| &subject.shape).map(|(a, b)| a - b));
        step.extend(both(|subject| &subject.albedo).map(|(a, b)| a - b));
        let recede = (self.place[2] / mode.place[2]).ln();
        let zoom = (self.focal / mode.focal).ln() - recede;
        let [x, y] = [0, 1].map(|axis| self.place[axis] - mode.place[axis]);
        step.extend([turn[0], turn[1], turn[2], x, y, zoom, recede].map(|x| x as f32));
        let bright: Vector =
            from_fn(|c| albedo[c] * self.gain[c] / (mode_albedo[c] * mode.gain[c]));
        for (own, mode) in self.light.iter().zip(&mode.light) {
            step.extend((0..3).map(|c| (bright[c] * own[c] - mode[c]) as f32));
        }
        step.extend((0..3).map(|c| (self.gain[c] - mode.gain[c]) as f32));
        step.push((self.contrast - mode.contrast) as f32);
        step.extend((0..3).map(|c| (self.offset[c] - mode.offset[c]) as f32));
        step
    }

    /// A step of the sampler from its mode.
    pub(super) fn at(around: &Around<'_, '_, 0>, position: &[f32]) -> Self {
        let mut step = around.step(position);
        let subject = around.held.subject(&mut step);
        Self::new(&subject, &around.held.views(step).next().unwrap())
    }

    /// `R Mᵀ` of another's rotation `M`: cosine of its angle.
    pub(super) fn cosine(&self, other: &Self) -> f64 {
        let all = self.rotation.as_flattened().iter().zip(other.rotation.as_flattened());
        0.5 * (all.map(|(a, b)| a * b).sum::<f64>() - 1.0)
    }
}

/// Positions, unit normals and albedos of all vertices.
fn fields(model: &Model<'_>, subject: &Subject) -> [Vec<Vector>; 3] {
    let quads = || vec![[0.0; 4]; padded(model.vertices())];
    let [mut positions, mut normals, mut albedos] = [quads(), quads(), quads()];
    model.shape.instance(&subject.shape, &mut positions);
    model.albedo.instance(&subject.albedo, &mut albedos);
    vertex_normals(model.triangles, &positions, &mut normals);
    [positions, normals, albedos].map(|field| {
        let all = field.into_iter().take(model.vertices());
        all.map(|[x, y, z, _]| [x, y, z].map(f64::from)).collect()
    })
}
