//! `onescan build`.

use super::{file_name, model_file};
use clap::{Args, ValueEnum};
use onescan::build::{BuildOptions, build};
use onescan::decompose::Truncation;
use onescan::error::{Error, Result};
use onescan::interchange::{self, Format};
use onescan::kernel::{Axis, PRESETS, Preset};
use onescan::progress::Console;
use onescan::{landmarks, ply};
use std::path::PathBuf;

/// The mean of the model is the scan; its deviations are Gaussian processes over the scan's
/// vertices, decomposed exactly into their leading components.
#[derive(Args)]
pub(super) struct Build {
    /// The scan: PLY with vertex colours.
    scan: PathBuf,
    /// The model to write: .3dmm, or for other programs .h5 or .h5.json.
    #[arg(short, long)]
    output: PathBuf,
    /// Kernels: (standard|correlated|symmetric)-(full|rgb|xyz).
    #[arg(long, default_value = "symmetric-full", value_parser = preset)]
    kernels: &'static Preset,
    /// Components of shape and of albedo.
    #[arg(long, default_value_t = 199, value_parser = clap::value_parser!(u32).range(0..=2000))]
    rank: u32,
    /// As many components as hold this fraction of the variance, instead of --rank.
    #[arg(long, conflicts_with = "rank", value_parser = fraction)]
    variance: Option<f64>,
    /// Landmarks of the scan, JSON; a fit needs them.
    #[arg(long)]
    landmarks: Option<PathBuf>,
    /// Axis the plane of symmetry through the origin is perpendicular to.
    #[arg(long, default_value = "x")]
    mirror: Mirror,
    /// Unit of the scan's coordinates.
    #[arg(long, default_value = "mm")]
    unit: Unit,
}

#[derive(Clone, Copy, ValueEnum)]
enum Mirror {
    X,
    Y,
    Z,
    None,
}

#[derive(Clone, Copy, ValueEnum)]
enum Unit {
    Mm,
    Cm,
    M,
}

fn preset(name: &str) -> std::result::Result<&'static Preset, String> {
    Preset::named(name).ok_or_else(|| {
        let names: Vec<_> = PRESETS.iter().map(|preset| preset.name).collect();
        format!("known kernels: {}", names.join(", "))
    })
}

fn fraction(text: &str) -> std::result::Result<f64, String> {
    match text.parse() {
        Ok(f) if f > 0.0 && f < 1.0 => Ok(f),
        _ => Err("expected a fraction between 0 and 1, like 0.99".into()),
    }
}

impl Build {
    pub(super) fn run(self, console: Console) -> Result<()> {
        model_file(&self.output)?;
        let scan = ply::read(&self.scan)?;
        let millimetres = match self.unit {
            Unit::Mm => 1.0,
            Unit::Cm => 10.0,
            Unit::M => 1000.0,
        };
        let landmarks = match &self.landmarks {
            Some(path) => landmarks::read(path, &scan.points, millimetres)?,
            None => Vec::new(),
        };
        let scan_name = file_name(&self.scan);
        let options = BuildOptions {
            scan_name: &scan_name,
            kernels: self.kernels,
            mirror: match self.mirror {
                Mirror::X => Some(Axis::X),
                Mirror::Y => Some(Axis::Y),
                Mirror::Z => Some(Axis::Z),
                Mirror::None => None,
            },
            truncation: match self.variance {
                Some(fraction) => Truncation::Variance(fraction),
                None => Truncation::Rank(self.rank as usize),
            },
            millimetres,
        };
        let mut task = console.task("building", 1000);
        let built = build(&scan, &landmarks, &options, &mut |done, what| {
            task.name(what);
            task.set((1000.0 * done) as u64);
        })
        .map_err(|e| Error::file(&self.scan, e))?;
        task.finish();
        match Format::of(&self.output) {
            Format::ThreeDmm => built.model.write(&self.output)?,
            format => {
                let mut model = built.morphable();
                if let Some(path) = &self.landmarks {
                    model.uncertainties = landmarks::read_uncertainties(path)?;
                }
                interchange::write(&model, &self.output)?;
                for lost in interchange::lost(&model, format) {
                    console.say(format_args!("not in this format: {lost}"));
                }
            }
        }
        console.say(&built.report);
        if landmarks.is_empty() {
            console.say("no --landmarks: the model can be sampled and rendered, but not fitted");
        }
        console.say(format_args!("wrote {}", self.output.display()));
        Ok(())
    }
}
