//! `onescan convert`.

use super::model_file;
use clap::Args;
use onescan::error::{Error, Result};
use onescan::interchange::{self, Format};
use onescan::landmarks;
use onescan::progress::Console;
use std::path::PathBuf;

/// Formats by extension: .3dmm is ours; .h5 is that of statismo, scalismo and the Basel face models
/// 2017 and 2019; .h5.json the same as newer versions of scalismo write it; .mat is the Basel face
/// model 2009 and only read. What the new file cannot carry is said.
#[derive(Args)]
pub(super) struct Convert {
    /// The model to read.
    model: PathBuf,
    /// The model to write.
    #[arg(short, long)]
    output: PathBuf,
    /// Landmarks to give it instead of its own, JSON.
    #[arg(long)]
    landmarks: Option<PathBuf>,
}

impl Convert {
    pub(super) fn run(self, console: Console) -> Result<()> {
        model_file(&self.output)?;
        let mut import = interchange::read(&self.model)?;
        if let Some(path) = &self.landmarks {
            import.notes.clear();
            import.model.landmarks = landmarks::read(path, import.model.reference(), 1.0)?;
            import.model.uncertainties = landmarks::read_uncertainties(path)?;
        }
        let model = import.model;
        interchange::write(&model, &self.output)?;
        for note in import.notes {
            console.say(Error::file(&self.model, note));
        }
        for lost in interchange::lost(&model, Format::of(&self.output)) {
            console.say(format_args!("not in this format: {lost}"));
        }
        console.say(format_args!("wrote {}", self.output.display()));
        Ok(())
    }
}
