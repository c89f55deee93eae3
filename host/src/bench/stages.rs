//! Stages of a rendering and their naive twins.

use super::workload::Workload;
use crate::error::{Error, Result};
use crate::photo::picture::Picture;
use crate::simd;
use onescan_core::basis::padded;
use onescan_core::chain::Config;
use onescan_core::engine::Engine;
use onescan_core::lanes::planes_words;
use onescan_core::likelihood::background::HISTOGRAM_LEN;
use onescan_core::likelihood::pixels::{Known, Rasterized, Target, target_words};
use onescan_core::memory::Carver;
use onescan_core::model::Model;
use onescan_core::naive;
use onescan_core::render::rasterize::{Frame, frame_words};
use onescan_core::render::shade::{self, Attributes, Planes, Shader};
use std::hint::black_box;

/// A stage of the pipeline, or several in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Shape coefficients to positions; the albedo's cost the same.
    Instance,
    /// Positions to vertex normals.
    Normals,
    /// Positions to window coordinates.
    Project,
    /// Window coordinates to what is visible. Without a twin of its own: see [`Stage::Draw`].
    Rasterize,
    /// Normals and albedo to colours per visible pixel, and what they differ from the picture by.
    Shade,
    /// Project, rasterize, shade.
    Draw,
    /// Coefficients to a drawn face: everything before the likelihood, nothing kept.
    Render,
    /// Image likelihood of a face whose normals and albedo per pixel are known: light and
    /// comparison. The twin only compares, and includes the background's histogram, which the
    /// chain makes once.
    Likelihood,
}

impl Stage {
    /// In the order the data flows, the larger after their parts; [`Stage::Render`] and
    /// [`Stage::Likelihood`] together are a step that keeps nothing from the one before.
    pub const ALL: [Self; 8] = [
        Self::Instance,
        Self::Normals,
        Self::Project,
        Self::Rasterize,
        Self::Shade,
        Self::Draw,
        Self::Render,
        Self::Likelihood,
    ];

    /// Its name in tables and in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Instance => "instance",
            Self::Normals => "normals",
            Self::Project => "project",
            Self::Shade => "shade",
            Self::Rasterize => "rasterize",
            Self::Draw => "draw",
            Self::Render => "render",
            Self::Likelihood => "likelihood",
        }
    }
}

/// What one way of rendering leaves behind, per vertex.
struct Buffers {
    positions: Vec<[f32; 4]>,
    normals: Vec<[f32; 4]>,
    albedo: Vec<[f32; 4]>,
    attributes: Vec<Attributes>,
    window: Vec<[f32; 4]>,
}

impl Buffers {
    fn new(vertices: usize) -> Self {
        let quads = || vec![[0.0; 4]; padded(vertices)];
        let attributes = vec![[0.0; 8]; padded(vertices)];
        Self { positions: quads(), normals: quads(), albedo: quads(), attributes, window: quads() }
    }

    fn join(&mut self) {
        shade::join(
            self.normals.iter().copied(),
            self.albedo.iter().copied(),
            &mut self.attributes,
        );
    }
}

fn rasterized<'s, 'w>(
    frame: &'s Frame<'w>,
    model: &Model<'s>,
    buffers: &'s Buffers,
) -> Rasterized<'s, 'w> {
    Rasterized { frame, triangles: model.triangles, vertices: &buffers.attributes }
}

/// The stages and their naive twins on the workload's truth, each repeatable by itself: its input
/// is what the stages before it left.
pub struct Stages<'w> {
    engine: &'static Engine,
    model: Model<'w>,
    workload: &'w Workload,
    sd: f32,
    fast: Buffers,
    frame: Frame<'w>,
    normals: &'w mut [Planes],
    albedo: &'w mut [Planes],
    target: Target<'w>,
    slow: Buffers,
    depth: Vec<f32>,
    pixels: Vec<[f32; 3]>,
    histogram: Vec<u32>,
}

impl<'w> Stages<'w> {
    /// Words of memory that [`Stages::new`] takes for a picture's sides.
    pub const fn words([width, height]: [u32; 2]) -> usize {
        let (width, height) = (width as usize, height as usize);
        target_words(width, height)
            + frame_words(width, height)
            + 2 * planes_words(width, height)
            + HISTOGRAM_LEN
    }

    /// Runs every stage once, both ways.
    ///
    /// # Errors
    /// When `memory` is shorter than [`Stages::words`].
    pub fn new(workload: &'w Workload, memory: &'w mut [u32]) -> Result<Self> {
        let model = workload.model.view();
        let Picture { width, height, ref rgb } = workload.picture;
        let (width, height) = (width as usize, height as usize);
        let mut carver = Carver::new(memory);
        let mut carve = || {
            let target = Target::carve(&mut carver, rgb, width)?;
            let frame = Frame::carve(&mut carver, width, height)?;
            Some((target, frame, carver.planes(width, height)?, carver.planes(width, height)?))
        };
        let (target, frame, normals, albedo) =
            carve().ok_or_else(|| Error::new("too little memory for the stages"))?;
        let mut stages = Self {
            engine: simd::best(),
            workload,
            sd: Config::default().pixel_sd,
            fast: Buffers::new(model.vertices()),
            frame,
            normals,
            albedo,
            target,
            slow: Buffers::new(model.vertices()),
            depth: vec![0.0; width * height],
            pixels: vec![[0.0; 3]; width * height],
            histogram: vec![0; HISTOGRAM_LEN],
            model,
        };
        for stage in [Stage::Render, Stage::Likelihood] {
            stages.run(stage);
            stages.run_naive(stage);
        }
        stages.interpolate();
        Ok(stages)
    }

    fn interpolate(&mut self) {
        let rasterized = rasterized(&self.frame, &self.model, &self.fast);
        (self.engine.interpolate)(&rasterized, Some(self.normals), self.albedo);
    }

    /// Runs a stage.
    pub fn run(&mut self, stage: Stage) {
        let (model, scene, b) = (&self.model, &self.workload.scene, &mut self.fast);
        let engine = self.engine;
        match stage {
            Stage::Instance => {
                (engine.instance)(&model.shape, &scene.subject.shape, &mut b.positions);
            }
            Stage::Normals => {
                (engine.normals)(model.triangles, &b.positions, &mut b.normals);
            }
            Stage::Project => (engine.project)(&scene.view, &b.positions, &mut b.window),
            Stage::Rasterize => (engine.rasterize)(model.triangles, &b.window, &mut self.frame),
            Stage::Shade => {
                black_box(self.residual(Known::default()));
            }
            Stage::Draw => {
                self.run(Stage::Project);
                self.run(Stage::Rasterize);
                self.run(Stage::Shade);
            }
            Stage::Render => {
                (engine.instance)(&model.albedo, &scene.subject.albedo, &mut b.albedo);
                self.run(Stage::Instance);
                self.run(Stage::Normals);
                self.fast.join();
                self.run(Stage::Draw);
            }
            Stage::Likelihood => {
                let coverage = (engine.coverage)(&self.frame, &self.target);
                let known = Known { normals: Some(self.normals), albedo: Some(self.albedo) };
                let residual = self.residual(known);
                black_box(coverage.ln_likelihood(residual, self.sd));
            }
        }
        black_box(self);
    }

    fn residual(&self, known: Known<'_>) -> f64 {
        let (rasterized, shader) = (
            rasterized(&self.frame, &self.model, &self.fast),
            Shader::new(&self.workload.scene.view),
        );
        let limit = f64::INFINITY;
        (self.engine.residual)(&rasterized, known, &shader, &self.target, limit).unwrap_or(0.0)
    }

    /// Runs a stage's naive twin; `None` if it has none.
    pub fn run_naive(&mut self, stage: Stage) -> Option<()> {
        let (model, scene, b) = (&self.model, &self.workload.scene, &mut self.slow);
        match stage {
            Stage::Instance => {
                naive::instance(&model.shape, &scene.subject.shape, &mut b.positions);
            }
            Stage::Normals => naive::vertex_normals(model, &b.positions, &mut b.normals),
            Stage::Project => naive::project(&scene.view, &b.positions, &mut b.window),
            Stage::Rasterize => return None,
            Stage::Shade => {
                let vertices = &self.fast.attributes;
                naive::shade(model, scene, &self.frame, vertices, &mut self.pixels);
            }
            Stage::Draw => {
                let vertices = [&b.positions[..], &b.normals, &b.albedo];
                naive::draw(model, scene, vertices, &mut self.depth, &mut self.pixels);
            }
            Stage::Render => {
                naive::instance(&model.albedo, &scene.subject.albedo, &mut b.albedo);
                for part in [Stage::Instance, Stage::Normals, Stage::Draw] {
                    self.run_naive(part)?;
                }
            }
            Stage::Likelihood => {
                let (picture, sd) = (&self.workload.picture.rgb, f64::from(self.sd));
                let (depth, pixels) = (&self.depth, &self.pixels);
                black_box(naive::ln_likelihood(depth, pixels, picture, &mut self.histogram, sd));
            }
        }
        black_box(self);
        Some(())
    }
}
