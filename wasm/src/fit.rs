//! A fit that JavaScript drives, a step at a time.

use crate::{CoreModel, File, Model, Opened, Photo, Pixels};
use onescan::error::{Error, Result};
use onescan::fit::output::{self, Names, PhotoNames};
use onescan::fit::summary::{Summary, hex};
use onescan::fit::{Job, Observed, Schedule, Searching};
use onescan::mesh::skin::Skin;
use onescan::photo::Crop;
use onescan::photo::picture::Picture;
use onescan::photo::tlms::Tlms;
use onescan::texture::Kind;
use onescan::{fit, render, report};
use onescan_core::chain::{self, Config, Problem};
use onescan_core::engine::Engine;
use onescan_core::scene::Scene;
use onescan_core::search::unknowns::MAX_PHOTOS;
use onescan_core::search::{self, Evidence, LEVELS, Options};
use self_cell::{MutBorrow, self_cell};
use serde::Deserialize;
use std::cell::OnceCell;
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

/// A photo, and what a fit looks at of it.
struct Look {
    photo: Rc<Picture>,
    landmarks: Tlms,
    crop: Crop,
}

/// Everything a fit looks at, and its memory.
struct Inputs {
    model: Rc<Opened>,
    looks: Vec<Look>,
    config: Config,
    memory: MutBorrow<Vec<u32>>,
}

impl Inputs {
    fn jobs(&self) -> Vec<Job<'_>> {
        let jobs = self.looks.iter().map(|look| Job {
            model: self.model.borrow_dependent(),
            photo: &look.photo,
            landmarks: &look.landmarks,
            crop: look.crop,
            mask: None,
            schedule: Schedule::Mode,
            config: self.config.clone(),
            // Of chains, of which there are none: the command's default.
            seed: 7,
            chains: 1,
        });
        jobs.collect()
    }

    fn observe(&self) -> Result<Vec<Observed<'_>>> {
        let looks = self.looks.iter();
        looks.map(|look| Observed::new(&look.photo, &look.landmarks, &look.crop)).collect()
    }

    fn problems<'a>(&'a self, observed: &'a [Observed<'a>]) -> Vec<Problem<'a>> {
        let (model, config) = (self.model.borrow_dependent(), &self.config);
        observed.iter().map(|observed| observed.problem(model, config, Engine::PORTABLE)).collect()
    }
}

type Observations<'a> = Vec<Observed<'a>>;

/// The problem of each photo, and the photos.
struct Posed<'a> {
    problems: Vec<Problem<'a>>,
    photos: Vec<chain::Photo<'a>>,
}

type Search<'a> = Searching<'a, 'a>;

// A search borrows what was made of what was made of the inputs.
self_cell!(
    struct Prepared {
        owner: Inputs,
        #[covariant]
        dependent: Observations,
    }
);

self_cell!(
    struct Ready {
        owner: Prepared,
        #[covariant]
        dependent: Posed,
    }
);

self_cell!(
    struct Started {
        owner: Ready,
        #[not_covariant]
        dependent: Search,
    }
);

/// A fit of a model to photos of one subject.
#[wasm_bindgen]
pub struct Fit(Started);

#[wasm_bindgen]
impl Fit {
    /// Prepares a fit to one photo or several of one subject. `landmarks` are the texts of their
    /// `.tlms` files, lines of `name visible x y` in pixels of the photo; `settings` a JSON object.
    ///
    /// # Errors
    /// Landmarks and settings that do not go with the model and the photos; too many photos.
    #[wasm_bindgen(constructor)]
    pub fn new(
        model: &Model,
        photos: Vec<Photo>,
        landmarks: Vec<String>,
        settings: &str,
    ) -> Result<Fit, JsError> {
        Ok(Self(start(model, photos, landmarks, settings)?))
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

    /// The face so far drawn over the part of a photo the fit looks at; `behind` what hides it.
    ///
    /// # Errors
    /// No photo of this number; they count from 0.
    pub fn overlay(&self, photo: usize, behind: bool) -> Result<Pixels, JsError> {
        let mask = self.mask(photo)?;
        self.0.with_dependent(|ready, searching| {
            let prepared = ready.borrow_owner();
            let views = searching.search.evidence().map(Evidence::view);
            let mut seen = views.zip(prepared.borrow_dependent());
            let (view, Observed { picture, .. }) = seen.nth(photo).ok_or_else(missing)?;
            let scene = Scene { subject: searching.search.subject().clone(), view: *view };
            let model = prepared.borrow_owner().model.borrow_dependent();
            let drawn = render::draw_over(model, &scene, picture)?;
            Ok(Pixels(if behind { output::behind(&mask.0, picture, &drawn) } else { drawn }))
        })
    }

    /// The mask so far: white where that part of the photo shows the face, black where something
    /// hides it or the face does not reach.
    ///
    /// # Errors
    /// No photo of this number.
    pub fn mask(&self, photo: usize) -> Result<Pixels, JsError> {
        let crop = self.look(photo)?.crop;
        self.with(|searching| {
            let evidence = searching.search.evidence().nth(photo).ok_or_else(missing)?;
            Ok(Pixels(output::mask(crop, evidence.mask())))
        })
    }

    /// Left, top, width and height of that part, in pixels of the photo.
    ///
    /// # Errors
    /// No photo of this number.
    pub fn crop(&self, photo: usize) -> Result<Vec<u32>, JsError> {
        let crop = self.look(photo)?.crop;
        Ok([crop.origin, crop.size].concat())
    }

    /// Ends the fit, `seconds` after it began: what it leaves behind. `images` are the photos' names.
    ///
    /// # Errors
    /// Another number of names than photos.
    pub fn finish(
        self,
        seconds: f64,
        model: String,
        images: Vec<String>,
    ) -> Result<Fitted, JsError> {
        let jobs = self.inputs().jobs();
        let fits = self.0.with_dependent(|ready, searching| {
            let problems = ready.borrow_dependent().problems.iter().copied();
            searching.end(jobs.iter().zip(problems), seconds)
        })?;
        let names = named(jobs.len(), model, images)?;
        let summaries = jobs.iter().zip(&fits).enumerate();
        let summaries = summaries.map(|(i, (job, fit))| output::summarize(job, fit, &names, i));
        let summaries = summaries.collect::<Result<_>>()?;
        let (files, skins) = (OnceCell::new(), [OnceCell::new(), OnceCell::new()]);
        Ok(Fitted(Rc::new(Ended { of: self, fits, names, summaries, files, skins })))
    }
}

impl Fit {
    fn with<T>(&self, look: impl FnOnce(&Search<'_>) -> T) -> T {
        self.0.with_dependent(|_, searching| look(searching))
    }

    fn inputs(&self) -> &Inputs {
        self.0.borrow_owner().borrow_owner().borrow_owner()
    }

    fn look(&self, photo: usize) -> Result<&Look> {
        self.inputs().looks.get(photo).ok_or_else(missing)
    }
}

fn missing() -> Error {
    Error::new("the fit has no photo of this number")
}

/// What the photos' files are called: as the command lays them out.
fn named(photos: usize, model: String, images: Vec<String>) -> Result<Names> {
    if images.len() != photos {
        return Err(Error::new("finish() wants a name for each photo"));
    }
    let named = |image| PhotoNames { image, landmarks: None, mask: None };
    let photos = images.into_iter().map(named).collect();
    let mut names = Names { model, given: None, face: 1, photos };
    let folders: Vec<_> = (0..names.photos.len()).map(|photo| names.folder(photo)).collect();
    for (photo, folder) in names.photos.iter_mut().zip(folders) {
        photo.landmarks = Some(format!("{folder}.tlms"));
    }
    Ok(names)
}

fn start(
    model: &Model,
    photos: Vec<Photo>,
    landmarks: Vec<String>,
    settings: &str,
) -> Result<Started> {
    let settings: Settings =
        serde_json::from_str(settings).map_err(|e| Error::new(format_args!("settings: {e}")))?;
    if !(32..=2048).contains(&settings.size) {
        return Err(Error::new(format_args!("size is {}, expected 32 to 2048", settings.size)));
    }
    let count = photos.len();
    if !(1..=MAX_PHOTOS).contains(&count) || landmarks.len() != count {
        return Err(Error::new(format_args!(
            "{count} photos and the landmarks of {}; a fit takes 1 to {MAX_PHOTOS} of one person, \
             each with its own",
            landmarks.len()
        )));
    }
    let model = Rc::clone(&model.0);
    let view = model.borrow_dependent();
    let config = Schedule::Mode.config(view, settings.size).with(|config| {
        config.shape_rank = settings.shape_rank.unwrap_or(config.shape_rank);
        config.albedo_rank = settings.albedo_rank.unwrap_or(config.albedo_rank);
        config.landmark_sd = settings.landmark_sd.unwrap_or(config.landmark_sd);
        config.pixel_patch = settings.pixel_patch.unwrap_or(config.pixel_patch);
    });
    let mut looks = Vec::new();
    for (photo, text) in photos.into_iter().zip(landmarks) {
        let look = look(view, photo.0, &text, settings.size, config.landmark_sd);
        looks.push(look.map_err(|e| match count {
            1 => e,
            _ => Error::new(format_args!("photo {}: {e}", looks.len() + 1)),
        })?);
    }
    let inputs = Inputs { model, looks, config, memory: MutBorrow::new(Vec::new()) };
    let prepared = Prepared::try_new(inputs, Inputs::observe)?;
    let ready = Ready::new(prepared, |prepared| {
        let problems = prepared.borrow_owner().problems(prepared.borrow_dependent());
        Posed { photos: problems.iter().map(|problem| problem.photo).collect(), problems }
    });
    Started::try_new(ready, |ready| {
        let Posed { problems, photos } = ready.borrow_dependent();
        let problem = *problems.first().ok_or_else(missing)?;
        let others = photos.get(1..).unwrap_or_default();
        let options = Options { others, ..Options::default() };
        let memory = ready.borrow_owner().borrow_owner().memory.borrow_mut();
        let words = search::words(&problem, &options);
        memory.try_reserve_exact(words).map_err(Error::new)?;
        memory.resize(words, 0);
        Searching::start(problem, options, memory)
    })
}

fn look(
    model: &CoreModel<'_>,
    photo: Rc<Picture>,
    landmarks: &str,
    side: u32,
    sd: f32,
) -> Result<Look> {
    let landmarks = Tlms::parse(landmarks)?;
    let names: Vec<_> = model.landmarks().map(|(name, _)| name).collect();
    let size = [photo.width, photo.height];
    landmarks.check(photo.width, photo.height, &names)?;
    fit::landmarks::check_sides(model, &landmarks, size, side, sd)?;
    let crop = fit::landmarks::crop_around(model, &landmarks, size, side, sd)?;
    Ok(Look { photo, landmarks, crop })
}

/// A finished fit.
#[wasm_bindgen]
pub struct Fitted(pub(crate) Rc<Ended>);

pub(crate) struct Ended {
    of: Fit,
    fits: Vec<fit::Fit>,
    names: Names,
    pub(crate) summaries: Vec<Summary>,
    files: OnceCell<Vec<File>>,
    /// With the photo's light, and without.
    skins: [OnceCell<Rc<Skin>>; 2],
}

#[wasm_bindgen]
impl Fitted {
    /// The contents of a photo's `fit.json`.
    ///
    /// # Errors
    /// No photo of this number.
    pub fn json(&self, photo: Option<usize>) -> Result<String, JsError> {
        let summary = self.0.summaries.get(photo.unwrap_or(0)).ok_or_else(missing)?;
        Ok(summary.to_json()?)
    }

    /// What the command would write, file by file; those of one photo among several are in a folder
    /// named like it. Made when first asked for, which takes as long as the fit.
    ///
    /// # Errors
    /// None of a fit that came to its end.
    pub fn files(&self) -> Result<Vec<File>, JsError> {
        if let Some(files) = self.0.files.get() {
            return Ok(files.clone());
        }
        let files = self.0.make()?;
        Ok(self.0.files.get_or_init(|| files).clone())
    }
}

impl Ended {
    /// What the face looks like, by its photos. Made when first asked for.
    pub(crate) fn skin(&self, kind: Kind) -> Result<Rc<Skin>> {
        let [photo, albedo] = &self.skins;
        let own = if kind == Kind::Photo { photo } else { albedo };
        if let Some(skin) = own.get() {
            return Ok(Rc::clone(skin));
        }
        let skin = Rc::new(output::skin(&self.of.inputs().jobs(), &self.fits, kind)?);
        Ok(Rc::clone(own.get_or_init(|| skin)))
    }

    fn make(&self) -> Result<Vec<File>> {
        let jobs = self.of.inputs().jobs();
        let mut files = Vec::new();
        let mut add = |name: String, bytes| files.push(File { name, bytes });
        let results = output::finish(&jobs, &self.fits, &self.names, Kind::default())?;
        let folders: Vec<_> = (0..jobs.len()).map(|photo| self.names.folder(photo)).collect();
        for ((job, result), folder) in jobs.iter().zip(&results).zip(&folders) {
            for (name, bytes) in output::files(result)? {
                add(if jobs.len() > 1 { format!("{folder}/{name}") } else { name }, bytes);
            }
            add(format!("{folder}.tlms"), job.landmarks.to_text().into_bytes());
        }
        let provenance = jobs.first().map_or("", |job| job.model.provenance());
        let page = match &results[..] {
            [result] => report::fit_report(result, provenance)?,
            results => report::subject_report(results, &folders, provenance)?,
        };
        add("report.html".into(), page.into_bytes());
        if results.len() > 1 {
            for (name, bytes) in output::files_of_all(&results)? {
                add(name, bytes);
            }
        }
        Ok(files)
    }
}
