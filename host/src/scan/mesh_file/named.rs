//! Files that a scan names: its textures, materials and buffers.

use super::Options;
use crate::error::{Error, Result};
use std::borrow::Cow;
use std::path::{Component, Path, PathBuf};

/// Where a scan lies, and how far from there its files may lie.
pub(super) struct Place<'a> {
    file: &'a Path,
    directory: &'a Path,
    allow_outside: bool,
}

impl<'a> Place<'a> {
    pub(super) fn new(file: &'a Path, options: &Options) -> Self {
        let directory = file.parent().unwrap_or(Path::new(""));
        Self { file, directory, allow_outside: options.allow_outside }
    }

    /// The scan's name without its extension.
    pub(super) fn stem(&self) -> Cow<'_, str> {
        self.file.file_stem().unwrap_or_default().to_string_lossy()
    }

    /// The file of such a name; if there is none, the file beside, of the last part of the name: it
    /// may be a path of the author's machine. A name may be followed by a comment. `below` is where
    /// the file that names it lies, from the scan's directory.
    ///
    /// # Errors
    /// A file outside the scan's directory, if that is not allowed.
    pub(super) fn find(&self, below: &Path, name: &str) -> Result<PathBuf> {
        let mut names = vec![name];
        names.extend(name.split_once(" #").map(|(name, _)| name));
        let mut first = None;
        for name in names {
            let name = name.trim().trim_matches('"').replace('\\', "/");
            let path = below.join(&name);
            let whole = self.directory.join(&path);
            if outside(&path) && !self.allow_outside {
                if whole.is_file() {
                    return Err(Error::file(
                        &whole,
                        "lies outside the scan's directory; put it beside the scan, or give \
                         --allow-outside if you trust the file that names it",
                    ));
                }
            } else if whole.is_file() {
                return Ok(whole);
            }
            let last = name.rsplit('/').find(|part| !part.is_empty()).unwrap_or(&name);
            let beside = self.directory.join(below).join(last);
            if beside.is_file() {
                return Ok(beside);
            }
            first.get_or_insert(if outside(&path) { beside } else { whole });
        }
        Ok(first.unwrap_or_default())
    }

    /// [`find`](Self::find) of a texture; none, with a note, if there is no such file and `other`
    /// colours take its place.
    ///
    /// # Errors
    /// See [`find`](Self::find).
    pub(super) fn texture(
        &self,
        below: &Path,
        name: &str,
        other: bool,
        notes: &mut Vec<String>,
    ) -> Result<Option<PathBuf>> {
        let path = self.find(below, name)?;
        if other && !path.exists() {
            notes.push(format!(
                "texture {} is not there; its other colours were taken instead",
                path.display()
            ));
            return Ok(None);
        }
        Ok(Some(path))
    }
}

/// Whether a path leads out of the directory that it is in.
fn outside(path: &Path) -> bool {
    let mut depth = 0_i64;
    path.components().any(|component| {
        match component {
            Component::Prefix(_) | Component::RootDir => return true,
            Component::ParentDir => depth -= 1,
            Component::Normal(_) => depth += 1,
            Component::CurDir => {}
        }
        depth < 0
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use tempfile::tempdir;

    #[test]
    fn paths_that_lead_out_are_told_from_those_that_come_back() {
        for (path, out) in [
            ("a.png", false),
            ("a/../b.png", false),
            ("./a/b", false),
            ("../a.png", true),
            ("a/../../b/c", true),
            ("/a", true),
        ] {
            assert_eq!(outside(Path::new(path)), out, "{path}");
        }
    }

    #[test]
    fn files_outside_are_refused_unless_allowed() {
        let root = tempdir().unwrap();
        let scan = root.path().join("in/scan.obj");
        fs::create_dir(root.path().join("in")).unwrap();
        let near = root.path().join("in/my skin.png");
        for path in [&near, &root.path().join("secret.png")] {
            fs::write(path, "x").unwrap();
        }
        let strict = Place::new(&scan, &Options::default());
        let find = |place: &Place<'_>, name| place.find(Path::new(""), name);
        for name in
            ["my skin.png", "C:\\scans\\my skin.png", "/far/my skin.png # mine", "\"my skin.png\""]
        {
            assert_eq!(find(&strict, name).unwrap(), near);
        }
        let error = find(&strict, "../secret.png").unwrap_err().to_string();
        assert!(error.contains("outside the scan's directory"), "{error}");
        let free = Options { allow_outside: true, ..Options::default() };
        assert!(find(&Place::new(&scan, &free), "../secret.png").unwrap().is_file());
        assert_eq!(strict.stem(), "scan");
    }
}
