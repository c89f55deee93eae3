//! Fits of photos and of directories of them, made or read.
//!
//! In a directory each of these is a face, called what stands for `NAME`:
//!
//! | | what |
//! |---|---|
//! | `NAME.jpg`, `.jpeg`, `.png` | a photo, which is to be fitted: to the landmarks in `NAME.tlms` or `.pts`, if there are, or to those found |
//! | `NAME/fit.json`, `NAME/components.json` | what `onescan fit` left, of a model or of a mixture |
//! | `NAME.json` | what [`Fits::write`] left |

use super::scores::Face;
use crate::error::{Error, Result};
use crate::face_mesh::Marked;
use crate::files::{folder, has_extension, read_text, write_atomically};
use crate::fit::output::{Names, PhotoNames, summarize};
use crate::fit::summary::{Summaries, Summary, hex};
use crate::fit::{Control, Fit, Job, find_mode};
use crate::interchange::mixture::Mixture;
use crate::photo::Crop;
use std::fs::metadata;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64};

/// Runs a search for the mode; `None` if it was stopped.
///
/// # Errors
/// Those of [`find_mode`].
pub fn run(job: &Job<'_>, stop: &AtomicBool) -> Result<Option<Fit>> {
    let control = Control { stop, steps: &AtomicU64::new(0) };
    let found = find_mode(std::slice::from_ref(job), &control)?;
    Ok(found.and_then(|fits| fits.into_iter().next()))
}

/// What shows a face.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Source {
    /// A photo, and its landmarks if they are known.
    Photo(PathBuf, Option<PathBuf>),
    /// A fit's numbers.
    Fit(PathBuf),
}

/// A face of a directory.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Entry {
    /// Its name.
    pub name: String,
    /// What shows it.
    pub source: Source,
}

const PHOTOS: [&str; 3] = ["jpg", "jpeg", "png"];
const LANDMARKS: [&str; 2] = ["tlms", "pts"];

impl Entry {
    /// The faces of a directory, sorted by name; or the single face of a photo or a fit.
    ///
    /// # Errors
    /// Nothing there.
    pub fn all(path: &Path) -> Result<Vec<Self>> {
        if let Some(one) = Self::of(path) {
            return Ok(vec![one]);
        }
        let entries = std::fs::read_dir(path).map_err(|e| {
            let what = "neither a directory of photos or fits, nor one of them";
            let e = if path.is_file() { what.into() } else { e.to_string() };
            Error::file(path, format_args!("{e}; see onescan recognise --help"))
        })?;
        let mut all = Vec::new();
        for entry in entries {
            let entry = entry.map_err(|e| Error::file(path, e))?.path();
            all.extend(Self::of(&entry));
        }
        if all.is_empty() {
            return Err(Error::file(
                path,
                "has no photos (.jpg, .png) and no fits (NAME/fit.json)",
            ));
        }
        all.sort();
        Ok(all)
    }

    /// `None` if the path is neither a photo nor a fit.
    fn of(path: &Path) -> Option<Self> {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let files = ["components.json", "fit.json"].map(|file| path.join(file));
            let found = files.into_iter().find(|file| file.is_file());
            return found.map(|file| Self { name, source: Source::Fit(file) });
        }
        if has_extension(path, &["json"]) {
            return Some(Self { name, source: Source::Fit(path.to_path_buf()) });
        }
        if !has_extension(path, &PHOTOS) {
            return None;
        }
        let beside = LANDMARKS.map(|extension| path.with_extension(extension));
        let landmarks = beside.into_iter().find(|file| file.is_file());
        Some(Self { name, source: Source::Photo(path.to_path_buf(), landmarks) })
    }
}

/// The fits of a photo by a model, or by all components of a mixture.
#[derive(Clone, Debug, PartialEq)]
pub struct Fits(Vec<Summary>);

impl Fits {
    /// Reads a fit's file.
    ///
    /// # Errors
    /// A file that cannot be read or holds no fit.
    pub fn read(path: &Path) -> Result<Self> {
        let text = read_text(path)?;
        let fault = |e| Error::file(path, e);
        if path.file_name().is_some_and(|name| name == "fit.json") {
            return Ok(Self(vec![Summary::parse(&text).map_err(fault)?]));
        }
        let found = Summaries::parse(&text).map_err(fault)?;
        if found.fits.is_empty() {
            return Err(Error::file(path, "holds no fit"));
        }
        Ok(Self(found.fits))
    }

    /// Writes them, whole or not at all.
    ///
    /// # Errors
    /// A place that cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = Summaries { fits: self.0.clone() }.to_json()?;
        write_atomically(path, |out| out.write_all(text.as_bytes()))
    }

    /// Fits a photo; `None` if it was stopped.
    ///
    /// # Errors
    /// Files that cannot be read, a photo without a face; those of [`Job::new`] and [`find_mode`], which name
    /// the landmarks.
    pub fn make(
        mixture: &Mixture,
        (photo, landmarks): (&Path, Option<&Path>),
        stop: &AtomicBool,
    ) -> Result<Option<Self>> {
        let name = |path: &Path| {
            path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
        };
        let photos =
            vec![PhotoNames { image: name(photo), landmarks: landmarks.map(name), mask: None }];
        let (picture, marked) = Marked::with_photo(photo, landmarks)?;
        let fault = |e: Error| Error::file(landmarks.unwrap_or(photo), e);
        let (mut all, mut crop) = (Vec::new(), None);
        for component in &mixture.components {
            let model = component.model.view();
            let names: Vec<_> = model.landmarks().map(|(name, _)| name).collect();
            let points = marked.known(&names).map_err(fault)?;
            let mut job = Job::new(&model, &picture, &points).map_err(fault)?;
            job.crop = *crop.get_or_insert(job.crop);
            let Some(fit) = run(&job, stop).map_err(fault)? else { return Ok(None) };
            let (model, photos) = (component.name.clone(), photos.clone());
            let names = Names { model, given: None, face: 1, photos };
            let mut summary = summarize(&job, &fit, &names, 0)?;
            summary.warnings.extend(marked.doubt.clone());
            all.push(summary);
        }
        Ok(Some(Self(all)))
    }

    /// The fits of a file, if it holds fits by these models that are younger than the photo and its landmarks;
    /// else makes them, as [`Fits::make`], and writes the file.
    ///
    /// # Errors
    /// Those of [`Fits::make`]; a place that cannot be written.
    pub fn make_or_read(
        mixture: &Mixture,
        (photo, landmarks): (&Path, Option<&Path>),
        path: &Path,
        stop: &AtomicBool,
    ) -> Result<Option<Self>> {
        let age = |path: &Path| metadata(path).and_then(|m| m.modified()).ok();
        let young = age(path) > age(photo) && landmarks.is_none_or(|file| age(path) > age(file));
        if let (true, Ok(known)) = (young, Self::read(path)) {
            let models = mixture.components.iter().map(|c| hex(c.model.view().checksum()));
            if known.models().map(|(_, checksum)| checksum.to_owned()).eq(models) {
                return Ok(Some(known));
            }
        }
        let made = Self::make(mixture, (photo, landmarks), stop)?;
        if let Some(made) = &made {
            let folder = folder(path);
            std::fs::create_dir_all(folder).map_err(|e| Error::file(folder, e))?;
            made.write(path)?;
        }
        Ok(made)
    }

    /// The part of the photo that was looked at.
    pub fn crop(&self) -> Option<Crop> {
        self.0.first().map(|fit| fit.image.crop)
    }

    /// File and checksum of the models.
    pub fn models(&self) -> impl Iterator<Item = (&str, &str)> {
        self.0.iter().map(|fit| (&*fit.model.file, &*fit.model.checksum))
    }

    /// The face as each of the models has it.
    pub fn faces(&self) -> Vec<Face> {
        self.0.iter().map(Face::of_summary).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_directory_holds_photos_and_fits() {
        let place = tempfile::tempdir().unwrap();
        let at = |name: &str| place.path().join(name);
        fs::create_dir(at("dora")).unwrap();
        fs::create_dir(at("nobody")).unwrap();
        for name in ["anna.JPG", "anna.tlms", "ben.png", "ben.pts", "carl.json", "dora/fit.json"] {
            fs::write(at(name), "").unwrap();
        }
        let found = Entry::all(place.path()).unwrap();
        let names: Vec<&str> = found.iter().map(|entry| &*entry.name).collect();
        assert_eq!(names, ["anna", "ben", "carl", "dora"]);
        assert_eq!(found[1].source, Source::Photo(at("ben.png"), Some(at("ben.pts"))));
        assert_eq!(found[3].source, Source::Fit(at("dora/fit.json")));
        assert_eq!(Entry::all(&at("dora")).unwrap(), found[3..]);
        assert_eq!(Entry::all(&at("anna.JPG")).unwrap(), found[..1]);

        fs::remove_file(at("ben.pts")).unwrap();
        let found = Entry::all(place.path()).unwrap();
        assert_eq!(found[1].source, Source::Photo(at("ben.png"), None));
        let error = Entry::all(&at("nobody")).unwrap_err().to_string();
        assert!(error.contains("has no photos (.jpg, .png) and no fits"), "{error}");
    }
}
