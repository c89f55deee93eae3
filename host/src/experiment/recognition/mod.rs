//! Face recognition (paper, section of that name): the same people at other angles, told by what fits
//! find.
//!
//! The gallery is made of pictures at 0°, the probes of pictures at 15, 30 and 45°, each in a light of
//! its own. The work is a list of jobs ([`Plan::jobs`]): one model fitted to all pictures of one angle
//! of one set. Every job writes one file, whole or not at all, and needs no other job; so any program
//! that runs commands of a list may run them, here or elsewhere.

pub mod models;
pub mod page;
pub mod people;
pub mod results;

use crate::error::{Error, Result};
use crate::files::{self, write_atomically};
use crate::fit::{self, Control};
use crate::model::decompose::Progress;
use crate::model_file::OwnedModel;
use crate::photo;
use crate::photo::picture::Picture;
use crate::photo::tlms::Tlms;
use crate::recognition::fits;
use crate::recognition::scores::Face;
use flate2::Crc;
use models::Named;
use people::Crowd;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

/// Angles of the pictures, degrees: the gallery's, then the probes'.
pub const YAWS: [u32; 4] = [0, 15, 30, 45];

/// What is to be done.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Directory of the results.
    pub output: PathBuf,
    /// Directory of the project's fixtures.
    pub fixtures: PathBuf,
    /// Directory of rough pictures `PERSON_YAW.jpg` with their landmarks, if they are to be fitted.
    pub pictures: Option<PathBuf>,
    /// The models, in the table's order.
    pub models: Vec<Named>,
    /// Components of models of kernels.
    pub rank: usize,
    /// Synthetic people, clean pictures of whom are fitted.
    pub people: usize,
    /// Their seed.
    pub seed: u64,
}

/// A set of pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Set {
    /// Rendered, of synthetic people.
    Clean,
    /// From a directory.
    Rough,
}

impl fmt::Display for Set {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Clean => "clean",
            Self::Rough => "rough",
        })
    }
}

/// One model, fitted to all pictures of one angle of one set. Displays as `SET/MODEL/YAW`.
#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    /// The set.
    pub set: Set,
    /// The model.
    pub model: Named,
    /// The angle.
    pub yaw: u32,
}

impl fmt::Display for Job {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{:02}", self.set, self.model.name, self.yaw)
    }
}

/// The result of a job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fitted {
    /// What was asked for, see [`Plan::about`].
    about: String,
    /// Persons by number, and their faces.
    pub faces: Vec<(u32, Face)>,
}

impl Plan {
    /// The sets there are.
    pub fn sets(&self) -> impl Iterator<Item = Set> {
        let clean = (self.people > 0).then_some(Set::Clean);
        clean.into_iter().chain(self.pictures.is_some().then_some(Set::Rough))
    }

    /// All jobs, those of a model one after the other.
    pub fn jobs(&self) -> Vec<Job> {
        let mut jobs = Vec::new();
        for set in self.sets() {
            for model in &self.models {
                jobs.extend(YAWS.map(|yaw| Job { set, model: model.clone(), yaw }));
            }
        }
        jobs
    }

    /// Where the result of a job goes.
    pub fn file(&self, job: &Job) -> PathBuf {
        self.output.join("fits").join(format!("{job}.bin"))
    }

    /// What a job's result depends on, to know one of other settings.
    fn about(&self, job: &Job) -> Result<String> {
        let pictures = match job.set {
            Set::Clean => format!("{} people of seed {}", self.people, self.seed),
            Set::Rough => {
                let sources = self.sources(job.set, job.yaw)?;
                let mut sum = Crc::new();
                for path in sources.iter().filter_map(|(_, path)| path.as_ref()) {
                    for path in [path, &path.with_extension("tlms")] {
                        sum.update(&files::read(path).map_err(|e| Error::file(path, e))?);
                    }
                }
                format!("{} pictures of checksum {:08x}", sources.len(), sum.sum())
            }
        };
        let version = env!("CARGO_PKG_VERSION");
        Ok(format!("onescan {version}: {job}, rank {}, {pictures}", self.rank))
    }

    /// The result of a job; `None` if it has not been done.
    ///
    /// # Errors
    /// A file that cannot be read, or is of other settings.
    pub fn read(&self, job: &Job) -> Result<Option<Fitted>> {
        let path = self.file(job);
        let bytes = match files::read(&path) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            bytes => bytes.map_err(|e| Error::file(&path, e))?,
        };
        let damaged =
            |e| Error::file(&path, format_args!("{e}; remove it, and the job is done again"));
        let fitted: Fitted = postcard::from_bytes(&bytes).map_err(damaged)?;
        let about = self.about(job)?;
        if fitted.about != about {
            return Err(Error::file(
                &path,
                format_args!(
                    "is of {}, not of {about}; give another -o, or remove it",
                    fitted.about
                ),
            ));
        }
        Ok(Some(fitted))
    }

    /// The model of a job, which is built unless it lies in the directory of results.
    fn model(&self, named: &Named, progress: &mut Progress<'_>) -> Result<OwnedModel> {
        let directory = self.output.join("models");
        let path = directory.join(format!("{}-{}.3dmm", named.name, self.rank));
        if path.exists() {
            return OwnedModel::read(&path);
        }
        make(&directory)?;
        let model = named.build(&self.fixtures, self.rank, progress)?;
        model.write(&path)?;
        Ok(model)
    }

    /// Persons of a set at an angle, and the files that show them, if they are not rendered.
    fn sources(&self, set: Set, yaw: u32) -> Result<Vec<(u32, Option<PathBuf>)>> {
        match (set, &self.pictures) {
            (Set::Rough, Some(directory)) => {
                let of = pictures(directory)?.into_iter().filter(|picture| picture.yaw == yaw);
                Ok(of.map(|picture| (picture.person, Some(picture.path))).collect())
            }
            _ => Ok((0..self.people as u32).map(|person| (person, None)).collect()),
        }
    }

    /// Does a job, unless its result is there, on rayon's threads; `false` if it was stopped. A picture
    /// done counts as a step.
    ///
    /// # Errors
    /// Pictures or fixtures that cannot be read, a place that cannot be written.
    pub fn run(&self, job: &Job, control: &Control<'_>) -> Result<bool> {
        let sources = self.sources(job.set, job.yaw)?;
        if self.read(job)?.is_some() {
            control.steps.fetch_add(sources.len() as u64, Ordering::Relaxed);
            return Ok(true);
        }
        let path = self.file(job);
        make(path.parent().unwrap_or(&self.output))?;
        let file = self.model(&job.model, &mut |_, _| ())?;
        let model = file.view();
        let crowd = Crowd::new(&self.fixtures, self.seed)?;
        let fit = |(person, file): &(u32, Option<PathBuf>)| -> Result<Option<(u32, Face)>> {
            if control.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            let (photo, landmarks) = match file {
                Some(path) => read(path)?,
                None => crowd.picture(*person as usize, job.yaw)?,
            };
            let fit = fits::run(&fit::Job::new(&model, &photo, &landmarks)?, control.stop)?;
            control.steps.fetch_add(1, Ordering::Relaxed);
            Ok(fit.map(|fit| (*person, Face::of_fit(&fit))))
        };
        let faces = sources.par_iter().map(fit).collect::<Result<Option<Vec<_>>>>()?;
        let Some(faces) = faces else { return Ok(false) };
        let bytes =
            postcard::to_stdvec(&Fitted { about: self.about(job)?, faces }).map_err(Error::new)?;
        write_atomically(&path, |out| out.write_all(&bytes))?;
        Ok(true)
    }

    /// How many pictures a job fits.
    ///
    /// # Errors
    /// A directory of pictures that cannot be read.
    pub fn size(&self, job: &Job) -> Result<u64> {
        Ok(self.sources(job.set, job.yaw)?.len() as u64)
    }
}

/// Makes a directory.
fn make(directory: &Path) -> Result<()> {
    std::fs::create_dir_all(directory).map_err(|e| {
        Error::file(directory, format_args!("cannot write here: {e}; choose another -o directory"))
    })
}

/// A picture `PERSON_YAW.jpg` of a directory.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Rough {
    /// Number of the person.
    pub person: u32,
    /// Angle, degrees.
    pub yaw: u32,
    /// The file.
    pub path: PathBuf,
}

/// All pictures `PERSON_YAW.jpg` of a directory, sorted.
///
/// # Errors
/// A directory that cannot be read or has none.
pub fn pictures(directory: &Path) -> Result<Vec<Rough>> {
    let entries = std::fs::read_dir(directory).map_err(|e| {
        Error::file(directory, format_args!("{e}; expected a directory of PERSON_YAW.jpg"))
    })?;
    let mut all = Vec::new();
    for entry in entries {
        let path = entry.map_err(|e| Error::file(directory, e))?.path();
        let named = path.file_stem().and_then(|stem| stem.to_str()?.split_once('_'));
        let numbers = named.and_then(|(p, y)| Some((p.parse().ok()?, y.parse().ok()?)));
        if let (Some((person, yaw)), Some("jpg")) =
            (numbers, path.extension().and_then(|e| e.to_str()))
        {
            all.push(Rough { person, yaw, path });
        }
    }
    if all.is_empty() {
        return Err(Error::file(directory, "has no pictures PERSON_YAW.jpg, such as 07_30.jpg"));
    }
    all.sort();
    Ok(all)
}

/// A photo and the landmarks beside it.
fn read(path: &Path) -> Result<(Picture, Tlms)> {
    let photo = photo::read(path)?;
    let landmarks = Tlms::read(&path.with_extension("tlms"), [photo.width, photo.height])?;
    Ok((photo, landmarks))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_is_of_its_pictures() {
        let place = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(place.path().join(name), text).unwrap();
        for name in ["07_30.jpg", "07_30.tlms", "07_45.jpg", "07_45.tlms"] {
            write(name, name);
        }
        let plan = Plan {
            output: place.path().into(),
            fixtures: place.path().into(),
            pictures: Some(place.path().into()),
            models: Named::all(),
            rank: 2,
            people: 0,
            seed: 7,
        };
        let job = Job { set: Set::Rough, model: Named::all().remove(0), yaw: 30 };
        let about = || plan.about(&job).unwrap();
        let first = about();
        assert!(first.contains("1 pictures of checksum"), "{first}");
        write("07_45.jpg", "another angle");
        assert_eq!(about(), first);
        write("07_30.tlms", "other landmarks");
        assert_ne!(about(), first);
        std::fs::remove_file(place.path().join("07_30.tlms")).unwrap();
        assert!(plan.about(&job).unwrap_err().to_string().contains("07_30.tlms"));
    }
}
