//! Models by file name: which program's format a file has, and what each format cannot carry.

pub mod bfm2009;
pub mod hdf5;
pub mod mat;
pub mod mixture;
pub mod statismo;

use crate::error::{Error, Result};
use crate::files::{self, write_atomically};
use crate::model::morphable::{Import, Morphable};
use crate::model_file::OwnedModel;
use hdf5::{BinaryFile, JsonFile};
use std::io::Write;
use std::path::Path;

/// A format that models are kept in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `.3dmm`: ours.
    ThreeDmm,
    /// `.h5`: HDF5 as statismo, scalismo and the Basel face models lay it out.
    Hdf5,
    /// `.h5.json`: the same as JSON.
    Hdf5Json,
    /// `.mat`: the Basel face model of 2009.
    Mat,
}

impl Format {
    /// The format a file's name tells; ours if it tells none.
    pub fn of(path: &Path) -> Self {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        let ends = |end: &str| name.ends_with(end);
        if ends(".h5.json") {
            Self::Hdf5Json
        } else if ends(".h5") || ends(".hdf5") {
            Self::Hdf5
        } else if ends(".mat") {
            Self::Mat
        } else {
            Self::ThreeDmm
        }
    }
}

/// Reads a model of any format.
///
/// # Errors
/// When the file cannot be read or is not a model of the format its name tells; they name the
/// file.
pub fn read(path: &Path) -> Result<Import> {
    let fault = |e| Error::file(path, e);
    match Format::of(path) {
        Format::ThreeDmm => {
            let file = open(path)?;
            Ok(Import { model: Morphable::of(&file.view()), notes: Vec::new() })
        }
        format => {
            let bytes = files::read(path).map_err(|e| Error::file(path, e))?;
            parse(format, bytes).map_err(fault)
        }
    }
}

/// Opens a model of any format as a `.3dmm`. Of another program's model only that remains which a `.3dmm`
/// holds.
///
/// # Errors
/// Those of [`read`].
pub fn open(path: &Path) -> Result<OwnedModel> {
    if mixture::is_mixture(path) {
        return Err(Error::file(
            path,
            "is a mixture of models, which fit and recognise take; here name one of its models",
        ));
    }
    if Format::of(path) == Format::ThreeDmm {
        return OwnedModel::read(path);
    }
    read(path)?.model.to_model(i16::MAX).map_err(|e| Error::file(path, e))
}

/// Parses the bytes of a model in another program's format.
///
/// # Errors
/// Those of [`statismo::read`] and [`bfm2009::parse`]; bytes that are not a `.3dmm` model.
pub fn parse(format: Format, bytes: Vec<u8>) -> Result<Import> {
    match format {
        Format::ThreeDmm => {
            let file = OwnedModel::from_bytes(&bytes)?;
            Ok(Import { model: Morphable::of(&file.view()), notes: Vec::new() })
        }
        Format::Hdf5 => statismo::read(&BinaryFile::parse(bytes)?),
        Format::Hdf5Json => {
            let text = String::from_utf8(bytes).map_err(Error::new)?;
            statismo::read(&JsonFile::parse(&text)?)
        }
        Format::Mat => bfm2009::parse(&bytes),
    }
}

/// Writes a model, which was made of the file `from`, in the format of the file's name, whole or not
/// at all.
///
/// # Errors
/// When the place cannot be written, or the format is only read; naming `from`, when the format cannot
/// hold the model.
pub fn write(model: &Morphable, from: &Path, path: &Path) -> Result<()> {
    match Format::of(path) {
        Format::ThreeDmm => model.to_model(i16::MAX).map_err(|e| Error::file(from, e))?.write(path),
        Format::Hdf5 => {
            let root = statismo::write(model);
            write_atomically(path, |out| root.write(out))
        }
        Format::Hdf5Json => {
            let root = statismo::write(model);
            write_atomically(path, |out| root.write_json(out))
        }
        Format::Mat => Err(Error::file(path, NOT_WRITTEN)),
    }
}

const NOT_WRITTEN: &str = ".mat models are read, not written; give .3dmm, .h5 or .h5.json";

/// Checks that models are written in the format of the file's name.
///
/// # Errors
/// When they are only read.
pub fn can_write(path: &Path) -> Result<()> {
    match Format::of(path) {
        Format::Mat => Err(Error::file(path, NOT_WRITTEN)),
        _ => Ok(()),
    }
}

/// What of a model a format cannot carry, as words for a person.
pub fn lost(model: &Morphable, format: Format) -> Vec<String> {
    let halves = [("shape", &model.shape), ("albedo", &model.albedo)];
    let mut lost = Vec::new();
    if format == Format::ThreeDmm {
        for (name, process) in halves {
            if process.noise > 0.0 {
                lost.push(format!("noise of the {name} (variance {})", process.noise as f32));
            }
        }
        if let Some(expression) = &model.expression {
            lost.push(format!("expressions ({} components)", expression.rank()));
        }
        if model.reference.is_some() {
            lost.push("the reference, which is not the mean".into());
        }
        if !model.uncertainties.is_empty() {
            lost.push(format!("how sure {} landmarks are", model.uncertainties.len()));
        }
    } else {
        for (name, process) in halves {
            let kept = process.held();
            // What rounding of the basis takes is none.
            if process.total_variance > 1.001 * kept {
                let share = 100.0 * (1.0 - kept / process.total_variance);
                lost.push(format!("that the {name} leaves out {share:.1} % of its variance"));
            }
        }
        if model.occlusion.is_some() {
            lost.push("where the surface is likely to be hidden (the occlusion map)".into());
        }
        lost.push("where the model comes from".into());
    }
    lost
}

/// Bytes of a file as [`write()`] makes them.
///
/// # Errors
/// As [`write()`], but for the place.
pub fn to_bytes(model: &Morphable, format: Format) -> Result<Vec<u8>> {
    let mut bytes: Vec<u8> = Vec::new();
    match format {
        Format::ThreeDmm => {
            bytes.write_all(model.to_model(i16::MAX)?.bytes()).map_err(Error::new)?;
        }
        Format::Hdf5 => statismo::write(model).write(&mut bytes).map_err(Error::new)?,
        Format::Hdf5Json => statismo::write(model).write_json(&mut bytes).map_err(Error::new)?,
        Format::Mat => return Err(Error::new(NOT_WRITTEN)),
    }
    Ok(bytes)
}
