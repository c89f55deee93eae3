//! Photos, and what each of the experiments' models makes of them (the paper's figures of
//! reconstructions: in the photo, from the side, and where the face is hidden).

use super::recognition::models::Named;
use super::stages::{Stages, packed, unpacked};
use crate::error::{Error, Result};
use crate::face_mesh::Marked;
use crate::fit::output::{behind, mask};
use crate::fit::{Fit, Job};
use crate::model::decompose::Progress;
use crate::photo::Crop;
use crate::photo::caption::captioned;
use crate::photo::picture::{Picture, WHITE, contact_sheet};
use crate::recognition::fits;
use crate::render;
use crate::report;
use onescan_core::hash::fnv64;
use onescan_core::model::Model;
use onescan_core::scene::Scene;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Longer side of a picture of a sheet, pixels.
const SIDE: u32 = 256;
/// Yaw of the side views, radians: as in the report of a fit.
const TURN: f32 = 0.9;
/// Gap between pictures, pixels.
const GAP: u32 = 4;

/// A photo to fit.
pub struct Subject {
    name: String,
    photo: Picture,
    landmarks: Marked,
}

impl Subject {
    /// What a fit of it depends on, hashed.
    pub fn hash(&self) -> u64 {
        let text = self.landmarks.landmarks.to_text();
        fnv64(self.photo.rgb.as_flattened()) ^ fnv64(text.as_bytes())
    }

    /// Reads a photo, and its landmarks; without a file of them they are found.
    ///
    /// # Errors
    /// Files that cannot be read, a photo without a face.
    pub fn read(photo: &Path, landmarks: Option<&Path>) -> Result<Self> {
        let name = photo.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let (photo, landmarks) = Marked::with_photo(photo, landmarks)?;
        Ok(Self { name, photo, landmarks })
    }
}

/// The sheets: a column for each photo. The first row has the photos, every other one a model.
pub struct Sheets {
    /// The model drawn on the photo.
    pub seen: Picture,
    /// Turned.
    pub turned: Picture,
    /// Two rows a model: what it takes for the face, white; and drawn behind what is none.
    pub masks: Picture,
}

/// What a model makes of a photo.
struct Views {
    seen: Picture,
    turned: Picture,
    mask: Picture,
    behind: Picture,
}

/// Fits all models to all photos, with all components.
///
/// # Errors
/// Fixtures that cannot be read; those of building and fitting, which name the photo.
pub fn run(
    subjects: &[Subject],
    models: &[Named],
    (fixtures, rank): (&Path, usize),
    stages: &Stages,
    progress: &mut Progress<'_>,
) -> Result<Sheets> {
    let steps = (models.len() * (1 + subjects.len())) as f64;
    let mut done = 0.0;
    let [mut seen, mut turned, mut masks] = [const { Vec::new() }; 3];
    for named in models {
        let kept = stages.stage(&named.name, || {
            let file = named.build(fixtures, rank, &mut |part, _| {
                progress((done + part) / steps, &named.name);
            })?;
            let mut all = Vec::new();
            for (i, subject) in subjects.iter().enumerate() {
                let part = (done + 1.0 + i as f64) / steps;
                progress(part, &format!("{}: {}", named.name, subject.name));
                let Views { seen, turned, mask, behind } = fit(&file.view(), subject)
                    .map_err(|e| Error::new(format_args!("{}: {e}", subject.name)))?;
                all.push(packed(&[seen, turned, mask, behind])?);
            }
            Ok(all)
        })?;
        done += (1 + subjects.len()) as f64;
        let mut hidden = Vec::new();
        for views in kept {
            let views = unpacked(&views)?;
            let [on_photo, from_side, mask, behind] = &views[..] else { continue };
            seen.push(captioned(on_photo, &named.name));
            turned.push(captioned(from_side, &named.name));
            masks.push(mask.clone());
            hidden.push(captioned(behind, &named.name));
        }
        masks.append(&mut hidden);
    }
    let photos: Vec<Picture> = subjects.iter().map(first).collect::<Result<_>>()?;
    let sheet = |rows: &[Picture]| {
        let all: Vec<&Picture> = photos.iter().chain(rows).collect();
        contact_sheet(&all, subjects.len(), GAP, WHITE)
    };
    Ok(Sheets { seen: sheet(&seen), turned: sheet(&turned), masks: sheet(&masks) })
}

/// Its name below the part of a photo that a fit looks at, as large as in the sheets.
fn first(subject: &Subject) -> Result<Picture> {
    let Subject { name, photo, landmarks } = subject;
    let points = landmarks.landmarks.visible_points();
    let crop = Crop::around(&points, [photo.width, photo.height], Crop::ENLARGE, SIDE)?;
    Ok(captioned(&square(&crop.cut(photo)?), name))
}

/// In the middle of a square.
fn square(picture: &Picture) -> Picture {
    let mut square = Picture::filled(SIDE, SIDE, WHITE);
    let shift = [picture.width, picture.height].map(|side| SIDE.saturating_sub(side) / 2);
    square.paste(picture, shift[0], shift[1]);
    square
}

fn fit(model: &Model<'_>, subject: &Subject) -> Result<Views> {
    let names: Vec<_> = model.landmarks().map(|(name, _)| name).collect();
    let landmarks = subject.landmarks.known(&names)?;
    let job = Job::new(model, &subject.photo, &landmarks)?;
    let fit = fits::run(&job, &AtomicBool::new(false))?;
    let Some(Fit { crop, best, mode: Some(mode), .. }) = fit else {
        return Err(Error::new("the search was stopped"));
    };
    let longer = crop.scaled_to[0].max(crop.scaled_to[1]).max(1);
    let shown = Crop { scaled_to: crop.scaled_to.map(|side| side * SIDE / longer), ..crop };
    let photo = shown.cut(&subject.photo)?;
    let mut scene = best.scene;
    scene.view.camera = render::resampled_camera(&scene.view.camera, shown.scaled_to);
    let seen = render::smooth_over(model, &scene, &photo)?;
    let mask = mask(crop, &mode.mask).resized(photo.width, photo.height);
    let behind = behind(&mask, &photo, &seen);
    let portrait = render::portrait(model, [SIDE; 2], TURN, 0.0);
    let turned = Scene { subject: scene.subject, view: portrait.view };
    Ok(Views {
        seen: square(&seen),
        turned: render::smooth_on(model, &turned, render::GROUND),
        mask: square(&mask),
        behind: square(&behind),
    })
}

impl Sheets {
    /// The sheets by file name.
    pub fn files(&self) -> [(&'static str, &Picture); 3] {
        [("seen.png", &self.seen), ("turned.png", &self.turned), ("masks.png", &self.masks)]
    }

    /// The page.
    ///
    /// # Errors
    /// Never in practice.
    pub fn page(&self) -> Result<String> {
        let mut body = String::new();
        for (heading, picture, caption) in [
            (
                "In the photo",
                &self.seen,
                "The models drawn on the photos: all of the model, also where the face is hidden.",
            ),
            ("From the side", &self.turned, "The same, turned, under frontal light."),
            (
                "What is hidden",
                &self.masks,
                "For every model what the fit takes for the face (white), and the model drawn behind the rest.",
            ),
        ] {
            body += "<section>\n<h2>";
            body += heading;
            body += "</h2>\n";
            body += &report::figure(picture, heading, caption)?;
            body += "</section>\n";
        }
        report::essay(
            "Photos and models",
            "The same photos, fitted by one model after the other.",
            &body,
        )
    }
}

/// Photos with the landmarks beside them, of paths of photos and of directories.
///
/// # Errors
/// Nothing there, or no photo.
pub fn photos(paths: &[PathBuf]) -> Result<Vec<(PathBuf, Option<PathBuf>)>> {
    let mut all = Vec::new();
    for path in paths {
        let entries = fits::Entry::all(path)?;
        let before = all.len();
        all.extend(entries.into_iter().filter_map(|entry| match entry.source {
            fits::Source::Photo(photo, landmarks) => Some((photo, landmarks)),
            fits::Source::Fit(_) => None,
        }));
        if all.len() == before {
            return Err(Error::file(path, "is no photo (.jpg, .png), and holds none"));
        }
    }
    Ok(all)
}
