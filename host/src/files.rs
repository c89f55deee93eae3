//! Names of files; reading text; writing files whole or not at all.

use crate::error::{Error, Result};
use std::path::Path;
#[cfg(feature = "full")]
use std::{
    fs::File,
    io::{self, BufWriter, Write},
    path::PathBuf,
};

/// Whether a file's name ends in one of these extensions, in capitals or not.
pub fn has_extension(path: &Path, among: &[&str]) -> bool {
    path.extension().is_some_and(|e| among.iter().any(|a| e.eq_ignore_ascii_case(a)))
}

/// Files that are named, and those of directories that are: of these in the order of their names the
/// ones with such an extension.
///
/// # Errors
/// A directory that cannot be read or has none; `none` says what is missing, and the mend.
#[cfg(feature = "full")]
pub fn listed(places: &[PathBuf], among: &[&str], none: &str) -> Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for place in places {
        if !place.is_dir() {
            paths.push(place.clone());
            continue;
        }
        let before = paths.len();
        for entry in std::fs::read_dir(place).map_err(|e| Error::file(place, e))? {
            let path = entry.map_err(|e| Error::file(place, e))?.path();
            if has_extension(&path, among) {
                paths.push(path);
            }
        }
        if paths.len() == before {
            return Err(Error::file(place, none));
        }
        paths[before..].sort();
    }
    Ok(paths)
}

/// Reads a text of UTF-8, or of UTF-16 if a byte order mark says so; the mark is not part of it.
///
/// # Errors
/// A file that cannot be read or is not text; they name the file.
pub fn read_text(path: &Path) -> Result<String> {
    let bytes = std::fs::read(path).map_err(|e| Error::file(path, e))?;
    let units = |unit: fn([u8; 2]) -> u16| {
        let (pairs, rest) = bytes.as_chunks();
        let units = pairs.iter().skip(1).map(|pair| unit(*pair));
        let text = char::decode_utf16(units).collect::<std::result::Result<String, _>>();
        text.ok().filter(|_| rest.is_empty())
    };
    let text = match &bytes[..] {
        [0xff, 0xfe, ..] => units(u16::from_le_bytes),
        [0xfe, 0xff, ..] => units(u16::from_be_bytes),
        bytes => std::str::from_utf8(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes))
            .ok()
            .map(str::to_owned),
    };
    text.ok_or_else(|| Error::file(path, "not a text; give a file of text, saved as UTF-8"))
}

/// Writes a file by `content` under a temporary name beside `path`, then renames it: readers
/// see the old file or the whole new one, never a part.
///
/// # Errors
/// When the directory is missing or not writable, the disk is full, or `path` is a directory;
/// nothing is left behind.
#[cfg(feature = "full")]
pub fn write_atomically(
    path: &Path,
    content: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> Result<()> {
    let fault =
        |e: io::Error| Error::file(path, format_args!("cannot write: {e}; give a writable place"));
    let directory = match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".onescan-");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // As `File::create` would: the umask takes its share.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let mut file = builder.tempfile_in(directory).map_err(fault)?;
    let mut writer = BufWriter::with_capacity(1 << 16, file.as_file_mut());
    content(&mut writer).and_then(|()| writer.flush()).map_err(fault)?;
    drop(writer);
    file.persist(path).map_err(|e| fault(e.error))?;
    Ok(())
}

#[cfg(all(test, feature = "full"))]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("model");
        write_atomically(&path, |w| w.write_all(b"old")).unwrap();
        let failed = write_atomically(&path, |w| {
            w.write_all(b"new")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("cannot write: disk full"));
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(&directory).unwrap().count(), 1);
    }

    #[test]
    fn text_is_read_whatever_wrote_it() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let read = |bytes: &[u8]| {
            std::fs::write(file.path(), bytes).unwrap();
            read_text(file.path())
        };
        assert_eq!(read(b"a \xc3\xa9").unwrap(), "a é");
        assert_eq!(read(b"\xef\xbb\xbfa").unwrap(), "a");
        assert_eq!(read(b"\xff\xfea\0\xe9\0").unwrap(), "aé");
        assert_eq!(read(b"\xfe\xff\0a").unwrap(), "a");
        for no_text in [&b"\x89PNG"[..], b"\xff\xfe\0\xd8", b"\xff\xfea\0b"] {
            let error = read(no_text).unwrap_err().to_string();
            assert!(error.ends_with("not a text; give a file of text, saved as UTF-8"), "{error}");
        }
    }

    #[test]
    fn a_missing_directory_is_named() {
        let error = write_atomically(Path::new("/nowhere/at/all"), |_| Ok(())).unwrap_err();
        assert!(error.to_string().starts_with("/nowhere/at/all: cannot write"), "{error}");
    }
}
