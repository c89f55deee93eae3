//! Models of other objects than faces (paper, section "Other Object Categories"): a fish and a
//! bird, and fits to pictures of others of their kind.
//!
//! The paper's templates are artists' meshes, its pictures photos. Here both come from one
//! generator (`animals`): the templates are its defaults, the pictures show animals of other
//! proportions and paint, before a background, under random light.

pub mod animals;
pub mod solid;

use super::stages::{Stages, packed, unpacked};
use crate::demo;
use crate::error::{Error, Result};
use crate::fit::{Control, Ending, Job, Schedule};
use crate::json;
use crate::mesh::landmarks::Landmark;
use crate::mesh::{Axis, Mesh};
use crate::model::build::{BuildOptions, Method, build};
use crate::model::decompose::{Progress, Truncation};
use crate::model::kernel::Kernels;
use crate::model::layout;
use crate::model_file::OwnedModel;
use crate::photo::Crop;
use crate::photo::picture::{Picture, WHITE, contact_sheet};
use crate::photo::tlms::Tlms;
use crate::render;
use crate::report;
use crate::scan::rigid::Rigid;
use crate::vector::{length, minus};
use animals::{Animal, Kind};
use onescan_core::chain::Config;
use onescan_core::model::Model;
use onescan_core::rng::Rng;
use onescan_core::scene::Scene;
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;

/// Kernels of the four models, as the paper's.
const MODELS: [&str; 4] = ["standard-full", "symmetric-full", "standard-xyz", "symmetric-xyz"];
/// Samples of each model that are shown.
const SAMPLES: usize = 6;
/// Side of a picture.
const SIDE: u32 = 256;
/// Noise of the pictures, per channel.
const NOISE: f32 = 0.02;
/// Stream of random numbers that draws the animals.
const ANIMALS: u32 = 0xa1;

/// How such fits are made, as in the paper's released program: landmarks to 2 pixels, and, by a chain, between pose
/// and picture a phase that lets the shape follow them.
pub fn config(schedule: Schedule, model: &Model<'_>) -> Config {
    schedule.config(model, SIDE).with(|config| {
        config.landmark_sd = 2.0;
        if schedule != Schedule::Mode {
            config.shape_steps = 5000;
        }
    })
}

/// What it came to.
#[derive(Serialize)]
pub struct Objects {
    /// Fish or bird.
    pub kind: &'static str,
    /// Vertices of the template.
    pub vertices: usize,
    /// Seed of animals, scenes and fits.
    pub seed: u64,
    /// The models.
    pub models: Vec<Row>,
    #[serde(skip)]
    sheets: [Picture; 2],
}

/// One model and its fits, means over pictures.
#[derive(Serialize)]
pub struct Row {
    /// Its kernels.
    pub kernels: &'static str,
    /// Components of shape and albedo.
    pub rank: [usize; 2],
    /// Fraction of the variance that they hold.
    pub captured: [f64; 2],
    /// Pixel error after the landmark phases, and after the fit.
    pub pixel_rmse: [f64; 2],
    /// Distance of corresponding landmarks from the truth, millimetres, after rigid alignment: of
    /// the template, and of the fit.
    pub landmark_mm: [f64; 2],
}

/// A picture of an animal and what is true of it.
struct Subject {
    photo: Picture,
    landmarks: Tlms,
    animal: Animal,
}

/// Builds the four models, draws samples, and fits each to `pictures` pictures.
///
/// # Errors
/// Those of building and fitting.
pub fn run(
    kind: Kind,
    (template, landmarks): (&Mesh, &[Landmark]),
    pictures: usize,
    schedule: Schedule,
    seed: u64,
    stages: &Stages,
    progress: &mut Progress<'_>,
) -> Result<Objects> {
    let mut rng = Rng::new(seed, ANIMALS);
    let subjects =
        (0..pictures).map(|_| subject(kind, &mut rng)).collect::<Result<Vec<Subject>>>()?;
    let steps = (MODELS.len() * (1 + pictures)) as f64;
    let mut done = 0.0;
    let (mut rows, mut samples) = (Vec::new(), Vec::new());
    let mut shown: Vec<Vec<Picture>> =
        subjects.iter().map(|subject| vec![subject.photo.clone()]).collect();
    for kernels in MODELS {
        let made = stages.stage(kernels, || {
            let progress = &mut |part: f64, what: &str| progress((done + part) / steps, what);
            model(kind, (template, landmarks), &subjects, (kernels, schedule, seed), progress)
        })?;
        done += (1 + pictures) as f64;
        let Made { rank, captured, pixel_rmse, landmark_mm, .. } = made;
        rows.push(Row { kernels, rank, captured, pixel_rmse, landmark_mm });
        samples.extend(unpacked(&made.samples)?);
        for (shown, picture) in shown.iter_mut().zip(unpacked(&made.fits)?) {
            shown.push(picture);
        }
    }
    let sheet = |pictures: &[Picture], columns: usize| {
        contact_sheet(&pictures.iter().collect::<Vec<_>>(), columns, 4, WHITE)
    };
    let sheets = [sheet(&samples, SAMPLES), sheet(&shown.concat(), 1 + MODELS.len())];
    Ok(Objects { kind: kind.name(), vertices: template.points.len(), seed, models: rows, sheets })
}

/// A model's stage: the numbers of its [`Row`], and pictures of samples and fits.
#[derive(Default, Serialize, Deserialize)]
struct Made {
    rank: [usize; 2],
    captured: [f64; 2],
    pixel_rmse: [f64; 2],
    landmark_mm: [f64; 2],
    samples: Vec<Vec<u8>>,
    fits: Vec<Vec<u8>>,
}

/// Builds a model, draws samples and fits it. `progress` hears how many models and fits are done.
fn model(
    kind: Kind,
    (template, landmarks): (&Mesh, &[Landmark]),
    subjects: &[Subject],
    (kernels, schedule, seed): (&str, Schedule, u64),
    progress: &mut Progress<'_>,
) -> Result<Made> {
    let options = BuildOptions {
        scan_name: kind.name(),
        kernels: Kernels::named(kernels, Some(Axis::X))?,
        method: Method::Exact(Truncation::Rank(199)),
        millimetres: 1.0,
    };
    let built = build(template, landmarks, &options, &mut |part, _| progress(part, kernels))?;
    let halves = [&built.report.shape, &built.report.albedo];
    let mut made = Made {
        rank: halves.map(|half| half.rank),
        captured: halves.map(|half| half.captured),
        samples: packed(&draw_samples(&built.model, seed)?)?,
        ..Made::default()
    };
    let mut shown = Vec::new();
    for subject in subjects {
        progress((1 + shown.len()) as f64, &format!("{kernels}: fit"));
        let one = fit(&built.model, subject, schedule, seed)?;
        let count = subjects.len() as f64;
        for k in 0..2 {
            made.pixel_rmse[k] += one.pixel_rmse[k] / count;
            made.landmark_mm[k] += one.landmark_mm[k] / count;
        }
        shown.push(one.picture);
    }
    made.fits = packed(&shown)?;
    Ok(made)
}

/// A picture of another animal, from the side.
fn subject(kind: Kind, rng: &mut Rng) -> Result<Subject> {
    let animal = kind.specimen(rng);
    let model = layout::rigid(&animal.mesh, &animal.landmarks)?;
    let model = model.view();
    let side = if rng.uniform() < 0.5 { -1.0 } else { 1.0 };
    let yaw = side * (75.0 + 30.0 * (rng.uniform() as f32 - 0.5)).to_radians();
    let mut scene = render::portrait(&model, [SIDE; 2], yaw, 0.0);
    scene.view.pose.pitch = rng.normal_sd(0.08);
    scene.view.pose.roll = rng.normal_sd(0.06);
    demo::random_light(&mut scene, rng);
    // Turned towards +x the subject shows its right.
    let hidden = if side > 0.0 { "left." } else { "right." };
    let seen = animal.landmarks.iter().filter(|l| !l.name.starts_with(hidden));
    let names: Vec<&str> = seen.map(|l| l.name.as_str()).collect();
    let (photo, landmarks) = demo::synthetic_photo(&model, &scene, NOISE, &names, rng)?;
    Ok(Subject { photo, landmarks, animal })
}

/// A fit and how good it is.
struct Fitted {
    picture: Picture,
    pixel_rmse: [f64; 2],
    landmark_mm: [f64; 2],
}

fn fit(model: &OwnedModel, subject: &Subject, schedule: Schedule, seed: u64) -> Result<Fitted> {
    let model = model.view();
    let Subject { photo, landmarks, animal } = subject;
    let job = Job {
        model: &model,
        photo,
        landmarks,
        crop: Crop::whole([SIDE; 2]),
        mask: None,
        schedule,
        config: config(schedule, &model),
        seed,
        chains: 1,
    };
    let Ending::Done(fit) = job.run(None, &Control::default())? else {
        return Err(Error::new("the fit was stopped"));
    };
    let truth: Vec<[f32; 3]> =
        animal.landmarks.iter().map(|l| animal.mesh.points[l.vertex as usize]).collect();
    let distance = |scene: Option<&Scene>| {
        let shape = scene.map_or(&[][..], |scene| &scene.subject.shape);
        let points = render::instance(&model, shape, &[]).points;
        let at = |l: &Landmark| model.landmark(&l.name).map(|v| points[v as usize]);
        let found: Vec<[f32; 3]> = animal.landmarks.iter().filter_map(at).collect();
        let Some(motion) = Rigid::between(&found, &truth) else { return f64::NAN };
        let apart = |(p, q): (&[f32; 3], &[f32; 3])| -> f64 {
            length(minus(motion.apply(*p), *q).map(f64::from))
        };
        found.iter().zip(&truth).map(apart).sum::<f64>() / truth.len() as f64
    };
    let best = &fit.best.scene;
    Ok(Fitted {
        picture: render::draw_over(&model, best, photo)?,
        pixel_rmse: [fit.initial_quality.pixel_rmse, fit.best_quality.pixel_rmse],
        landmark_mm: [distance(None), distance(Some(best))],
    })
}

fn draw_samples(model: &OwnedModel, seed: u64) -> Result<Vec<Picture>> {
    let model = model.view();
    let mut rng = Rng::new(seed, 0);
    let scene = render::portrait(&model, [SIDE; 2], 70_f32.to_radians(), 0.0);
    (0..SAMPLES)
        .map(|_| {
            let shape = render::random_coefficients(model.shape.rank(), &mut rng);
            let albedo = render::random_coefficients(model.albedo.rank(), &mut rng);
            render::draw_mesh(&render::instance(&model, &shape, &albedo), &scene, render::GROUND)
        })
        .collect()
}

impl Objects {
    /// The pictures: samples, a row for each model; and fits, the picture first, then the models'
    /// in its place.
    pub fn sheets(&self) -> [(&'static str, &Picture); 2] {
        let [samples, fits] = &self.sheets;
        [("samples.png", samples), ("fits.png", fits)]
    }

    /// The contents of `objects.json`.
    ///
    /// # Errors
    /// A number that is not finite, naming the field.
    pub fn to_json(&self) -> Result<String> {
        json::to_text(self)
    }

    /// The figures, in Markdown.
    pub fn markdown(&self) -> String {
        let mut text = String::from(
            "| model | components | variance, % | pixel error: landmarks → fit | landmarks off: \
             template → fit, mm |\n|---|---|---|---|---|\n",
        );
        for row in &self.models {
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "| {} | {} + {} | {:.1}, {:.1} | {:.4} → {:.4} | {:.1} → {:.1} |",
                row.kernels,
                row.rank[0],
                row.rank[1],
                100.0 * row.captured[0],
                100.0 * row.captured[1],
                row.pixel_rmse[0],
                row.pixel_rmse[1],
                row.landmark_mm[0],
                row.landmark_mm[1]
            );
        }
        text
    }

    /// The page.
    ///
    /// # Errors
    /// Never in practice.
    pub fn page(&self) -> Result<String> {
        let mut body = String::from("<section>\n<h2>Samples</h2>\n");
        let [(_, samples), (_, fits)] = self.sheets();
        body += &report::figure(
            samples,
            "Four rows of six random instances",
            "Random instances: a row for each model, in the order of the table.",
        )?;
        body += "<h2>Fits</h2>\n";
        body += &report::figure(
            fits,
            "A row for each picture: the picture, then four fits in its place",
            "A row for each picture of an animal that the models have not seen: the picture, and \
             each model's fit drawn over it.",
        )?;
        body += "<table class=\"measures\">\n";
        for (i, line) in self.markdown().lines().enumerate().filter(|(i, _)| *i != 1) {
            let cell = if i == 0 { "th" } else { "td" };
            let cells = line.trim_matches('|').split('|').map(str::trim);
            body += "<tr>";
            for text in cells {
                let _ = write!(body, "<{cell}>{text}</{cell}>");
            }
            body += "</tr>\n";
        }
        body += "</table>\n</section>\n";
        let title = format!("One {} scan", self.kind);
        let lead = "Models of one mesh with simple paint, and fits to pictures of others of its \
                    kind: pose by landmarks, pose and shape by landmarks, everything by the picture.";
        report::essay(&title, lead, &body)
    }
}
