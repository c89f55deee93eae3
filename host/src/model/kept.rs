//! The first half of a model, kept in a file while the second is computed, so that a build that was stopped
//! goes on from there with the same bits.

use crate::error::Result;
use crate::files::{self, seal, unseal, write_atomically};
use crate::model::decompose::{Decomposition, Truncation};
use crate::model::kernel::{Kernel, Vertex};
use onescan_core::hash::Fnv64;
use std::fs::File;
use std::io::{Read as _, Write as _};
use std::path::Path;
use std::time::Duration;

/// First bytes of a file, version included.
const MAGIC: [u8; 8] = *b"1scanbd1";

/// A half that took less is not worth a file.
pub(super) const WORTH: Duration = Duration::from_secs(15);

/// What a half is computed of: kernel, vertices, how many components, and by which program.
pub(super) fn identity(kernel: &Kernel, vertices: &[Vertex], truncation: Truncation) -> u64 {
    let mut hash = Fnv64::default();
    let version = env!("CARGO_PKG_VERSION");
    hash.write(format!("{version} {kernel} {truncation:?} {}", vertices.len()).as_bytes());
    for number in vertices.iter().flat_map(|v| v.position.into_iter().chain(v.color)) {
        hash.write(&number.to_bits().to_le_bytes());
    }
    hash.finish()
}

/// Whether a file is such a one.
fn is_ours(path: &Path) -> bool {
    let mut first = [0; MAGIC.len()];
    File::open(path).and_then(|mut file| file.read_exact(&mut first)).is_ok() && first == MAGIC
}

/// Removes such a file, if one is there.
pub fn forget(path: &Path) {
    if is_ours(path) {
        // What stays is only in the way.
        let _ = std::fs::remove_file(path);
    }
}

/// Keeps a half of that identity, unless something else is there.
pub(super) fn write(path: &Path, identity: u64, half: &Decomposition) -> Result<()> {
    if path.exists() && !is_ours(path) {
        return Ok(());
    }
    let bytes = seal(MAGIC, &(identity, half))?;
    write_atomically(path, |out| out.write_all(&bytes))
}

/// The half of that identity, over so many vertices, if the file holds it.
pub(super) fn read(path: &Path, identity: u64, vertices: usize) -> Option<Decomposition> {
    let (of, half): (u64, Decomposition) = unseal(MAGIC, &files::read(path).ok()?)?;
    (of == identity && half.is_over(vertices)).then_some(half)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::decompose::decompose;
    use crate::model::kernel::Preset;

    #[test]
    fn what_was_kept_comes_back_if_it_is_the_same_and_whole() {
        let vertex = |i: u8| Vertex { position: [f64::from(i), 1.0, 0.3], color: [0.5; 3] };
        let vertices: Vec<_> = (0..9).map(vertex).collect();
        let kernel = Preset::named("standard-full").unwrap().shape(None);
        let rank = Truncation::Rank(5);
        let half = decompose(&kernel, &vertices, rank, &mut |_, _| ()).unwrap();
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("kept");
        let of = identity(&kernel, &vertices, rank);
        assert!(read(&path, of, 9).is_none());
        write(&path, of, &half).unwrap();
        let found = read(&path, of, 9).unwrap();
        assert_eq!(found.variances, half.variances);
        assert!((0..5).all(|k| found.column(k) == half.column(k)));
        assert!(read(&path, of, 8).is_none());
        for other in [
            identity(&kernel, &vertices[..8], rank),
            identity(&kernel, &vertices, Truncation::Rank(6)),
            identity(&Preset::named("standard-full").unwrap().albedo(None), &vertices, rank),
        ] {
            assert!(other != of && read(&path, other, 9).is_none());
        }
        let mut bytes = files::read(&path).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        std::fs::write(&path, &bytes).unwrap();
        assert!(read(&path, of, 9).is_none());
        forget(&path);
        assert!(!path.exists());
        // Somebody else's file stays.
        std::fs::write(&path, "mine, and long enough").unwrap();
        write(&path, of, &half).unwrap();
        forget(&path);
        assert!(std::fs::read(&path).unwrap().starts_with(b"mine"));
    }
}
