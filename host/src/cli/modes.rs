//! `onescan modes`.

use super::{degrees, output_directory, positive, write_mesh};
use clap::Args;
use onescan::error::Result;
use onescan::interchange;
use onescan::photo::caption::captioned;
use onescan::photo::picture::{WHITE, contact_sheet};
use onescan::progress::Console;
use onescan::render;
use std::path::PathBuf;

#[derive(Args)]
pub(super) struct Modes {
    /// The model: .3dmm, .h5, .h5.json or .mat.
    model: PathBuf,
    /// Directory to write to.
    #[arg(short, long)]
    output: PathBuf,
    /// How many components.
    #[arg(short, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    n: u32,
    /// How many standard deviations to each side.
    #[arg(long, default_value_t = 3.0, value_parser = positive)]
    deviations: f64,
    /// Side of a picture, pixels.
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(32..=2048))]
    size: u32,
    /// Turn to the subject's left, degrees.
    #[arg(long, default_value_t = 20.0, allow_negative_numbers = true, value_parser = degrees)]
    yaw: f32,
}

impl Modes {
    pub(super) fn run(self, console: Console) -> Result<()> {
        let file = interchange::open(&self.model)?;
        let model = file.view();
        output_directory(&self.output)?;
        let scene = render::portrait(&model, [self.size; 2], self.yaw.to_radians(), 0.0);
        let show = |name: &str, shape: &[f32], albedo: &[f32]| {
            let mesh = render::instance(&model, shape, albedo);
            for format in ["ply", "glb"] {
                write_mesh(&self.output.join(format!("{name}.{format}")), &mesh)?;
            }
            render::draw_mesh(&mesh, &scene, render::GROUND)
        };
        let mean = show("mean", &[], &[])?;
        let count = (self.n as usize).min(model.shape.rank().max(model.albedo.rank()));
        let mut pictures = Vec::new();
        for k in 0..count {
            for half in ["shape", "albedo"] {
                let rank = if half == "shape" { model.shape.rank() } else { model.albedo.rank() };
                let side = |name: &str, deviations: f64| {
                    let mut c = vec![0.0; k + 1];
                    c[k] = deviations as f32;
                    // A half with fewer components shows its mean.
                    c.truncate(rank);
                    let name = format!("{half}_{}_{name}", k + 1);
                    if half == "shape" { show(&name, &c, &[]) } else { show(&name, &[], &c) }
                };
                for (name, deviations) in [("minus", -self.deviations), ("plus", self.deviations)] {
                    let text = format!("{half} {}: {deviations:+} sd", k + 1);
                    pictures.push(captioned(&side(name, deviations)?, &text));
                    if name == "minus" {
                        pictures.push(captioned(&mean, "mean"));
                    }
                }
            }
        }
        let path = self.output.join("modes.png");
        let shown: Vec<_> =
            if pictures.is_empty() { vec![&mean] } else { pictures.iter().collect() };
        contact_sheet(&shown, 6, 4, WHITE).write_png(&path)?;
        console.say(format_args!("wrote {}", path.display()));
        Ok(())
    }
}
