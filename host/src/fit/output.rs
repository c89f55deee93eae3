//! What a fit leaves behind: parameters, meshes and pictures.

use super::{Fit, Job, Schedule, landmarks};
use crate::error::{Error, Result};
#[cfg(feature = "full")]
use crate::files::publish;
use crate::fit::rps::Rps;
use crate::fit::summary::{
    BeforeAfter, LandmarkFound, ModelUsed, PhotoUsed, Proposal, Summaries, Summary, hex,
};
use crate::mesh::ply::{self, Encoding};
use crate::mesh::skin::Skin;
use crate::mesh::{Mesh, glb, obj};
use crate::photo::Crop;
use crate::photo::picture::{self, Picture, Rgb};
use crate::photo::tlms::Tlms;
use crate::render;
use crate::texture::{self, Shot};
use onescan_core::model::Model;
use onescan_core::scene::{Scene, Subject};
use std::fmt::{Display, Write as _};
use std::path::Path;
use std::sync::Arc;

/// Longer side of the face's pictures, pixels.
const SIDE: u32 = 512;
/// Yaw of the side views, radians.
const SIDES: [f32; 2] = [-0.9, 0.9];
/// And of the one that shows the mesh in its skin.
const TURN: f32 = -0.6;

/// Colours of landmarks: where they were marked, the same far off, and where the fit has them.
const MARKED: Rgb = [255, 220, 60];
const ASTRAY: Rgb = [255, 60, 50];
const FITTED: Rgb = [70, 200, 255];

/// Files that only a search writes.
const MASKED: [&str; 2] = ["mask.png", "behind.png"];
/// File that only a fit to found landmarks writes.
const FOUND: [&str; 1] = ["landmarks.tlms"];
/// File that only a mesh with a texture has.
#[cfg(feature = "full")]
const TEXTURED: [&str; 1] = ["mesh.png"];
/// File that only the fit of a mixture writes.
#[cfg(feature = "full")]
const MIXED: [&str; 1] = ["components.json"];
/// Files that only a sampler writes.
#[cfg(feature = "full")]
const SAMPLED: [&str; 6] = [
    "posterior.h5",
    "mean.ply",
    "mean.glb",
    "uncertainty.ply",
    "uncertainty.glb",
    "uncertainty.png",
];

/// What the files are called, with directories as they were given; texts about the fit leave these out.
#[derive(Clone, Debug)]
pub struct Names {
    /// The model's file.
    pub model: String,
    /// What the command was given in place of the model's file, quoted: a mixture, or several models.
    pub given: Option<String>,
    /// Which face was found, by size from 1.
    pub face: u32,
    /// The files of each photo of the subject.
    pub photos: Vec<PhotoNames>,
}

impl Names {
    /// Where the files of one of several photos go: a folder named like it, numbered if another photo
    /// is called the same. Nowhere if there is no such photo.
    pub fn folder(&self, photo: usize) -> String {
        fn stem(names: &PhotoNames) -> &str {
            let name = bare(&names.image);
            name.rsplit_once('.').map_or(name, |(stem, _)| stem)
        }
        let own = self.photos.get(photo).map(stem).unwrap_or_default();
        if self.photos.iter().filter(|names| stem(names) == own).count() > 1 {
            return format!("{}-{own}", photo + 1);
        }
        own.to_owned()
    }
}

/// A file's name without its directories.
fn bare(name: &str) -> &str {
    Path::new(name).file_name().and_then(|name| name.to_str()).unwrap_or(name)
}

/// A name as a shell takes it.
pub fn quoted(name: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./+,:@%=".contains(c);
    if !name.is_empty() && name.chars().all(plain) {
        return name.to_owned();
    }
    format!("'{}'", name.replace('\'', r"'\''"))
}

/// What a photo's files are called.
#[derive(Clone, Debug)]
pub struct PhotoNames {
    /// The photo's file.
    pub image: String,
    /// The file of its landmarks; none if they were found.
    pub landmarks: Option<String>,
    /// The file of its mask, if there is one.
    pub mask: Option<String>,
}

/// A fit with everything that is shown of it.
pub struct Finished {
    /// The numbers.
    pub summary: Summary,
    /// The fitted face: shape in the model's frame, albedo as colours.
    pub mesh: Mesh,
    /// What it looks like, in the colours of all photos of the subject.
    pub skin: Arc<Skin>,
    /// The pictures.
    pub pictures: Pictures,
    /// The landmarks, if they were found.
    pub found: Option<Tlms>,
}

/// Pictures of a fit.
pub struct Pictures {
    /// The part of the photo the fit looked at.
    pub photo: Picture,
    /// The same with the fitted model drawn on it.
    pub on_photo: Picture,
    /// The fitted model alone, as in the photo.
    pub alone: Picture,
    /// The fitted model turned to both sides, under frontal light.
    pub sides: Vec<Picture>,
    /// The mesh in its skin, as in the photo and turned.
    pub textured: [Picture; 2],
    /// The whole photo with the fitted model drawn on it.
    pub whole: Picture,
    /// What hides the face, if the fit was a search for the mode.
    pub masked: Option<Masked>,
    /// How far the shape is known, if a sampler was asked: the mean face from three sides, coloured by
    /// the standard deviation of its vertices.
    #[cfg(feature = "full")]
    pub uncertainty: Option<Picture>,
    /// The landmarks on the photo, and on the model in it: crosses where they were marked, dots where
    /// the fit has them; in red those that are far off.
    pub landmarks: [Picture; 2],
}

/// Pictures of what hides the face.
pub struct Masked {
    /// White where the photo shows the face, black where something hides it or nothing is fitted.
    pub mask: Picture,
    /// The photo with the fitted model drawn behind what hides it.
    pub behind: Picture,
}

/// Draws the pictures and collects the numbers of finished fits to photos of one subject, and bakes its
/// texture.
///
/// # Errors
/// Never, if the fits are of these jobs and there are names for each photo.
pub fn finish(
    jobs: &[Job<'_>],
    fits: &[Fit],
    names: &Names,
    kind: texture::Kind,
) -> Result<Vec<Finished>> {
    let mut results = Vec::new();
    let skin = Arc::new(skin(jobs, fits, kind)?);
    for (i, (job, fit)) in jobs.iter().zip(fits).enumerate() {
        let mut summary = summarize(job, fit, names, i)?;
        if kind != texture::Kind::default() {
            summary.command = format!("{} --texture {kind}", summary.command);
        }
        let subject = &fit.best.scene.subject;
        let mesh = render::instance(job.model, &subject.shape, &subject.albedo);
        let given = names.photos.get(i).and_then(|names| names.landmarks.as_ref());
        results.push(Finished {
            mesh,
            pictures: pictures(job, fit, &summary, &skin)?,
            skin: Arc::clone(&skin),
            summary,
            found: given.is_none().then(|| job.landmarks.clone()),
        });
    }
    Ok(results)
}

/// Bakes what a subject looks like, by all its photos.
///
/// # Errors
/// No photos. Never, if there are some and the fits are of these jobs.
pub fn skin(jobs: &[Job<'_>], fits: &[Fit], kind: texture::Kind) -> Result<Skin> {
    let (Some(job), Some(fit)) = (jobs.first(), fits.first()) else {
        return Err(Error::new("a fit without photos"));
    };
    let subject = &fit.best.scene.subject;
    let mesh = render::instance(job.model, &subject.shape, &subject.albedo);
    let shots: Vec<_> = jobs.iter().zip(fits).map(shot).collect();
    texture::bake(job.model, subject, &mesh, &shots, kind)
}

fn shot<'a>((job, fit): (&'a Job<'_>, &'a Fit)) -> Shot<'a> {
    Shot {
        photo: job.photo,
        crop: fit.crop,
        mask: fit.mode.as_ref().map(|mode| &mode.mask[..]),
        hidden: job.mask,
        view: &fit.best.scene.view,
    }
}

/// Collects the numbers alone.
///
/// # Errors
/// No such photo.
pub fn summarize(job: &Job<'_>, fit: &Fit, names: &Names, photo: usize) -> Result<Summary> {
    let own = names.photos.get(photo).ok_or_else(|| Error::new("a photo without a name"))?;
    let mut parameters = fit.best.scene.clone();
    parameters.view.camera = fit.crop.camera_in_photo(&fit.best.scene.view.camera);
    let config = &job.config;
    let Subject { shape, albedo } = &fit.best.scene.subject;
    let mesh = render::instance(job.model, shape, albedo);
    let landmarks = landmarks::compare(job, fit, &mesh.points);
    Ok(Summary {
        onescan: env!("CARGO_PKG_VERSION").into(),
        command: command(job, names),
        model: ModelUsed {
            file: bare(&names.model).to_owned(),
            checksum: hex(job.model.checksum()),
        },
        image: PhotoUsed {
            file: bare(&own.image).to_owned(),
            size: [job.photo.width, job.photo.height],
            crop: fit.crop,
            landmarks: job.landmarks.visible().count(),
        },
        others: (names.photos.iter().enumerate())
            .filter(|(i, _)| *i != photo)
            .map(|(_, other)| bare(&other.image).to_owned())
            .collect(),
        seed: job.seed,
        fingerprint: hex(fit.fingerprint),
        chains: job.chains,
        landmark_steps: config.landmark_steps,
        shape_steps: config.shape_steps,
        image_steps: config.image_steps,
        steps: fit.steps,
        accepted: fit.accepted,
        steps_per_second: fit.steps_per_second,
        log_likelihood: BeforeAfter {
            initial: finite(fit.initial.density.image),
            best: finite(fit.best.density.image),
        },
        pixel_rmse: BeforeAfter {
            initial: fit.initial_quality.pixel_rmse,
            best: fit.best_quality.pixel_rmse,
        },
        landmark_rmse_px: fit.best_quality.landmark_rmse,
        warnings: landmarks::warnings(job, fit, &landmarks),
        landmarks,
        proposals: fit
            .acceptance
            .iter()
            .map(|a| Proposal {
                phase: a.phase,
                name: a.name.into(),
                proposed: a.tally.proposed.into(),
                accepted: a.tally.accepted.into(),
                steers: a.steers,
            })
            .collect(),
        trace: fit.trace.clone(),
        mode: fit.mode.as_ref().map(|mode| mode.found.clone()),
        #[cfg(feature = "full")]
        laplace: fit.mode.as_ref().and_then(|mode| mode.laplace.clone()),
        #[cfg(feature = "full")]
        mixture: Vec::new(),
        #[cfg(feature = "full")]
        posterior: None,
        parameters,
    })
}

/// The command that repeats the fit.
fn command(job: &Job<'_>, names: &Names) -> String {
    let list = |name: &dyn Fn(&PhotoNames) -> Option<&str>| {
        names.photos.iter().filter_map(name).map(quoted).collect::<Vec<_>>().join(" ")
    };
    let images = list(&|photo| Some(&photo.image));
    let landmarks = list(&|photo| photo.landmarks.as_deref());
    let model = names.given.clone().unwrap_or_else(|| quoted(&names.model));
    let marks =
        if landmarks.is_empty() { String::new() } else { format!(" --landmarks {landmarks}") };
    let mut command = format!("onescan fit {model} {images}{marks} -o fit");
    let size = job.crop.scaled_to[0].max(job.crop.scaled_to[1]);
    let (config, base) = (&job.config, job.schedule.config(job.model, size));
    let mut add = |option: &str, value: &dyn Display, differs: bool| {
        if differs {
            // Writing to a string cannot fail.
            let _ = write!(command, " --{option} {value}");
        }
    };
    add("face", &names.face, names.face != 1);
    let masks = list(&|photo| photo.mask.as_deref());
    add("mask", &masks, !masks.is_empty());
    // Nothing in a search is random.
    add("seed", &job.seed, job.schedule != Schedule::Mode);
    add("schedule", &job.schedule, job.schedule != Schedule::default());
    add("samples", &config.image_steps, config.image_steps != base.image_steps);
    let landmark_steps = config.landmark_steps;
    add("landmark-samples", &landmark_steps, landmark_steps != base.landmark_steps);
    add("shape-samples", &config.shape_steps, config.shape_steps != base.shape_steps);
    add("landmark-sd", &config.landmark_sd, config.landmark_sd != base.landmark_sd);
    add("shape-rank", &config.shape_rank, config.shape_rank != base.shape_rank);
    add("albedo-rank", &config.albedo_rank, config.albedo_rank != base.albedo_rank);
    add("chains", &job.chains, job.chains != 1);
    add("size", &size, size != Crop::LONGER_SIDE);
    add("pixel-patch", &config.pixel_patch, config.pixel_patch != base.pixel_patch);
    command
}

/// JSON holds no infinities: a state that shows nothing of the model has the lowest number.
fn finite(x: f64) -> f64 {
    x.max(f64::MIN)
}

fn pictures(job: &Job<'_>, fit: &Fit, summary: &Summary, skin: &Skin) -> Result<Pictures> {
    let longer = fit.crop.scaled_to[0].max(fit.crop.scaled_to[1]).max(1);
    let shown = |side: u32| (side * SIDE).div_ceil(longer).max(1);
    let crop = Crop { scaled_to: fit.crop.scaled_to.map(shown), ..fit.crop };
    let photo = crop.cut(job.photo)?;
    let mut scene = fit.best.scene.clone();
    scene.view.camera.image_size = crop.scaled_to;
    let sides = SIDES
        .map(|yaw| render::smooth_on(job.model, &turned(job.model, &scene, yaw), render::GROUND));
    let show = |scene: &Scene| {
        render::smooth(scene, |scene, _| Ok(texture::show(job.model, scene, skin, render::GROUND)))
    };
    let mut seen = fit.best.scene.clone();
    seen.view.camera = render::resampled_camera(&seen.view.camera, crop.scaled_to);
    let on_photo = render::smooth_over(job.model, &scene, &photo)?;
    let masked = fit.mode.as_ref().map(|mode| masked(fit.crop, &mode.mask, &photo, &on_photo));
    Ok(Pictures {
        masked,
        #[cfg(feature = "full")]
        uncertainty: None,
        landmarks: marked(&crop, &photo, &on_photo, &summary.landmarks),
        on_photo,
        alone: render::smooth_on(job.model, &scene, render::GROUND),
        sides: sides.into(),
        textured: [show(&seen)?, show(&turned(job.model, &scene, TURN))?],
        whole: render::smooth_over(job.model, &summary.parameters, job.photo)?,
        photo,
    })
}

/// The mask as a picture, and the model behind what it holds to be no face.
fn masked(crop: Crop, mask: &[f32], photo: &Picture, on_photo: &Picture) -> Masked {
    let mask = self::mask(crop, mask).resized(photo.width, photo.height);
    let behind = behind(&mask, photo, on_photo);
    Masked { mask, behind }
}

/// The photo, with the model drawn where the mask says that the face is seen; all three of one size.
pub fn behind(mask: &Picture, photo: &Picture, on_photo: &Picture) -> Picture {
    Picture::from_fn(photo.width, photo.height, |x, y| {
        let [face, model, before] =
            [mask, on_photo, photo].map(|picture| picture.pixel(x, y).unwrap_or_default());
        // A soft edge about one half, for the eye.
        let share = (2.0 * f32::from(face[0]) / 255.0 - 0.5).clamp(0.0, 1.0);
        std::array::from_fn(|c| {
            let [model, before] = [model[c], before[c]].map(f32::from);
            (before + share * (model - before)).round() as u8
        })
    })
}

/// A search's mask as a grey picture of its crop.
pub fn mask(crop: Crop, mask: &[f32]) -> Picture {
    let [width, height] = crop.scaled_to;
    let grey: Vec<[f32; 3]> = mask.iter().map(|&m| [m; 3]).collect();
    Picture::from_unit(width, height, &grey)
}

fn marked(
    crop: &Crop,
    photo: &Picture,
    on_photo: &Picture,
    landmarks: &[LandmarkFound],
) -> [Picture; 2] {
    [photo, on_photo].map(|ground| {
        let mut picture = ground.clone();
        let place = |at: [f64; 2]| crop.to_crop(at).map(|c| c as f32);
        for l in landmarks {
            picture.dot(place(l.fitted), 2, FITTED);
        }
        for l in landmarks {
            picture.cross(place(l.marked), 4, if l.far { ASTRAY } else { MARKED });
        }
        picture
    })
}

/// The fitted face turned, upright, under frontal light.
fn turned(model: &Model<'_>, fitted: &Scene, yaw: f32) -> Scene {
    let portrait = render::portrait(model, [SIDE; 2], yaw, 0.0);
    Scene { subject: fitted.subject.clone(), view: portrait.view }
}

impl Pictures {
    /// `photo | model on photo, behind what hides it`.
    pub fn behind(&self) -> Option<Picture> {
        let masked = self.masked.as_ref()?;
        Some(picture::montage(&[&self.photo, &masked.behind], 8, [255; 3]))
    }

    /// `photo | mesh in its skin | the same turned`.
    pub fn textured(&self) -> Picture {
        let [seen, turned] = self.textured.each_ref();
        picture::montage(&[&self.photo, seen, turned], 8, picture::WHITE)
    }

    /// `photo | model on photo`, with the landmarks.
    pub fn landmarks(&self) -> Picture {
        picture::montage(&self.landmarks.each_ref(), 8, picture::WHITE)
    }

    /// `photo | model on photo | model alone | side views`.
    pub fn overlay(&self) -> Picture {
        picture::overlay(&self.photo, &self.on_photo, &self.alone, &self.sides)
    }
}

/// What a fit leaves behind: file names and contents, but for the report.
///
/// # Errors
/// Never for a fit that [`finish`] made.
pub fn files(result: &Finished) -> Result<Vec<(String, Vec<u8>)>> {
    let rps = Rps {
        scene: result.summary.parameters.clone(),
        model_uri: result.summary.model.file.clone(),
    };
    let mut files: Vec<(String, Vec<u8>)> = vec![
        ("fit.json".into(), result.summary.to_json()?.into_bytes()),
        ("fit.rps".into(), rps.to_text()?.into_bytes()),
        ("overlay.png".into(), result.pictures.overlay().to_png()?),
        ("textured.png".into(), result.pictures.textured().to_png()?),
        ("photo.png".into(), result.pictures.whole.to_png()?),
        ("landmarks.png".into(), result.pictures.landmarks().to_png()?),
    ];
    if let (Some(masked), Some(behind)) = (&result.pictures.masked, result.pictures.behind()) {
        let [mask_name, behind_name] = MASKED;
        files.push((mask_name.into(), masked.mask.to_png()?));
        files.push((behind_name.into(), behind.to_png()?));
    }
    if let Some(found) = &result.found {
        files.push((FOUND[0].into(), found.to_text().into_bytes()));
    }
    files.extend(meshes(result)?);
    Ok(files)
}

fn meshes(Finished { mesh, skin, .. }: &Finished) -> Result<Vec<(String, Vec<u8>)>> {
    let mut ply = Vec::new();
    ply::write(&mut ply, mesh, Encoding::default()).map_err(Error::new)?;
    let mut files = vec![
        ("mesh.ply".into(), ply),
        ("mesh.glb".into(), glb::encode_with(mesh, skin, "fitted face")?),
    ];
    files.extend(obj::files(mesh, skin, "mesh"));
    Ok(files)
}

/// What fits to several photos of one subject leave behind besides each fit's [`files`]: the face, and
/// all numbers.
///
/// # Errors
/// Never for fits that [`finish`] made.
pub fn files_of_all(results: &[Finished]) -> Result<Vec<(String, Vec<u8>)>> {
    let fits = results.iter().map(|result| result.summary.clone()).collect();
    let mut all = vec![("summary.json".into(), Summaries { fits }.to_json()?.into_bytes())];
    if let Some(first) = results.first() {
        all.extend(meshes(first)?);
    }
    Ok(all)
}

/// The file by which others know that a directory holds a fit, and that of fits to several photos.
#[cfg(feature = "full")]
const RESULTS: [&str; 2] = ["fit.json", "summary.json"];

/// Writes [`files`] and `more` into a directory, all or none: fit.json is the last of them. What lies there of
/// an older fit is replaced or removed, but none of the `inputs`.
///
/// # Errors
/// Files that cannot be written, or would replace an input.
#[cfg(feature = "full")]
pub fn write(
    directory: &Path,
    result: &Finished,
    mut more: Vec<(String, Vec<u8>)>,
    inputs: &[&Path],
) -> Result<()> {
    let [own, other] = RESULTS;
    more.extend(files(result)?);
    more.sort_by_key(|(name, _)| *name == own);
    let mut gone = stale(result, true);
    gone.extend(["report.html", other]);
    publish(directory, &more, &gone, inputs)
}

/// Writes what fits to several photos leave behind, each fit's [`files`] to a folder of its own, and
/// `page` as their report; all or none: summary.json is the last.
///
/// # Errors
/// As [`write()`]; the folders must be there.
#[cfg(feature = "full")]
pub fn write_all(
    directory: &Path,
    results: &[Finished],
    folders: &[String],
    mut more: Vec<(String, Vec<u8>)>,
    inputs: &[&Path],
) -> Result<()> {
    let (mut all, mut gone) = (Vec::new(), Vec::new());
    let [single, last] = RESULTS;
    for (result, folder) in results.iter().zip(folders) {
        let within = |name: &str| format!("{folder}/{name}");
        all.extend(files(result)?.into_iter().map(|(name, bytes)| (within(&name), bytes)));
        let old = stale(result, true);
        gone.extend(old.into_iter().chain(["report.html", single]).map(within));
    }
    more.extend(files_of_all(results)?);
    more.sort_by_key(|(name, _)| *name == last);
    all.append(&mut more);
    if let Some(first) = results.first() {
        gone.extend(stale(first, false).into_iter().map(String::from));
    }
    gone.extend(["report.html", single].map(String::from));
    publish(directory, &all, &gone, inputs)
}

/// What an earlier fit may have left in a directory and this one does not write there: its `own`, or of
/// several photos the directory of all.
#[cfg(feature = "full")]
fn stale(result: &Finished, own: bool) -> Vec<&'static str> {
    let unless = |there: bool, names: &'static [&'static str]| if there { &[] } else { names };
    let Finished { summary, skin, pictures, found, .. } = result;
    [
        unless(own && pictures.masked.is_some(), &MASKED),
        unless(own && found.is_some(), &FOUND),
        unless(skin.textured(), &TEXTURED),
        unless(summary.posterior.is_some(), &SAMPLED),
        unless(!summary.mixture.is_empty(), &MIXED),
    ]
    .concat()
}

/// One line that says how the fit went.
pub fn closing_line(summary: &Summary) -> String {
    let percent = |part: f64| 100.0 * part;
    let BeforeAfter { initial, best } = summary.pixel_rmse;
    let error = match &summary.mode {
        Some(mode) => format!("{:.1} % where the face is seen", percent(mode.seen_rmse)),
        None => format!("{:.1} % (before: {:.1} %)", percent(best), percent(initial)),
    };
    let [width, height] = summary.image.crop.scaled_to;
    format!(
        "{}: colours off by {error}, landmarks by {:.1} px of {width}×{height}; fingerprint {}",
        summary.image.file, summary.landmark_rmse_px, summary.fingerprint
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_quoted_as_shells_want_it() {
        assert_eq!(quoted("photos/a-1.png"), "photos/a-1.png");
        assert_eq!(quoted("my photo.png"), "'my photo.png'");
        assert_eq!(quoted("it's"), r"'it'\''s'");
        assert_eq!(bare("photos/a.png"), "a.png");
    }
}
