//! `onescan fit`.

use super::{file_name, output_directory};
use clap::Args;
use onescan::error::{Error, Result};
use onescan::files::write_atomically;
use onescan::fit::checkpoint::Save;
use onescan::fit::output::{self, Names};
use onescan::fit::{self, Control, Ending, Job};
use onescan::interchange;
use onescan::photo::tlms::Tlms;
use onescan::photo::{self, Crop};
use onescan::progress::Console;
use onescan::report;
use onescan_core::chain::Config;
use onescan_core::scene::MAX_RANK;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// Fit a model to a photo with landmarks.
///
/// Writes fit.json, fit.rps, mesh.ply, mesh.glb, overlay.png, photo.png and report.html to the
/// output directory. Ctrl-C saves a checkpoint there; --resume goes on from it, with the same
/// result as without the interruption.
#[derive(Args)]
pub(super) struct Fit {
    /// The model, with landmarks: .3dmm, .h5 or .h5.json.
    model: PathBuf,
    /// The photo, PNG or JPEG.
    image: PathBuf,
    /// Landmarks in the photo: .tlms (lines of `name visible x y`), or .pts (68 points).
    #[arg(long)]
    landmarks: PathBuf,
    /// Directory to write to.
    #[arg(short, long)]
    output: PathBuf,
    /// Seed of all randomness.
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// Steps of the image stage.
    #[arg(long, default_value_t = 5000)]
    samples: u32,
    /// Steps of the landmark stage before it.
    #[arg(long, default_value_t = 5000)]
    landmark_samples: u32,
    /// Steps between them, of pose and shape by the landmarks: for an object whose template is far
    /// from what the photo shows.
    #[arg(long, default_value_t = 0)]
    shape_samples: u32,
    /// How exact landmarks are: standard deviation, pixels of the picture the fit looks at.
    #[arg(long, default_value_t = Config::default().landmark_sd, value_parser = deviation)]
    landmark_sd: f32,
    /// Shape coefficients to infer.
    #[arg(long, default_value_t = 50, value_parser = rank())]
    shape_rank: u32,
    /// Albedo coefficients to infer.
    #[arg(long, default_value_t = 50, value_parser = rank())]
    albedo_rank: u32,
    /// Independent chains, run in parallel; the best state of all is kept.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=256))]
    chains: u32,
    /// Side of the picture the fit looks at: the face is cut out and scaled to it.
    #[arg(long, default_value_t = Crop::LONGER_SIDE, value_parser = clap::value_parser!(u32).range(32..=2048))]
    size: u32,
    /// Pixels that share one independent error; 1 trusts every pixel by itself, as the reference
    /// engine does.
    #[arg(long, default_value_t = Config::default().pixel_patch, value_parser = at_least_one)]
    pixel_patch: f32,
    /// Use no search moves: the chain is then a sampler of the posterior, and slower to get there.
    #[arg(long)]
    sampler: bool,
    /// How to fit: `paper`, the paper's chain; or `mode`, which searches for the mode of the
    /// posterior, takes what hides the face for what it is, and also writes mask.png and behind.png.
    #[arg(long, value_enum, default_value_t = Schedule::Paper)]
    schedule: Schedule,
    /// Go on from the checkpoint of an interrupted fit with the same arguments.
    #[arg(long)]
    resume: bool,
}

/// The ways to fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Schedule {
    /// The paper's: a chain.
    Paper,
    /// The mode of the posterior.
    Mode,
}

fn rank() -> clap::builder::RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(0..=i64::try_from(MAX_RANK).unwrap_or(i64::MAX))
}

fn deviation(text: &str) -> std::result::Result<f32, String> {
    match text.parse::<f32>() {
        Ok(x) if x > 0.0 && x.is_finite() => Ok(x),
        _ => Err("expected a number above 0".into()),
    }
}

fn at_least_one(text: &str) -> std::result::Result<f32, String> {
    match text.parse::<f32>() {
        Ok(x) if x >= 1.0 && x.is_finite() => Ok(x),
        _ => Err("expected a number of at least 1".into()),
    }
}

impl Fit {
    pub(super) fn run(self, console: Console) -> Result<()> {
        output_directory(&self.output)?;
        let file = interchange::open(&self.model)?;
        let model = file.view();
        let photo = photo::read(&self.image)?;
        let mut landmarks = Tlms::read(&self.landmarks)?;
        let names: Vec<_> = model.landmarks().map(|(name, _)| name).collect();
        if names.is_empty() {
            return Err(Error::file(
                &self.model,
                "has no landmarks, so nothing says where it is in a photo; build it with --landmarks",
            ));
        }
        if Tlms::is_pts(&self.landmarks) {
            landmarks.keep(&names);
        }
        landmarks
            .check(photo.width, photo.height, &names)
            .map_err(|e| Error::file(&self.landmarks, e))?;
        let crop = Crop::around(
            &landmarks.visible_points(),
            [photo.width, photo.height],
            Crop::ENLARGE,
            self.size,
        )
        .map_err(|e| Error::file(&self.landmarks, e))?;
        let job = Job {
            model: &model,
            photo: &photo,
            landmarks: &landmarks,
            crop,
            config: self.config(),
            seed: self.seed,
            chains: self.chains,
        };
        let checkpoint = self.output.join("checkpoint.bin");
        if self.schedule == Schedule::Mode && (self.resume || self.chains > 1 || self.sampler) {
            return Err(Error::new(
                "--schedule mode is no chain: it takes seconds and leaves no checkpoint; fit \
                 without --resume, --chains and --sampler",
            ));
        }
        let resume = if self.resume { Some(Save::read(&checkpoint)?) } else { None };

        let stop = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            // The second signal ends the program at once.
            signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop))
                .and_then(|_| signal_hook::flag::register(signal, Arc::clone(&stop)))
                .map_err(|e| Error::new(format_args!("cannot watch for Ctrl-C: {e}")))?;
        }
        if self.schedule == Schedule::Mode {
            let task = console.task("searching", fit::most_steps());
            let found = watch(&stop, task, |control| job.find_mode(control))?;
            let fit = found.ok_or_else(|| Error::new("interrupted; nothing was written"))?;
            return self.write(&job, &fit, model.provenance(), console);
        }
        let total = u64::from(self.chains) * job.config.steps();
        match watch(&stop, console.task("fitting", total), |control| job.run(resume, control))
            .map_err(|e| if self.resume { Error::file(&checkpoint, e) } else { e })?
        {
            Ending::Stopped(save) => {
                let bytes = save.to_bytes()?;
                write_atomically(&checkpoint, |out| out.write_all(&bytes))?;
                Err(Error::file(
                    &checkpoint,
                    "interrupted, progress saved; the same command with --resume goes on",
                ))
            }
            Ending::Done(fit) => {
                self.write(&job, &fit, model.provenance(), console)?;
                remove_if_there(&checkpoint);
                Ok(())
            }
        }
    }

    fn write(
        &self,
        job: &Job<'_>,
        fit: &fit::Fit,
        provenance: &str,
        console: Console,
    ) -> Result<()> {
        let names = Names {
            model: file_name(&self.model),
            image: file_name(&self.image),
            landmarks: file_name(&self.landmarks),
        };
        let result = output::finish(job, fit, names)?;
        output::write(&self.output, &result)?;
        let page = report::fit_report(&result, provenance)?;
        let report = self.output.join("report.html");
        write_atomically(&report, |out| out.write_all(page.as_bytes()))?;
        console.say(output::closing_line(&result.summary));
        console.say(format_args!("open {}", report.display()));
        Ok(())
    }

    fn config(&self) -> Config {
        Config::default().with(|config| {
            config.shape_rank = self.shape_rank as usize;
            config.albedo_rank = self.albedo_rank as usize;
            config.landmark_samples = self.landmark_samples;
            config.shape_samples = self.shape_samples;
            config.samples = self.samples;
            config.landmark_sd = self.landmark_sd;
            config.pixel_patch = self.pixel_patch;
            config.search = !self.sampler;
        })
    }
}

/// Runs the job and moves the bar meanwhile.
pub(super) fn watch<T>(
    stop: &AtomicBool,
    mut task: onescan::progress::Task,
    run: impl FnOnce(&Control<'_>) -> Result<T>,
) -> Result<T> {
    let steps = AtomicU64::new(0);
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let watcher = scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                task.set(steps.load(Ordering::Relaxed));
                std::thread::park_timeout(Duration::from_millis(100));
            }
            task.finish();
        });
        let ending = run(&Control { stop, steps: &steps });
        done.store(true, Ordering::Relaxed);
        watcher.thread().unpark();
        ending
    })
}

/// A finished fit has no use for its checkpoint; if it stays, it is refused by the next --resume.
fn remove_if_there(checkpoint: &Path) {
    let _ = std::fs::remove_file(checkpoint);
}
