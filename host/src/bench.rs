//! How fast the fit is on this machine: stage by stage beside its naive twin, whole steps, the
//! search for the mode, and the memory bandwidth and arithmetic that bound them.
//!
//! Times are the fastest of many runs: what the machine does when nothing else runs on it. A chain
//! repeats to the last bit, so the same holds step by step: each step counts with the fastest of
//! its repetitions.

use crate::demo;
use crate::error::{Error, Result};
use crate::model::layout;
use crate::model_file::OwnedModel;
use crate::photo::picture::Picture;
use crate::photo::tlms::Tlms;
use crate::render::{self, random_coefficients};
use crate::simd;
use onescan_core::basis::{field_len, padded};
use onescan_core::chain::{self, Chain, Config, Problem};
use onescan_core::draw::{draw, draw_words};
use onescan_core::engine::Engine;
use onescan_core::image::Image;
use onescan_core::lanes::planes_words;
use onescan_core::likelihood::background::HISTOGRAM_LEN;
use onescan_core::likelihood::landmarks::Observation;
use onescan_core::likelihood::pixels::{Known, Surface, Target, target_words};
use onescan_core::memory::Carver;
use onescan_core::model::{Model, Triangles};
use onescan_core::naive;
use onescan_core::proposal::Touched;
use onescan_core::render::rasterize::{Frame, frame_words};
use onescan_core::render::shade::{self, Attributes, Planes, Shader};
use onescan_core::rng::Rng;
use onescan_core::scene::{Coefficients, Scene, Subject, View};
use onescan_core::search::{self, ModeSearch, Options};
use serde::{Serialize, Serializer};
use std::fmt;
use std::hint::black_box;
use std::mem::size_of;
use std::time::{Duration, Instant};

/// Components of each half of the model. Fits infer 50 of them.
const RANK: usize = 60;
/// Sides of the picture.
const SIZE: [u32; 2] = [256, 256];
/// Part of the picture the face covers.
const COVERED: f64 = 0.4;
/// Of the face, its light, the noise, and the chain.
const SEED: u64 = 7;
/// Steps of the image stage in one run.
const STEPS: u32 = 1500;
/// Runs of the same chain.
const REPETITIONS: usize = 2;
/// Components of each half of the search's other model: as many as a scan's usually keeps.
const FULL_RANK: usize = 199;
/// Passes of [`simd::arithmetic`] timed together: some ten microseconds.
const PASSES: u32 = 2000;
/// Time spent on each stage, on each twin and on each bandwidth.
const BUDGET: Duration = Duration::from_millis(150);
/// Read to measure the bandwidth of the memory: more than the caches of common machines hold.
const MEMORY_BYTES: usize = 256 << 20;
/// Read to measure the bandwidth of the cache: more than one core's own, and about what the steps
/// of a fit read again and again (50 components of shape or albedo are 2.5 MB).
const CACHE_BYTES: usize = 8 << 20;

/// What is measured: the built-in face model and a rendered face of known truth.
pub struct Workload {
    /// The symmetric-full model of the template, rank 60 each.
    pub model: OwnedModel,
    /// The truth: a random instance (50 + 50 coefficients) under random light, turned by 15°, in
    /// a picture of 256 × 256 of which it covers [`Workload::covered`].
    pub scene: Scene,
    /// The picture of [`Workload::scene`], with noise, before a soft background.
    pub picture: Picture,
    /// Its landmarks, with errors of two pixels.
    pub landmarks: Tlms,
    /// Part of the picture that the face covers, some 0.4.
    pub covered: f64,
}

impl Workload {
    /// Builds the model and draws the picture; a few seconds, told to `progress` in `[0, 1]`.
    ///
    /// # Errors
    /// None: everything it needs is built in.
    pub fn new(progress: &mut dyn FnMut(f64)) -> Result<Self> {
        let owned = demo::template_model(RANK, &mut |done, _| progress(done))?.model;
        let model = owned.view();
        let config = Config::default();
        let mut rng = Rng::new(SEED, 0);
        let mut coefficients = |rank| Coefficients::from_iter(random_coefficients(rank, &mut rng));
        let (shape, albedo) = (coefficients(config.shape_rank), coefficients(config.albedo_rank));
        let subject = Subject { shape, albedo };
        let mut scene = Scene { subject, view: View::initial(SIZE[0], SIZE[1]) };
        scene.view.pose.yaw = 15_f32.to_radians();
        demo::random_light(&mut scene, &mut rng);
        let covered = frame(&model, &mut scene)?;

        let mesh = render::instance(&model, &scene.subject.shape, &scene.subject.albedo);
        let rigid = layout::rigid(&mesh, &demo::template()?.1)?;
        let seen = Scene { subject: Subject::default(), view: scene.view };
        let (picture, landmarks) =
            demo::synthetic_photo(&rigid.view(), &seen, 0.02, &demo::FIT_LANDMARKS, &mut rng)?;
        Ok(Self { model: owned, scene, picture, landmarks, covered })
    }

    /// The landmarks in the form a chain takes.
    pub fn observations(&self) -> Vec<Observation<'_>> {
        let visible = self.landmarks.visible();
        visible.map(|l| Observation { name: &l.id, position: [l.x, l.y] }).collect()
    }

    /// The fit of `model` (a view of [`Workload::model`]) to the picture.
    pub fn problem<'a>(
        &'a self,
        model: &'a Model<'a>,
        landmarks: &'a [Observation<'a>],
        config: &'a Config,
    ) -> Problem<'a> {
        let Picture { width, height, ref rgb } = self.picture;
        let image = Image { pixels: rgb, width, height };
        Problem::new(model, image, landmarks, config).with_engine(simd::best())
    }
}

/// Zooms until the model covers [`COVERED`] of the picture; returns how much it then covers.
fn frame(model: &Model<'_>, scene: &mut Scene) -> Result<f64> {
    let [width, height] = scene.view.camera.image_size.map(|side| side as usize);
    let mut memory = vec![0; draw_words(model.vertices(), width, height)];
    let mut pixels = vec![[0.0; 3]; width * height];
    let mut covered = |scene: &Scene| {
        let count = draw(model, scene, &mut memory, &mut pixels).unwrap_or(0);
        if count == 0 {
            return Err(Error::new("the face is out of the picture"));
        }
        Ok(count as f64 / (width * height) as f64)
    };
    for _ in 0..3 {
        scene.view.camera.focal_length *= (COVERED / covered(scene)?).sqrt() as f32;
    }
    covered(scene)
}

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

fn surface<'s, 'w>(
    frame: &'s Frame<'w>,
    model: &Model<'s>,
    buffers: &'s Buffers,
) -> Surface<'s, 'w> {
    Surface { frame, triangles: model.triangles, vertices: &buffers.attributes }
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
        let surface = surface(&self.frame, &self.model, &self.fast);
        (self.engine.interpolate)(&surface, Some(self.normals), self.albedo);
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
        let (surface, shader) =
            (surface(&self.frame, &self.model, &self.fast), Shader::new(&self.workload.scene.view));
        let limit = f64::INFINITY;
        (self.engine.residual)(&surface, known, &shader, &self.target, limit).unwrap_or(0.0)
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

/// Steps until one has compared the picture. Returns whether there was one.
pub fn step_to_image(chain: &mut Chain<'_, '_>) -> bool {
    let before = chain.checkpoint().image_evaluated;
    while chain.step().is_some() {
        if chain.checkpoint().image_evaluated != before {
            return true;
        }
    }
    false
}

/// Time of something and of its naive twin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Timing {
    /// Microseconds.
    pub us: f64,
    /// Microseconds of the naive twin, if it has one.
    pub naive_us: Option<f64>,
    /// How many times faster it is than its twin.
    pub ratio: Option<f64>,
}

impl Timing {
    fn new(seconds: f64, naive_seconds: Option<f64>) -> Self {
        Self {
            us: 1e6 * seconds,
            naive_us: naive_seconds.map(|naive| 1e6 * naive),
            ratio: naive_seconds.map(|naive| naive / seconds),
        }
    }
}

/// Speed of the image stage of a chain on one core.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Speed {
    /// Steps per second that compared the picture. The time of the others, turned down by an
    /// earlier test, is theirs too.
    pub steps_per_second: f64,
    /// Steps per second, whatever became of them.
    pub all_steps_per_second: f64,
}

/// How fast this machine reads, one core, 10⁹ bytes per second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bandwidth {
    /// A buffer larger than the caches.
    pub memory: f64,
    /// A buffer of 8 MiB, about what the steps of a fit read again and again.
    pub cache: f64,
}

/// How fast a search comes to the mode on one core.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ModeTime {
    /// Components of the shape, and as many of the albedo.
    pub rank: usize,
    /// Iterations until it has converged.
    pub iterations: usize,
    /// Seconds of all of it.
    pub seconds: f64,
    /// Floating-point operations of an iteration, an estimate: the sums of the normal equations,
    /// their solution, and both bases, once forth and once back.
    pub flops_per_iteration: f64,
    /// Bytes an iteration moves, an estimate: both bases forth and back and by vertex, and the
    /// matrix when it is made, copied and solved.
    pub bytes_per_iteration: f64,
    /// Seconds if its operations at the peak, or moving these bytes at the memory's bandwidth,
    /// whichever takes longer, were all there is to do.
    pub roofline_seconds: f64,
    /// Part of that speed reached.
    pub fraction_of_roofline: f64,
}

impl ModeTime {
    /// `gflops` and `bandwidth` are the machine's, 10⁹ per second.
    fn new(
        workload: &Workload,
        model: &OwnedModel,
        rank: usize,
        gflops: f64,
        bandwidth: f64,
    ) -> Result<Self> {
        let config = mode_config(rank);
        let (model, landmarks) = (model.view(), workload.observations());
        let problem = workload.problem(&model, &landmarks, &config);
        let mut memory = vec![0; search::words(&problem, &Options::default())];
        let mut times = Vec::new();
        let mut samples = 0;
        for _ in 0..REPETITIONS {
            samples = 0;
            let begin = Instant::now();
            let mut search =
                ModeSearch::new(problem, Options::default(), &mut memory).map_err(Error::new)?;
            let mut again = vec![begin.elapsed()];
            let mut start = Instant::now();
            while let Some(iteration) = search.step() {
                again.push(start.elapsed());
                samples += search::LEVELS[iteration.level].samples;
                start = Instant::now();
            }
            let known = times.iter().copied().chain(std::iter::repeat(Duration::MAX));
            times = again.into_iter().zip(known).map(|(time, known)| time.min(known)).collect();
        }
        let (iterations, seconds) = (times.len() - 1, times.iter().sum::<Duration>().as_secs_f64());
        let n =
            (2 * rank + search::unknowns::POSE + search::unknowns::LIGHT + search::unknowns::COLOR)
                as f64;
        let entries = 2.0 * (rank * field_len(model.vertices())) as f64;
        let equations = 3.0 * samples as f64 / iterations as f64;
        let flops = equations * n * n + n * n * n / 3.0 + 4.0 * entries;
        // Half a matrix of 4-byte numbers is read and written four times.
        let bytes = 3.0 * size_of::<i16>() as f64 * entries + 4.0 * 2.0 * 0.5 * 4.0 * n * n;
        let roofline = iterations as f64 * (flops / gflops).max(bytes / bandwidth) * 1e-9;
        Ok(Self {
            rank,
            iterations,
            seconds,
            flops_per_iteration: flops,
            bytes_per_iteration: bytes,
            roofline_seconds: roofline,
            fraction_of_roofline: roofline / seconds,
        })
    }
}

/// A search's configuration with so many components of shape and albedo each.
pub fn mode_config(rank: usize) -> Config {
    Config::default().with(|config| {
        (config.shape_rank, config.albedo_rank) = (rank, rank);
        (config.landmark_samples, config.shape_samples, config.samples) = (0, 0, 0);
    })
}

/// What was measured; displays as a table for a person, serializes as `onescan bench --json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The paper's chain, with closed-form light.
    #[serde(flatten)]
    pub fit: Speed,
    /// The same chain without it, a sampler.
    pub sampler: Speed,
    /// Vectors the stages were compiled for.
    pub engine: &'static str,
    /// The first with stages compiled for any processor of this kind.
    pub portable: Speed,
    /// Part of the picture that the face covers.
    pub covered_fraction: f64,
    /// Stages by name, and last the `step`: an image-evaluated step of the paper's chain beside
    /// the naive twins of rendering and likelihood.
    #[serde(serialize_with = "as_map")]
    pub stages: Vec<(&'static str, Timing)>,
    /// How fast this machine reads.
    pub bandwidth_gb_per_s: Bandwidth,
    /// Bytes an average image-evaluated step of that chain reads and writes, an estimate:
    /// every stage that the step's move makes necessary counts each of its buffers once. What the
    /// closed-form light looks at is not counted.
    pub bytes_per_step: f64,
    /// Image-evaluated steps per second if moving those bytes, at the cache's bandwidth, were all
    /// there is to do.
    pub roofline_steps_per_second: f64,
    /// Part of that reached.
    pub fraction_of_roofline: f64,
    /// The most single-precision operations this machine does, one core, 10⁹ per second, not fused.
    pub peak_gflops: f64,
    /// The search for the mode: with as many components as fits infer by default, and 199.
    pub mode: Vec<ModeTime>,
}

fn as_map<S: Serializer>(
    stages: &[(&'static str, Timing)],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    serializer.collect_map(stages.iter().copied())
}

impl Report {
    /// As JSON text.
    ///
    /// # Errors
    /// None in practice: all keys are text.
    pub fn to_json(&self) -> Result<String> {
        serde_json::to_string_pretty(self).map_err(Error::new)
    }
}

/// Measures everything; half a minute or so, told to `progress` in `[0, 1]`.
///
/// # Errors
/// None in practice: everything it needs is built in.
pub fn measure(progress: &mut dyn FnMut(f64)) -> Result<Report> {
    let workload = Workload::new(&mut |done| progress(0.3 * done))?;
    let mut memory = vec![0; Stages::words(SIZE)];
    let mut stages = Stages::new(&workload, &mut memory)?;
    let mut timings = Vec::new();
    for (done, stage) in Stage::ALL.into_iter().enumerate() {
        let fast = fastest(|| stages.run(stage));
        let twin = stages.run_naive(stage);
        let slow = twin.map(|()| fastest(|| stages.run_naive(stage)));
        timings.push((stage.name(), Timing::new(fast, slow)));
        progress(0.3 + 0.2 * (done + 1) as f64 / Stage::ALL.len() as f64);
    }

    let best = simd::best();
    let fit = Run::new(&workload, best, true, &mut |done| progress(0.5 + 0.15 * done))?;
    let sampler = Run::new(&workload, best, false, &mut |done| progress(0.65 + 0.1 * done))?;
    let portable = Engine::PORTABLE;
    let portable = Run::new(&workload, portable, true, &mut |done| progress(0.75 + 0.2 * done))?;
    let naive_step = timings
        .iter()
        .filter(|(name, _)| [Stage::Render, Stage::Likelihood].map(Stage::name).contains(name))
        .map(|(_, timing)| timing.naive_us)
        .sum::<Option<f64>>()
        .map(|us| 1e-6 * us);
    timings.push(("step", Timing::new(fit.seconds / fit.evaluated, naive_step)));

    let traffic = Traffic::new(&workload);
    let bandwidth =
        Bandwidth { memory: read_bandwidth(MEMORY_BYTES), cache: read_bandwidth(CACHE_BYTES) };
    let passes = fastest(|| simd::arithmetic(PASSES));
    let peak = simd::OPERATIONS as f64 * f64::from(PASSES) / passes / 1e9;
    let full = demo::template_model(FULL_RANK, &mut |done, _| progress(0.95 + 0.04 * done))?.model;
    let rank = Config::default().shape_rank;
    let mode = [(&workload.model, rank), (&full, FULL_RANK)]
        .map(|(model, rank)| ModeTime::new(&workload, model, rank, peak, bandwidth.memory));
    let mode = mode.into_iter().collect::<Result<_>>()?;
    progress(1.0);
    let bytes_per_step = traffic.per_step(&fit);
    let roofline = 1e9 * bandwidth.cache / bytes_per_step;
    Ok(Report {
        fit: fit.speed(),
        sampler: sampler.speed(),
        engine: best.name,
        portable: portable.speed(),
        covered_fraction: workload.covered,
        stages: timings,
        bandwidth_gb_per_s: bandwidth,
        bytes_per_step,
        roofline_steps_per_second: roofline,
        fraction_of_roofline: fit.speed().steps_per_second / roofline,
        peak_gflops: peak,
        mode,
    })
}

/// Seconds of the fastest call within [`BUDGET`].
fn fastest<T>(mut call: impl FnMut() -> T) -> f64 {
    let mut best = f64::INFINITY;
    let begin = Instant::now();
    while begin.elapsed() < BUDGET {
        let start = Instant::now();
        black_box(call());
        best = best.min(start.elapsed().as_secs_f64());
    }
    best
}

/// 10⁹ bytes per second of reading a buffer from front to back, again and again; each slice
/// counts with its fastest pass.
fn read_bandwidth(bytes: usize) -> f64 {
    const SLICE: usize = (1 << 20) / size_of::<u64>();
    // Not zeros: those the system would give as one and the same page.
    let buffer = black_box(vec![1_u64; bytes / size_of::<u64>()]);
    let mut times = vec![Duration::MAX; buffer.len().div_ceil(SLICE)];
    let begin = Instant::now();
    while begin.elapsed() < BUDGET {
        for (time, slice) in times.iter_mut().zip(buffer.chunks(SLICE)) {
            let start = Instant::now();
            black_box(slice.iter().fold(0_u64, |sum, x| sum.wrapping_add(*x)));
            *time = start.elapsed().min(*time);
        }
    }
    bytes as f64 / times.iter().sum::<Duration>().as_secs_f64() / 1e9
}

/// The image stage of a chain, timed.
struct Run {
    /// Seconds of the whole stage.
    seconds: f64,
    /// Steps that compared the picture; of these, how many computed positions, what is visible,
    /// and albedo anew.
    evaluated: f64,
    shape: f64,
    geometry: f64,
    albedo: f64,
}

impl Run {
    fn new(
        workload: &Workload,
        engine: &Engine,
        search: bool,
        progress: &mut dyn FnMut(f64),
    ) -> Result<Self> {
        let config = Config::default().with(|config| {
            config.samples = STEPS;
            config.search = search;
        });
        let (model, landmarks) = (workload.model.view(), workload.observations());
        let problem = workload.problem(&model, &landmarks, &config).with_engine(engine);
        let mut memory = vec![0_u32; problem.dimensions().words()];
        let mut times = vec![Duration::MAX; STEPS as usize];
        let mut evaluated = Vec::new();
        for repetition in 0..REPETITIONS {
            let mut chain = Chain::new(problem, SEED, 0, &mut memory).map_err(Error::new)?;
            while chain.stage() == chain::Stage::Landmarks && chain.step().is_some() {}
            let touches: Vec<Touched> = chain
                .tallies(chain::Stage::Image)
                .map(|(branch, _)| branch.kind.touches())
                .collect();
            evaluated.clear();
            for time in &mut times {
                let before = chain.checkpoint().image_evaluated;
                let start = Instant::now();
                let step = chain.step();
                *time = start.elapsed().min(*time);
                if chain.checkpoint().image_evaluated != before {
                    evaluated.extend(step.map(|step| touches[step.branch]));
                }
            }
            progress((repetition + 1) as f64 / REPETITIONS as f64);
        }
        let count = |of: fn(&Touched) -> bool| {
            evaluated.iter().filter(|touched| of(touched)).count() as f64
        };
        Ok(Self {
            seconds: times.iter().sum::<Duration>().as_secs_f64(),
            evaluated: count(|_| true),
            shape: count(|touched| touched.shape),
            geometry: count(|touched| touched.geometry),
            albedo: count(|touched| touched.albedo),
        })
    }

    fn speed(&self) -> Speed {
        Speed {
            steps_per_second: self.evaluated / self.seconds,
            all_steps_per_second: f64::from(STEPS) / self.seconds,
        }
    }
}

/// Bytes the stages read and write, each buffer once.
struct Traffic {
    /// The components in use of one half's basis, and its mean.
    basis: f64,
    /// Four numbers per vertex.
    quads: f64,
    /// Corner indices.
    triangles: f64,
    /// Covered pixels.
    covered: f64,
}

impl Traffic {
    fn new(workload: &Workload) -> Self {
        let model = workload.model.view();
        let number = size_of::<f32>();
        let triangles = match model.triangles {
            Triangles::U16(t) => size_of_val(t),
            Triangles::U32(t) => size_of_val(t),
        };
        let entry = size_of::<i16>() * Config::default().shape_rank + number;
        Self {
            basis: (entry * field_len(model.vertices())) as f64,
            quads: (4 * number * padded(model.vertices())) as f64,
            triangles: triangles as f64,
            covered: workload.covered * workload.picture.rgb.len() as f64,
        }
    }

    /// An average image-evaluated step of a run. Per covered pixel, the frame holds 16 bytes,
    /// normal, albedo and target 12 each, the background 4.
    fn per_step(&self, run: &Run) -> f64 {
        let instance = self.basis + self.quads;
        let normals = 2.0 * self.quads + self.triangles;
        let project = 2.0 * self.quads;
        let rasterize = self.triangles + self.quads + (2.0 * 16.0 + 4.0) * self.covered;
        let normal = (16.0 + 12.0) * self.covered + self.quads + self.triangles;
        let albedo = 12.0 * self.covered + self.quads;
        let compare = 3.0 * 12.0 * self.covered;
        let total = run.shape * (instance + normals)
            + run.albedo * (instance + albedo + 16.0 * self.covered + self.triangles)
            + run.geometry * (project + rasterize + normal + albedo)
            + run.evaluated * compare;
        total / run.evaluated
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [width, height] = SIZE;
        let covered = 100.0 * self.covered_fraction;
        writeln!(
            f,
            "one core, {width} × {height} pixels, {covered:.0} % of them face, {}",
            self.engine
        )?;
        writeln!(f)?;
        writeln!(f, "{:12}{:>12}{:>12}{:>9}", "stage", "µs", "naive µs", "ratio")?;
        for (name, Timing { us, naive_us, ratio }) in &self.stages {
            write!(f, "{name:12}{us:>12.1}")?;
            match naive_us.zip(*ratio) {
                Some((naive, ratio)) => writeln!(f, "{naive:>12.1}{ratio:>9.1}")?,
                None => writeln!(f, "{:>12}{:>9}", "–", "–")?,
            }
        }
        writeln!(f)?;
        writeln!(f, "{:12}{:>24}{:>12}", "steps/s", "picture compared", "all")?;
        for (name, speed) in
            [("chain", self.fit), ("sampler", self.sampler), ("portable", self.portable)]
        {
            let Speed { steps_per_second, all_steps_per_second } = speed;
            writeln!(f, "{name:12}{steps_per_second:>24.0}{all_steps_per_second:>12.0}")?;
        }
        let Bandwidth { memory, cache } = self.bandwidth_gb_per_s;
        writeln!(f)?;
        writeln!(f, "reading: memory {memory:.1} GB/s, cache {cache:.1} GB/s")?;
        writeln!(
            f,
            "a step moves {:.2} MB; bandwidth alone would allow {:.0} steps/s from cache, {:.0} from \
             memory",
            1e-6 * self.bytes_per_step,
            self.roofline_steps_per_second,
            1e9 * memory / self.bytes_per_step
        )?;
        writeln!(f, "the chain reaches {:.0} % of the former", 100.0 * self.fraction_of_roofline)?;
        writeln!(f)?;
        write!(f, "{:12}{:>12}{:>12}{:>12}", "time to mode", "s", "iterations", "ms each")?;
        write!(f, "{:>12}{:>12}{:>12}", "Mflop each", "MB each", "roofline s")?;
        for mode in &self.mode {
            let each = 1e3 * mode.seconds / mode.iterations as f64;
            writeln!(f)?;
            write!(f, "{:12}", format!("{0} + {0}", mode.rank))?;
            write!(f, "{:>12.3}{:>12}{each:>12.2}", mode.seconds, mode.iterations)?;
            write!(f, "{:>12.1}", 1e-6 * mode.flops_per_iteration)?;
            write!(f, "{:>12.1}", 1e-6 * mode.bytes_per_iteration)?;
            write!(f, "{:>12.3}", mode.roofline_seconds)?;
        }
        writeln!(f)?;
        write!(f, "arithmetic: {:.0} Gflop/s at most, none fused", self.peak_gflops)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_has_the_promised_keys() {
        let speed = Speed { steps_per_second: 2.0, all_steps_per_second: 3.0 };
        let report = Report {
            fit: speed,
            sampler: speed,
            engine: "none",
            portable: speed,
            covered_fraction: 0.4,
            stages: vec![
                ("draw", Timing::new(1.0, Some(4.0))),
                ("rasterize", Timing::new(1.0, None)),
            ],
            bandwidth_gb_per_s: Bandwidth { memory: 8.0, cache: 16.0 },
            bytes_per_step: 1e6,
            roofline_steps_per_second: 16e3,
            fraction_of_roofline: 0.1,
            peak_gflops: 90.0,
            mode: vec![ModeTime {
                rank: 50,
                iterations: 30,
                seconds: 0.3,
                flops_per_iteration: 1e8,
                bytes_per_iteration: 1e7,
                roofline_seconds: 0.1,
                fraction_of_roofline: 0.3,
            }],
        };
        let text = report.to_json().expect("JSON");
        let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(json["steps_per_second"], 2.0);
        assert_eq!(json["all_steps_per_second"], 3.0);
        assert_eq!(json["stages"]["draw"]["ratio"], 4.0);
        assert!(json["stages"]["rasterize"]["naive_us"].is_null());
        assert_eq!(json["bandwidth_gb_per_s"]["cache"], 16.0);
        for key in ["covered_fraction", "bytes_per_step", "roofline_steps_per_second"] {
            assert!(json[key].is_number(), "{key}");
        }
        assert!(json["fraction_of_roofline"].is_number());
        assert!(json["peak_gflops"].is_number());
        assert_eq!(json["mode"][0]["seconds"], 0.3);
    }
}
