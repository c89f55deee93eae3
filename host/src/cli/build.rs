//! `onescan build`.

use super::scan::Scan;
use super::{file_name, output_file};
use clap::{Args, ValueEnum};
use onescan::build::{BuildOptions, build};
use onescan::decompose::Truncation;
use onescan::error::{Error, Result};
use onescan::kernel::{Axis, PRESETS, Preset};
use onescan::landmarks;
use onescan::progress::Console;
use std::path::PathBuf;

/// The mean of the model is the scan; its deviations are Gaussian processes over the scan's
/// vertices, decomposed exactly into their leading components.
#[derive(Args)]
pub(super) struct Build {
    #[command(flatten)]
    scan: Scan,
    /// The model to write, .3dmm.
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
    /// Landmarks of the scan, JSON; a fit needs them. By vertex number for PLY and OBJ; in glTF and
    /// STL equal vertices are joined: name them by coordinates, which are the file's.
    #[arg(long)]
    landmarks: Option<PathBuf>,
    /// Axis the plane of symmetry through the origin is perpendicular to.
    #[arg(long, default_value = "x")]
    mirror: Mirror,
}

#[derive(Clone, Copy, ValueEnum)]
enum Mirror {
    X,
    Y,
    Z,
    None,
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
        output_file(&self.output)?;
        let (scan, millimetres) = self.scan.read()?;
        let landmarks = match &self.landmarks {
            Some(path) => {
                // Their coordinates are the file's.
                let frame = self.scan.frame()?;
                let points: Vec<_> = scan.points.iter().map(|p| frame.undo(*p)).collect();
                landmarks::read(path, &points, millimetres)?
            }
            None => Vec::new(),
        };
        let scan_name = file_name(&self.scan.path);
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
        .map_err(|e| Error::file(&self.scan.path, e))?;
        task.finish();
        built.model.write(&self.output)?;
        console.say(&built.report);
        if landmarks.is_empty() {
            console.say("no --landmarks: the model can be sampled and rendered, but not fitted");
        }
        console.say(format_args!("wrote {}", self.output.display()));
        Ok(())
    }
}
