//! The C face of onescan-core: checks pointers, converts, calls, maps errors; nothing else.
//!
//! Two ways to fit: a search for the mode of the posterior (`onescan_search_…`), and the paper's
//! chain (`onescan_start` and what follows). Memory is the caller's, sizes are known before a
//! program runs (`sizeof(OnescanSearch)`, `ONESCAN_SEARCH_WORDS`) and asked for while it does
//! ([`onescan_search_words`]). There are no globals: as many fits may run as there is memory for,
//! each on one thread at a time.

#![no_std]

use core::ffi::{CStr, c_char};
use core::mem::{align_of, size_of};
use core::{ptr, slice};
use onescan_core::chain::{Chain, ChainError, Config, Dimensions, Problem, Schedule};
use onescan_core::draw::{draw, draw_words};
use onescan_core::image::Image;
use onescan_core::likelihood::landmarks::{MAX_LANDMARKS, ObservedLandmark};
use onescan_core::model::{Model, ModelError};
use onescan_core::scene::{MAX_RANK, Scene, Subject, View};
use onescan_core::search::{LEVELS, ModeSearch, Options, words_for};

/// What became of a call.
#[repr(C)]
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum OnescanStatus {
    /// It did what it says.
    Ok = 0,
    /// A pointer is null that must not be.
    Null,
    /// The model's bytes do not start at a multiple of four.
    ModelMisaligned,
    /// The bytes are not a model.
    NotAModel,
    /// The model has another format version.
    ModelVersion,
    /// The model's bytes are fewer or more than its header says.
    ModelLength,
    /// The model's bytes are damaged.
    ModelDamaged,
    /// The picture is empty.
    Image,
    /// No landmarks, or more than ONESCAN_MAX_LANDMARKS.
    LandmarkCount,
    /// A landmark that the model does not have, or a name that is not UTF-8.
    UnknownLandmark,
    /// A landmark position that is not finite.
    LandmarkPosition,
    /// More coefficients than a fit infers.
    Rank,
    /// A standard deviation that is not positive.
    Config,
    /// Too little memory.
    Memory,
    /// A pointer to something that does not lie at a multiple of its alignment.
    Misaligned,
    /// The fit was never started, or its last start failed.
    NotStarted,
    /// More of something than memory can hold.
    Count,
}

/// The most landmarks a fit takes.
pub const ONESCAN_MAX_LANDMARKS: usize = 64;
const _: () = assert!(ONESCAN_MAX_LANDMARKS == MAX_LANDMARKS);

/// The most coefficients of a kind a fit infers.
pub const ONESCAN_MAX_RANK: usize = 200;
const _: () = assert!(ONESCAN_MAX_RANK == MAX_RANK);

/// Numbers in an OnescanFit, eight bytes each.
pub const ONESCAN_FIT_LENGTH: usize = 3072;

/// Numbers in an OnescanSearch, eight bytes each.
pub const ONESCAN_SEARCH_LENGTH: usize = 1536;

/// What a model holds.
#[repr(C)]
pub struct OnescanModelInfo {
    /// Vertices.
    pub vertices: u32,
    /// Triangles.
    pub triangles: u32,
    /// Components of the shape.
    pub shape_rank: u32,
    /// Components of the albedo.
    pub albedo_rank: u32,
    /// Landmarks.
    pub landmarks: u32,
}

/// A landmark in the picture.
#[repr(C)]
pub struct OnescanLandmark {
    /// Its name in the model.
    pub name: *const c_char,
    /// Pixels to the right of the centre of the upper left pixel.
    pub x: f32,
    /// Pixels below it.
    pub y: f32,
}

/// How a fit is done. Begin with onescan_default_settings().
#[repr(C)]
#[derive(Clone, Copy)]
pub struct OnescanSettings {
    /// Seed of all randomness.
    pub seed: u64,
    /// Shape coefficients to infer, at most 200.
    pub shape_rank: u32,
    /// Albedo coefficients to infer, at most 200.
    pub albedo_rank: u32,
    /// Steps of the chain's landmark phase.
    pub landmark_samples: u32,
    /// Steps of the shape phase: 0 for faces, 5000 for other objects.
    pub shape_samples: u32,
    /// Steps of the image phase.
    pub samples: u32,
    /// Standard deviation of a landmark, pixels; the default is for pictures of about 256.
    pub landmark_sd: f32,
    /// Standard deviation of a pixel's colour channel, of 1.
    pub pixel_sd: f32,
    /// Pixels that share one independent error; the default is for pictures of about 256, elsewhere it
    /// grows as the picture's area.
    pub pixel_patch: f32,
    /// Whether (0: no) the chain also solves for the light in closed form; otherwise it samples its
    /// posterior.
    pub search: u8,
    /// Whether memory is scarcer than time: the chain then takes less than half of it, same result.
    pub lean: u8,
    /// Whether something may hide the face, for a search for the mode.
    pub occlusion: u8,
}

/// How far a chain is, and how good.
#[repr(C)]
pub struct OnescanProgress {
    /// Steps done.
    pub done: u32,
    /// Steps in all.
    pub total: u32,
    /// Hash of every accepted state: equal on every machine.
    pub fingerprint: u64,
    /// Log posterior density of the best state, up to a constant.
    pub best: f64,
}

/// How far a search for the mode is, and how good.
#[repr(C)]
pub struct OnescanSearchProgress {
    /// Steps done.
    pub done: u32,
    /// The most steps it may make.
    pub most: u32,
    /// Whether it has ended.
    pub ended: bool,
    /// Whether its last steps changed nothing.
    pub converged: bool,
    /// Hash of every scene on the way: equal on every machine.
    pub fingerprint: u64,
    /// Negative log posterior density, up to a constant that differs from level to level.
    pub energy: f64,
}

/// What was found: everything the picture depends on.
#[repr(C)]
pub struct OnescanScene {
    /// Turn about the axis of view, radians; the last of the three turns.
    pub roll: f32,
    /// Turn to the side, radians.
    pub yaw: f32,
    /// Turn up or down, radians; the first.
    pub pitch: f32,
    /// Factor of the model's size.
    pub scale: f32,
    /// Where the model's origin is, mm: x to the right, y up, z towards the camera's back.
    pub translation: [f32; 3],
    /// Focal length, in the sensor's unit.
    pub focal_length: f32,
    /// Width and height of the sensor.
    pub sensor: [f32; 2],
    /// Where the optical axis meets the picture: -1 to 1 to the right and up.
    pub principal_point: [f32; 2],
    /// Spherical harmonics of the light: nine, red, green and blue.
    pub light: [[f32; 3]; 9],
    /// Factors of red, green and blue.
    pub gain: [f32; 3],
    /// Contrast of colours to grey.
    pub contrast: f32,
    /// Added to red, green and blue.
    pub offset: [f32; 3],
    /// Shape coefficients that were inferred.
    pub shape_rank: u32,
    /// Albedo coefficients that were inferred.
    pub albedo_rank: u32,
    /// They, in standard deviations; 0 beyond.
    pub shape: [f32; ONESCAN_MAX_RANK],
    /// They, in standard deviations; 0 beyond.
    pub albedo: [f32; ONESCAN_MAX_RANK],
}

/// A chain. Allocate it anywhere and do not move it between calls. If it is zero, as static memory
/// is, or its last start failed, it counts as never started: calls say so.
#[repr(C)]
pub struct OnescanFit {
    /// The library's.
    pub storage: [u64; ONESCAN_FIT_LENGTH],
}

/// A search for the mode. Allocate it anywhere and do not move it between calls. What is said of a chain
/// that was never started holds here, too.
#[repr(C)]
pub struct OnescanSearch {
    /// The library's.
    pub storage: [u64; ONESCAN_SEARCH_LENGTH],
}

/// What is in the caller's storage: the inference borrows from the rest, which therefore must stay
/// where it is.
struct Running<I> {
    /// [`STARTED`], if the rest is good.
    mark: u64,
    model: Model<'static>,
    config: Config,
    observed: [ObservedLandmark<'static>; MAX_LANDMARKS],
    inference: Result<I, ChainError>,
}

/// Stands in storage that holds a running inference: not zero, and unlikely to be there by chance.
const STARTED: u64 = 0x1c3a_95d2_0e7b_64f9;

type Fit = Running<Chain<'static, 'static>>;
type Search = Running<ModeSearch<'static, 'static>>;

const _: () = assert!(size_of::<Fit>() <= size_of::<OnescanFit>());
const _: () = assert!(align_of::<Fit>() <= align_of::<OnescanFit>());
const _: () = assert!(size_of::<Search>() <= size_of::<OnescanSearch>());
const _: () = assert!(align_of::<Search>() <= align_of::<OnescanSearch>());

/// What a status means, in English; a number that is no status has a text, too.
#[unsafe(no_mangle)]
pub extern "C" fn onescan_status_text(status: u32) -> *const c_char {
    // In the order of `OnescanStatus`.
    let texts = [
        c"all is well",
        c"a pointer is null that must not be",
        c"the model's bytes must start at a multiple of 4",
        c"the bytes are not a .3dmm model",
        c"the model has another format version; build it again",
        c"the model is incomplete: fewer or more bytes than its header says",
        c"the model is damaged",
        c"the picture has no pixels",
        c"a fit needs 1 to 64 landmarks",
        c"a landmark is not one of the model's",
        c"a landmark's position is not finite",
        c"a fit infers at most 200 coefficients of each kind",
        c"a standard deviation is not positive",
        c"too little memory; onescan_words() and onescan_search_words() say how much is needed",
        c"a pointer is not aligned for what it points to",
        c"the fit was never started, or its last start failed",
        c"more of something than memory can hold",
    ];
    let text = texts.get(status as usize).copied();
    text.unwrap_or(c"not a status of this library").as_ptr()
}

/// The settings of the paper's face fit.
#[unsafe(no_mangle)]
pub extern "C" fn onescan_default_settings() -> OnescanSettings {
    let config = Config::default();
    OnescanSettings {
        seed: 7,
        shape_rank: config.shape_rank as u32,
        albedo_rank: config.albedo_rank as u32,
        landmark_samples: config.landmark_steps,
        shape_samples: config.shape_steps,
        samples: config.image_steps,
        landmark_sd: config.landmark_sd,
        pixel_sd: config.pixel_sd,
        pixel_patch: config.pixel_patch,
        search: u8::from(config.solve_light),
        lean: 0,
        occlusion: 1,
    }
}

/// Checks a model's bytes, which must start at a multiple of four.
///
/// # Safety
/// `model` points to `bytes` bytes or is null; `info` to a OnescanModelInfo or is null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn onescan_model_info(
    model: *const u8,
    bytes: usize,
    info: *mut OnescanModelInfo,
) -> OnescanStatus {
    if let Err(status) = check(model, bytes).and_then(|()| check(info, 1)) {
        return status;
    }
    // SAFETY: as the caller promises.
    let (model, info) = unsafe { (slice::from_raw_parts(model, bytes), &mut *info) };
    match Model::new_checked(model) {
        Ok(model) => {
            *info = OnescanModelInfo {
                vertices: model.vertices() as u32,
                triangles: model.triangles.len() as u32,
                shape_rank: model.shape.rank() as u32,
                albedo_rank: model.albedo.rank() as u32,
                landmarks: model.landmarks().len() as u32,
            };
            OnescanStatus::Ok
        }
        Err(error) => model_status(error),
    }
}

/// Words (4 bytes) of memory of a chain. 0 if a pointer is null, or if that is more than there can be.
///
/// # Safety
/// `info` and `settings` point to what they say or are null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn onescan_words(
    info: *const OnescanModelInfo,
    settings: *const OnescanSettings,
    landmarks: usize,
    width: u32,
    height: u32,
) -> usize {
    // SAFETY: as the caller promises.
    unsafe { dimensions(info, settings, landmarks, width, height) }.map_or(0, |d| d.words())
}

/// Words (4 bytes) of memory of a search for the mode. 0 as of onescan_words().
///
/// # Safety
/// `info` and `settings` point to what they say or are null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn onescan_search_words(
    info: *const OnescanModelInfo,
    settings: *const OnescanSettings,
    landmarks: usize,
    width: u32,
    height: u32,
) -> usize {
    // SAFETY: as the caller promises.
    unsafe {
        let dimensions = dimensions(info, settings, landmarks, width, height);
        dimensions.map_or(0, |d| words_for(&d, (*info).triangles as usize))
    }
}

/// The sizes that determine a fit's memory; `None` if a pointer is null, or for sizes whose memory could
/// not be counted.
///
/// # Safety
/// `info` and `settings` point to what they say or are null.
unsafe fn dimensions(
    info: *const OnescanModelInfo,
    settings: *const OnescanSettings,
    landmarks: usize,
    width: u32,
    height: u32,
) -> Option<Dimensions> {
    check(info, 1).and_then(|()| check(settings, 1)).ok()?;
    // SAFETY: as the caller promises.
    let (info, settings) = unsafe { (&*info, &*settings) };
    let pixels = (width as usize).checked_mul(height as usize)?;
    // Each with more words than one of them takes; of all four there is room for a sum.
    let [vertices, triangles] = [info.vertices as usize, info.triangles as usize];
    for (count, words) in [(pixels, 64), (vertices, 2048), (triangles, 16), (landmarks, 2048)] {
        count.checked_mul(words * 4 * size_of::<u32>())?;
    }
    Some(Dimensions {
        vertices: info.vertices as usize,
        shape_rank: settings.shape_rank.min(info.shape_rank) as usize,
        albedo_rank: settings.albedo_rank.min(info.albedo_rank) as usize,
        landmarks,
        width: width as usize,
        height: height as usize,
        lean: settings.lean != 0,
    })
}

/// Starts a chain. `rgb` are `3 * width * height` bytes, rows from the top. Nothing is copied:
/// model, picture, landmark names and memory must stay as long as the fit is used.
///
/// # Safety
/// Pointers point to as many things as the numbers beside them say, or are null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn onescan_start(
    fit: *mut OnescanFit,
    model: *const u8,
    model_bytes: usize,
    rgb: *const u8,
    width: u32,
    height: u32,
    landmarks: *const OnescanLandmark,
    landmark_count: usize,
    settings: *const OnescanSettings,
    memory: *mut u32,
    memory_words: usize,
) -> OnescanStatus {
    let inputs = Inputs {
        model: (model, model_bytes),
        rgb,
        size: [width, height],
        landmarks: (landmarks, landmark_count),
        settings,
        memory: (memory, memory_words),
    };
    // SAFETY: `fit` is large enough and aligned for a `Fit` (asserted above); the rest is as the
    // caller promises.
    unsafe {
        inputs.start(fit.cast::<Fit>(), |problem, settings, memory| {
            let problem = problem
                .with_schedule(Schedule::of(problem.photo.landmarks))
                .with_lean(settings.lean != 0);
            Chain::new(problem, settings.seed, 0, memory)
        })
    }
}

/// Starts a search for the mode: pose, camera, shape, albedo, light, colours and what hides the
/// face, by pixels and landmarks. Takes what onescan_start takes; of the settings those of a chain
/// alone are of no consequence.
///
/// # Safety
/// Pointers point to as many things as the numbers beside them say, or are null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn onescan_search_start(
    search: *mut OnescanSearch,
    model: *const u8,
    model_bytes: usize,
    rgb: *const u8,
    width: u32,
    height: u32,
    landmarks: *const OnescanLandmark,
    landmark_count: usize,
    settings: *const OnescanSettings,
    memory: *mut u32,
    memory_words: usize,
) -> OnescanStatus {
    let inputs = Inputs {
        model: (model, model_bytes),
        rgb,
        size: [width, height],
        landmarks: (landmarks, landmark_count),
        settings,
        memory: (memory, memory_words),
    };
    // SAFETY: as in `onescan_start`.
    unsafe {
        inputs.start(search.cast::<Search>(), |problem, settings, memory| {
            let options = Options { occlusion: settings.occlusion != 0, ..Options::default() };
            ModeSearch::new(problem.with_lean(settings.lean != 0), options, memory)
        })
    }
}

/// What a fit is started with, as the caller gave it.
struct Inputs {
    model: (*const u8, usize),
    rgb: *const u8,
    size: [u32; 2],
    landmarks: (*const OnescanLandmark, usize),
    settings: *const OnescanSettings,
    memory: (*mut u32, usize),
}

impl Inputs {
    /// Checks and converts it, and begins an inference in `place`, where an older one ends whatever
    /// becomes of this.
    ///
    /// # Safety
    /// Pointers point to as many things as the numbers beside them say, or are null.
    unsafe fn start<I>(
        self,
        place: *mut Running<I>,
        begin: impl FnOnce(
            Problem<'static>,
            &OnescanSettings,
            &'static mut [u32],
        ) -> Result<I, ChainError>,
    ) -> OnescanStatus {
        let Self { model, rgb, size: [width, height], landmarks, settings, memory } = self;
        if let Err(status) = check(place, 1) {
            return status;
        }
        // SAFETY: it is there and aligned.
        unsafe { (&raw mut (*place).mark).write(0) };
        let Some(pixels) = (width as usize).checked_mul(height as usize) else {
            return OnescanStatus::Count;
        };
        let checked = check(model.0, model.1)
            .and_then(|()| check(rgb.cast::<[u8; 3]>(), pixels))
            .and_then(|()| check(landmarks.0, landmarks.1))
            .and_then(|()| check(settings, 1))
            .and_then(|()| check(memory.0, memory.1));
        if let Err(status) = checked {
            return status;
        }
        // SAFETY: as the caller promises, for as long as the fit is used.
        let (model, pixels, landmarks, settings, memory) = unsafe {
            (
                slice::from_raw_parts(model.0, model.1),
                slice::from_raw_parts(rgb.cast::<[u8; 3]>(), pixels),
                slice::from_raw_parts(landmarks.0, landmarks.1),
                *settings,
                slice::from_raw_parts_mut(memory.0, memory.1),
            )
        };
        let model = match Model::new_checked(model) {
            Ok(model) => model,
            Err(error) => return model_status(error),
        };
        if landmarks.is_empty() || landmarks.len() > MAX_LANDMARKS {
            return OnescanStatus::LandmarkCount;
        }
        let mut observed = [ObservedLandmark { name: "", position: [0.0; 2] }; MAX_LANDMARKS];
        for (observed, landmark) in observed.iter_mut().zip(landmarks) {
            if landmark.name.is_null() {
                return OnescanStatus::Null;
            }
            // SAFETY: a C string, for as long as the fit is used.
            let Ok(name) = (unsafe { CStr::from_ptr(landmark.name) }).to_str() else {
                return OnescanStatus::UnknownLandmark;
            };
            *observed = ObservedLandmark { name, position: [landmark.x, landmark.y] };
        }
        let config = Config::default().with(|config| {
            config.shape_rank = settings.shape_rank as usize;
            config.albedo_rank = settings.albedo_rank as usize;
            config.landmark_steps = settings.landmark_samples;
            config.shape_steps = settings.shape_samples;
            config.image_steps = settings.samples;
            config.landmark_sd = settings.landmark_sd;
            config.pixel_sd = settings.pixel_sd;
            config.pixel_patch = settings.pixel_patch;
            config.solve_light = settings.search != 0;
        });
        // SAFETY: `place` is large enough and aligned. Its fields are written before they are
        // borrowed, and stay where they are, as the caller promises.
        unsafe {
            (&raw mut (*place).model).write(model);
            (&raw mut (*place).config).write(config);
            (&raw mut (*place).observed).write(observed);
            let landmarks = &(&(*place).observed)[..landmarks.len()];
            let image = Image { pixels, width, height };
            let problem = Problem::new(&(*place).model, image, landmarks, &(*place).config);
            (&raw mut (*place).inference).write(begin(problem, &settings, memory));
            match &(*place).inference {
                Ok(_) => {
                    (&raw mut (*place).mark).write(STARTED);
                    OnescanStatus::Ok
                }
                Err(error) => chain_status(*error),
            }
        }
    }
}

/// Whether so many things can lie at a pointer: it is not null, aligned for them, and they are no more
/// than memory can hold.
fn check<T>(place: *const T, count: usize) -> Result<(), OnescanStatus> {
    if place.is_null() {
        Err(OnescanStatus::Null)
    } else if !place.is_aligned() {
        Err(OnescanStatus::Misaligned)
    } else if count.checked_mul(size_of::<T>()).is_none_or(|bytes| bytes > isize::MAX as usize) {
        Err(OnescanStatus::Count)
    } else {
        Ok(())
    }
}

/// Makes up to `steps` steps; how many it made. 0: the chain is done.
///
/// # Safety
/// `fit` is null, zero or was started.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn onescan_step(fit: *mut OnescanFit, steps: u32) -> u32 {
    // SAFETY: as the caller promises.
    let Ok(chain) = (unsafe { inference(fit.cast::<Fit>()) }) else { return 0 };
    let mut done = 0;
    while done < steps && chain.step().is_some() {
        done += 1;
    }
    done
}

/// Makes up to `steps` steps of a search; how many it made. 0: it is done. A step takes as long as
/// some dozens of renderings.
///
/// # Safety
/// `search` is null, zero or was started.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn onescan_search_step(search: *mut OnescanSearch, steps: u32) -> u32 {
    // SAFETY: as the caller promises.
    let Ok(search) = (unsafe { inference(search.cast::<Search>()) }) else { return 0 };
    let mut done = 0;
    while done < steps && search.step().is_some() {
        done += 1;
    }
    done
}

/// How far a chain is.
///
/// # Safety
/// `fit` is null, zero or was started; `progress` points to a OnescanProgress or is null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn onescan_progress(
    fit: *mut OnescanFit,
    progress: *mut OnescanProgress,
) -> OnescanStatus {
    // SAFETY: as the caller promises.
    let result = unsafe { borrowed(fit.cast::<Fit>(), progress) };
    let (running, chain, progress) = match result {
        Ok(all) => all,
        Err(status) => return status,
    };
    let (done, total) = chain.progress();
    let best = chain.best().density.posterior(&running.config);
    *progress = OnescanProgress { done, total, fingerprint: chain.fingerprint(), best };
    OnescanStatus::Ok
}

/// How far a search is.
///
/// # Safety
/// `search` is null, zero or was started; `progress` points to a
/// OnescanSearchProgress or is null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn onescan_search_progress(
    search: *mut OnescanSearch,
    progress: *mut OnescanSearchProgress,
) -> OnescanStatus {
    // SAFETY: as the caller promises.
    let (_, search, progress) = match unsafe { borrowed(search.cast::<Search>(), progress) } {
        Ok(all) => all,
        Err(status) => return status,
    };
    *progress = OnescanSearchProgress {
        done: search.iterations(),
        most: LEVELS.iter().map(|level| level.iterations).sum(),
        ended: search.done(),
        converged: search.converged(),
        fingerprint: search.fingerprint(),
        energy: search.energy().total(),
    };
    OnescanStatus::Ok
}

/// What a search has found so far.
///
/// # Safety
/// `search` is null, zero or was started; `scene` points to a OnescanScene or is
/// null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn onescan_search_scene(
    search: *mut OnescanSearch,
    scene: *mut OnescanScene,
) -> OnescanStatus {
    // SAFETY: as the caller promises.
    let (_, search, to) = match unsafe { borrowed(search.cast::<Search>(), scene) } {
        Ok(all) => all,
        Err(status) => return status,
    };
    let Scene { subject: Subject { shape, albedo }, view } = search.scene();
    let View { pose, camera, light, color } = view;
    let coefficients = |values: &[f32]| {
        let mut all = [0.0; ONESCAN_MAX_RANK];
        for (to, value) in all.iter_mut().zip(values) {
            *to = *value;
        }
        all
    };
    *to = OnescanScene {
        roll: pose.roll,
        yaw: pose.yaw,
        pitch: pose.pitch,
        scale: pose.scale,
        translation: pose.translation,
        focal_length: camera.focal_length,
        sensor: camera.sensor,
        principal_point: camera.principal_point,
        light,
        gain: color.gain,
        contrast: color.contrast,
        offset: color.offset,
        shape_rank: shape.len() as u32,
        albedo_rank: albedo.len() as u32,
        shape: coefficients(&shape),
        albedo: coefficients(&albedo),
    };
    OnescanStatus::Ok
}

/// The mask of a search so far, `width * height` numbers, rows from the top: the probability of a
/// pixel to show the face, 0 where the face does not reach. It is good until the next call with the
/// search. Null if the search is.
///
/// # Safety
/// `search` is null, zero or was started.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn onescan_search_mask(search: *mut OnescanSearch) -> *const f32 {
    // SAFETY: as the caller promises.
    let search = unsafe { inference(search.cast::<Search>()) };
    search.map_or(ptr::null(), |search| search.mask().as_ptr())
}

/// Draws the best state so far over a picture of the fit's size, `3 * width * height` numbers of
/// 0 to 1; what the model does not cover stays. `memory` is other memory than the fit's, as large
/// as that of a lean fit.
///
/// # Safety
/// As the pointers of onescan_start.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn onescan_draw(
    fit: *mut OnescanFit,
    colors: *mut f32,
    memory: *mut u32,
    memory_words: usize,
) -> OnescanStatus {
    // SAFETY: as the caller promises.
    unsafe {
        match borrowed(fit.cast::<Fit>(), colors) {
            Ok((running, chain, _)) => {
                draw_scene(&running.model, &chain.best().scene, colors, memory, memory_words)
            }
            Err(status) => status,
        }
    }
}

/// Draws what a search has found so far, as onescan_draw does.
///
/// # Safety
/// As the pointers of onescan_search_start.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn onescan_search_draw(
    search: *mut OnescanSearch,
    colors: *mut f32,
    memory: *mut u32,
    memory_words: usize,
) -> OnescanStatus {
    // SAFETY: as the caller promises.
    unsafe {
        match borrowed(search.cast::<Search>(), colors) {
            Ok((running, search, _)) => {
                draw_scene(&running.model, &search.scene(), colors, memory, memory_words)
            }
            Err(status) => status,
        }
    }
}

/// Draws a scene.
///
/// # Safety
/// As the pointers of onescan_draw.
unsafe fn draw_scene(
    model: &Model<'_>,
    scene: &Scene,
    colors: *mut f32,
    memory: *mut u32,
    memory_words: usize,
) -> OnescanStatus {
    if let Err(status) = check(memory, memory_words) {
        return status;
    }
    let [width, height] = scene.view.camera.image_size.map(|side| side as usize);
    if memory_words < draw_words(model.vertices(), width, height) {
        return OnescanStatus::Memory;
    }
    // SAFETY: as the caller promises.
    let (colors, memory) = unsafe {
        (
            slice::from_raw_parts_mut(colors.cast::<[f32; 3]>(), width * height),
            slice::from_raw_parts_mut(memory, memory_words),
        )
    };
    match draw(model, scene, memory, colors) {
        Some(_) => OnescanStatus::Ok,
        None => OnescanStatus::Memory,
    }
}

/// What runs in a caller's storage.
///
/// # Safety
/// `place` points to storage that was started or is zero, or is null.
unsafe fn inference<'f, I>(place: *mut Running<I>) -> Result<&'f mut I, OnescanStatus> {
    check(place, 1)?;
    // SAFETY: as the caller promises. Only the inference is borrowed for writing; what it borrows
    // itself are other fields.
    unsafe {
        if (&raw const (*place).mark).read() != STARTED {
            return Err(OnescanStatus::NotStarted);
        }
        (*place).inference.as_mut().map_err(|_| OnescanStatus::NotStarted)
    }
}

/// What runs in a caller's storage, to be looked at, and where the answer goes.
///
/// # Safety
/// As [`inference`]; `answer` points to what it says or is null.
unsafe fn borrowed<'f, I, A>(
    place: *mut Running<I>,
    answer: *mut A,
) -> Result<(&'f Running<I>, &'f I, &'f mut A), OnescanStatus> {
    check(answer, 1)?;
    // SAFETY: as the caller promises.
    unsafe {
        inference(place)?;
        let running = &*place;
        let inference = running.inference.as_ref().map_err(|_| OnescanStatus::NotStarted)?;
        Ok((running, inference, &mut *answer))
    }
}

fn model_status(error: ModelError) -> OnescanStatus {
    match error {
        ModelError::Misaligned => OnescanStatus::ModelMisaligned,
        ModelError::NotAModel => OnescanStatus::NotAModel,
        ModelError::Version { .. } => OnescanStatus::ModelVersion,
        ModelError::Length { .. } => OnescanStatus::ModelLength,
        _ => OnescanStatus::ModelDamaged,
    }
}

fn chain_status(error: ChainError) -> OnescanStatus {
    match error {
        ChainError::Image => OnescanStatus::Image,
        ChainError::LandmarkCount { .. } => OnescanStatus::LandmarkCount,
        ChainError::UnknownLandmark { .. } => OnescanStatus::UnknownLandmark,
        ChainError::LandmarkPosition { .. } => OnescanStatus::LandmarkPosition,
        ChainError::Rank { .. } => OnescanStatus::Rank,
        // One photo is all that a search is started with here.
        ChainError::Config
        | ChainError::Schedule
        | ChainError::Checkpoint
        | ChainError::Photos { .. } => OnescanStatus::Config,
        ChainError::Memory { .. } => OnescanStatus::Memory,
    }
}

/// Nothing in the core panics on what it has checked; should it ever, the program stops here.
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {
        core::hint::spin_loop();
    }
}
