//! The state of a search, in the caller's memory.

use super::occlusion;
use super::priors::{Priors, Widths};
use super::surface::{Surface, surface_words};
use super::unknowns::Layout;
use crate::basis::{ByVertex, by_vertex_words, padded};
use crate::chain::{Dimensions, Problem};
use crate::hash::Fnv64;
use crate::least_squares::{matrix_words, system_words};
use crate::likelihood::background::HISTOGRAM_LEN;
use crate::likelihood::landmarks::{Landmarks, rows_words};
use crate::math;
use crate::memory::Carver;
use crate::render::rasterize::{Frame, frame_words};
use crate::scene::{Camera, MAX_RANK, Scene};

/// One resolution of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Standard deviation of the photo's blur, pixels; at most 4.
    pub blur: f32,
    /// Standard deviation of a pixel's colour channel, as a multiple of the configuration's.
    pub error: f32,
    /// The most pixels whose rows make a step's metric.
    pub samples: usize,
    /// The most components that are sought of shape and of albedo each, the leading ones.
    pub components: usize,
    /// The most iterations.
    pub iterations: u32,
}

/// The levels of a search, coarse to fine.
pub const LEVELS: [Level; 5] = [
    Level { blur: 4.0, error: 2.8, samples: 500, components: 20, iterations: 5 },
    Level { blur: 2.0, error: 1.86, samples: 500, components: 50, iterations: 5 },
    Level { blur: 1.0, error: 1.4, samples: 500, components: 100, iterations: 5 },
    Level { blur: 0.0, error: 1.3, samples: 1500, components: MAX_RANK, iterations: 10 },
    Level { blur: 0.0, error: 1.0, samples: 1500, components: MAX_RANK, iterations: 30 },
];

/// What a search needs to know besides the problem.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options<'a> {
    /// Priors that only the search uses.
    pub widths: Widths,
    /// Whether pixels may show something else than the face.
    pub occlusion: bool,
    /// Where the face may be seen, if that is known: 255 of a pixel that may show it, 0 of one that
    /// cannot, in between a part of its weight; row by row, as many as the picture has.
    pub open: Option<&'a [u8]>,
}

impl Default for Options<'_> {
    fn default() -> Self {
        Self { widths: Widths::default(), occlusion: true, open: None }
    }
}

impl Options<'_> {
    /// How much a pixel may show the face, 0 to 1.
    pub(super) fn open_at(&self, index: usize) -> f32 {
        self.open.map_or(1.0, |open| f32::from(open.get(index).copied().unwrap_or(0)) / 255.0)
    }
}

/// Words of memory a [`ModeSearch`] of a problem needs. Without copies of the bases if it is to be
/// [lean](Problem::lean): then it is slower, with the same bits.
pub fn words(problem: &Problem<'_>) -> usize {
    words_for(&problem.dimensions(), problem.model.triangles.len())
}

/// The same of sizes that are known before there is a problem.
///
/// Per pixel what is visible (4), photo and rendering (3 each), the background's density, mask and
/// weight; per vertex its position, normal, albedo and window coordinates (4 each), whether it is
/// likely to be hidden, and where its faces are listed, 3 per triangle; the landmarks' rows of the basis; what is needed in passing;
/// and, unless it is to be lean, copies of the bases.
pub const fn words_for(d: &Dimensions, triangles: usize) -> usize {
    let layout = Layout { shape_rank: d.shape_rank, albedo_rank: d.albedo_rank };
    let n = layout.len();
    let pixels = d.width * d.height;
    let rest = frame_words(d.width, d.height)
        + surface_words(d.vertices, triangles)
        + d.vertices.div_ceil(4)
        + 3 * d.shape_rank
        + copies_words(d)
        + rows_words(d.landmarks, d.shape_rank)
        + passing_words(d.vertices, pixels, n)
        + 5 * n;
    9 * pixels + rest
}

/// Words of copies of both bases, which cost memory and save time.
const fn copies_words(d: &Dimensions) -> usize {
    if d.lean {
        return 0;
    }
    by_vertex_words(d.vertices, d.shape_rank) + by_vertex_words(d.vertices, d.albedo_rank)
}

/// Words of what is needed in passing, one after another: the histogram of the background; what
/// vertices cost; equations, and beside them their matrix or three planes.
const fn passing_words(vertices: usize, pixels: usize, n: usize) -> usize {
    let equations = system_words(n) + larger(matrix_words(n), 3 * pixels);
    larger(larger(HISTOGRAM_LEN, Costs::words(vertices)), equations)
}

const fn larger(a: usize, b: usize) -> usize {
    if a > b { a } else { b }
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

/// Planes of a picture, a number per pixel.
pub(super) struct Planes<'w> {
    /// The photo at this level.
    pub(super) photo: [&'w mut [f32]; 3],
    /// The rendering; NaN where nothing is covered.
    pub(super) rendering: [&'w mut [f32]; 3],
    pub(super) ln_background: &'w mut [f32],
    /// Probability that a covered pixel shows the face; 0 where nothing is covered.
    pub(super) mask: &'w mut [f32],
    /// What a pixel's squared difference counts, in units of [`ModeSearch::pixel_weight`].
    pub(super) weights: &'w mut [f32],
}

/// Of every vertex, what it costs to change it.
pub(super) struct Costs<'p> {
    pub(super) normals: &'p mut [[f32; 4]],
    pub(super) albedo: &'p mut [[f32; 4]],
    /// First of the window coordinates, then of the positions.
    pub(super) positions: &'p mut [[f32; 4]],
}

impl<'p> Costs<'p> {
    /// Words of the costs.
    const fn words(vertices: usize) -> usize {
        3 * 4 * padded(vertices)
    }

    /// No costs yet; `None` if there is too little memory.
    pub(super) fn new(vertices: usize, memory: &'p mut [f32]) -> Option<Self> {
        let memory = memory.get_mut(..Self::words(vertices))?;
        memory.fill(0.0);
        let (quads, _) = memory.as_chunks_mut();
        let (normals, rest) = quads.split_at_mut_checked(padded(vertices))?;
        let (albedo, positions) = rest.split_at_mut_checked(padded(vertices))?;
        Some(Self { normals, albedo, positions })
    }
}

/// A running search.
pub struct ModeSearch<'a, 'w> {
    pub(super) problem: Problem<'a>,
    pub(super) options: Options<'a>,
    /// By vertex, how likely it is to be hidden before the photo is seen, see [`occlusion::fill`].
    pub(super) hidden: &'w mut [u8],
    /// Of the unknowns at this level.
    pub(super) layout: Layout,
    pub(super) scene: Scene,
    /// What the search for the pose by landmarks came to.
    pub(super) initial: Scene,
    pub(super) landmarks: Landmarks<'w>,
    pub(super) planes: Planes<'w>,
    pub(super) frame: Frame<'w>,
    pub(super) surface: Surface<'w>,
    /// Whether frame and surface are the scene's.
    pub(super) rendered: bool,
    /// A vertex's components of the shape.
    pub(super) components: &'w mut [[f32; 3]],
    /// Shape and albedo by vertex, unless memory is scarce.
    pub(super) by_vertex: [Option<ByVertex<'w>>; 2],
    /// Of a pixel's three channels.
    pub(super) rows: [&'w mut [f32]; 3],
    /// Of what is needed in passing, see [`passing_words`].
    pub(super) passing: &'w mut [f32],
    pub(super) gradient: &'w mut [f32],
    pub(super) step: &'w mut [f32],
    pub(super) fingerprint: Fnv64,
    pub(super) damping: f32,
    pub(super) level: usize,
    pub(super) iteration: u32,
    pub(super) iterations: u32,
    pub(super) still: u32,
    /// Covered pixels, and the sum of the mask.
    pub(super) seen: (usize, f32),
    /// What the pixels that the face covers by the landmarks alone have to say.
    pub(super) expected: f32,
    /// Whether energy and planes are the scene's at this level.
    pub(super) judged: bool,
    pub(super) energy: Energy,
}

impl<'a, 'w> ModeSearch<'a, 'w> {
    /// Carves the memory; `None` if it is shorter than [`words`].
    #[inline(never)]
    pub(super) fn carve(
        problem: Problem<'a>,
        options: Options<'a>,
        observed: &[(u32, [f32; 2])],
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
            rendering: [plane()?, plane()?, plane()?],
            ln_background: plane()?,
            mask: plane()?,
            weights: plane()?,
        };
        let frame = Frame::carve(&mut carver, d.width, d.height)?;
        let surface = Surface::carve(&mut carver, model)?;
        let components = carver.groups(d.shape_rank)?;
        let mut by_vertex = [None, None];
        if !d.lean {
            let halves = [(&model.shape, d.shape_rank), (&model.albedo, d.albedo_rank)];
            for (copy, (basis, rank)) in by_vertex.iter_mut().zip(halves) {
                *copy = Some(ByVertex::carve(&mut carver, basis, d.vertices, rank)?);
            }
        }
        let sd = config.landmark_sd;
        let landmarks = Landmarks::gather(&mut carver, model, observed, d.shape_rank, sd)?;
        let hidden = carver.bytes(d.vertices.div_ceil(4))?;
        hidden.fill(occlusion::NEVER);
        if options.occlusion {
            occlusion::fill(model, hidden);
        }
        let scene = Scene::initial(image.width, image.height, d.shape_rank, d.albedo_rank);
        Some(Self {
            problem,
            options,
            hidden,
            layout,
            initial: scene.clone(),
            scene,
            landmarks,
            planes,
            frame,
            surface,
            rendered: false,
            components,
            by_vertex,
            rows: [carver.floats(n)?, carver.floats(n)?, carver.floats(n)?],
            passing: carver.floats(passing_words(d.vertices, pixels, n))?,
            gradient: carver.floats(n)?,
            step: carver.floats(n)?,
            fingerprint: Fnv64::default(),
            damping: 1e-2,
            level: 0,
            iteration: 0,
            iterations: 0,
            still: 0,
            seen: (0, 0.0),
            expected: 0.0,
            judged: false,
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

    /// What is fitted to what.
    pub(crate) fn problem(&self) -> Problem<'a> {
        self.problem
    }

    /// The unknowns that are sought.
    pub(crate) fn layout(&self) -> Layout {
        self.layout
    }

    /// Root mean square difference per channel between photo and rendering, `[0, 1]`, of the pixels
    /// of the scene so far, each as much as it shows the face.
    pub fn seen_rmse(&self) -> f64 {
        let Planes { photo, rendering, mask, .. } = &self.planes;
        let (mut sum, mut seen) = (0.0, 0.0);
        for (photo, rendering) in photo.iter().zip(rendering) {
            for ((p, r), m) in photo.iter().zip(&**rendering).zip(&**mask) {
                if *m > 0.0 && !r.is_nan() {
                    sum += f64::from(m * (p - r) * (p - r));
                    seen += f64::from(*m);
                }
            }
        }
        math::sqrt_f64(sum / f64::max(seen, f64::MIN_POSITIVE))
    }

    /// Energy of the scene so far, at its level.
    pub fn energy(&self) -> Energy {
        self.energy
    }

    /// Iterations so far.
    pub fn iterations(&self) -> u32 {
        self.iterations
    }

    /// Hash of every scene on the way.
    pub fn fingerprint(&self) -> u64 {
        self.fingerprint.finish()
    }

    /// Whether the level is the last.
    pub(super) fn finest(&self) -> bool {
        self.level + 1 == LEVELS.len()
    }

    /// The level the search is at.
    pub(super) fn level(&self) -> Level {
        LEVELS.get(self.level).copied().unwrap_or(LEVELS[LEVELS.len() - 1])
    }

    /// What is sought at a level.
    pub(super) fn layout_of(&self, level: Level) -> Layout {
        let Dimensions { shape_rank, albedo_rank, .. } = self.problem.dimensions();
        let [shape_rank, albedo_rank] =
            [shape_rank, albedo_rank].map(|rank| rank.min(level.components));
        Layout { shape_rank, albedo_rank }
    }

    /// The priors at work.
    pub(super) fn priors(&self) -> Priors<'a> {
        let [width, height] = self.scene.view.camera.image_size;
        let focal_length = Camera::for_image(width, height).focal_length;
        Priors { prior: &self.problem.config.prior, widths: self.options.widths, focal_length }
    }

    /// Standard deviation of a pixel's channel at this level.
    pub(super) fn sd(&self) -> f32 {
        self.level().error * self.problem.config.pixel_sd
    }

    /// Pixels of a row.
    pub(super) fn width(&self) -> usize {
        self.problem.image.width as usize
    }

    /// Hands out the memory of what is needed in passing.
    pub(super) fn in_passing<T>(&mut self, f: impl FnOnce(&mut Self, &mut [f32]) -> T) -> T {
        let memory = core::mem::take(&mut self.passing);
        let result = f(self, memory);
        self.passing = memory;
        result
    }

    /// Computes and rasterizes the surface of the scene, unless that has been done.
    pub(super) fn render(&mut self) {
        if !self.rendered {
            let scene = self.scene.clone();
            self.render_other(&scene);
            self.rendered = true;
        }
    }

    /// Computes and rasterizes the surface of a scene that may become the search's.
    pub(super) fn render_other(&mut self, scene: &Scene) {
        self.rendered = false;
        let Problem { model, engine, .. } = self.problem;
        self.surface.update(model, engine, scene);
        (engine.rasterize)(model.triangles, self.surface.window, &mut self.frame);
    }
}
