//! A fit that JavaScript drives, some steps at a time.

use crate::{File, Model, Opened, Photo, Pixels};
use onescan::error::{Error, Result};
use onescan::fit::output::{self, Names};
use onescan::fit::summary::{Summary, hex};
use onescan::fit::{Job, Observed, Running, Schedule};
use onescan::photo::Crop;
use onescan::photo::picture::Picture;
use onescan::photo::tlms::Tlms;
use onescan::{render, report};
use onescan_core::chain::{Config, Problem, Stage};
use onescan_core::engine::Engine;
use self_cell::{MutBorrow, self_cell};
use serde::Deserialize;
use std::rc::Rc;
use wasm_bindgen::prelude::*;

/// How a fit is done; everything has a default.
#[derive(Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "camelCase")]
struct Settings {
    /// Seed of all randomness.
    seed: u64,
    /// Steps of the image stage.
    samples: u32,
    /// Steps of the landmark stage.
    landmark_samples: u32,
    /// Steps of the shape stage, for objects that are no faces.
    shape_samples: u32,
    /// Standard deviation of a landmark, pixels of the picture the fit looks at.
    landmark_sd: f32,
    /// Shape coefficients to infer.
    shape_rank: usize,
    /// Albedo coefficients to infer.
    albedo_rank: usize,
    /// Side of the picture the fit looks at.
    size: u32,
    /// Pixels that share one independent error.
    pixel_patch: f32,
    /// No search moves.
    sampler: bool,
}

impl Default for Settings {
    fn default() -> Self {
        let config = Config::default();
        Self {
            seed: 7,
            samples: config.samples,
            landmark_samples: config.landmark_samples,
            shape_samples: config.shape_samples,
            landmark_sd: config.landmark_sd,
            shape_rank: config.shape_rank,
            albedo_rank: config.albedo_rank,
            size: Crop::LONGER_SIDE,
            pixel_patch: config.pixel_patch,
            sampler: !config.search,
        }
    }
}

/// Everything a fit looks at, and its memory.
struct Inputs {
    model: Rc<Opened>,
    photo: Rc<Picture>,
    landmarks: Tlms,
    crop: Crop,
    config: Config,
    seed: u64,
    memory: MutBorrow<Vec<u32>>,
}

impl Inputs {
    fn job(&self) -> Job<'_> {
        Job {
            model: self.model.borrow_dependent(),
            photo: &self.photo,
            landmarks: &self.landmarks,
            crop: self.crop,
            mask: None,
            schedule: if self.config.search { Schedule::Paper } else { Schedule::Sampler },
            config: self.config.clone(),
            seed: self.seed,
            chains: 1,
        }
    }

    fn observe(&self) -> Result<Observed<'_>> {
        Observed::new(&self.photo, &self.landmarks, &self.crop)
    }

    fn problem<'a>(&'a self, observed: &'a Observed<'a>) -> Problem<'a> {
        observed.problem(self.model.borrow_dependent(), &self.config, &Engine::PORTABLE)
    }
}

// A chain borrows what was made of the inputs, which borrows the inputs.
self_cell!(
    struct Prepared {
        owner: Inputs,
        #[covariant]
        dependent: Observed,
    }
);

type Chain<'a> = Running<'a, 'a>;

self_cell!(
    struct Started {
        owner: Prepared,
        #[not_covariant]
        dependent: Chain,
    }
);

/// A fit of a model to a photo.
#[wasm_bindgen]
pub struct Fit(Started);

#[wasm_bindgen]
impl Fit {
    /// Prepares a fit. `landmarks` is the text of a `.tlms` file, lines of `name visible x y` in
    /// pixels of the photo; `settings` a JSON object.
    ///
    /// # Errors
    /// Landmarks and settings that do not go with the model and the photo.
    #[wasm_bindgen(constructor)]
    pub fn new(
        model: &Model,
        photo: &Photo,
        landmarks: &str,
        settings: &str,
    ) -> Result<Fit, JsError> {
        Ok(Self(start(model, photo, landmarks, settings)?))
    }

    /// Makes up to `count` steps; how many it made. 0: the fit is done.
    pub fn step(&mut self, count: u32) -> u32 {
        self.0.with_dependent_mut(|_, running| {
            (0..count).take_while(|_| running.step().is_some()).count() as u32
        })
    }

    /// Steps made.
    #[wasm_bindgen(getter)]
    pub fn done(&self) -> u32 {
        self.with(|running| running.chain.progress().0)
    }

    /// Steps in all.
    #[wasm_bindgen(getter)]
    pub fn total(&self) -> u32 {
        self.with(|running| running.chain.progress().1)
    }

    /// Steps so far that rendered the model and compared the pictures.
    #[wasm_bindgen(getter, js_name = imageEvaluated)]
    pub fn image_evaluated(&self) -> u32 {
        self.with(|running| running.chain.checkpoint().image_evaluated)
    }

    /// The stage it is in: `landmarks`, `shape` or `image`.
    #[wasm_bindgen(getter)]
    pub fn stage(&self) -> String {
        let stage = self.with(|running| running.chain.stage());
        match stage {
            Stage::Landmarks => "landmarks",
            Stage::Shape => "shape",
            Stage::Image => "image",
        }
        .into()
    }

    /// Hash over the bits of every accepted state, 16 hexadecimal digits.
    #[wasm_bindgen(getter)]
    pub fn fingerprint(&self) -> String {
        self.with(|running| hex(running.chain.fingerprint()))
    }

    /// The log likelihood so far: step and value by turns, from the landmark stage to the image's.
    pub fn trace(&self) -> Vec<f64> {
        self.with(|running| running.trace().iter().flat_map(|&(x, y)| [f64::from(x), y]).collect())
    }

    /// The current state drawn over the part of the photo the fit looks at.
    ///
    /// # Errors
    /// None.
    pub fn overlay(&self) -> Result<Pixels, JsError> {
        self.0.with_dependent(|prepared, running| {
            let model = prepared.borrow_owner().model.borrow_dependent();
            let picture = &prepared.borrow_dependent().picture;
            Ok(Pixels(render::draw_over(model, &running.chain.state().scene, picture)?))
        })
    }

    /// Left, top, width and height of that part, in pixels of the photo.
    #[wasm_bindgen(getter)]
    pub fn crop(&self) -> Vec<u32> {
        let crop = self.inputs().crop;
        [crop.origin, crop.size].concat()
    }

    /// Ends the fit, `seconds` after it began: what it leaves behind.
    ///
    /// # Errors
    /// None for a fit that is done.
    pub fn finish(self, seconds: f64, model: String, image: String) -> Result<Fitted, JsError> {
        let mut run = None;
        let mut started = self.0;
        started.with_dependent_mut(|_, running| run = Some(running.end(seconds)));
        let inputs = started.borrow_owner().borrow_owner();
        let job = inputs.job();
        let fit = job.summarize(run.into_iter().collect());
        let fit = fit.ok_or_else(|| JsError::new("no chain ran"))?;
        let stem = image.rsplit_once('.').map_or(&*image, |(stem, _)| stem);
        let landmarks = format!("{stem}.tlms");
        let names = Names { model, image, landmarks: landmarks.clone(), mask: None };
        let finished = output::finish(&job, &fit, names)?;
        let mut files: Vec<_> = output::files(&finished)?
            .into_iter()
            .map(|(name, bytes)| File { name: name.into(), bytes })
            .collect();
        files.push(File { name: landmarks, bytes: job.landmarks.to_text().into_bytes() });
        let page = report::fit_report(&finished, job.model.provenance())?;
        files.push(File { name: "report.html".into(), bytes: page.into_bytes() });
        Ok(Fitted { summary: finished.summary, files })
    }
}

impl Fit {
    fn with<T>(&self, look: impl FnOnce(&Chain<'_>) -> T) -> T {
        self.0.with_dependent(|_, running| look(running))
    }

    fn inputs(&self) -> &Inputs {
        self.0.borrow_owner().borrow_owner()
    }
}

fn start(model: &Model, photo: &Photo, landmarks: &str, settings: &str) -> Result<Started> {
    let settings: Settings =
        serde_json::from_str(settings).map_err(|e| Error::new(format_args!("settings: {e}")))?;
    let (model, photo) = (Rc::clone(&model.0), Rc::clone(&photo.0));
    let landmarks = Tlms::parse(landmarks)?;
    let names: Vec<_> = model.borrow_dependent().landmarks().map(|(name, _)| name).collect();
    landmarks.check(photo.width, photo.height, &names)?;
    let points = landmarks.visible_points();
    if !(32..=2048).contains(&settings.size) {
        return Err(Error::new(format_args!("size is {}, expected 32 to 2048", settings.size)));
    }
    let size = [photo.width, photo.height];
    let crop = Crop::around(&points, size, Crop::ENLARGE, settings.size)?;
    let config = Config::default().with(|config| {
        config.shape_rank = settings.shape_rank;
        config.albedo_rank = settings.albedo_rank;
        config.landmark_samples = settings.landmark_samples;
        config.shape_samples = settings.shape_samples;
        config.landmark_sd = settings.landmark_sd;
        config.samples = settings.samples;
        config.pixel_patch = settings.pixel_patch;
        config.search = !settings.sampler;
    });
    let memory = MutBorrow::new(Vec::new());
    let seed = settings.seed;
    let mut inputs = Inputs { model, photo, landmarks, crop, config, seed, memory };
    let words = {
        let observed = inputs.observe()?;
        inputs.problem(&observed).dimensions().words()
    };
    inputs.memory = MutBorrow::new(vec![0; words]);
    let prepared = Prepared::try_new(inputs, Inputs::observe)?;
    Started::try_new(prepared, |prepared| {
        let (inputs, observed) = (prepared.borrow_owner(), prepared.borrow_dependent());
        let memory = inputs.memory.borrow_mut();
        Running::start(inputs.problem(observed), inputs.seed, 0, None, memory)
    })
}

/// A finished fit.
#[wasm_bindgen]
pub struct Fitted {
    pub(crate) summary: Summary,
    files: Vec<File>,
}

#[wasm_bindgen]
impl Fitted {
    /// The contents of `fit.json`.
    ///
    /// # Errors
    /// A number that JSON cannot hold.
    pub fn json(&self) -> Result<String, JsError> {
        Ok(self.summary.to_json()?)
    }

    /// What the command would write, file by file.
    pub fn files(&self) -> Vec<File> {
        self.files.clone()
    }
}
