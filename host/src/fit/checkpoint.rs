//! Checkpoint files: an interrupted fit goes on with the same bits.

use super::TracePoint;
use crate::error::{Error, Result};
use crate::files;
use onescan_core::chain::{Checkpoint, Config};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// First bytes of a checkpoint file, version included.
const MAGIC: [u8; 8] = *b"1scanck4";

/// What a checkpoint belongs to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    /// Checksum of the model.
    pub model: u64,
    /// Hash of photo, crop and landmarks.
    pub picture: u64,
    /// Configuration.
    pub config: Config,
    /// Seed.
    pub seed: u64,
    /// Number of chains.
    pub chains: u32,
}

/// One chain's state and its trace so far.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ChainSave {
    /// The chain.
    pub checkpoint: Checkpoint,
    /// Its trace.
    pub trace: Vec<TracePoint>,
}

/// An interrupted fit.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Save {
    /// What it belongs to.
    pub identity: Identity,
    /// Its chains, in order; none of one that had not begun.
    pub chains: Vec<Option<ChainSave>>,
}

impl Save {
    /// The file's bytes. Binary, because every bit of every number must come back.
    ///
    /// # Errors
    /// Never in practice: those of the encoder are passed on.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        pack(MAGIC, self)
    }

    /// Reads a checkpoint's bytes.
    ///
    /// # Errors
    /// Not a checkpoint, or damaged.
    pub fn parse(bytes: &[u8]) -> Result<Self> {
        unpack(MAGIC, bytes)
    }

    /// Reads a checkpoint file.
    ///
    /// # Errors
    /// As [`Save::parse`], naming the file.
    pub fn read(path: &Path) -> Result<Self> {
        read(path, Self::parse)
    }
}

/// A checkpoint's bytes.
pub(crate) fn pack(magic: [u8; 8], save: &impl Serialize) -> Result<Vec<u8>> {
    files::seal(magic, save)
}

/// What [`pack`] has packed.
pub(crate) fn unpack<T: DeserializeOwned>(kind: [u8; 8], bytes: &[u8]) -> Result<T> {
    files::unseal(kind, bytes).ok_or_else(|| {
        Error::new("not a checkpoint of this version, or damaged; fit without --resume")
    })
}

/// A file, parsed; errors name it.
pub(crate) fn read<T>(path: &Path, parse: impl FnOnce(&[u8]) -> Result<T>) -> Result<T> {
    let bytes = files::read(path).map_err(|e| {
        Error::file(path, format_args!("{e}; --resume continues an interrupted fit only"))
    })?;
    parse(&bytes).map_err(|e| Error::file(path, e))
}
