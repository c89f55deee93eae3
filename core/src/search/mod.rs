//! The mode of the posterior: Levenberg–Marquardt on everything at once.
//!
//! The unknowns are pose, camera, shape, albedo, light and colour transform ([`unknowns`]); what is
//! minimised is
//!
//! `E = ½‖a‖² + ½‖b‖² + priors + Σ landmarks + Σ_p w_p ‖I_p − c_p‖² / (2σ²·patch)`,
//!
//! where `w_p` is the probability that pixel `p` shows the face and not something before it
//! (`occlusion.rs`), estimated anew before every step. The image term is the *mean* over the
//! covered pixels times the weight they had before the step: to cover fewer of them is no gain.
//!
//! A step's direction is exact: the derivative of every covered pixel's colour, passed back by
//! reverse differentiation through shading, normals, projection and basis (`shading.rs`,
//! `surface.rs`), at the cost of a few renderings. Its metric is the Gauss–Newton matrix of some of
//! the pixels, drawn evenly from a random first one on. So the seed changes the way to the mode,
//! not the mode. Steps that do not lower `E` are not taken, but damped more.
//!
//! From coarse to fine: the photo is blurred less and a pixel's error is smaller at every level
//! ([`Level`]).

mod occlusion;
mod picture;
pub mod priors;
mod shading;
mod surface;
pub mod unknowns;
mod vector;

use crate::basis::padded;
use crate::chain::{ChainError, Problem};
use crate::hash::Fnv64;
use crate::least_squares::{System, matrix_words, system_words};
use crate::likelihood::background::HISTOGRAM_LEN;
use crate::likelihood::landmarks::{Landmarks, Points, rows_words};
use crate::math;
use crate::memory::Carver;
use crate::render::rasterize::{Frame, Hit, frame_words};
use crate::rng::Rng;
use crate::scene::{PixelCamera, Scene};
use core::array::from_fn;
use occlusion::Hiding;
use priors::{Priors, Widths};
use shading::{Adjoint, Point, Shading, slopes};
use surface::{Surface, at, surface_words};
use unknowns::{Layout, POSE, advance};
use vector::{Vec3, add, apply, apply_transposed, cross, dot, scale, sub, xyz};

/// One resolution of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Standard deviation of the photo's blur, pixels; at most 4.
    pub blur: f32,
    /// Standard deviation of a pixel's colour channel, as a multiple of the configuration's.
    pub error: f32,
    /// The most iterations.
    pub iterations: u32,
}

/// The levels of a search, coarse to fine.
pub const LEVELS: [Level; 4] = [
    Level { blur: 4.0, error: 2.8, iterations: 5 },
    Level { blur: 2.0, error: 1.86, iterations: 5 },
    Level { blur: 1.0, error: 1.4, iterations: 5 },
    Level { blur: 0.0, error: 1.0, iterations: 30 },
];

/// Pixels whose rows make the matrix.
const SAMPLES: usize = 1500;
/// Iterations on the landmarks alone, for the pose.
const POSE_ITERATIONS: u32 = 40;
/// Decrease of `E` below which a step counts as none.
const STILL: f64 = 0.05;
/// Iterations of the finest level after which the mask is held, so that what is minimised no longer
/// changes.
const RENEWALS: u32 = 8;
/// Steps in a row that count as none before the search has converged.
const PATIENCE: u32 = 2;
/// Dampings tried for one step.
const TRIES: u32 = 6;
/// Standard deviation, pixels, over which neighbouring pixels are judged together whether they show
/// the face: some 50 pixels, the order of the patch that shares one error.
const COHERENCE: f32 = 2.0;
/// Least log density a pixel's colour may have under the face, relative to the background: beyond
/// it, one pixel's error is no more evidence.
const HOPELESS: f32 = 60.0;
/// Degrees of freedom of a landmark's error: a landmark that is far off has little to say.
const LANDMARK_FREEDOM: f64 = 8.0;
/// Vertices whose positions a pixel's colour may depend on.
const MAX_AROUND: usize = 40;

/// What a search needs to know besides the problem.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Priors that only the search uses.
    pub widths: Widths,
    /// Whether pixels may show something else than the face.
    pub occlusion: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { widths: Widths::default(), occlusion: true }
    }
}

/// Words of memory a [`ModeSearch`] of a problem needs.
pub fn words(problem: &Problem<'_>) -> usize {
    let d = problem.dimensions();
    let layout = Layout { shape_rank: d.shape_rank, albedo_rank: d.albedo_rank };
    let n = layout.len();
    let pixels = d.width * d.height;
    let rest = frame_words(d.width, d.height)
        + surface_words(d.vertices, problem.model.triangles.len())
        + 3 * 4 * padded(d.vertices)
        + 3 * (d.shape_rank + d.albedo_rank)
        + rows_words(d.landmarks, d.shape_rank)
        + equations_words(n)
        + matrix_words(n)
        + 5 * n;
    7 * pixels + rest
}

/// Words of the normal equations, or of the histogram that is made there before.
const fn equations_words(n: usize) -> usize {
    let equations = system_words(n);
    if equations > HISTOGRAM_LEN { equations } else { HISTOGRAM_LEN }
}

/// `E`, part by part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    /// Of the covered pixels.
    pub image: f64,
    /// Of the landmarks.
    pub landmarks: f64,
    /// Of everything else.
    pub prior: f64,
}

impl Energy {
    /// The sum.
    pub fn total(&self) -> f64 {
        self.image + self.landmarks + self.prior
    }
}

/// What an iteration came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// Index of the level in [`LEVELS`].
    pub level: usize,
    /// Energy before it, with the mask it estimated.
    pub before: Energy,
    /// Energy after it, with the same mask; the same if no step was taken.
    pub after: Energy,
    /// Levenberg's damping after it.
    pub damping: f32,
    /// Covered pixels.
    pub covered: usize,
    /// How many of them show the face.
    pub visible: f32,
}

/// Planes of a picture, a number per pixel.
struct Planes<'w> {
    /// The photo at this level.
    photo: [&'w mut [f32]; 3],
    ln_background: &'w mut [f32],
    /// Probability that a covered pixel shows the face; 0 where nothing is covered.
    mask: &'w mut [f32],
    scratch: [&'w mut [f32]; 2],
}

/// Of every vertex, what it costs to change it.
struct Costs<'w> {
    normals: &'w mut [[f32; 4]],
    albedo: &'w mut [[f32; 4]],
    /// First of the window coordinates, then of the positions.
    positions: &'w mut [[f32; 4]],
}

/// A running search.
pub struct ModeSearch<'a, 'w> {
    problem: Problem<'a>,
    options: Options,
    hiding: Hiding,
    layout: Layout,
    scene: Scene,
    /// What the search for the pose by landmarks came to.
    initial: Scene,
    landmarks: Landmarks<'w>,
    planes: Planes<'w>,
    frame: Frame<'w>,
    surface: Surface<'w>,
    costs: Costs<'w>,
    /// A vertex's components.
    components: [&'w mut [[f32; 3]]; 2],
    /// Of a pixel's three channels.
    rows: [&'w mut [f32]; 3],
    system: &'w mut [f32],
    matrix: &'w mut [f32],
    gradient: &'w mut [f32],
    step: &'w mut [f32],
    rng: Rng,
    fingerprint: Fnv64,
    damping: f32,
    level: usize,
    iteration: u32,
    iterations: u32,
    still: u32,
    /// Covered pixels, and the sum of the mask, when it was last estimated.
    seen: (usize, f32),
    energy: Energy,
}

impl<'a, 'w> ModeSearch<'a, 'w> {
    /// Checks the problem, finds the pose by the landmarks and is ready to look at the picture.
    ///
    /// # Errors
    /// Whatever in the problem does not fit together, see [`ChainError`].
    pub fn new(
        problem: Problem<'a>,
        options: Options,
        seed: u64,
        memory: &'w mut [u32],
    ) -> Result<Self, ChainError> {
        let observed = problem.check()?;
        let needed = words(&problem);
        let error = ChainError::Memory { needed, found: memory.len() };
        if memory.len() < needed {
            return Err(error);
        }
        let mut search = Self::carve(problem, options, &observed, seed, memory).ok_or(error)?;
        search.find_pose();
        search.look_outside();
        search.enter(0);
        Ok(search)
    }

    #[inline(never)]
    fn carve(
        problem: Problem<'a>,
        options: Options,
        observed: &[(u32, [f32; 2])],
        seed: u64,
        memory: &'w mut [u32],
    ) -> Option<Self> {
        let Problem { model, image, config, .. } = problem;
        let d = problem.dimensions();
        let layout = Layout { shape_rank: d.shape_rank, albedo_rank: d.albedo_rank };
        let n = layout.len();
        let pixels = d.width * d.height;
        let mut carver = Carver::new(memory);
        let mut plane = || carver.floats(pixels);
        let planes = Planes {
            photo: [plane()?, plane()?, plane()?],
            ln_background: plane()?,
            mask: plane()?,
            scratch: [plane()?, plane()?],
        };
        let frame = Frame::carve(&mut carver, d.width, d.height)?;
        let surface = Surface::carve(&mut carver, model)?;
        let mut quads = || carver.quads(padded(d.vertices));
        let costs = Costs { normals: quads()?, albedo: quads()?, positions: quads()? };
        let mut components = |rank: usize| Some(carver.floats(3 * rank)?.as_chunks_mut().0);
        let components = [components(d.shape_rank)?, components(d.albedo_rank)?];
        let sd = config.landmark_sd;
        let landmarks = Landmarks::gather(&mut carver, model, observed, d.shape_rank, sd)?;
        let scene = Scene::initial(image.width, image.height, d.shape_rank, d.albedo_rank);
        Some(Self {
            problem,
            options,
            hiding: Hiding::of(model),
            layout,
            initial: scene.clone(),
            scene,
            landmarks,
            planes,
            frame,
            surface,
            costs,
            components,
            rows: [carver.floats(n)?, carver.floats(n)?, carver.floats(n)?],
            system: carver.floats(equations_words(n))?,
            matrix: carver.floats(matrix_words(n))?,
            gradient: carver.floats(n)?,
            step: carver.floats(n)?,
            rng: Rng::new(seed, 0),
            fingerprint: Fnv64::default(),
            damping: 1e-2,
            level: 0,
            iteration: 0,
            iterations: 0,
            still: 0,
            seen: (0, 0.0),
            energy: Energy::default(),
        })
    }

    /// The scene so far.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The scene by the landmarks alone.
    pub fn initial(&self) -> &Scene {
        &self.initial
    }

    /// Probability of every pixel to show the face, row by row; 0 where the face does not reach.
    pub fn mask(&self) -> &[f32] {
        self.planes.mask
    }

    /// Energy of the scene so far, at its level.
    pub fn energy(&self) -> Energy {
        self.energy
    }

    /// Iterations so far.
    pub fn iterations(&self) -> u32 {
        self.iterations
    }

    /// Whether the mode has been found: the last steps of the finest level changed nothing.
    pub fn converged(&self) -> bool {
        self.level + 1 == LEVELS.len() && self.still >= PATIENCE
    }

    /// Whether there is nothing left to do.
    pub fn done(&self) -> bool {
        self.level >= LEVELS.len() || self.converged() || self.exhausted()
    }

    fn exhausted(&self) -> bool {
        self.level + 1 == LEVELS.len() && self.iteration >= self.level().iterations
    }

    /// Hash of every scene on the way.
    pub fn fingerprint(&self) -> u64 {
        self.fingerprint.finish()
    }

    fn level(&self) -> Level {
        LEVELS.get(self.level).copied().unwrap_or(LEVELS[LEVELS.len() - 1])
    }

    fn priors(&self) -> Priors<'a> {
        let [width, height] = self.scene.camera.image_size;
        let focal_length = crate::scene::Camera::for_image(width, height).focal_length;
        Priors { prior: &self.problem.config.prior, widths: self.options.widths, focal_length }
    }

    /// Standard deviation of a pixel's channel at this level.
    fn sd(&self) -> f32 {
        self.level().error * self.problem.config.pixel_sd
    }

    /// Pose and camera by the landmarks, the shape being the mean.
    #[inline(never)]
    fn find_pose(&mut self) {
        let mut damping = 1e-3;
        for _ in 0..POSE_ITERATIONS {
            let energy = |scene: &Scene, search: &Self| {
                search.landmark_energy(scene, &search.landmarks.points(&scene.shape))
                    + search.priors().energy(scene)
            };
            let before = energy(&self.scene, self);
            let solved = self.solve_pose(damping);
            let mut scene = self.scene.clone();
            if let (Some(()), Some(step)) = (solved, self.layout.split(self.step)) {
                advance(&mut scene, &step);
                if energy(&scene, self) < before {
                    self.scene = scene;
                    damping *= 0.2;
                    continue;
                }
            }
            damping *= 5.0;
        }
        self.initial.clone_from(&self.scene);
        self.energy.landmarks =
            self.landmark_energy(&self.scene, &self.landmarks.points(&self.scene.shape));
        self.energy.prior = self.priors().energy(&self.scene);
    }

    /// A step of the pose alone: everything else is held by its damping.
    fn solve_pose(&mut self, lambda: f32) -> Option<()> {
        let n = self.layout.len();
        let priors = self.priors();
        let mut system = System::new(n, self.problem.engine.normal_equations, self.system)?;
        let points = self.landmarks.points(&self.scene.shape);
        add_landmarks(
            &self.problem,
            &self.landmarks,
            &self.scene,
            &points,
            self.components[0],
            &mut system,
        );
        priors.add(&self.scene, self.layout, &mut system);
        let held = |i: usize| if i < POSE { pose_damping(i) } else { 1e6 };
        system.solve_damped(lambda, held, self.matrix, self.step)?;
        if let Some(rest) = self.step.get_mut(POSE..) {
            rest.fill(0.0);
        }
        Some(())
    }

    /// The background is what the picture holds outside of where the landmarks put the face.
    #[inline(never)]
    fn look_outside(&mut self) {
        let width = self.problem.image.width as usize;
        self.render();
        let frame = &self.frame;
        let outside = |i: usize| {
            let (x, y) = (i % width.max(1), i / width.max(1));
            frame.hit(x, y).is_none()
        };
        // The equations are not in use yet.
        let ln = &mut *self.planes.ln_background;
        ln.fill(0.0);
        let scratch = &mut *self.system;
        if let Some(histogram) = scratch.get_mut(..HISTOGRAM_LEN) {
            picture::ln_background(self.problem.image.pixels, outside, histogram, ln);
        }
    }

    /// Blurs the photo for a level.
    #[inline(never)]
    fn enter(&mut self, level: usize) {
        self.level = level;
        self.iteration = 0;
        self.still = 0;
        self.damping = 1e-2;
        let blur = self.level().blur;
        let width = self.problem.image.width as usize;
        for (c, plane) in self.planes.photo.iter_mut().enumerate() {
            for (value, pixel) in plane.iter_mut().zip(self.problem.image.pixels) {
                *value = f32::from(at(pixel, c)) / 255.0;
            }
            picture::blur(plane, self.planes.scratch[0], width, blur);
        }
    }

    fn render(&mut self) {
        let Problem { model, engine, .. } = self.problem;
        self.surface.update(model, engine, &self.scene);
        (engine.rasterize)(model.triangles, self.surface.window, &mut self.frame);
    }

    /// One iteration; `None` when the search is done.
    pub fn step(&mut self) -> Option<Iteration> {
        if self.done() {
            return None;
        }
        self.render();
        let held = self.level + 1 == LEVELS.len() && self.iteration >= RENEWALS;
        if !held {
            self.seen = self.estimate_mask();
        }
        let (covered, visible) = self.seen;
        let shading = Shading::new(&self.scene);
        let before = self.evaluate(&self.scene, visible);
        self.gradient.fill(0.0);
        self.add_gradient(&shading);
        let mut after = before;
        if let Some(scene) = self.descend(&shading, covered, before, visible) {
            after = scene.1;
            self.scene = scene.0;
        }
        self.energy = after;
        for &parameter in self.scene.parameters() {
            self.fingerprint.write_f32(&[parameter]);
        }
        let level = self.level;
        let calm = before.total() - after.total() < STILL;
        self.still = if calm { self.still + 1 } else { 0 };
        if !held && self.level + 1 == LEVELS.len() {
            // The next mask may yet change it.
            self.still = 0;
        }
        self.iteration += 1;
        self.iterations += 1;
        let last = level + 1 == LEVELS.len();
        if !last && (self.iteration >= self.level().iterations || self.still > 0) {
            self.enter(level + 1);
        }
        Some(Iteration { level, before, after, damping: self.damping, covered, visible })
    }

    /// What a visible pixel of the current scene shows.
    #[inline(always)]
    fn point(&self, shading: &Shading, hit: &Hit) -> Option<([usize; 3], Point)> {
        let corners = self.problem.model.triangles.get(hit.triangle)?.map(|v| v as usize);
        let [second, third] = hit.weights;
        let weights = [1.0 - second - third, second, third];
        let normals = corners.map(|v| xyz(at(self.surface.normals, v)));
        let albedos = corners.map(|v| xyz(at(self.surface.albedo, v)));
        Some((corners, shading.point(weights, normals, albedos)))
    }

    /// The photo at a pixel.
    #[inline(always)]
    fn photo(&self, index: usize) -> Vec3 {
        let [r, g, b] = &self.planes.photo;
        [at(r, index), at(g, index), at(b, index)]
    }

    /// Estimates the mask of what has been rendered, and gives covered pixels and the mask's sum.
    #[inline(never)]
    fn estimate_mask(&mut self) -> (usize, f32) {
        let width = self.problem.image.width as usize;
        let sd = self.sd();
        let k = 1.0 / (2.0 * sd * sd);
        let normaliser = crate::likelihood::pixels::ln_normaliser(f64::from(sd)) as f32;
        let shading = Shading::new(&self.scene);
        for plane in &mut self.planes.scratch {
            plane.fill(0.0);
        }
        self.planes.mask.fill(0.0);
        let mut covered = 0;
        for y in self.frame.rows() {
            for x in self.frame.columns() {
                let Some(hit) = self.frame.hit(x, y) else { continue };
                let index = y * width + x;
                let Some((_, point)) = self.point(&shading, &hit) else { continue };
                let difference = sub(self.photo(index), point.color);
                let face = normaliser - k * dot(difference, difference);
                let ratio = (face - at(self.planes.ln_background, index)).max(-HOPELESS);
                covered += 1;
                let [ratios, count] = &mut self.planes.scratch;
                let (Some(r), Some(c)) = (ratios.get_mut(index), count.get_mut(index)) else {
                    continue;
                };
                *r = ratio;
                *c = 1.0;
            }
        }
        if !self.options.occlusion {
            self.planes.mask.copy_from_slice(self.planes.scratch[1]);
            return (covered, covered as f32);
        }
        let [ratios, count] = &mut self.planes.scratch;
        picture::blur(ratios, self.planes.mask, width, COHERENCE);
        picture::blur(count, self.planes.mask, width, COHERENCE);
        self.planes.mask.fill(0.0);
        let mut sum = 0.0;
        for y in self.frame.rows() {
            let mut row = 0.0;
            for x in self.frame.columns() {
                let Some(hit) = self.frame.hit(x, y) else { continue };
                let index = y * width + x;
                let [ratios, count] = &self.planes.scratch;
                let ratio = at(ratios, index) / at(count, index).max(1e-6);
                let hidden = self.hidden(&hit);
                // face (1 − ε) against background ε.
                let odds = f64::from(hidden / (1.0 - hidden)) * math::exp(f64::from(-ratio));
                let mask = (1.0 / (1.0 + odds)) as f32;
                row += mask;
                if let Some(out) = self.planes.mask.get_mut(index) {
                    *out = mask;
                }
            }
            sum += row;
        }
        (covered, sum)
    }

    /// Prior probability that the surface is hidden at a pixel.
    fn hidden(&self, hit: &Hit) -> f32 {
        let model = self.problem.model;
        let Some(corners) = model.triangles.get(hit.triangle) else { return 0.5 };
        let [second, third] = hit.weights;
        let [a, b, c] = corners.map(|v| model.shape.mean_at(v as usize));
        let place = add(add(scale(a, 1.0 - second - third), scale(b, second)), scale(c, third));
        self.hiding.at(place)
    }

    /// Energy of what has been rendered of a scene. `visible` is the sum the mask had when it was
    /// estimated.
    fn evaluate(&self, scene: &Scene, visible: f32) -> Energy {
        let points = self.landmarks.points(&scene.shape);
        Energy {
            image: self.image_energy(scene, visible),
            landmarks: self.landmark_energy(scene, &points),
            prior: self.priors().energy(scene),
        }
    }

    #[inline(never)]
    fn image_energy(&self, scene: &Scene, visible: f32) -> f64 {
        let width = self.problem.image.width as usize;
        let shading = Shading::new(scene);
        let (mut squares, mut weights) = (0.0_f64, 0.0_f64);
        for y in self.frame.rows() {
            let (mut row, mut row_weights) = (0.0_f32, 0.0_f32);
            for x in self.frame.columns() {
                let index = y * width + x;
                let mask = at(self.planes.mask, index);
                if mask == 0.0 {
                    continue;
                }
                let Some(hit) = self.frame.hit(x, y) else { continue };
                let Some((_, point)) = self.point(&shading, &hit) else { continue };
                let difference = sub(self.photo(index), point.color);
                row += mask * dot(difference, difference);
                row_weights += mask;
            }
            squares += f64::from(row);
            weights += f64::from(row_weights);
        }
        if !(weights > 0.0) {
            return f64::INFINITY;
        }
        squares * f64::from(visible) / weights * 0.5 * f64::from(self.pixel_weight())
    }

    /// What a squared difference of colours counts.
    fn pixel_weight(&self) -> f32 {
        let sd = self.sd();
        1.0 / (sd * sd * self.problem.config.pixel_patch)
    }

    fn landmark_energy(&self, scene: &Scene, points: &Points) -> f64 {
        let sd = f64::from(self.problem.config.landmark_sd);
        let samples = self.landmarks.samples(scene, points);
        samples
            .map(|sample| {
                let [x, y] = sample.residual.map(f64::from);
                let q = (x * x + y * y) / (sd * sd);
                0.5 * (LANDMARK_FREEDOM + 2.0) * math::ln(1.0 + q / LANDMARK_FREEDOM)
            })
            .sum()
    }

    /// The slopes of a triangle's barycentric coordinates in the window.
    #[inline(always)]
    fn slopes(&self, corners: [usize; 3]) -> [[f32; 2]; 3] {
        slopes(corners.map(|v| {
            let [x, y, ..] = at(self.surface.window, v);
            [x, y]
        }))
    }

    /// Adds `−∂E/∂x` of the image term to the gradient.
    #[inline(never)]
    fn add_gradient(&mut self, shading: &Shading) {
        let width = self.problem.image.width as usize;
        let weight = self.pixel_weight();
        let Costs { normals, albedo, positions } = &mut self.costs;
        normals.fill([0.0; 4]);
        albedo.fill([0.0; 4]);
        positions.fill([0.0; 4]);
        let mut light = [[0.0_f64; 3]; 9];
        let mut color = [0.0_f64; unknowns::COLOR];
        for y in self.frame.rows() {
            for x in self.frame.columns() {
                let index = y * width + x;
                let mask = at(self.planes.mask, index);
                if mask < 1e-3 {
                    continue;
                }
                let Some(hit) = self.frame.hit(x, y) else { continue };
                let Some((corners, point)) = self.point(shading, &hit) else { continue };
                let difference = sub(self.photo(index), point.color);
                let adjoint = shading.adjoint(&point, scale(difference, mask * weight));
                let motion = adjoint.motion(&point, &self.slopes(corners));
                for (vertex, w) in corners.into_iter().zip(point.weights) {
                    let put = |to: Option<&mut [f32; 4]>, [x, y, z]: Vec3| {
                        if let Some(to) = to {
                            *to = [to[0] + w * x, to[1] + w * y, to[2] + w * z, 0.0];
                        }
                    };
                    put(self.costs.normals.get_mut(vertex), adjoint.normal);
                    put(self.costs.albedo.get_mut(vertex), adjoint.albedo);
                    put(self.costs.positions.get_mut(vertex), [motion[0], motion[1], 0.0]);
                }
                for (sum, y) in light.iter_mut().zip(adjoint.harmonics) {
                    for (sum, r) in sum.iter_mut().zip(adjoint.radiance) {
                        *sum += f64::from(y * r);
                    }
                }
                for (sum, c) in color.iter_mut().zip(adjoint.color) {
                    *sum += f64::from(c);
                }
            }
        }
        let mut pose = [0.0_f64; POSE];
        let view = Window::new(&self.scene);
        for (v, cost) in self.costs.positions.iter_mut().enumerate() {
            let [x, y, ..] = *cost;
            if x != 0.0 || y != 0.0 {
                let (moved, by_pose) = view.adjoint(xyz(at(self.surface.positions, v)), [x, y]);
                *cost = [moved[0], moved[1], moved[2], 0.0];
                for (sum, p) in pose.iter_mut().zip(by_pose) {
                    *sum += f64::from(p);
                }
            }
        }
        for v in 0..self.problem.model.vertices() {
            let cost = xyz(at(self.costs.normals, v));
            if cost == [0.0; 3] {
                continue;
            }
            let turned = apply(&view.rotation, cross(xyz(at(self.surface.normals, v)), cost));
            for (sum, t) in pose.iter_mut().zip(turned) {
                *sum += f64::from(t);
            }
            let positions = &mut *self.costs.positions;
            self.surface.normal_adjoint(self.problem.model, v, cost, |vertex, cost| {
                if let Some(to) = positions.get_mut(vertex) {
                    *to = [to[0] + cost[0], to[1] + cost[1], to[2] + cost[2], 0.0];
                }
            });
        }
        let model = self.problem.model;
        let Some(parts) = self.layout.split(self.gradient) else { return };
        for (g, p) in parts.pose.iter_mut().zip(pose) {
            *g += p as f32;
        }
        model.shape.transposed(self.costs.positions, parts.shape);
        model.albedo.transposed(self.costs.albedo, parts.albedo);
        for (g, l) in parts.light.as_flattened_mut().iter_mut().zip(light.as_flattened()) {
            *g += *l as f32;
        }
        for (g, c) in parts.color.iter_mut().zip(color) {
            *g += c as f32;
        }
    }

    /// Solves for a step and takes it if it lowers the energy; otherwise damps more.
    #[inline(never)]
    fn descend(
        &mut self,
        shading: &Shading,
        covered: usize,
        before: Energy,
        visible: f32,
    ) -> Option<(Scene, Energy)> {
        let words = core::mem::take(&mut self.system);
        let found = self.descend_in(words, shading, covered, before, visible);
        self.system = words;
        found
    }

    fn descend_in(
        &mut self,
        words: &mut [f32],
        shading: &Shading,
        covered: usize,
        before: Energy,
        visible: f32,
    ) -> Option<(Scene, Energy)> {
        let n = self.layout.len();
        let mut system = System::new(n, self.problem.engine.normal_equations, words)?;
        self.add_curvature(shading, covered, &mut system);
        let points = self.landmarks.points(&self.scene.shape);
        add_landmarks(
            &self.problem,
            &self.landmarks,
            &self.scene,
            &points,
            self.components[0],
            &mut system,
        );
        self.priors().add(&self.scene, self.layout, &mut system);
        system.push(self.gradient);
        let light = self.layout.light()..self.layout.color();
        let damping = |i: usize| {
            if i < POSE {
                pose_damping(i)
            } else if light.contains(&i) {
                1.0
            } else {
                0.0
            }
        };
        for _ in 0..TRIES {
            if system.solve_damped(self.damping, damping, self.matrix, self.step).is_some() {
                let mut scene = self.scene.clone();
                advance(&mut scene, &self.layout.split(self.step)?);
                let Problem { model, engine, .. } = self.problem;
                self.surface.update(model, engine, &scene);
                (engine.rasterize)(model.triangles, self.surface.window, &mut self.frame);
                let after = self.evaluate(&scene, visible);
                if after.total() < before.total() {
                    self.damping = (0.25 * self.damping).max(1e-5);
                    return Some((scene, after));
                }
            }
            self.damping = (5.0 * self.damping).min(1e6);
        }
        None
    }

    /// Adds the Gauss–Newton matrix of evenly drawn pixels.
    #[inline(never)]
    fn add_curvature(&mut self, shading: &Shading, covered: usize, system: &mut System<'_>) {
        let width = self.problem.image.width as usize;
        let stride = (covered as f64 / SAMPLES as f64).max(1.0);
        let mut next = self.rng.uniform() * stride;
        let weight = self.pixel_weight() * stride as f32;
        let view = Window::new(&self.scene);
        let mut seen = 0.0;
        for y in self.frame.rows() {
            for x in self.frame.columns() {
                let Some(hit) = self.frame.hit(x, y) else { continue };
                seen += 1.0;
                if seen <= next {
                    continue;
                }
                next += stride;
                let mask = at(self.planes.mask, y * width + x);
                if mask < 1e-2 {
                    continue;
                }
                let Some((corners, point)) = self.point(shading, &hit) else { continue };
                self.add_pixel(shading, &view, corners, &point, weight * mask, system);
            }
        }
    }

    /// Adds one pixel's three rows.
    fn add_pixel(
        &mut self,
        shading: &Shading,
        view: &Window,
        corners: [usize; 3],
        point: &Point,
        weight: f32,
        system: &mut System<'_>,
    ) {
        let slopes = self.slopes(corners);
        let adjoints: [Adjoint; 3] = from_fn(|channel| {
            let mut gradient = [0.0; 3];
            gradient[channel] = 1.0;
            shading.adjoint(point, gradient)
        });
        // What each channel's colour costs each position around, and the pose.
        let mut around = heapless::Vec::<(usize, [Vec3; 3]), MAX_AROUND>::new();
        let mut pose = [[0.0_f32; POSE]; 3];
        for (channel, adjoint) in adjoints.iter().enumerate() {
            let mut put = |vertex: usize, cost: Vec3| {
                let known = around.iter_mut().find(|(v, _)| *v == vertex);
                if let Some((_, costs)) = known {
                    costs[channel] = add(costs[channel], cost);
                } else {
                    let mut costs = [[0.0; 3]; 3];
                    costs[channel] = cost;
                    // A corner of very many faces: what does not fit is left out of the matrix.
                    let _ = around.push((vertex, costs));
                }
            };
            let motion = adjoint.motion(point, &slopes);
            for (i, vertex) in corners.into_iter().enumerate() {
                let w = point.weights[i];
                let cost = scale(adjoint.normal, w);
                let turned = apply(&view.rotation, cross(point.normals[i], cost));
                for (sum, t) in pose[channel].iter_mut().zip(turned) {
                    *sum += t;
                }
                self.surface.normal_adjoint(self.problem.model, vertex, cost, &mut put);
                let position = xyz(at(self.surface.positions, vertex));
                let (moved, by_pose) = view.adjoint(position, [w * motion[0], w * motion[1]]);
                put(vertex, moved);
                for (sum, p) in pose[channel].iter_mut().zip(by_pose) {
                    *sum += p;
                }
            }
        }
        let model = self.problem.model;
        let [shape, albedo] = &mut self.components;
        let rows = &mut self.rows;
        for row in rows.iter_mut() {
            row.fill(0.0);
        }
        for (vertex, costs) in &around {
            model.shape.at(*vertex, shape);
            for (row, cost) in rows.iter_mut().zip(costs) {
                let part = row.get_mut(POSE..).unwrap_or_default();
                for (out, b) in part.iter_mut().zip(&**shape) {
                    *out += cost[0] * b[0] + cost[1] * b[1] + cost[2] * b[2];
                }
            }
        }
        let first_albedo = POSE + self.layout.shape_rank;
        for (vertex, w) in corners.into_iter().zip(point.weights) {
            model.albedo.at(vertex, albedo);
            for (row, adjoint) in rows.iter_mut().zip(&adjoints) {
                let [r, g, b] = scale(adjoint.albedo, w);
                let part = row.get_mut(first_albedo..).unwrap_or_default();
                for (out, c) in part.iter_mut().zip(&**albedo) {
                    *out += r * c[0] + g * c[1] + b * c[2];
                }
            }
        }
        for ((row, adjoint), pose) in rows.iter_mut().zip(&adjoints).zip(&pose) {
            let Some(parts) = self.layout.split(row) else { continue };
            *parts.pose = *pose;
            for (out, y) in parts.light.iter_mut().zip(adjoint.harmonics) {
                *out = scale(adjoint.radiance, y);
            }
            *parts.color = adjoint.color;
        }
        for row in rows {
            system.add_row(row, weight, 0.0);
        }
    }
}

/// Levenberg's absolute damping of pose and camera: half a radian, 100 mm, half the focal length.
fn pose_damping(i: usize) -> f32 {
    [4.0, 4.0, 4.0, 1e-4, 1e-4, 4.0, 0.0].get(i).copied().unwrap_or(0.0)
}

/// Adds the landmarks' equations.
fn add_landmarks(
    problem: &Problem<'_>,
    landmarks: &Landmarks<'_>,
    scene: &Scene,
    points: &Points,
    components: &mut [[f32; 3]],
    system: &mut System<'_>,
) {
    let view = Window::new(scene);
    let sd = problem.config.landmark_sd;
    for sample in landmarks.samples(scene, points) {
        problem.model.shape.at(sample.vertex, components);
        let [x, y] = sample.residual;
        let q = (x * x + y * y) / (sd * sd);
        let freedom = LANDMARK_FREEDOM as f32;
        let weight = (freedom + 2.0) / (freedom + q) / (sd * sd);
        for (axis, residual) in [x, y].into_iter().enumerate() {
            let mut cost = [0.0; 2];
            cost[axis] = 1.0;
            let (moved, pose) = view.adjoint(sample.point, cost);
            let row = &mut system.rows[0];
            row.fill(0.0);
            for (out, p) in row.iter_mut().zip(pose) {
                *out = p;
            }
            for (out, b) in row.get_mut(POSE..).unwrap_or_default().iter_mut().zip(&*components) {
                *out = dot(moved, *b);
            }
            system.add(0, weight, residual);
        }
    }
}

/// How window coordinates follow positions, pose and camera.
struct Window {
    rotation: [Vec3; 3],
    translation: Vec3,
    scale: f32,
    pixel: PixelCamera,
}

impl Window {
    fn new(scene: &Scene) -> Self {
        Self {
            rotation: scene.pose.rotation(),
            translation: scene.pose.translation,
            scale: scene.pose.scale,
            pixel: scene.camera.pixel_scale(),
        }
    }

    /// Passes what `(u, v)` of a model point cost back to the point, and to the pose.
    ///
    /// `u = c + f X/d`, `v = c − f Y/d`, `d = −Z`; turning by ω about the object's origin moves
    /// `X` by `ω × (X − t)`.
    #[inline(always)]
    fn adjoint(&self, point: Vec3, [pu, pv]: [f32; 2]) -> (Vec3, [f32; POSE]) {
        let q = scale(apply(&self.rotation, point), self.scale);
        let [x, y, z] = add(q, self.translation);
        let k = -1.0 / z;
        let [fx, fy] = self.pixel.focal;
        let (u, v) = (fx * x * k * pu, fy * y * k * pv);
        let world = [fx * k * pu, -fy * k * pv, (u - v) * k];
        let zoom = u - v;
        let turned = cross(q, world);
        let recede = world[2] * self.translation[2] + zoom;
        let moved = scale(apply_transposed(&self.rotation, world), self.scale);
        (moved, [turned[0], turned[1], turned[2], world[0], world[1], zoom, recede])
    }
}

#[cfg(test)]
mod tests;
