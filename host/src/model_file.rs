//! `.3dmm` files in memory: their bytes, checked, read and written.
//!
//! The layout is documented with its reader, [`onescan_core::model`].

use crate::error::{Error, Result};
#[cfg(feature = "full")]
use crate::files::write_atomically;
use crate::files::{self, FileKind};
use onescan_core::model::Model;
#[cfg(feature = "full")]
use std::io::Write;
use std::path::Path;

/// A model with its memory: checked `.3dmm` bytes, aligned for a view.
#[derive(Clone, Debug)]
pub struct OwnedModel {
    words: Vec<u32>,
    bytes: usize,
}

impl OwnedModel {
    /// Copies bytes into aligned memory and checks them.
    ///
    /// # Errors
    /// Those of [`Model::new_checked`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let mut words = vec![0; bytes.len().div_ceil(4)];
        bytemuck::cast_slice_mut(&mut words)[..bytes.len()].copy_from_slice(bytes);
        let model = Self { words, bytes: bytes.len() };
        Model::new_checked(model.bytes()).map_err(Error::new)?;
        Ok(model)
    }

    /// Reads a `.3dmm` file.
    ///
    /// # Errors
    /// When the file cannot be read or is not a model; they name the file.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = files::read(path).map_err(|e| Error::file(path, e))?;
        Self::from_bytes(&bytes).map_err(|e| FileKind::Model.or_misplaced(path, e))
    }

    /// Writes the model file, whole or not at all.
    ///
    /// # Errors
    /// See [`write_atomically`].
    #[cfg(feature = "full")]
    pub fn write(&self, path: &Path) -> Result<()> {
        write_atomically(path, |out| out.write_all(self.bytes()))
    }

    /// The bytes of the file, starting at a multiple of four.
    pub fn bytes(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.bytes]
    }

    /// The model. Checks the bytes once more (some 1 ns each), so make it once and keep it.
    ///
    /// # Panics
    /// Never: the bytes were checked when they came in.
    pub fn view(&self) -> Model<'_> {
        Model::new_checked(self.bytes()).expect("bytes checked on entry")
    }
}
