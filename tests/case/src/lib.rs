//! One small fit for every target: the same inputs from flash or memory, the same bits out. Once by
//! a chain, once more as a search for the mode, and where there is memory by a sampler around that.
//!
//! The inputs are fixtures/device, which `cargo xtask golden --device` makes: a decimated face
//! model of 30 + 30 components, a 64 × 64 photo, and the same of half the size for the search,
//! which needs more memory and infers 20 + 20.

#![no_std]
#![forbid(unsafe_code)]

use core::fmt::{self, Write};
use onescan_core::basis::padded;
use onescan_core::chain::{Chain, Config, Dimensions, Problem, Quality};
use onescan_core::draw::{draw, draw_words};
use onescan_core::engine::Engine;
use onescan_core::hash::Fnv64;
use onescan_core::image::Image;
use onescan_core::likelihood::landmarks::ObservedLandmark;
use onescan_core::likelihood::pixels::{Coverage, Known, Rasterized, Target};
use onescan_core::memory::Carver;
use onescan_core::model::Model;
use onescan_core::posterior::{self, Sampler};
use onescan_core::render::rasterize;
use onescan_core::render::shade::{Shader, set_albedo, set_normals};
use onescan_core::rng::Rng;
use onescan_core::scene::Scene;
use onescan_core::search::{self, ModeSearch, Options, Part, part_words, words_for};

/// Side of the photo, pixels.
pub const SIDE: usize = 64;
const PIXELS: usize = SIDE * SIDE;
/// Side of the photo the search looks at.
pub const HALF_SIDE: usize = SIDE / 2;
/// Components of shape and of albedo.
pub const RANK: usize = 30;
/// Those the search infers: its memory has to leave a microcontroller's stack its room.
pub const SEARCH_RANK: usize = 20;
const SEED: u64 = 7;

/// Model bytes must start at a multiple of four.
#[repr(C, align(64))]
struct Aligned<B: ?Sized>(B);

static MODEL: &Aligned<[u8]> = &Aligned(*include_bytes!("../../../fixtures/device/face.3dmm"));

/// A photo with landmarks.
struct Photo {
    side: usize,
    /// A binary PPM.
    ppm: &'static [u8],
    /// Components of shape and of albedo to infer from it.
    rank: usize,
    landmarks: &'static [(&'static str, [f32; 2])],
}

static PHOTO: Photo = Photo {
    side: SIDE,
    ppm: include_bytes!("../../../fixtures/device/photo.ppm"),
    rank: RANK,
    landmarks: include!(concat!(env!("OUT_DIR"), "/photo.rs")),
};
static HALF: Photo = Photo {
    side: HALF_SIDE,
    ppm: include_bytes!("../../../fixtures/device/half.ppm"),
    rank: SEARCH_RANK,
    landmarks: include!(concat!(env!("OUT_DIR"), "/half.rs")),
};
const PPM_HEADER: usize = b"P6\n64 64\n255\n".len();

impl Photo {
    fn pixels(&self) -> Option<&'static [[u8; 3]]> {
        Some(self.ppm.get(PPM_HEADER..)?.as_chunks().0)
    }

    /// Calls `solve` with the problem of fitting the model to it.
    fn pose<T>(&self, engine: &Engine, solve: impl FnOnce(Problem<'_>) -> Option<T>) -> Option<T> {
        let model = model()?;
        let config = Config::default().with(|config| {
            config.shape_rank = self.rank;
            config.albedo_rank = self.rank;
            config.landmark_steps = 1000;
            config.image_steps = 2000;
            config.landmark_sd = 1.0;
            config.pixel_patch = 5.0;
        });
        let landmarks: [ObservedLandmark<'_>; MAX_LANDMARKS] = core::array::from_fn(|i| {
            let (name, position) = self.landmarks.get(i).copied().unwrap_or_default();
            ObservedLandmark { name, position }
        });
        let side = self.side as u32;
        let image = Image { pixels: self.pixels()?, width: side, height: side };
        let landmarks = landmarks.get(..self.landmarks.len())?;
        solve(Problem::new(&model, image, landmarks, &config).with_engine(engine))
    }

    const fn dimensions(&self) -> Dimensions {
        Dimensions {
            vertices: header(12),
            shape_rank: self.rank,
            albedo_rank: self.rank,
            landmarks: self.landmarks.len(),
            width: self.side,
            height: self.side,
            lean: true,
        }
    }
}

/// A number in the model's header.
const fn header(at: usize) -> usize {
    let Aligned(bytes) = MODEL;
    let [a, b, c, d] = [bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]];
    u32::from_le_bytes([a, b, c, d]) as usize
}

const VERTICES: usize = header(12);
const TRIANGLES: usize = header(32);

/// The most landmarks the photo may have.
const MAX_LANDMARKS: usize = 48;
const _: () = assert!(PHOTO.landmarks.len() <= MAX_LANDMARKS);
const _: () = assert!(HALF.landmarks.len() <= MAX_LANDMARKS);

/// Memory of the chain and what is drawn after it, words.
pub const WORDS: usize = {
    let (fit, picture) = (PHOTO.dimensions().words(), picture_words(&PHOTO));
    if fit > picture { fit } else { picture }
};

/// Memory of the search and what is drawn after it, words.
pub const SEARCH_WORDS: usize = {
    let (search, picture) = (words_for(&HALF.dimensions(), TRIANGLES), picture_words(&HALF));
    if search > picture { search } else { picture }
};

const fn picture_words(photo: &Photo) -> usize {
    draw_words(VERTICES, photo.side, photo.side) + 3 * photo.side * photo.side
}

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

/// What a search came to.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// Hash of every scene on the way.
    pub fingerprint: u64,
    /// Hash of the mask.
    pub mask: u64,
    /// Iterations.
    pub iterations: u32,
    /// The mode.
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
    PHOTO.pose(engine, |problem| {
        // Not moved out of the result: it is large.
        let mut chain = Chain::new(problem.with_lean(lean), SEED, 0, memory);
        let chain = chain.as_mut().ok()?;
        while chain.step().is_some() {}
        let scene = chain.best().scene.clone();
        let quality = chain.quality(&scene);
        Some(Fitted { fingerprint: chain.fingerprint(), quality, scene })
    })
}

/// Searches for the mode, given the photo of half the size, in `memory` of [`SEARCH_WORDS`]. `None`
/// if it is too short.
#[inline(never)]
pub fn search(memory: &mut [u32], engine: &Engine) -> Option<Found> {
    HALF.pose(engine, |problem| {
        let problem = problem.with_lean(true);
        let mut search = ModeSearch::new(problem, Options::default(), memory);
        let search = search.as_mut().ok()?;
        while search.step().is_some() {}
        Some(Found {
            fingerprint: search.fingerprint(),
            mask: hash(search.mask()),
            iterations: search.iterations(),
            scene: search.scene(),
        })
    })
}

/// Memory of [`posterior()`], words.
pub const POSTERIOR_WORDS: usize = 1 << 20;
/// Steps of its chain's warm-up, before and after the metric is made better, and steps after it.
const POSTERIOR_STEPS: [u32; 3] = [15, 10, 40];

/// Samples the posterior around the mode of the photo of half the size, in `memory` of
/// [`POSTERIOR_WORDS`]; gives the hash of every accepted state. `None` if it is too short.
#[inline(never)]
pub fn posterior(memory: &mut [u32], engine: &Engine) -> Option<u64> {
    HALF.pose(engine, |problem| {
        let options = Options::default();
        let (first, second) = memory.split_at_mut_checked(search::words(&problem, &options))?;
        let mut search: ModeSearch<'_, '_> = ModeSearch::new(problem, options, first).ok()?;
        while search.step().is_some() {}
        let (shown, second) = second.split_at_mut_checked(part_words(problem.model))?;
        let part = Part::new(&mut search, shown)?;
        let [meeting, turning, steps] = POSTERIOR_STEPS;
        let places = 5 * meeting as usize;
        let words = posterior::words(&problem, &options, places);
        let (second, rest) = second.split_at_mut_checked(words)?;
        let mut chain = Sampler::new(search, &part, places, SEED, 0, second).ok()?;
        for _ in 0..meeting {
            chain.warm_up();
        }
        let n = chain.unknowns();
        let mut carver = Carver::new(rest);
        let scratch = carver.floats(posterior::improve_words(n))?;
        let met = chain.places();
        let places = carver.floats(met.len())?;
        places.copy_from_slice(met);
        let change = posterior::improve(n, places, engine, scratch)?;
        chain.adopt(&change);
        for _ in 0..turning {
            chain.warm_up();
        }
        for _ in 0..steps {
            chain.step();
        }
        Some(chain.fingerprint())
    })
}

/// Draws the model under a hypothesis of [`fit`] on the photo and hands the picture to `show`, rows
/// of [`SIDE`] colours. `None` if `memory` is shorter than [`WORDS`].
#[inline(never)]
pub fn picture(memory: &mut [u32], scene: &Scene, show: impl FnOnce(&[[f32; 3]])) -> Option<()> {
    PHOTO.draw(memory, scene, show)
}

/// The same for [`search()`], rows of [`HALF_SIDE`] colours; of [`SEARCH_WORDS`].
#[inline(never)]
pub fn half_picture(
    memory: &mut [u32],
    scene: &Scene,
    show: impl FnOnce(&[[f32; 3]]),
) -> Option<()> {
    HALF.draw(memory, scene, show)
}

impl Photo {
    fn draw(
        &self,
        memory: &mut [u32],
        scene: &Scene,
        show: impl FnOnce(&[[f32; 3]]),
    ) -> Option<()> {
        let numbers = 3 * self.side * self.side;
        let (colors, rest) = memory.split_at_mut_checked(numbers)?;
        let colors = Carver::new(colors).floats(numbers)?.as_chunks_mut::<3>().0;
        for (color, pixel) in colors.iter_mut().zip(self.pixels()?) {
            *color = pixel.map(|x| f32::from(x) / 255.0);
        }
        draw(&model()?, scene, rest, colors)?;
        show(colors);
        Some(())
    }
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
    scene.view.pose.yaw = 0.4;
    scene.view.pose.pitch = -0.1;
    for c in scene
        .subject
        .shape
        .iter_mut()
        .chain(&mut scene.subject.albedo)
        .chain(scene.view.light.as_flattened_mut())
    {
        *c += rng.normal_sd(0.3);
    }

    let mut carver = Carver::new(memory);
    let photo = PHOTO.pixels()?;
    let target = Target::carve(&mut carver, photo, SIDE)?;
    let n = padded(VERTICES);
    let (positions, attributes) = (carver.quads(n)?, carver.groups(n)?);
    let window = carver.quads(n)?;
    let mut frame = rasterize::Frame::carve(&mut carver, SIDE, SIDE)?;

    (engine.instance)(&model.shape, &scene.subject.shape, positions);
    let instance = hash(positions.as_flattened());
    (engine.normals)(model.triangles, positions, window);
    let normals = hash(window.as_flattened());
    set_normals(window, attributes);
    (engine.instance)(&model.albedo, &scene.subject.albedo, window);
    let albedo = hash(window.as_flattened());
    set_albedo(window, attributes);
    (engine.project)(&scene.view, positions, window);
    // What is NaN has no bits to compare.
    let projected = hash_of(window.as_flattened().iter().copied().filter(|x| !x.is_nan()));
    (engine.rasterize)(model.triangles, window, &mut frame);
    let hits = (0..PIXELS).filter_map(|pixel| frame.hit(pixel % SIDE, pixel / SIDE));
    let rasterized =
        hash_of(hits.flat_map(|hit| [hit.triangle as f32, hit.weights[0], hit.weights[1]]));
    let drawn = Rasterized { frame: &frame, triangles: model.triangles, vertices: attributes };
    let shader = Shader::new(&scene.view);
    let residual = (engine.residual)(&drawn, Known::default(), &shader, &target, f64::INFINITY)?;
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

/// Hash of a scene.
fn hash_of_scene(scene: &Scene) -> u64 {
    hash_of(scene.parameters().copied())
}

/// Writes the first lines that every target is to write: a hash per stage, and the chain's
/// fingerprint.
///
/// # Errors
/// Those of `out`.
pub fn write_chain(
    out: &mut impl Write,
    stages: &[u64; STAGES.len()],
    fingerprint: u64,
) -> fmt::Result {
    for (name, hash) in STAGES.iter().zip(stages) {
        writeln!(out, "{name} {hash:016x}")?;
    }
    writeln!(out, "fingerprint {fingerprint:016x}")
}

/// Writes the lines after them: the search's fingerprint, and hashes of the mode and the mask.
///
/// # Errors
/// Those of `out`.
pub fn write_search(out: &mut impl Write, found: &Found) -> fmt::Result {
    for (name, hash) in SEARCH.iter().zip(found.hashes()) {
        writeln!(out, "{name} {hash:016x}")?;
    }
    Ok(())
}

/// What a search's lines are called.
pub const SEARCH: [&str; 3] = ["search", "mode", "mask"];

impl Found {
    /// The hashes of [`SEARCH`].
    pub fn hashes(&self) -> [u64; SEARCH.len()] {
        [self.fingerprint, hash_of_scene(&self.scene), self.mask]
    }
}
