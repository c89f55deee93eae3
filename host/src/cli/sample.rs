//! `onescan sample`.

use super::{degrees, output_directory, write_mesh};
use clap::Args;
use onescan::error::Result;
use onescan::interchange;
use onescan::photo::picture::contact_sheet;
use onescan::progress::Console;
use onescan::render;
use onescan_core::rng::Rng;
use std::path::PathBuf;

/// Draw random instances of a model: meshes, and a sheet of pictures.
///
/// Writes `sample_NN.ply` and `sample_NN.glb` (albedo as vertex colours) and samples.png, a sheet of them all.
#[derive(Args)]
pub(super) struct Sample {
    /// The model: .3dmm, .h5, .h5.json or .mat.
    model: PathBuf,
    /// Directory to write to.
    #[arg(short, long)]
    output: PathBuf,
    /// How many.
    #[arg(short, default_value_t = 12, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    n: u32,
    /// Seed of the coefficients.
    #[arg(long, default_value_t = 7)]
    seed: u64,
    /// Vary the shape alone.
    #[arg(long, conflicts_with = "albedo_only")]
    shape_only: bool,
    /// Vary the albedo alone.
    #[arg(long)]
    albedo_only: bool,
    /// Side of a picture, pixels.
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(32..=2048))]
    size: u32,
    /// Turn to the subject's left, degrees.
    #[arg(long, default_value_t = 20.0, allow_negative_numbers = true, value_parser = degrees)]
    yaw: f32,
}

/// How many the sheet shows at most.
const SHOWN: usize = 48;

impl Sample {
    pub(super) fn run(self, console: Console) -> Result<()> {
        let file = interchange::open(&self.model)?;
        let model = file.view();
        output_directory(&self.output)?;
        let yaw = self.yaw.to_radians();
        let mut rng = Rng::new(self.seed, 0);
        let mut task = console.task("sampling", u64::from(self.n));
        let mut pictures = Vec::new();
        for number in 0..self.n {
            let mut shape = render::random_coefficients(model.shape.rank(), &mut rng);
            let mut albedo = render::random_coefficients(model.albedo.rank(), &mut rng);
            if self.albedo_only {
                shape.clear();
            }
            if self.shape_only {
                albedo.clear();
            }
            let mesh = render::instance(&model, &shape, &albedo);
            for format in ["ply", "glb"] {
                write_mesh(&self.output.join(format!("sample_{number:02}.{format}")), &mesh)?;
            }
            if pictures.len() < SHOWN {
                let scene = render::portrait(&model, [self.size; 2], yaw, 0.0);
                pictures.push(render::draw_mesh(&mesh, &scene, render::GROUND)?);
            }
            task.set(u64::from(number) + 1);
        }
        task.finish();
        let path = self.output.join("samples.png");
        let pictures: Vec<_> = pictures.iter().collect();
        let columns = (pictures.len() as f64).sqrt().ceil() as usize;
        contact_sheet(&pictures, columns.clamp(1, 6), 4, [255; 3]).write_png(&path)?;
        console.say(format_args!("wrote {} meshes and {}", self.n, path.display()));
        Ok(())
    }
}
