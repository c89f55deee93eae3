//! `onescan convert`.

use super::{output_file, read_model, write_mesh, write_model};
use clap::Args;
use onescan::error::{Error, Result};
use onescan::files::has_extension;
use onescan::interchange::{self, Format};
use onescan::mesh::landmarks;
use onescan::model::process::Process;
use onescan::progress::Console;
use onescan::render;
use std::path::PathBuf;

/// Write a model for another program, or take one from there; or write its mean as a mesh.
///
/// Formats by extension: .3dmm is ours; .h5 is that of statismo, scalismo and the Basel face models
/// 2017 and 2019; .h5.json the same as newer versions of scalismo write it; .mat is the Basel face
/// model 2009 and only read. What the new file cannot carry is said. A .glb or .ply has the mean face
/// alone, with its albedo, for viewers and modelling programs.
#[derive(Args)]
pub(super) struct Convert {
    /// The model to read.
    model: PathBuf,
    /// The model to write; or the mesh, .glb or .ply.
    #[arg(short, long)]
    output: PathBuf,
    /// Landmarks to give it instead of its own, JSON.
    #[arg(long)]
    landmarks: Option<PathBuf>,
    /// Give a model without expressions one that changes nothing: some readers of the Basel face
    /// model 2017, like eos's converter, demand the block. For .h5 and .h5.json.
    #[arg(long)]
    zero_expression: bool,
}

impl Convert {
    pub(super) fn run(self, console: Console) -> Result<()> {
        if has_extension(&self.output, &["glb", "ply"]) {
            if let Some(path) = &self.landmarks {
                return Err(Error::file(path, "a mesh has no landmarks; leave --landmarks out"));
            }
            output_file(&self.output, &["glb", "ply"])?;
            let file = interchange::open(&self.model)?;
            write_mesh(&self.output, &render::instance(&file.view(), &[], &[]))?;
            console.say(format_args!("wrote the mean, {}", self.output.display()));
            return Ok(());
        }
        interchange::can_write(&self.output)?;
        output_file(&self.output, &["3dmm", "h5", "hdf5", "h5.json", "glb", "ply"])?;
        let mut model = match &self.landmarks {
            None => read_model(console, &self.model)?,
            // What there is to say of its own landmarks does not matter.
            Some(path) => {
                let mut model = interchange::read(&self.model)?.model;
                model.landmarks = landmarks::read(path, model.reference(), 1.0)?;
                model.uncertainties = landmarks::read_uncertainties(path)?;
                model
            }
        };
        if self.zero_expression {
            if Format::of(&self.output) == Format::ThreeDmm {
                return Err(Error::file(
                    &self.output,
                    "--zero-expression is for .h5 and .h5.json; .3dmm has no expressions",
                ));
            }
            let vertices = model.shape.vertices();
            model.expression.get_or_insert_with(|| Process::zero(vertices));
        }
        write_model(console, &self.model, &self.output, &model)
    }
}
