//! A fit that JavaScript drives, a step at a time.

use crate::{File, Model, Opened, Photo, Pixels};
use onescan::error::{Error, Result};
use onescan::fit::output::{self, Names, PhotoNames};
use onescan::fit::summary::{Summary, hex};
use onescan::fit::{Job, Observed, Schedule, Searching};
use onescan::photo::Crop;
use onescan::photo::picture::Picture;
use onescan::photo::tlms::Tlms;
use onescan::{fit, render, report};
use onescan_core::chain::{Config, Problem};
use onescan_core::engine::Engine;
use onescan_core::search::{self, LEVELS, Options};
use self_cell::{MutBorrow, self_cell};
use serde::Deserialize;
use std::rc::Rc;
use wasm_bindgen::prelude::*;

/// How a fit is done; everything has a default.
#[derive(Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "camelCase")]
struct Settings {
    /// Standard deviation of a landmark, pixels of the picture the fit looks at; by default as the
    /// size.
    landmark_sd: Option<f32>,
    /// Shape coefficients to infer; all of the model's by default.
    shape_rank: Option<usize>,
    /// Albedo coefficients to infer; all of the model's by default.
    albedo_rank: Option<usize>,
    /// Side of the picture the fit looks at.
    size: u32,
    /// Pixels that share one independent error; by default as the picture's area.
    pixel_patch: Option<f32>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            landmark_sd: None,
            shape_rank: None,
            albedo_rank: None,
            size: Crop::LONGER_SIDE,
            pixel_patch: None,
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
            schedule: Schedule::Mode,
            config: self.config.clone(),
            // Of chains, of which there are none: the command's default.
            seed: 7,
            chains: 1,
        }
    }

    fn observe(&self) -> Result<Observed<'_>> {
        Observed::new(&self.photo, &self.landmarks, &self.crop)
    }

    fn problem<'a>(&'a self, observed: &'a Observed<'a>) -> Problem<'a> {
        observed.problem(self.model.borrow_dependent(), &self.config, Engine::PORTABLE)
    }
}

// A search borrows what was made of the inputs, which borrows the inputs.
self_cell!(
    struct Prepared {
        owner: Inputs,
        #[covariant]
        dependent: Observed,
    }
);

type Search<'a> = Searching<'a, 'a>;

self_cell!(
    struct Started {
        owner: Prepared,
        #[not_covariant]
        dependent: Search,
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
        self.0.with_dependent_mut(|_, searching| {
            (0..count).take_while(|_| searching.step().is_some()).count() as u32
        })
    }

    /// Steps made.
    #[wasm_bindgen(getter)]
    pub fn done(&self) -> u32 {
        self.with(|searching| searching.search.iterations())
    }

    /// Whether it has ended.
    #[wasm_bindgen(getter)]
    pub fn ended(&self) -> bool {
        self.with(|searching| searching.search.done())
    }

    /// Whether its last steps changed nothing.
    #[wasm_bindgen(getter)]
    pub fn converged(&self) -> bool {
        self.with(|searching| searching.search.converged())
    }

    /// The levels of every fit, coarse to fine: of each the standard deviation of the photo's blur,
    /// pixels of the picture the fit looks at, and the most steps, by turns.
    pub fn levels() -> Vec<f32> {
        LEVELS.iter().flat_map(|level| [level.blur, level.iterations as f32]).collect()
    }

    /// Hash over the bits of every scene on the way, 16 hexadecimal digits.
    #[wasm_bindgen(getter)]
    pub fn fingerprint(&self) -> String {
        self.with(|searching| hex(searching.search.fingerprint()))
    }

    /// The course so far: of every step its level and the energy after it, by turns. The energy is
    /// the negative log posterior density up to a constant, which differs from level to level.
    pub fn trace(&self) -> Vec<f64> {
        self.with(|searching| {
            let levels = searching.levels().iter().map(|&level| f64::from(level));
            let energies = searching.trace().iter().map(|&(_, density)| -density);
            levels.zip(energies).flat_map(|(level, energy)| [level, energy]).collect()
        })
    }

    /// The face so far drawn over the part of the photo the fit looks at; `behind` what hides it.
    ///
    /// # Errors
    /// None.
    pub fn overlay(&self, behind: bool) -> Result<Pixels, JsError> {
        self.0.with_dependent(|prepared, searching| {
            let model = prepared.borrow_owner().model.borrow_dependent();
            let picture = &prepared.borrow_dependent().picture;
            let drawn = render::draw_over(model, &searching.search.scene(), picture)?;
            Ok(Pixels(if behind { output::behind(&self.mask().0, picture, &drawn) } else { drawn }))
        })
    }

    /// The mask so far: white where that part of the photo shows the face, black where something
    /// hides it or the face does not reach.
    pub fn mask(&self) -> Pixels {
        let crop = self.inputs().crop;
        self.with(|searching| Pixels(output::mask(crop, searching.search.mask())))
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
        let started = self.0;
        let job = started.borrow_owner().borrow_owner().job();
        let fits = started.with_dependent(|prepared, searching| {
            let problem = prepared.borrow_owner().problem(prepared.borrow_dependent());
            searching.end([(&job, problem)], seconds)
        })?;
        let [fit] = &fits[..] else { return Err(JsError::new("a fit of one photo")) };
        let stem = image.rsplit_once('.').map_or(&*image, |(stem, _)| stem);
        let landmarks = format!("{stem}.tlms");
        let photo = PhotoNames { image, landmarks: landmarks.clone(), mask: None };
        let names = Names { model, photos: vec![photo] };
        let finished = output::finish(&job, fit, &names, 0)?;
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
    fn with<T>(&self, look: impl FnOnce(&Search<'_>) -> T) -> T {
        self.0.with_dependent(|_, searching| look(searching))
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
    if !(32..=2048).contains(&settings.size) {
        return Err(Error::new(format_args!("size is {}, expected 32 to 2048", settings.size)));
    }
    let size = [photo.width, photo.height];
    let view = model.borrow_dependent();
    let config = Schedule::Mode.config(view, settings.size).with(|config| {
        config.shape_rank = settings.shape_rank.unwrap_or(config.shape_rank);
        config.albedo_rank = settings.albedo_rank.unwrap_or(config.albedo_rank);
        config.landmark_sd = settings.landmark_sd.unwrap_or(config.landmark_sd);
        config.pixel_patch = settings.pixel_patch.unwrap_or(config.pixel_patch);
    });
    let sd = config.landmark_sd;
    fit::landmarks::check_sides(view, &landmarks, size, settings.size, sd)?;
    let crop = fit::landmarks::crop_around(view, &landmarks, size, settings.size, sd)?;
    let memory = MutBorrow::new(Vec::new());
    let mut inputs = Inputs { model, photo, landmarks, crop, config, memory };
    let words = {
        let observed = inputs.observe()?;
        search::words(&inputs.problem(&observed), &Options::default())
    };
    inputs.memory = MutBorrow::new(vec![0; words]);
    let prepared = Prepared::try_new(inputs, Inputs::observe)?;
    Started::try_new(prepared, |prepared| {
        let (inputs, observed) = (prepared.borrow_owner(), prepared.borrow_dependent());
        let memory = inputs.memory.borrow_mut();
        Searching::start(inputs.problem(observed), Options::default(), memory)
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
