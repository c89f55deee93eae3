//! `onescan recognise`.

use super::output_directory;
use super::running::{stop_on_signals, watch};
use clap::Args;
use onescan::error::{Error, Result};
use onescan::files::publish;
use onescan::interchange::mixture::Mixture;
use onescan::photo;
use onescan::progress::{Console, print};
use onescan::recognition::fits::{Entry, Fits, Source};
use onescan::recognition::output::{Candidate, Ranking, Recognition, Told};
use onescan::recognition::scores::{Face, Score};
use rayon::prelude::*;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

/// Say who is in photos: which faces of a gallery are the most alike.
///
/// The gallery is a directory; the probes are directories, or single ones of what these hold: photos
/// (NAME.jpg), which are fitted first by --model, or earlier fits (NAME/fit.json, as `onescan fit
/// -o GALLERY/NAME` leaves them). Landmarks of photos are found, or read if they are beside (NAME.tlms);
/// of several faces in a photo the largest counts. Faces are compared by the
/// coefficients that fits found, so all must be of one model, or of one mixture: of a mixture the
/// component counts by which two faces are the most alike.
///
/// Prints the nearest of the gallery for every probe, and writes report.html, ranks.csv and ranks.json.
/// What it fits goes to the folder fits beside them: a photo that has been fitted is not fitted again
/// by the same command, so one that was stopped goes on.
///
/// If names say who is who (anna-1.jpg, anna-2.jpg), --person-until - tells how often the first one is
/// right, and how far scores of the same and of other people are apart (d′).
///
/// Examples:
///   onescan recognise people unknown.jpg --model face.3dmm -o who
///   onescan recognise fits/gallery fits/probes -o who --person-until -
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub(super) struct Recognise {
    /// Directory of the faces that are known.
    gallery: PathBuf,
    /// Faces to be recognised: directories, photos or fits.
    #[arg(required = true)]
    probes: Vec<PathBuf>,
    /// The model for photos, or several, or a mixture (.toml).
    #[arg(short, long, num_args = 1..)]
    model: Vec<PathBuf>,
    /// Directory to write to.
    #[arg(short, long)]
    output: PathBuf,
    /// What two faces are compared by.
    #[arg(long, value_enum, default_value_t)]
    score: Score,
    /// Names up to the first of these characters say who it is.
    #[arg(long, value_name = "TEXT", allow_hyphen_values = true)]
    person_until: Option<String>,
}

/// A face, whatever it came from.
struct Known {
    name: String,
    photo: Option<PathBuf>,
    fits: Fits,
    faces: Vec<Face>,
}

impl Recognise {
    pub(super) fn run(self, console: Console) -> Result<()> {
        let gallery = unique(Entry::all(&self.gallery)?)?;
        let probes = self.probes.iter().map(|path| Entry::all(path)).collect::<Result<Vec<_>>>()?;
        let probes = unique(probes.concat())?;
        let is_photo = |entry: &&Entry| matches!(entry.source, Source::Photo(..));
        if let (Some(entry), true) =
            (gallery.iter().chain(&probes).find(is_photo), self.model.is_empty())
        {
            return Err(Error::new(format_args!(
                "{} is a photo, which is fitted first; say by which --model",
                entry.name
            )));
        }
        output_directory(&self.output)?;
        let mixture = Mixture::open(&self.model)?;
        let total = (gallery.len() + probes.len()) as u64;
        let stop = stop_on_signals()?;
        let found = watch(&stop, console.task("fitting", total), |control| {
            let get = |entry: &Entry, folder: &str| {
                let known = self.get(entry, folder, &mixture, control.stop);
                control.steps.fetch_add(1, Ordering::Relaxed);
                known
            };
            let all = |entries: &[Entry], folder: &str| {
                entries
                    .par_iter()
                    .map(|entry| get(entry, folder))
                    .collect::<Result<Option<Vec<_>>>>()
            };
            match all(&gallery, "gallery")? {
                None => Ok(None),
                Some(gallery) => Ok(all(&probes, "probes")?.map(|probes| (gallery, probes))),
            }
        })?;
        let Some((gallery, probes)) = found else {
            return Err(Error::file(
                &self.output,
                "interrupted; the same command goes on from the last photo fitted",
            ));
        };
        let recognition = self.compare(&gallery, &probes)?;
        self.write(&recognition, &gallery, &probes, console)
    }

    /// Reads a fit, or makes it; `None` if it was stopped.
    fn get(
        &self,
        entry: &Entry,
        folder: &str,
        mixture: &Mixture,
        stop: &std::sync::atomic::AtomicBool,
    ) -> Result<Option<Known>> {
        let (fits, photo) = match &entry.source {
            Source::Fit(path) => (Some(Fits::read(path)?), None),
            Source::Photo(photo, landmarks) => {
                let directory = self.output.join("fits").join(folder);
                let path = directory.join(format!("{}.json", entry.name));
                let shown = (photo.as_path(), landmarks.as_deref());
                (Fits::make_or_read(mixture, shown, &path, stop)?, Some(photo.clone()))
            }
        };
        let name = entry.name.clone();
        Ok(fits.map(|fits| Known { name, photo, faces: fits.faces(), fits }))
    }

    fn compare(&self, gallery: &[Known], probes: &[Known]) -> Result<Recognition> {
        let Some(first) = gallery.first() else {
            return Err(Error::file(&self.gallery, "is empty"));
        };
        for other in gallery.iter().chain(probes) {
            let sums = |known: &Known| {
                known.fits.models().map(|(_, sum)| sum.to_owned()).collect::<Vec<_>>()
            };
            if sums(first) != sums(other) {
                let names = |known: &Known| {
                    known
                        .fits
                        .models()
                        .map(|(file, _)| file.to_owned())
                        .collect::<Vec<_>>()
                        .join(", ")
                };
                return Err(Error::new(format_args!(
                    "{} was fitted by {}, {} by {}, which is another model; fit all by the same",
                    first.name,
                    names(first),
                    other.name,
                    names(other)
                )));
            }
        }
        let rank = |probe: &Known| {
            let candidate = |known: &Known| Candidate {
                name: known.name.clone(),
                score: self.score.of_mixture(&probe.faces, &known.faces),
            };
            Ranking::new(probe.name.clone(), gallery.iter().map(candidate).collect())
        };
        let probes: Vec<Ranking> = probes.iter().map(rank).collect();
        let told = self.person_until.as_ref().and_then(|until| {
            let person = |name: &str| name.split(until.as_str()).next().unwrap_or(name).to_owned();
            Told::new(&probes, person)
        });
        let models = first.fits.models().map(|(file, _)| file.to_owned()).collect();
        Ok(Recognition { models, score: self.score, probes, told })
    }

    fn write(
        &self,
        recognition: &Recognition,
        gallery: &[Known],
        probes: &[Known],
        console: Console,
    ) -> Result<()> {
        let picture = |probe: bool, name: &str| {
            let all = if probe { probes } else { gallery };
            let known = all.iter().find(|known| known.name == name)?;
            known.fits.crop()?.cut(&photo::read(known.photo.as_ref()?).ok()?).ok()
        };
        let page = recognition.page(picture)?;
        let files = [
            ("report.html", page),
            ("ranks.csv", recognition.to_csv()),
            ("ranks.json", recognition.to_json()?),
        ];
        let files = files.map(|(name, text)| (name, text.into_bytes()));
        publish(&self.output, &files, &[""; 0], &[])?;
        print(recognition.to_text().trim_end())?;
        if let Some(told) = &recognition.told {
            print(told.line())?;
        }
        console.say(format_args!("open {}", self.output.join("report.html").display()));
        Ok(())
    }
}

/// Refuses two of one name.
fn unique(entries: Vec<Entry>) -> Result<Vec<Entry>> {
    for (i, entry) in entries.iter().enumerate() {
        if entries[..i].iter().any(|other| other.name == entry.name) {
            return Err(Error::new(format_args!(
                "two faces are called {}; rename one, names tell them apart",
                entry.name
            )));
        }
    }
    Ok(entries)
}
