//! Names of files; reading text; what continues an interrupted command; writing files whole or not at all.

use crate::error::{Error, Result};
use onescan_core::hash::fnv64;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::Path;
#[cfg(feature = "full")]
use std::{
    io::{BufWriter, Write},
    path::PathBuf,
};

/// Whether a file's name ends in one of these extensions, in capitals or not.
pub fn has_extension(path: &Path, among: &[&str]) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    among
        .iter()
        .any(|e| name.strip_suffix(e).is_some_and(|rest| rest.len() > 1 && rest.ends_with('.')))
}

/// What a file can be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A model.
    Model,
    /// A mesh.
    Scan,
    /// A photo.
    Photo,
    /// Landmarks on a mesh.
    ScanLandmarks,
    /// Landmarks in a photo.
    PhotoLandmarks,
}

impl FileKind {
    const ALL: [Self; 5] =
        [Self::Model, Self::Scan, Self::Photo, Self::ScanLandmarks, Self::PhotoLandmarks];

    /// What it is called, and the extensions it has.
    fn known(self) -> (&'static str, &'static [&'static str]) {
        match self {
            Self::Model => ("a model", &["3dmm", "h5", "h5.json", "hdf5", "mat"]),
            Self::Scan => ("a scan", &["ply", "obj", "glb", "gltf", "stl", "off"]),
            Self::Photo => ("a photo", &["png", "jpg", "jpeg"]),
            Self::ScanLandmarks => ("landmarks on a scan", &["json", "pp", "mrk.json", "fcsv"]),
            Self::PhotoLandmarks => ("landmarks in a photo", &["tlms", "pts", "json"]),
        }
    }

    /// The kind that a file's name tells. `.json` alone tells none.
    pub fn of(path: &Path) -> Option<Self> {
        let tells = |e: &&str| *e != "json" && has_extension(path, &[e]);
        Self::ALL.into_iter().find(|kind| kind.known().1.iter().any(&tells))
    }

    /// What to say of a file of this kind that stands where another belongs.
    pub fn in_place_of(self, other: Self) -> String {
        let ((found, _), (wanted, extensions)) = (self.known(), other.known());
        let known = extensions.join(", .");
        format!("is {found}, in the place of {wanted} (.{known}); --help shows the order")
    }

    /// Says that a file is of another kind, if its name tells so, as names of files do that were given in the
    /// wrong order.
    pub fn misplaced(self, path: &Path) -> Option<Error> {
        let found = Self::of(path).filter(|found| *found != self && path.is_file())?;
        Some(Error::file(path, found.in_place_of(self)))
    }

    /// What to say of a file that could not be read as this kind: that it is another, or else `fault`.
    pub fn or_misplaced(self, path: &Path, fault: impl std::fmt::Display) -> Error {
        self.misplaced(path).unwrap_or_else(|| Error::file(path, fault))
    }
}

/// The files among `places`, and of each directory among them the files with one of the extensions, in the
/// order of their names.
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

/// Most bytes that are read of what is no file, whose length is not known before: a pipe, a device. Chosen,
/// not measured.
const MOST_STREAMED: u64 = 1 << 30;

/// Reads a file, or what a pipe or a device gives.
///
/// # Errors
/// A file that cannot be read; a stream without end; they do not name the file.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut file = File::open(path)?;
    let known = file.metadata()?;
    let mut bytes = Vec::new();
    if known.is_file() {
        let length = usize::try_from(known.len()).unwrap_or(usize::MAX);
        bytes.try_reserve_exact(length).map_err(|_| {
            io::Error::new(ErrorKind::OutOfMemory, format!("{length} bytes do not fit into memory"))
        })?;
        file.read_to_end(&mut bytes)?;
    } else if file.take(MOST_STREAMED + 1).read_to_end(&mut bytes)? as u64 > MOST_STREAMED {
        return Err(io::Error::other("no file, and gives more than 1 GiB; give a file"));
    }
    Ok(bytes)
}

/// Reads a text of UTF-8, or of UTF-16 if a byte order mark says so; the mark is not part of it.
///
/// # Errors
/// A file that cannot be read or is not text; they name the file.
pub fn read_text(path: &Path) -> Result<String> {
    let bytes = read(path).map_err(|e| Error::file(path, e))?;
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

/// Bytes of what continues an interrupted command: their kind, FNV-1a 64 of the rest, postcard. Binary,
/// because every bit of every number must come back.
///
/// # Errors
/// None in practice; the encoder's are passed on.
pub(crate) fn seal(kind: [u8; 8], value: &impl Serialize) -> Result<Vec<u8>> {
    let mut bytes = postcard::to_extend(value, vec![0; 16]).map_err(Error::new)?;
    let sum = fnv64(&bytes[16..]);
    bytes[..8].copy_from_slice(&kind);
    bytes[8..16].copy_from_slice(&sum.to_le_bytes());
    Ok(bytes)
}

/// What [`seal`] has made of a value; `None` if it is of another kind or damaged.
pub(crate) fn unseal<T: DeserializeOwned>(kind: [u8; 8], bytes: &[u8]) -> Option<T> {
    let (own, rest) = bytes.split_first_chunk::<8>()?;
    let (sum, body) = rest.split_first_chunk::<8>()?;
    let whole = *own == kind && u64::from_le_bytes(*sum) == fnv64(body);
    postcard::from_bytes(body).ok().filter(|_| whole)
}

/// Whether something is there that is neither file nor directory: a device or a pipe, to be written
/// through.
#[cfg(feature = "full")]
pub fn is_stream(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|known| !known.is_file() && !known.is_dir())
}

#[cfg(feature = "full")]
fn fault(path: &Path, e: &io::Error) -> Error {
    Error::file(path, format_args!("cannot write: {e}; give a writable place"))
}

/// A file whose content is on the disk, under a temporary name beside the one it is to have.
#[cfg(feature = "full")]
struct Prepared {
    content: tempfile::NamedTempFile,
    /// Where symbolic links lead.
    target: PathBuf,
    /// What is there now has other names, which are to stay names of it.
    linked: bool,
}

#[cfg(feature = "full")]
impl Prepared {
    /// Writes a file's content; mode and owner are those of the file that is there, if one is.
    fn new(
        path: &Path,
        content: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
    ) -> io::Result<Self> {
        let target = followed(path);
        let old = std::fs::metadata(&target).ok();
        let mut builder = tempfile::Builder::new();
        builder.prefix(".onescan-");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // As `File::create` would: the umask takes its share.
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let mut file = builder.tempfile_in(folder(&target))?;
        let mut writer = BufWriter::with_capacity(1 << 16, file.as_file_mut());
        content(&mut writer)?;
        writer.flush()?;
        drop(writer);
        let mut linked = false;
        if let Some(old) = old {
            #[cfg(unix)]
            {
                use std::os::unix::fs::{MetadataExt, fchown};
                linked = old.nlink() > 1;
                let new = file.as_file().metadata()?;
                if (new.uid(), new.gid()) != (old.uid(), old.gid()) {
                    // Who may not give files away keeps them.
                    let _ = fchown(file.as_file(), Some(old.uid()), Some(old.gid()));
                }
            }
            file.as_file().set_permissions(old.permissions())?;
        }
        file.as_file().sync_all()?;
        Ok(Self { content: file, target, linked })
    }

    /// Gives the file its name: readers see the old one or the whole new one.
    fn publish(self) -> io::Result<()> {
        if self.linked {
            // A new file would part the names, so the old one gets the content.
            let mut from = self.content.reopen()?;
            let mut to = File::create(&self.target)?;
            io::copy(&mut from, &mut to)?;
            return to.sync_all();
        }
        self.content.persist(&self.target).map(drop).map_err(|e| e.error)
    }
}

/// The directory a file is in.
#[cfg(feature = "full")]
pub fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    }
}

/// Where a symbolic link leads, whether or not something is there.
#[cfg(feature = "full")]
fn followed(path: &Path) -> PathBuf {
    // As many as Linux follows.
    const MOST: usize = 40;
    let mut path = path.to_path_buf();
    for _ in 0..MOST {
        let Ok(next) = std::fs::read_link(&path) else { break };
        path = folder(&path).join(next);
    }
    path
}

/// Makes sure that names given in a directory outlast a loss of power, where the system can.
#[cfg(feature = "full")]
fn sync_folder(directory: &Path) {
    if cfg!(unix) {
        // Some file systems have nothing to sync there, and say so.
        let _ = File::open(directory).and_then(|directory| directory.sync_all());
    }
}

/// Writes a file by `content` under a temporary name beside `path`, then renames it: readers
/// see the old file or the whole new one, never a part, also after a loss of power. Symbolic links,
/// further names, mode and owner of the old file stay. What is no file is written through.
///
/// # Errors
/// When the directory is missing or not writable, the disk is full, or `path` is a directory;
/// nothing is left behind.
#[cfg(feature = "full")]
pub fn write_atomically(
    path: &Path,
    content: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> Result<()> {
    let write = || {
        if is_stream(path) {
            let mut file = File::options().write(true).open(path)?;
            let mut writer = BufWriter::with_capacity(1 << 16, &mut file);
            content(&mut writer)?;
            return writer.flush();
        }
        let prepared = Prepared::new(path, content)?;
        let directory = folder(&prepared.target).to_path_buf();
        prepared.publish()?;
        sync_folder(&directory);
        Ok(())
    };
    write().map_err(|e| fault(path, &e))
}

/// Writes the files of one result into a directory, all of them or none. By the last file others know that a
/// result is there. Before the first file gets its name, an older result's last file is removed, and what is to
/// be `gone` of that result. What the result was made of, `inputs`, is neither replaced nor removed.
///
/// # Errors
/// As [`write_atomically`], and a file that would replace an input. The older result is then still whole,
/// unless a finished file could not get its name.
#[cfg(feature = "full")]
pub fn publish(
    directory: &Path,
    files: &[(impl AsRef<Path>, Vec<u8>)],
    gone: &[impl AsRef<Path>],
    inputs: &[&Path],
) -> Result<()> {
    let inputs: Vec<_> = inputs.iter().filter_map(|path| path.canonicalize().ok()).collect();
    let is_input = |path: &Path| path.canonicalize().is_ok_and(|path| inputs.contains(&path));
    let mut prepared = Vec::new();
    for (name, _) in files {
        let path = directory.join(name);
        if is_input(&path) {
            return Err(Error::file(
                &path,
                "is read by this command and would be replaced by it; rename it, or give another -o",
            ));
        }
    }
    for (name, bytes) in files {
        let path = directory.join(name);
        let file = Prepared::new(&path, |out| out.write_all(bytes));
        prepared.push(file.map_err(|e| fault(&path, &e))?);
    }
    let last = files.last().map(|(name, _)| name.as_ref());
    for name in last.into_iter().chain(gone.iter().map(AsRef::as_ref)) {
        let path = directory.join(name);
        if is_input(&path) {
            continue;
        }
        match std::fs::remove_file(&path) {
            Err(e) if e.kind() != ErrorKind::NotFound => return Err(Error::file(&path, e)),
            _ => {}
        }
    }
    sync_folder(directory);
    for ((name, _), file) in files.iter().zip(prepared) {
        let path = directory.join(name);
        if Some(name.as_ref()) == last {
            // All that it stands for is there before it is.
            for (name, _) in files {
                sync_folder(folder(&directory.join(name)));
            }
        }
        file.publish().map_err(|e| fault(&path, &e))?;
    }
    sync_folder(directory);
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

    #[cfg(unix)]
    #[test]
    fn what_is_overwritten_keeps_its_links_and_mode() {
        use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        std::fs::write(at("file"), "old").unwrap();
        std::fs::set_permissions(at("file"), std::fs::Permissions::from_mode(0o640)).unwrap();
        symlink("file", at("link")).unwrap();
        let write = |name: &str, text: &str| {
            write_atomically(&at(name), |w| w.write_all(text.as_bytes())).unwrap();
        };
        write("link", "new");
        assert!(at("link").symlink_metadata().unwrap().is_symlink());
        let known = std::fs::metadata(at("file")).unwrap();
        assert_eq!((known.mode() & 0o777, known.len()), (0o640, 3));
        std::fs::hard_link(at("file"), at("twin")).unwrap();
        write("file", "longer");
        assert_eq!(std::fs::read(at("twin")).unwrap(), b"longer");
        symlink("nowhere yet", at("dangling")).unwrap();
        write("dangling", "x");
        assert_eq!(std::fs::read(at("nowhere yet")).unwrap(), b"x");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn devices_are_written_through_and_streams_end() {
        write_atomically(Path::new("/dev/null"), |w| w.write_all(b"gone")).unwrap();
        assert!(is_stream(Path::new("/dev/null")));
        let full = write_atomically(Path::new("/dev/full"), |w| w.write_all(b"gone"));
        assert!(full.unwrap_err().to_string().starts_with("/dev/full: cannot write"));
        let endless = read(Path::new("/dev/zero")).unwrap_err().to_string();
        assert!(endless.contains("more than 1 GiB"), "{endless}");
    }

    #[test]
    fn a_result_is_published_whole_or_not_at_all() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        let names = || {
            let entries = std::fs::read_dir(&directory).unwrap();
            let mut names: Vec<_> =
                entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
            names.sort();
            names
        };
        let files = |text: &str| [("a", text.into()), ("last", text.into())];
        publish(directory.path(), &files("old"), &["b"], &[]).unwrap();
        std::fs::write(at("b"), "stale").unwrap();
        // The second cannot be written, so the first is not published.
        let broken = [("a", b"new".to_vec()), ("none/last", b"new".to_vec())];
        assert!(publish(directory.path(), &broken, &["b"], &[]).is_err());
        assert_eq!(std::fs::read(at("a")).unwrap(), b"old");
        assert_eq!(names(), ["a", "b", "last"]);
        // An input is neither removed nor replaced, by whatever name it was given.
        let input = directory.path().join("./b");
        publish(directory.path(), &files("mid"), &["b"], &[&input]).unwrap();
        assert_eq!(names(), ["a", "b", "last"]);
        let refused = publish(directory.path(), &files("new"), &["b"], &[&at("a")]).unwrap_err();
        assert!(refused.to_string().contains("would be replaced"), "{refused}");
        assert_eq!(std::fs::read(at("a")).unwrap(), b"mid");
        publish(directory.path(), &files("new"), &["b"], &[]).unwrap();
        assert_eq!(std::fs::read(at("a")).unwrap(), b"new");
        assert_eq!(names(), ["a", "last"]);
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
