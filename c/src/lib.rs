//! The C face of onescan-core: checks pointers, converts, calls, maps errors; nothing else.
//!
//! Memory is the caller's, sizes are known before a program runs (`sizeof(OnescanFit)`,
//! `ONESCAN_WORDS`) and asked for while it does ([`onescan_words`]). There are no globals: as many
//! fits may run as there is memory for, each on one thread at a time.

#![no_std]

use core::ffi::{CStr, c_char};
use core::mem::{align_of, size_of};
use core::slice;
use onescan_core::chain::{Chain, ChainError, Config, Dimensions, Problem, Schedule};
use onescan_core::image::Image;
use onescan_core::likelihood::landmarks::{MAX_LANDMARKS, Observation};
use onescan_core::model::{Model, ModelError};
use onescan_core::render::{draw, draw_words};

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
}

/// The most landmarks a fit takes.
pub const ONESCAN_MAX_LANDMARKS: usize = 64;
const _: () = assert!(ONESCAN_MAX_LANDMARKS == MAX_LANDMARKS);

/// Numbers in an OnescanFit, eight bytes each.
pub const ONESCAN_FIT_LENGTH: usize = 3072;

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
    /// Steps of the landmark stage.
    pub landmark_samples: u32,
    /// Steps of the shape stage: 0 for faces, 5000 for other objects.
    pub shape_samples: u32,
    /// Steps of the image stage.
    pub samples: u32,
    /// Standard deviation of a landmark, pixels.
    pub landmark_sd: f32,
    /// Standard deviation of a pixel's colour channel, of 1.
    pub pixel_sd: f32,
    /// Pixels that share one independent error.
    pub pixel_patch: f32,
    /// Whether to search for the best fit; otherwise the chain samples the posterior.
    pub search: bool,
    /// Whether memory is scarcer than time: less than half of it, same result.
    pub lean: bool,
}

/// How far a fit is, and how good.
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

/// A fit. Allocate it anywhere and do not move it between calls.
#[repr(C)]
pub struct OnescanFit {
    /// The library's.
    pub storage: [u64; ONESCAN_FIT_LENGTH],
}

/// What is in a [`OnescanFit`]: the chain borrows from the rest, which therefore must stay where it is.
struct Running {
    model: Model<'static>,
    config: Config,
    observations: [Observation<'static>; MAX_LANDMARKS],
    chain: Result<Chain<'static, 'static>, ChainError>,
}

const _: () = assert!(size_of::<Running>() <= size_of::<OnescanFit>());
const _: () = assert!(align_of::<Running>() <= align_of::<OnescanFit>());

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
        c"too little memory; onescan_words() says how much is needed",
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
        landmark_samples: config.landmark_samples,
        shape_samples: config.shape_samples,
        samples: config.samples,
        landmark_sd: config.landmark_sd,
        pixel_sd: config.pixel_sd,
        pixel_patch: config.pixel_patch,
        search: config.search,
        lean: false,
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
    if model.is_null() || info.is_null() {
        return OnescanStatus::Null;
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

/// Words (4 bytes) of memory of a fit. 0 if a pointer is null.
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
    let (Some(info), Some(settings)) = (unsafe { (info.as_ref(), settings.as_ref()) }) else {
        return 0;
    };
    Dimensions {
        vertices: info.vertices as usize,
        shape_rank: settings.shape_rank.min(info.shape_rank) as usize,
        albedo_rank: settings.albedo_rank.min(info.albedo_rank) as usize,
        landmarks,
        width: width as usize,
        height: height as usize,
        lean: settings.lean,
    }
    .words()
}

/// Starts a fit. `rgb` are `3 * width * height` bytes, rows from the top. Nothing is copied:
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
    let null = fit.is_null() || model.is_null() || rgb.is_null() || memory.is_null();
    if null || landmarks.is_null() || settings.is_null() {
        return OnescanStatus::Null;
    }
    let Some(pixels) = (width as usize).checked_mul(height as usize) else {
        return OnescanStatus::Image;
    };
    // SAFETY: as the caller promises, for as long as the fit is used.
    let (model, pixels, landmarks, settings, memory) = unsafe {
        (
            slice::from_raw_parts(model, model_bytes),
            slice::from_raw_parts(rgb.cast::<[u8; 3]>(), pixels),
            slice::from_raw_parts(landmarks, landmark_count),
            *settings,
            slice::from_raw_parts_mut(memory, memory_words),
        )
    };
    let model = match Model::new_checked(model) {
        Ok(model) => model,
        Err(error) => return model_status(error),
    };
    if landmarks.is_empty() || landmarks.len() > MAX_LANDMARKS {
        return OnescanStatus::LandmarkCount;
    }
    let mut observations = [Observation { name: "", position: [0.0; 2] }; MAX_LANDMARKS];
    for (observation, landmark) in observations.iter_mut().zip(landmarks) {
        if landmark.name.is_null() {
            return OnescanStatus::Null;
        }
        // SAFETY: a C string, for as long as the fit is used.
        let Ok(name) = (unsafe { CStr::from_ptr(landmark.name) }).to_str() else {
            return OnescanStatus::UnknownLandmark;
        };
        *observation = Observation { name, position: [landmark.x, landmark.y] };
    }
    let config = Config::default().with(|config| {
        config.shape_rank = settings.shape_rank as usize;
        config.albedo_rank = settings.albedo_rank as usize;
        config.landmark_samples = settings.landmark_samples;
        config.shape_samples = settings.shape_samples;
        config.samples = settings.samples;
        config.landmark_sd = settings.landmark_sd;
        config.pixel_sd = settings.pixel_sd;
        config.pixel_patch = settings.pixel_patch;
        config.search = settings.search;
    });
    let running = fit.cast::<Running>();
    // SAFETY: `fit` is large enough and aligned for a `Running` (asserted above). Its fields are
    // written before they are borrowed, and stay where they are, as the caller promises.
    unsafe {
        (&raw mut (*running).model).write(model);
        (&raw mut (*running).config).write(config);
        (&raw mut (*running).observations).write(observations);
        let landmarks = &(&(*running).observations)[..landmark_count];
        let image = Image { pixels, width, height };
        let problem = Problem::new(&(*running).model, image, landmarks, &(*running).config)
            .with_schedule(Schedule::of(landmarks))
            .with_lean(settings.lean);
        (&raw mut (*running).chain).write(Chain::new(problem, settings.seed, 0, memory));
        match &(*running).chain {
            Ok(_) => OnescanStatus::Ok,
            Err(error) => chain_status(*error),
        }
    }
}

/// Makes up to `steps` steps; how many it made. 0: the fit is done.
///
/// # Safety
/// `fit` is null or was started, with OnescanStatus::Ok.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn onescan_step(fit: *mut OnescanFit, steps: u32) -> u32 {
    // SAFETY: as the caller promises.
    let Some(chain) = (unsafe { chain(fit) }) else { return 0 };
    let mut done = 0;
    while done < steps && chain.step().is_some() {
        done += 1;
    }
    done
}

/// How far a fit is.
///
/// # Safety
/// `fit` is null or was started, with OnescanStatus::Ok; `progress` points to a OnescanProgress or is null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn onescan_progress(
    fit: *mut OnescanFit,
    progress: *mut OnescanProgress,
) -> OnescanStatus {
    // SAFETY: as the caller promises.
    let (Some(running), Some(progress)) =
        (unsafe { (fit.cast::<Running>().as_ref(), progress.as_mut()) })
    else {
        return OnescanStatus::Null;
    };
    let Ok(chain) = &running.chain else { return OnescanStatus::Null };
    let (done, total) = chain.progress();
    let best = chain.best().density.posterior(&running.config);
    *progress = OnescanProgress { done, total, fingerprint: chain.fingerprint(), best };
    OnescanStatus::Ok
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
    if colors.is_null() || memory.is_null() {
        return OnescanStatus::Null;
    }
    // SAFETY: as the caller promises.
    let Some(running) = (unsafe { fit.cast::<Running>().as_ref() }) else {
        return OnescanStatus::Null;
    };
    let Ok(chain) = &running.chain else { return OnescanStatus::Null };
    let scene = &chain.best().scene;
    let [width, height] = scene.camera.image_size.map(|side| side as usize);
    if memory_words < draw_words(running.model.vertices(), width, height) {
        return OnescanStatus::Memory;
    }
    // SAFETY: as the caller promises.
    let (colors, memory) = unsafe {
        (
            slice::from_raw_parts_mut(colors.cast::<[f32; 3]>(), width * height),
            slice::from_raw_parts_mut(memory, memory_words),
        )
    };
    match draw(&running.model, scene, memory, colors) {
        Some(_) => OnescanStatus::Ok,
        None => OnescanStatus::Memory,
    }
}

/// The chain of a fit.
///
/// # Safety
/// `fit` is null or was started, with [`OnescanStatus::Ok`].
unsafe fn chain<'f>(fit: *mut OnescanFit) -> Option<&'f mut Chain<'static, 'static>> {
    // SAFETY: as the caller promises. Only the chain is borrowed for writing; what it borrows
    // itself are other fields.
    unsafe {
        if fit.is_null() {
            return None;
        }
        (*fit.cast::<Running>()).chain.as_mut().ok()
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
        ChainError::Config | ChainError::Schedule | ChainError::Checkpoint => OnescanStatus::Config,
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
