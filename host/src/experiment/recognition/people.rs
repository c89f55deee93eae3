//! People whom no scan knows: drawn from principal components of the 60, with detail of their own,
//! and clean pictures of them.

use crate::demo::{self, FIT_LANDMARKS};
use crate::error::Result;
use crate::experiment::faces::identity_meshes;
use crate::mesh::Mesh;
use crate::mesh::landmarks::Landmark;
use crate::model::layout;
use crate::model::morphable::Morphable;
use crate::photo::picture::Picture;
use crate::photo::tlms::Tlms;
use onescan_core::rng::Rng;
use onescan_core::scene::Scene;
use std::path::Path;

/// Side of a picture.
const SIDE: u32 = 256;
/// Noise of the pictures, per channel: of an indoor photo, chosen, not measured.
const NOISE: f32 = 0.02;
/// Standard deviations of nodding and tilting, radians: some three and two degrees, chosen, as people look
/// into a camera.
const LEAN: [f32; 2] = [0.05, 0.03];
/// Bumps and spots of a person, and their radii, mm: finer than what 60 principal components hold.
const BUMPS: usize = 150;
const RADII: [f64; 2] = [4.0, 16.0];
/// Standard deviations of a bump's height, mm, and of a spot's colour: chosen by eye.
const HEIGHT: f32 = 0.5;
const COLOR: f32 = 0.03;

/// A crowd, as endless as its seeds.
pub struct Crowd {
    model: Morphable,
    landmarks: Vec<Landmark>,
    seed: u64,
}

impl Crowd {
    /// Drawn with a seed from the principal components of the 60 people in the directory of fixtures.
    ///
    /// # Errors
    /// Fixtures that cannot be read.
    pub fn new(fixtures: &Path, seed: u64) -> Result<Self> {
        let (_, landmarks) = demo::template()?;
        let model = Morphable::of_meshes(&identity_meshes(fixtures)?, Vec::new())?;
        Ok(Self { model, landmarks, seed })
    }

    /// The person of a number.
    pub fn person(&self, number: usize) -> Mesh {
        let mut rng = Rng::new(self.seed, number as u32);
        let mut draw = |count| (0..count).map(|_| rng.normal()).collect::<Vec<f64>>();
        let (shape, albedo) = (draw(self.model.shape.rank()), draw(self.model.albedo.rank()));
        let mut mesh = self.model.instance(&shape, &albedo);
        let around = mesh.points.clone();
        for _ in 0..BUMPS {
            let centre = around[(rng.uniform() * around.len() as f64) as usize % around.len()];
            let radius = (RADII[0] + rng.uniform() * (RADII[1] - RADII[0])) as f32;
            let height: [f32; 3] = std::array::from_fn(|_| rng.normal_sd(HEIGHT));
            let grey = rng.normal_sd(COLOR);
            let color: [f32; 3] = std::array::from_fn(|_| grey + rng.normal_sd(0.3 * COLOR));
            for (v, p) in around.iter().enumerate() {
                let square: f32 = (0..3).map(|k| (p[k] - centre[k]).powi(2)).sum();
                let share = (-square / (radius * radius)).exp();
                if share > 1e-4 {
                    for k in 0..3 {
                        mesh.points[v][k] += share * height[k];
                        let c = &mut mesh.colors[v][k];
                        *c = (*c + share * color[k]).clamp(0.0, 1.0);
                    }
                }
            }
        }
        mesh
    }

    /// A person's picture, the head turned by so many degrees, in a light of its own; and landmarks,
    /// off by 2 pixels.
    ///
    /// # Errors
    /// Never in practice.
    pub fn picture(&self, number: usize, yaw: u32) -> Result<(Picture, Tlms)> {
        let rigid = layout::rigid(&self.person(number), &self.landmarks)?;
        // Far from the streams of people.
        let mut rng = Rng::new(self.seed, 1_000_000 + 100 * number as u32 + yaw);
        let mut scene = Scene::initial(SIDE, SIDE, 0, 0);
        let pose = &mut scene.view.pose;
        pose.yaw = (yaw as f32).to_radians();
        (pose.pitch, pose.roll) = (rng.normal_sd(LEAN[0]), rng.normal_sd(LEAN[1]));
        demo::random_light(&mut scene, &mut rng);
        demo::synthetic_photo(&rigid.view(), &scene, NOISE, &FIT_LANDMARKS, &mut rng)
    }
}
