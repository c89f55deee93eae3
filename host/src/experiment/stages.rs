//! The stages that an experiment has done, kept until all are: the same command goes on where it was stopped.

use crate::error::{Error, Result};
use crate::files::{self, seal, unseal, write_atomically};
use crate::photo;
use crate::photo::picture::Picture;
use onescan_core::hash::fnv64;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::cell::RefCell;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// First bytes of a stage's file, version included.
const MAGIC: [u8; 8] = *b"1scanst1";

/// The stages of one experiment, files in a folder.
pub struct Stages {
    folder: PathBuf,
    settings: u64,
    /// The files of those that were asked for.
    used: RefCell<Vec<PathBuf>>,
}

impl Stages {
    /// Those of an experiment with these settings (all that its results depend on, but this program's version),
    /// in the folder `stages` of its output directory, which is made with the first of them.
    pub fn new(output: &Path, settings: &str) -> Self {
        let settings = fnv64(format!("{} {settings}", env!("CARGO_PKG_VERSION")).as_bytes());
        Self { folder: output.join("stages"), settings, used: RefCell::default() }
    }

    /// What a stage came to: as it was kept, or as it is made now, to be kept. Names are names of files.
    ///
    /// # Errors
    /// Those of `make`; a folder that cannot be written.
    pub fn stage<T: Serialize + DeserializeOwned>(
        &self,
        name: &str,
        make: impl FnOnce() -> Result<T>,
    ) -> Result<T> {
        let path = self.folder.join(format!("{name}.bin"));
        self.used.borrow_mut().push(path.clone());
        let known = files::read(&path).ok().and_then(|bytes| unseal(MAGIC, &bytes));
        if let Some(known) = known.and_then(|known| self.value(&known)) {
            return Ok(known);
        }
        let made = make()?;
        // As JSON, since results may leave fields out, which postcard could not read.
        let text = serde_json::to_string(&made).map_err(Error::new)?;
        let bytes = seal(MAGIC, &(self.settings, text))?;
        std::fs::create_dir_all(&self.folder).map_err(|e| Error::file(&self.folder, e))?;
        write_atomically(&path, |out| out.write_all(&bytes))?;
        Ok(made)
    }

    fn value<T: DeserializeOwned>(&self, (settings, text): &(u64, String)) -> Option<T> {
        serde_json::from_str(text).ok().filter(|_| *settings == self.settings)
    }

    /// Removes them: the experiment's results are written.
    pub fn forget(self) {
        // What stays is only in the way; what else is in the folder keeps it.
        for path in self.used.into_inner() {
            let _ = std::fs::remove_file(path);
        }
        let _ = std::fs::remove_dir(self.folder);
    }
}

/// Pictures as a stage keeps them.
///
/// # Errors
/// A picture without pixels.
pub fn packed(pictures: &[Picture]) -> Result<Vec<Vec<u8>>> {
    pictures.iter().map(Picture::to_png).collect()
}

/// The pictures that [`packed`] has made so.
///
/// # Errors
/// Bytes of another origin.
pub fn unpacked(kept: &[Vec<u8>]) -> Result<Vec<Picture>> {
    kept.iter().map(|bytes| photo::decode(bytes)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::metrics::{Estimate, Metrics, Point};

    #[test]
    fn results_come_back_to_the_last_bit_whatever_they_leave_out() {
        let place = tempfile::tempdir().unwrap();
        let estimate = Estimate { mean: 0.1 + 0.2, standard_error: 1e-300 };
        let point = Point {
            components: 1,
            compactness: std::f64::consts::PI,
            generalization: estimate,
            specificity: estimate,
            surface_generalization: Some(estimate),
            surface_specificity: None,
        };
        let metrics = Metrics { shape: vec![point], albedo: Vec::new() };
        let stages = Stages::new(place.path(), "");
        stages.stage("one", || Ok(metrics.clone())).unwrap();
        let again = stages.stage("one", || Err(Error::new("it was kept"))).unwrap();
        assert_eq!(metrics, again);
        let pictures = [Picture::filled(3, 2, [9, 0, 255]), Picture::filled(1, 1, [1, 2, 3])];
        stages.stage("two", || packed(&pictures)).unwrap();
        let again: Vec<Vec<u8>> = stages.stage("two", || Err(Error::new("it was kept"))).unwrap();
        assert_eq!(unpacked(&again).unwrap(), pictures);
    }

    #[test]
    fn a_stage_is_made_once_for_the_same_settings() {
        let place = tempfile::tempdir().unwrap();
        let made = |settings: &str, value: f64| {
            let stages = Stages::new(place.path(), settings);
            stages.stage("one", || Ok(vec![value])).unwrap()
        };
        assert_eq!(made("a", 1.5), [1.5]);
        assert_eq!(made("a", 2.5), [1.5], "it was kept");
        assert_eq!(made("b", 2.5), [2.5], "of other settings");
        std::fs::write(place.path().join("stages/one.bin"), "damaged").unwrap();
        assert_eq!(made("b", 3.5), [3.5]);
        let stages = Stages::new(place.path(), "b");
        let failed = stages.stage("two", || Err::<u8, _>(Error::new("stopped")));
        assert_eq!(failed.unwrap_err().to_string(), "stopped");
        assert_eq!(stages.stage("one", || Ok(vec![4.5])).unwrap(), [3.5]);
        stages.forget();
        assert_eq!(std::fs::read_dir(place.path()).unwrap().count(), 0);
    }
}
