//! `onescan fit`.

use super::running::{Checkpoint, interrupted, stop_on_signals, watch};
use super::{output_directory, typed};
use clap::Args;
use onescan::error::{Error, Result};
use onescan::face_mesh::Marked;
use onescan::files::{FileKind, has_extension};
use onescan::fit::checkpoint::Save;
use onescan::fit::output::{self, Finished, Names, PhotoNames, quoted};
use onescan::fit::summary::{ComponentFound, Summaries};
use onescan::fit::{self, Ending, Job, Schedule, find_mode};
use onescan::interchange::mixture::Mixture;
use onescan::photo::picture::Picture;
use onescan::photo::tlms::Tlms;
use onescan::photo::{self, Crop};
use onescan::posterior::output::Spread;
use onescan::posterior::{self, Request, sample_kept, warning};
use onescan::progress::Console;
use onescan::report;
use onescan::texture::Kind;
use onescan_core::chain::Config;
use onescan_core::model::Model;
use onescan_core::scene::MAX_RANK;
use onescan_core::search::unknowns::MAX_PHOTOS;
use std::path::{Path, PathBuf};
use std::slice::from_ref;
use std::sync::atomic::AtomicBool;

/// Fit a model to a photo, or to several photos of one person.
///
/// Landmarks say where the face is. It finds them itself (as `onescan landmarks` does), or takes those
/// of --landmarks. Of several faces in a photo the largest is fitted, or another by --face.
///
/// Searches for the mode of the posterior of pose, camera, light, colour, shape and albedo: some
/// thirty steps on everything at once, each with a mask of what hides the face. Or, with --schedule
/// paper or sampler, runs a chain.
///
/// Writes to the output directory: report.html, overlay.png and photo.png (the model on the photo),
/// landmarks.png; mesh.glb (the face with a texture from the photo), the same as mesh.obj with mesh.mtl
/// and mesh.png, mesh.ply (with its albedo), textured.png; fit.json and fit.rps (all parameters); of a
/// search mask.png (white: the face is seen) and behind.png (the model behind what hides it) as well.
///
/// Of several photos (2 to 8; with --landmarks as many files, in the same order) it finds one face, and
/// each photo's pose, camera and light: more views show more of the shape. Each photo's files then go
/// to a folder named like it; report.html, summary.json and the meshes stand beside.
///
/// Example: onescan fit face.3dmm a.jpg b.jpg -o out
///
/// Of several models, or of a mixture of them (.toml, see `onescan model mix`), each is fitted, and the
/// likeliest given the photo is kept: by the marginal likelihood in Laplace's approximation. fit.json
/// and the report say how likely each is; components.json holds the numbers of all fits.
///
/// Example: onescan fit anna.3dmm ben.3dmm photo.jpg -o out
///
/// With --posterior N it samples the posterior around that, and writes to the output directory
/// posterior.h5 (all states), mean.ply and mean.glb (the posterior's mean face), uncertainty.ply,
/// uncertainty.glb and uncertainty.png (how far each vertex is known); fit.json then holds every
/// parameter's 90 % interval and whether the chains have mixed.
///
/// Landmarks are in pixels of the photo, y down, left the subject's left. Those far from where the
/// fit has them are named; a search bears a wrong one or two. Those it found itself are written to
/// landmarks.tlms: move what is off (landmarks.png shows it), and give that file to --landmarks.
///
/// A chain saves a checkpoint there every few seconds, and when Ctrl-C ends it; --resume goes on from
/// it, with the same result as without the interruption. A search takes seconds and is made again, and
/// so is the warm-up of --posterior.
#[derive(Args)]
pub(super) struct Fit {
    /// The model, with landmarks: .3dmm, .h5 or .h5.json; or a mixture of models, .toml.
    model: PathBuf,
    /// The photo, or photos of one person, PNG or JPEG; before them more models, if there are any.
    #[arg(num_args = 1..)]
    images: Vec<PathBuf>,
    /// The models after the first.
    #[arg(skip)]
    more: Vec<PathBuf>,
    /// What speaks against each photo's landmarks.
    #[arg(skip)]
    doubts: Vec<Option<String>>,
    /// Landmarks in the photo: .tlms (lines of `name visible x y`), .pts (68 points, or dlib's 5), or
    /// .json (MediaPipe's face mesh); a file per photo [default: found].
    #[arg(long, num_args = 1..)]
    landmarks: Vec<PathBuf>,
    /// Which face to fit, by size in the photo: 1 is the largest [default: 1].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), conflicts_with = "landmarks")]
    face: Option<u32>,
    /// Directory to write to.
    #[arg(short, long)]
    output: PathBuf,
    /// What hides the face in the photo: a picture of the whole photo's size, PNG or JPEG, black where
    /// the face cannot be seen (a hand, a microphone), white where it may; grey counts in part. Hair
    /// and glasses need none. (The mask.png that fits write is of the cut-out, and no such picture.) Of
    /// several photos, a file per photo.
    #[arg(long, value_name = "FILE", num_args = 1..)]
    mask: Vec<PathBuf>,
    /// How to fit.
    #[arg(long, value_enum, default_value_t)]
    schedule: Schedule,
    /// Seed of a chain's randomness; nothing in a search is random.
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// How exact landmarks are: standard deviation, pixels of the picture the fit looks at
    /// [default: 4 at --size 256, at others in proportion].
    #[arg(long, value_parser = deviation, allow_negative_numbers = true)]
    landmark_sd: Option<f32>,
    /// Shape coefficients to infer, the leading ones [default: all of the model, at most 200; of a
    /// chain 50].
    #[arg(long, value_parser = rank())]
    shape_rank: Option<u32>,
    /// Albedo coefficients to infer, likewise.
    #[arg(long, value_parser = rank())]
    albedo_rank: Option<u32>,
    /// Longer side of the picture the fit looks at: the face is cut out and scaled to it. Priors and
    /// masks are made for about 256.
    #[arg(long, default_value_t = Crop::LONGER_SIDE, value_parser = clap::value_parser!(u32).range(32..=2048))]
    size: u32,
    /// Pixels that share one independent error; 1 trusts every pixel by itself, as the paper does
    /// [default: 80 at --size 256, at others as the picture's area; with --schedule paper 1].
    #[arg(long, value_parser = at_least_one, allow_negative_numbers = true)]
    pixel_patch: Option<f32>,
    /// What the mesh's texture shows: `photo` the face as photographed, its light included; `albedo` the
    /// same without that light, for scenes with their own; `none` the fitted albedo alone, as colours of
    /// vertices.
    #[arg(long, value_enum, default_value_t)]
    texture: Kind,
    /// Sample the posterior around the mode as well: so many states of each chain are kept. Some 400
    /// and a minute or two tell how far pose and shape are known.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(100..=100_000))]
    posterior: Option<u32>,
    #[command(flatten)]
    chain: ChainOptions,
}

/// Chains of a posterior, if nothing is said: as in docs/posterior.md.
const CHAINS: u32 = 4;

/// What only a chain has use for.
#[derive(Args)]
#[command(next_help_heading = "With --schedule paper or sampler")]
struct ChainOptions {
    /// Steps of the image phase [default: 5000].
    #[arg(long, value_name = "STEPS")]
    samples: Option<u32>,
    /// Steps of the landmark phase before it [default: 5000].
    #[arg(long, value_name = "STEPS")]
    landmark_samples: Option<u32>,
    /// Steps between them, of pose and shape by the landmarks: for an object whose template is far
    /// from what the photo shows [default: 0].
    #[arg(long, value_name = "STEPS")]
    shape_samples: Option<u32>,
    /// Independent chains, run in parallel; the best state of all is kept [default: 1]. Of --posterior
    /// likewise, all states being kept [default: 4].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=256))]
    chains: Option<u32>,
    /// Go on from the checkpoint of an interrupted fit with the same arguments.
    #[arg(long)]
    resume: bool,
}

impl ChainOptions {
    /// The first of them that was given.
    fn given(&self) -> Option<&'static str> {
        let Self { samples, landmark_samples, shape_samples, chains, resume } = self;
        [
            ("--samples", samples.is_some()),
            ("--landmark-samples", landmark_samples.is_some()),
            ("--shape-samples", shape_samples.is_some()),
            ("--chains", chains.is_some()),
            ("--resume", *resume),
        ]
        .into_iter()
        .find_map(|(name, given)| given.then_some(name))
    }
}

fn rank() -> clap::builder::RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(0..=i64::try_from(MAX_RANK).unwrap_or(i64::MAX))
}

fn deviation(text: &str) -> std::result::Result<f32, String> {
    match text.parse::<f32>() {
        Ok(x) if x >= 0.1 && x.is_finite() => Ok(x),
        _ => Err("expected a finite number of at least 0.1".into()),
    }
}

fn at_least_one(text: &str) -> std::result::Result<f32, String> {
    match text.parse::<f32>() {
        Ok(x) if x >= 1.0 && x.is_finite() => Ok(x),
        _ => Err("expected a finite number of at least 1".into()),
    }
}

impl Fit {
    pub(super) fn run(mut self, console: Console) -> Result<()> {
        self.sort_out();
        let of_posteriors = |option| ["--chains", "--resume"].contains(&option);
        let idle = self.chain.given().filter(|o| self.posterior.is_none() || !of_posteriors(*o));
        if let (Schedule::Mode, Some(option)) = (self.schedule, idle) {
            return Err(Error::new(format_args!(
                "{option} is for chains, and --schedule mode (the default) runs none; add \
                 --schedule paper, or leave {option} out"
            )));
        }
        self.check_counts()?;
        if let (Schedule::Paper | Schedule::Sampler, Some(mask)) =
            (self.schedule, self.mask.first())
        {
            return Err(Error::file(
                mask,
                "a mask is for --schedule mode; chains take all they cover for the face",
            ));
        }
        if let (Schedule::Paper | Schedule::Sampler, Some(_)) = (self.schedule, self.posterior) {
            return Err(Error::new(
                "--posterior samples around what a search found; leave --schedule out",
            ));
        }
        output_directory(&self.output)?;
        let mixture = Mixture::open(&[&[self.model.clone()], &self.more[..]].concat())?;
        let photos =
            (0..self.images.len()).map(|i| self.read(i, console)).collect::<Result<Vec<_>>>()?;
        for (i, (photo, _)) in photos.iter().enumerate() {
            if let Some(other) = photos[..i].iter().position(|(other, _)| other == photo) {
                let same = format!(
                    "is the same picture as {}, and would count twice; leave it out",
                    self.images[other].display()
                );
                return Err(Error::file(&self.images[i], same));
            }
        }
        self.doubts = photos.iter().map(|(_, marked)| marked.doubt.clone()).collect();
        let looks = |model: &Model<'_>| {
            let look = |(i, read)| self.look(model, i, read);
            photos.iter().enumerate().map(look).collect::<Result<Vec<_>>>()
        };
        let [component] = &mixture.components[..] else {
            return self.run_mixture(&mixture, &looks, console);
        };
        let model = component.model.view();
        let looks = looks(&model)?;
        let jobs: Vec<_> = looks.iter().map(|look| self.job(&model, look)).collect();
        let stop = stop_on_signals()?;
        if let Some(draws) = self.posterior {
            return self.run_posterior(&jobs, draws, &stop, &model, console);
        }
        match &jobs[..] {
            [job] => self.run_one(job, &stop, model.provenance(), console),
            jobs => self.run_several(jobs, &stop, model.provenance(), console),
        }
    }

    /// Before the photos there may be more models. Photos may be named after the landmarks, whose option
    /// then took them.
    fn sort_out(&mut self) {
        let given = std::mem::take(&mut self.images);
        (self.more, self.images) = given.into_iter().partition(|path| is_model(path));
        let is_photo = |path: &Path| FileKind::of(path) == Some(FileKind::Photo);
        if self.images.is_empty() {
            let given = std::mem::take(&mut self.landmarks);
            (self.images, self.landmarks) = given.into_iter().partition(|path| is_photo(path));
        }
    }

    /// Whether there is a file of landmarks, and of the mask if any, for every photo.
    fn check_counts(&self) -> Result<()> {
        let photos = self.images.len();
        if photos == 0 {
            let none = || Error::new("no photo; name it after the model (PNG or JPEG)");
            return Err(FileKind::Model.misplaced(&self.model).unwrap_or_else(none));
        }
        if photos > MAX_PHOTOS {
            return Err(Error::new(format_args!(
                "{photos} photos; a fit takes at most {MAX_PHOTOS} of one person"
            )));
        }
        if let (Schedule::Paper | Schedule::Sampler, 2..) = (self.schedule, photos) {
            return Err(Error::new("a chain fits one photo; several are for --schedule mode"));
        }
        let wrong = |what: &str, found: usize| {
            Err(Error::new(format_args!(
                "{photos} photo(s) and {found} {what} file(s); name one per photo, in the same order"
            )))
        };
        if !self.landmarks.is_empty() && self.landmarks.len() != photos {
            return wrong("--landmarks", self.landmarks.len());
        }
        if !self.mask.is_empty() && self.mask.len() != photos {
            return wrong("--mask", self.mask.len());
        }
        Ok(())
    }

    /// Reads a photo and what goes with it, but for what a model makes of it.
    fn read(&self, number: usize, console: Console) -> Result<(Picture, Marked)> {
        let (image, file) = (&self.images[number], self.landmarks.get(number));
        let photo = photo::read(image)?;
        let face = self.face.unwrap_or(1) as usize;
        let marked = Marked::read(file.map(PathBuf::as_path), &photo, face);
        // What is wrong with a file names it.
        let marked = marked.map_err(|e| if file.is_none() { Error::file(image, e) } else { e })?;
        if let Some(note) = &marked.note {
            console.say(Error::file(image, note));
        }
        Ok((photo, marked))
    }

    /// Checks a photo and its landmarks against a model.
    fn look(&self, model: &Model<'_>, number: usize, read: &(Picture, Marked)) -> Result<Look> {
        let (photo, marked) = (read.0.clone(), &read.1);
        let path = self.landmarks.get(number).unwrap_or(&self.images[number]);
        let names: Vec<_> = model.landmarks().map(|(name, _)| name).collect();
        let landmarks = marked.known(&names).map_err(|e| Error::file(path, e))?;
        landmarks.check(photo.width, photo.height, &names).map_err(|e| Error::file(path, e))?;
        let mask = self.mask.get(number).map(|path| read_mask(path, &photo)).transpose()?;
        let crop = self
            .crop(model, &landmarks, [photo.width, photo.height])
            .map_err(|e| Error::file(path, e))?;
        Ok(Look { photo, landmarks, mask, crop })
    }

    fn job<'a>(&self, model: &'a Model<'a>, look: &'a Look) -> Job<'a> {
        Job {
            model,
            photo: &look.photo,
            landmarks: &look.landmarks,
            crop: look.crop,
            mask: look.mask.as_ref(),
            schedule: self.schedule,
            config: self.config(model),
            seed: self.seed,
            chains: self.chain.chains.unwrap_or(1),
        }
    }

    fn run_one(
        &self,
        job: &Job<'_>,
        stop: &AtomicBool,
        provenance: &str,
        console: Console,
    ) -> Result<()> {
        let checkpoint = self.checkpoint();
        let resume = self.chain.resume.then(|| Save::read(&checkpoint.path)).transpose()?;
        let keep = |save: &Save| checkpoint.write(&save.to_bytes()?);
        let culprit = self.culprit(&checkpoint);
        let task = console.task("fitting", job.steps());
        match watch(stop, task, |control| job.run_kept(resume, control, &keep))
            .map_err(|e| culprit.map_or_else(|| e.clone(), |file| Error::file(file, &e)))?
        {
            Ending::Stopped(save) => {
                save.map_or(Ok(()), |save| keep(&save))?;
                Err(checkpoint.interrupted())
            }
            Ending::Done(fit) => {
                let results =
                    output::finish(from_ref(job), from_ref(&*fit), &self.names(), self.texture)?;
                self.write_all(results, Vec::new(), provenance, console)?;
                checkpoint.remove();
                Ok(())
            }
        }
    }

    fn checkpoint(&self) -> Checkpoint {
        Checkpoint::new(self.output.join("checkpoint.bin"), self.chain.resume)
    }

    /// What a fit can still be refused for.
    fn culprit<'a>(&'a self, checkpoint: &'a Checkpoint) -> Option<&'a Path> {
        if self.chain.resume { Some(&checkpoint.path) } else { Some(self.mask.first()?) }
    }

    /// Fits every component of a mixture, and keeps the likeliest.
    fn run_mixture(
        &self,
        mixture: &Mixture,
        look: &dyn Fn(&Model<'_>) -> Result<Vec<Look>>,
        console: Console,
    ) -> Result<()> {
        if self.schedule != Schedule::Mode {
            return Err(Error::new(
                "several models are for --schedule mode; a chain tells no evidence to choose by",
            ));
        }
        if self.posterior.is_some() {
            return Err(Error::new(
                "--posterior samples around the fit of one model; name the likeliest of them alone",
            ));
        }
        let models: Vec<_> = mixture.components.iter().map(|c| c.model.view()).collect();
        let mut looks = Vec::new();
        for (model, component) in models.iter().zip(&mixture.components) {
            let named = |e| Error::new(format_args!("{}: {e}", component.name));
            looks.push(look(model).map_err(named)?);
        }
        // All look at the same pixels, or their evidence could not be compared.
        let crops: Vec<_> = looks[0].iter().map(|look| look.crop).collect();
        for look in &mut looks {
            for (look, crop) in look.iter_mut().zip(&crops) {
                look.crop = *crop;
            }
        }
        let jobs: Vec<Vec<Job<'_>>> = models
            .iter()
            .zip(&looks)
            .map(|(model, looks)| looks.iter().map(|look| self.job(model, look)).collect())
            .collect();
        let before: Vec<f64> = mixture.components.iter().map(|c| c.weight).collect();
        let stop = stop_on_signals()?;
        let steps = jobs.iter().filter_map(|jobs| jobs.first()).map(Job::steps).sum();
        let task = console.task("fitting", steps);
        let found = watch(&stop, task, |control| fit::mixture::find(&jobs, &before, control))?;
        let found = found.ok_or_else(interrupted)?;
        let names = |k: usize| Names {
            model: mixture.components[k].name.clone(),
            given: Some(self.given_models()),
            ..self.names()
        };
        let mut fits = Vec::new();
        for (k, (jobs, of)) in jobs.iter().zip(&found.fits).enumerate() {
            fits.push(output::summarize(&jobs[0], &of[0], &names(k), 0)?);
        }
        let components: Vec<_> = (fits.iter().zip(&found.weights).zip(&before))
            .map(|((fit, weight), before)| ComponentFound {
                model: fit.model.clone(),
                before: *before,
                weight: *weight,
                ln_evidence: fit.laplace.as_ref().map_or(0.0, |laplace| laplace.ln_evidence),
            })
            .collect();
        for component in &components {
            console.say(format_args!(
                "{}: {:.1} % given the photo",
                component.model.file,
                100.0 * component.weight
            ));
        }
        let best = found.best;
        let (jobs, found) = (&jobs[best], &found.fits[best]);
        let mut results = output::finish(jobs, found, &names(best), self.texture)?;
        for result in &mut results {
            result.summary.mixture.clone_from(&components);
        }
        let all = vec![("components.json".into(), Summaries { fits }.to_json()?.into_bytes())];
        self.write_all(results, all, models[best].provenance(), console)
    }

    fn run_several(
        &self,
        jobs: &[Job<'_>],
        stop: &AtomicBool,
        provenance: &str,
        console: Console,
    ) -> Result<()> {
        let steps = jobs.first().map_or(0, Job::steps);
        let found =
            watch(stop, console.task("fitting", steps), |control| find_mode(jobs, control))?;
        let fits = found.ok_or_else(interrupted)?;
        let results = output::finish(jobs, &fits, &self.names(), self.texture)?;
        self.write_all(results, Vec::new(), provenance, console)
    }

    /// Samples the posterior around the mode of one photo or several.
    fn run_posterior(
        &self,
        jobs: &[Job<'_>],
        draws: u32,
        stop: &AtomicBool,
        model: &Model<'_>,
        console: Console,
    ) -> Result<()> {
        let request =
            Request { draws, chains: self.chain.chains.unwrap_or(CHAINS), seed: self.seed };
        let checkpoint = self.checkpoint();
        let read = || posterior::Save::read(&checkpoint.path);
        let resume = self.chain.resume.then(read).transpose()?;
        let keep = |save: &posterior::Save| checkpoint.write(&save.to_bytes()?);
        let task = console.task("sampling", request.steps());
        let found =
            watch(stop, task, |control| sample_kept(jobs, &request, resume, control, &keep));
        let culprit = self.culprit(&checkpoint);
        let found =
            found.map_err(|e| culprit.map_or_else(|| e.clone(), |file| Error::file(file, &e)))?;
        let (fits, samples) = found.ok_or_else(|| checkpoint.interrupted())?;
        let spread = Spread::new(model, &samples)?;
        let mut results = output::finish(jobs, &fits, &self.names(), self.texture)?;
        for (i, result) in results.iter_mut().enumerate() {
            let summary = &mut result.summary;
            summary.posterior = samples.found(i, &spread);
            summary.warnings.extend(summary.posterior.as_ref().and_then(warning));
            let Request { draws, chains, seed } = request;
            summary.command =
                format!("{} --posterior {draws} --chains {chains} --seed {seed}", summary.command);
            result.pictures.uncertainty = Some(spread.picture(model)?);
        }
        let mut files = spread.files(model)?;
        files.push(("posterior.h5".into(), posterior::output::states(&samples)?));
        self.write_all(results, files, model.provenance(), console)?;
        checkpoint.remove();
        Ok(())
    }

    fn write_all(
        &self,
        mut results: Vec<Finished>,
        mut more: Vec<(String, Vec<u8>)>,
        provenance: &str,
        console: Console,
    ) -> Result<()> {
        for (result, doubt) in results.iter_mut().zip(&self.doubts) {
            result.summary.warnings.extend(doubt.clone());
        }
        if let [result] = &results[..] {
            more.push(("report.html".into(), report::fit_report(result, provenance)?.into_bytes()));
            output::write(&self.output, result, more, &self.inputs())?;
            say(result, console);
            self.say_open(console);
            return Ok(());
        }
        let names = self.names();
        let folders: Vec<_> = (0..results.len()).map(|i| names.folder(i)).collect();
        for folder in &folders {
            output_directory(&self.output.join(folder))?;
        }
        let page = report::subject_report(&results, &folders, provenance)?;
        more.push(("report.html".into(), page.into_bytes()));
        output::write_all(&self.output, &results, &folders, more, &self.inputs())?;
        for result in &results {
            say(result, console);
        }
        self.say_open(console);
        Ok(())
    }

    /// All files that the fit reads.
    fn inputs(&self) -> Vec<&Path> {
        let models = std::iter::once(&self.model).chain(&self.more);
        let photos = self.images.iter().chain(&self.landmarks).chain(&self.mask);
        models.chain(photos).map(PathBuf::as_path).collect()
    }

    fn names(&self) -> Names {
        let photos = self.images.iter().enumerate();
        Names {
            model: typed(&self.model),
            given: None,
            face: self.face.unwrap_or(1),
            photos: photos
                .map(|(i, image)| PhotoNames {
                    image: typed(image),
                    landmarks: self.landmarks.get(i).map(|path| typed(path)),
                    mask: self.mask.get(i).map(|path| typed(path)),
                })
                .collect(),
        }
    }

    /// The models as they were given.
    fn given_models(&self) -> String {
        let all = std::iter::once(&self.model).chain(&self.more);
        all.map(|path| quoted(&typed(path))).collect::<Vec<_>>().join(" ")
    }

    fn say_open(&self, console: Console) {
        console.say(format_args!("open {}", self.output.join("report.html").display()));
    }

    /// The part of the photo to look at. A chain, whose landmarks are all believed, looks around
    /// all.
    fn crop(&self, model: &Model<'_>, landmarks: &Tlms, photo: [u32; 2]) -> Result<Crop> {
        let sd = self.config(model).landmark_sd;
        fit::landmarks::check_sides(model, landmarks, photo, self.size, sd)?;
        match self.schedule {
            Schedule::Mode => fit::landmarks::crop_around(model, landmarks, photo, self.size, sd),
            Schedule::Paper | Schedule::Sampler => {
                Crop::around(&landmarks.visible_points(), photo, Crop::ENLARGE, self.size)
            }
        }
    }

    fn config(&self, model: &Model<'_>) -> Config {
        let set = |value: &mut u32, given: Option<u32>| *value = given.unwrap_or(*value);
        let rank = |value: &mut usize, given: Option<u32>| {
            *value = given.map_or(*value, |rank| rank as usize);
        };
        self.schedule.config(model, self.size).with(|config| {
            rank(&mut config.shape_rank, self.shape_rank);
            rank(&mut config.albedo_rank, self.albedo_rank);
            set(&mut config.landmark_steps, self.chain.landmark_samples);
            set(&mut config.shape_steps, self.chain.shape_samples);
            set(&mut config.image_steps, self.chain.samples);
            config.landmark_sd = self.landmark_sd.unwrap_or(config.landmark_sd);
            config.pixel_patch = self.pixel_patch.unwrap_or(config.pixel_patch);
        })
    }
}

/// Whether a file's name is a model's, or a mixture's.
fn is_model(path: &Path) -> bool {
    has_extension(path, &["3dmm", "h5", "hdf5", "json", "mat", "toml"])
}

/// A photo and what goes with it.
struct Look {
    photo: Picture,
    landmarks: Tlms,
    mask: Option<Picture>,
    crop: Crop,
}

/// Says how a fit went.
fn say(result: &Finished, console: Console) {
    for warning in &result.summary.warnings {
        console.say(format_args!("warning: {warning}"));
    }
    console.say(output::closing_line(&result.summary));
}

/// Reads the mask of a photo.
fn read_mask(path: &Path, photo: &Picture) -> Result<Picture> {
    let mask = photo::read(path)?;
    if (mask.width, mask.height) == (photo.width, photo.height) {
        return Ok(mask);
    }
    Err(Error::file(
        path,
        format_args!(
            "the mask is {}×{}, the photo {}×{}; make it of the photo's size",
            mask.width, mask.height, photo.width, photo.height
        ),
    ))
}
