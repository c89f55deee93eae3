//! One small fit for every target: the same inputs from flash or memory, the same bits out.
//!
//! The inputs are fixtures/device, which `cargo xtask golden --device` makes: a decimated face
//! model of 30 + 30 components and a 64 × 64 photo.

#![no_std]
#![forbid(unsafe_code)]

use core::fmt::{self, Write};
use onescan_core::basis::padded;
use onescan_core::chain::{Chain, Config, Dimensions, Problem, Quality};
use onescan_core::engine::Engine;
use onescan_core::hash::Fnv64;
use onescan_core::image::Image;
use onescan_core::likelihood::landmarks::Observation;
use onescan_core::likelihood::pixels::{Coverage, Known, Surface, Target};
use onescan_core::memory::Carver;
use onescan_core::model::Model;
use onescan_core::render::shade::{Shader, set_albedo, set_normals};
use onescan_core::render::{draw, draw_words, rasterize};
use onescan_core::rng::Rng;
use onescan_core::scene::Scene;

/// Side of the photo, pixels.
pub const SIDE: usize = 64;
const PIXELS: usize = SIDE * SIDE;
/// Components of shape and of albedo.
pub const RANK: usize = 30;
const SEED: u64 = 7;

/// Model bytes must start at a multiple of four.
#[repr(C, align(64))]
struct Aligned<B: ?Sized>(B);

static MODEL: &Aligned<[u8]> = &Aligned(*include_bytes!("../../../fixtures/device/face.3dmm"));
/// A binary PPM.
static PHOTO: &[u8] = include_bytes!("../../../fixtures/device/photo.ppm");
const PPM_HEADER: usize = b"P6\n64 64\n255\n".len();
static LANDMARKS: &[(&str, [f32; 2])] = include!(concat!(env!("OUT_DIR"), "/landmarks.rs"));

/// Where a model's header has its number of vertices.
const VERTICES_AT: usize = 12;
const VERTICES: usize = {
    let Aligned(bytes) = MODEL;
    let [a, b, c, d] = [
        bytes[VERTICES_AT],
        bytes[VERTICES_AT + 1],
        bytes[VERTICES_AT + 2],
        bytes[VERTICES_AT + 3],
    ];
    u32::from_le_bytes([a, b, c, d]) as usize
};

/// The most landmarks the photo may have.
const MAX_LANDMARKS: usize = 48;
const _: () = assert!(LANDMARKS.len() <= MAX_LANDMARKS);

/// Memory of a whole case, words.
pub const WORDS: usize = {
    let dimensions = Dimensions {
        vertices: VERTICES,
        shape_rank: RANK,
        albedo_rank: RANK,
        landmarks: LANDMARKS.len(),
        width: SIDE,
        height: SIDE,
        lean: true,
    };
    let (fit, picture) = (dimensions.words(), draw_words(VERTICES, SIDE, SIDE) + 3 * PIXELS);
    if fit > picture { fit } else { picture }
};

/// What a fit came to.
#[derive(Clone, Debug, PartialEq)]
pub struct Fitted {
    /// Hash of every accepted state.
    pub fingerprint: u64,
    /// Of the best state.
    pub quality: Quality,
    /// The best state.
    pub scene: Scene,
}

/// The model; `None` if the fixture is damaged.
pub fn model() -> Option<Model<'static>> {
    Model::new_checked(&MODEL.0).ok()
}

/// Fits the model to the photo in `memory` of [`WORDS`], or more where not `lean`. `None` if it
/// is too short.
#[inline(never)]
pub fn fit(memory: &mut [u32], engine: &Engine, lean: bool) -> Option<Fitted> {
    let model = model()?;
    let config = Config::default().with(|config| {
        config.shape_rank = RANK;
        config.albedo_rank = RANK;
        config.landmark_samples = 1000;
        config.samples = 2000;
        config.landmark_sd = 1.0;
        config.pixel_patch = 5.0;
    });
    let landmarks: [Observation<'_>; MAX_LANDMARKS] = core::array::from_fn(|i| {
        let (name, position) = LANDMARKS.get(i).copied().unwrap_or_default();
        Observation { name, position }
    });
    let pixels = PHOTO.get(PPM_HEADER..)?.as_chunks().0;
    let image = Image { pixels, width: SIDE as u32, height: SIDE as u32 };
    let landmarks = landmarks.get(..LANDMARKS.len())?;
    let problem =
        Problem::new(&model, image, landmarks, &config).with_engine(engine).with_lean(lean);
    // Not moved out of the result: it is large.
    let mut chain = Chain::new(problem, SEED, 0, memory);
    let chain = chain.as_mut().ok()?;
    while chain.step().is_some() {}
    let scene = chain.best().scene.clone();
    let quality = chain.quality(&scene);
    Some(Fitted { fingerprint: chain.fingerprint(), quality, scene })
}

/// Draws the model under a hypothesis on the photo and hands the picture to `show`, rows of
/// [`SIDE`] colours. `None` if `memory` is shorter than [`WORDS`].
#[inline(never)]
pub fn picture(memory: &mut [u32], scene: &Scene, show: impl FnOnce(&[[f32; 3]])) -> Option<()> {
    let (colors, rest) = memory.split_at_mut_checked(3 * PIXELS)?;
    let colors = Carver::new(colors).floats(3 * PIXELS)?.as_chunks_mut::<3>().0;
    let photo = PHOTO.get(PPM_HEADER..)?.as_chunks::<3>().0;
    for (color, pixel) in colors.iter_mut().zip(photo) {
        *color = pixel.map(|x| f32::from(x) / 255.0);
    }
    draw(&model()?, scene, rest, colors)?;
    show(colors);
    Some(())
}

/// Stages of a rendering, in order; each gets what the one before it made.
pub const STAGES: [&str; 7] =
    ["instance", "normals", "albedo", "project", "rasterize", "shade", "likelihood"];

/// Hash of what each of [`STAGES`] makes of a fixed hypothesis: where two machines differ first is
/// the stage to look at. `None` if `memory` is shorter than [`WORDS`].
#[inline(never)]
pub fn stages(memory: &mut [u32], engine: &Engine) -> Option<[u64; STAGES.len()]> {
    let model = model()?;
    let mut rng = Rng::new(SEED, 1);
    let mut scene = Scene::initial(SIDE as u32, SIDE as u32, RANK, RANK);
    scene.pose.yaw = 0.4;
    scene.pose.pitch = -0.1;
    for c in scene.shape.iter_mut().chain(&mut scene.albedo).chain(scene.light.as_flattened_mut()) {
        *c += rng.normal_sd(0.3);
    }

    let mut carver = Carver::new(memory);
    let photo = PHOTO.get(PPM_HEADER..)?.as_chunks().0;
    let target = Target::carve(&mut carver, photo, SIDE)?;
    let n = padded(VERTICES);
    let (positions, attributes) = (carver.quads(n)?, carver.groups(n)?);
    let window = carver.quads(n)?;
    let mut frame = rasterize::Frame::carve(&mut carver, SIDE, SIDE)?;

    (engine.instance)(&model.shape, &scene.shape, positions);
    let instance = hash(positions.as_flattened());
    (engine.normals)(model.triangles, positions, window);
    let normals = hash(window.as_flattened());
    set_normals(window, attributes);
    (engine.instance)(&model.albedo, &scene.albedo, window);
    let albedo = hash(window.as_flattened());
    set_albedo(window, attributes);
    (engine.project)(&scene, positions, window);
    // What is NaN has no bits to compare.
    let projected = hash_of(window.as_flattened().iter().copied().filter(|x| !x.is_nan()));
    (engine.rasterize)(model.triangles, window, &mut frame);
    let hits = (0..PIXELS).filter_map(|pixel| frame.hit(pixel % SIDE, pixel / SIDE));
    let rasterized =
        hash_of(hits.flat_map(|hit| [hit.triangle as f32, hit.weights[0], hit.weights[1]]));
    let surface = Surface { frame: &frame, triangles: model.triangles, vertices: attributes };
    let shader = Shader::new(&scene);
    let residual = (engine.residual)(&surface, Known::default(), &shader, &target, f64::INFINITY)?;
    let shaded = hash_of([residual as f32, (residual - f64::from(residual as f32)) as f32]);
    let coverage: Coverage = (engine.coverage)(&frame, &target);
    let mut likelihood = Fnv64::default();
    likelihood.write(&coverage.ln_likelihood(residual, 0.05).to_bits().to_le_bytes());
    Some([instance, normals, albedo, projected, rasterized, shaded, likelihood.finish()])
}

fn hash(values: &[f32]) -> u64 {
    hash_of(values.iter().copied())
}

fn hash_of(values: impl IntoIterator<Item = f32>) -> u64 {
    let mut hash = Fnv64::default();
    for value in values {
        hash.write_f32(&[value]);
    }
    hash.finish()
}

/// Writes the lines that every target is to write: a hash per stage, and the fingerprint.
///
/// # Errors
/// Those of `out`.
pub fn write_golden(
    out: &mut impl Write,
    stages: &[u64; STAGES.len()],
    fingerprint: u64,
) -> fmt::Result {
    for (name, hash) in STAGES.iter().zip(stages) {
        writeln!(out, "{name} {hash:016x}")?;
    }
    writeln!(out, "fingerprint {fingerprint:016x}")
}
