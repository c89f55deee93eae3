//! Reading `.h5` files.

use super::{Store, missing};
use crate::error::{Error, Result};
use hdf5_pure::{DType, Dataset, Error as Fault, File, FormatError};

/// No dataset of a model shrinks this much when it is compressed; one that claims to would take
/// more memory than its file deserves.
const MOST_COMPRESSED: u64 = 64;

/// An `.h5` file in memory.
pub struct BinaryFile {
    file: File,
    bytes: u64,
}

impl BinaryFile {
    /// Takes the bytes of a file.
    ///
    /// # Errors
    /// When they are not HDF5.
    pub fn parse(bytes: Vec<u8>) -> Result<Self> {
        let length = bytes.len() as u64;
        let file = File::from_bytes(bytes).map_err(|e| {
            Error::new(format_args!("not an HDF5 file, or a damaged one ({e}); get it again"))
        })?;
        Ok(Self { file, bytes: length })
    }

    fn dataset(&self, path: &str) -> Result<Option<Dataset>> {
        match self.file.dataset(path) {
            Ok(dataset) => Ok(Some(dataset)),
            Err(Fault::Format(FormatError::PathNotFound(_))) => Ok(None),
            Err(e) => Err(damaged(path, &e)),
        }
    }

    /// The dataset, if all it claims to hold can be in the file.
    fn bounded(&self, path: &str) -> Result<Dataset> {
        let dataset = self.dataset(path)?.ok_or_else(|| missing(path))?;
        let shape = dataset.shape().map_err(|e| damaged(path, &e))?;
        let size = dataset.element_size().map_err(|e| damaged(path, &e))?;
        let claimed = shape.iter().try_fold(size.max(8), |product, n| product.checked_mul(*n));
        let most = self.bytes.saturating_mul(MOST_COMPRESSED);
        match claimed {
            Some(claimed) if claimed <= most => Ok(dataset),
            _ => Err(Error::new(format_args!(
                "{path}: shape {shape:?} cannot be in a file of {} bytes; the file is damaged, \
                 get it again",
                self.bytes
            ))),
        }
    }
}

fn damaged(path: &str, fault: &Fault) -> Error {
    if let Fault::Format(FormatError::InvalidLayoutVersion(version)) = fault {
        return Error::new(format_args!(
            "{path}: stored in a way (layout version {version}) of HDF5 2.0, which is not read; write \
             the file again for older programs (h5py: libver=('earliest', 'v110'))"
        ));
    }
    Error::new(format_args!("{path}: {fault}; the file is damaged, get it again"))
}

impl Store for BinaryFile {
    fn shape(&self, path: &str) -> Result<Option<Vec<u64>>> {
        let Some(dataset) = self.dataset(path)? else { return Ok(None) };
        dataset.shape().map(Some).map_err(|e| damaged(path, &e))
    }

    fn numbers(&self, path: &str) -> Result<Vec<f64>> {
        let dataset = self.bounded(path)?;
        match dataset.dtype().map_err(|e| damaged(path, &e))? {
            DType::F32
            | DType::F64
            | DType::I8
            | DType::I16
            | DType::I32
            | DType::I64
            | DType::U8
            | DType::U16
            | DType::U32
            | DType::U64 => dataset.read_f64().map_err(|e| damaged(path, &e)),
            other => Err(Error::new(format_args!("{path}: holds {other}, expected numbers"))),
        }
    }

    fn text(&self, path: &str) -> Result<String> {
        let dataset = self.bounded(path)?;
        match dataset.dtype().map_err(|e| damaged(path, &e))? {
            DType::String | DType::VariableLengthString => {}
            other => {
                return Err(Error::new(format_args!("{path}: holds {other}, expected a text")));
            }
        }
        let texts = dataset.read_string().map_err(|e| damaged(path, &e))?;
        match <[String; 1]>::try_from(texts) {
            Ok([text]) => Ok(text.trim_end_matches('\0').to_string()),
            Err(texts) => {
                Err(Error::new(format_args!("{path}: {} texts, expected one", texts.len())))
            }
        }
    }
}
