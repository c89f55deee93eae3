//! `onescan export`.

use super::{model_file, write_model};
use clap::Args;
use onescan::error::{Error, Result};
use onescan::interchange::{self, Format};
use onescan::model::export::{ExportOptions, export};
use onescan::model::morphable::Morphable;
use onescan::progress::Console;
use std::path::PathBuf;

/// Make a smaller model: for a device, for a web page.
///
/// Writes a smaller model of the same thing, and says how much variance it lost. Landmarks stay.
#[derive(Args)]
pub(super) struct Export {
    /// The model: .3dmm, .h5, .h5.json or .mat.
    model: PathBuf,
    /// The model to write: .3dmm, .h5 or .h5.json.
    #[arg(short, long)]
    output: PathBuf,
    /// For a microcontroller: 960 vertices, 30 + 30 components.
    #[arg(long, conflicts_with = "page")]
    device: bool,
    /// For a web page: 50 + 50 components, 9 bits.
    #[arg(long)]
    page: bool,
    /// Components of the shape, if there are more.
    #[arg(long)]
    shape_rank: Option<u32>,
    /// Components of the albedo, if there are more.
    #[arg(long)]
    albedo_rank: Option<u32>,
    /// Vertices, if there are more: the mesh is decimated.
    #[arg(long, value_parser = clap::value_parser!(u32).range(3..))]
    vertices: Option<u32>,
    /// Bits of an entry of the basis. The file is not shorter for fewer, but compresses better.
    #[arg(long, value_parser = clap::value_parser!(u32).range(2..=16))]
    bits: Option<u32>,
}

impl Export {
    pub(super) fn run(self, console: Console) -> Result<()> {
        model_file(&self.output)?;
        let model = interchange::open(&self.model)?;
        let (rank, vertices, bits) = match (self.device, self.page) {
            (true, _) => (30, Some(960), 16),
            (_, true) => (50, None, 9),
            _ => (usize::MAX, None, 16),
        };
        let options = ExportOptions {
            shape_rank: self.shape_rank.map_or(rank, |rank| rank as usize),
            albedo_rank: self.albedo_rank.map_or(rank, |rank| rank as usize),
            vertices: self.vertices.map(|v| v as usize).or(vertices),
            bits: self.bits.unwrap_or(bits),
        };
        let exported = export(&model, &options).map_err(|e| Error::file(&self.model, e))?;
        console.say(&exported.report);
        if Format::of(&self.output) != Format::ThreeDmm {
            let model = Morphable::of(&exported.model.view());
            return write_model(console, &self.model, &self.output, &model);
        }
        exported.model.write(&self.output)?;
        console.say(format_args!("wrote {}", self.output.display()));
        Ok(())
    }
}
