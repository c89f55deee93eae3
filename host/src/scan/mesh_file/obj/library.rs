//! Libraries of materials (`.mtl`).

use super::super::named::Place;
use super::{lines, numbers, unmarked};
use crate::error::{Error, Result};
use crate::files;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A flat colour, and the texture: where the library lies, from the scan's directory, and the
/// texture's name there.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Material {
    pub(super) color: Option<[f32; 3]>,
    pub(super) texture: Option<(PathBuf, String)>,
}

/// Materials by name.
#[derive(Debug, Default)]
pub(super) struct Library {
    materials: BTreeMap<String, Material>,
}

impl Library {
    /// Reads the libraries a scan names, one or several to a line, in names that may hold spaces.
    ///
    /// # Errors
    /// Files that cannot be read, or may not; malformed lines.
    pub(super) fn read(place: &Place<'_>, names: &[String]) -> Result<Self> {
        let mut library = Self::default();
        let here = Path::new("");
        for line in names {
            let whole = place.find(here, line)?;
            // One name with spaces, unless each of its words is a library.
            let several = line.split_whitespace().filter(|word| is_library(word)).count() > 1;
            let files = if whole.is_file() || !several {
                vec![(whole, line.as_str())]
            } else {
                let words = line.split_whitespace().filter(|word| is_library(word));
                words.map(|word| Ok((place.find(here, word)?, word))).collect::<Result<_>>()?
            };
            for (file, name) in files {
                let bytes = files::read(&file).map_err(|e| {
                    Error::file(
                        &file,
                        format_args!("{e}; put the materials there, or give --texture or --colour"),
                    )
                })?;
                // Textures lie beside the library, which lies where its name says or here.
                let name = PathBuf::from(name.replace('\\', "/"));
                let below = name.parent().filter(|_| file.ends_with(&name)).unwrap_or(here);
                library
                    .add(&String::from_utf8_lossy(unmarked(&bytes)), below)
                    .map_err(|e| Error::file(&file, e))?;
            }
        }
        Ok(library)
    }

    /// All materials.
    pub(super) fn all(&self) -> impl Iterator<Item = &Material> {
        self.materials.values()
    }

    /// The material of a name; if there is none, the one whose name differs by a comment.
    pub(super) fn get(&self, name: &str) -> Option<&Material> {
        let bare =
            |name: &str| name.split_once(" #").map_or(name, |(name, _)| name).trim().to_owned();
        self.materials.get(name).or_else(|| {
            let mut alike = self.materials.iter().filter(|(key, _)| bare(key) == bare(name));
            alike.next().filter(|_| alike.next().is_none()).map(|(_, material)| material)
        })
    }

    fn add(&mut self, text: &str, below: &Path) -> Result<()> {
        let mut name = None;
        for (number, line) in lines(text) {
            let fault = |e: Error| Error::new(format_args!("line {number}: {e}"));
            let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
            let rest = rest.trim();
            if keyword == "newmtl" {
                self.materials.entry(rest.into()).or_default();
                name = Some(rest);
            }
            let Some(material) = name.and_then(|name| self.materials.get_mut(name)) else {
                continue;
            };
            match keyword {
                // Other notations (`Kd spectral`, `Kd xyz`) are left alone.
                "Kd" if rest.starts_with(|c: char| c.is_ascii_digit() || c == '.') => {
                    let ([r, g, b], count) = numbers::<3>(rest).map_err(fault)?;
                    let color = if count < 3 { [r; 3] } else { [r, g, b] };
                    material.color = Some(color.map(|c| c.clamp(0.0, 1.0) as f32));
                }
                "map_Kd" => {
                    let name = texture_name(rest).map_err(fault)?;
                    material.texture = Some((below.into(), name.into()));
                }
                _ => {}
            }
        }
        Ok(())
    }
}

fn is_library(word: &str) -> bool {
    word.len() > 4 && word.to_ascii_lowercase().ends_with(".mtl")
}

/// The file name of a `map_Kd` line, behind its options.
fn texture_name(mut rest: &str) -> Result<&str> {
    let word = |text: &'_ str| -> (usize, usize) {
        let start = text.len() - text.trim_start().len();
        let end = text[start..].find(char::is_whitespace).map_or(text.len(), |end| start + end);
        (start, end)
    };
    while rest.starts_with('-') {
        let (_, end) = word(rest);
        let (option, mut after) = rest.split_at(end);
        // How many arguments an option has at most, and what a number has to be to move nothing.
        let (most, still) = match option {
            "-o" | "-t" => (3, Some(0.0)),
            "-s" => (3, Some(1.0)),
            "-mm" => (2, None),
            _ => (1, None),
        };
        for _ in 0..most {
            let (start, end) = word(after);
            let argument = &after[start..end];
            let number = argument.parse::<f32>().ok();
            if still.is_some() && number.is_some() && number != still {
                return Err(Error::new(format_args!(
                    "textures that are moved or scaled ({option}) are not read; export without"
                )));
            }
            let channel = matches!(option, "-imfchan" | "-type") && !argument.contains('.');
            if !(channel || matches!(argument, "on" | "off") || number.is_some()) {
                break;
            }
            after = &after[end..];
        }
        rest = after.trim_start();
    }
    if rest.is_empty() {
        return Err(Error::new("map_Kd names no file"));
    }
    Ok(rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_of_textures_are_skipped() {
        for (rest, name) in [
            ("a b.png", "a b.png"),
            ("-blendu on -bm 0.5 -imfchan r a.png", "a.png"),
            ("-bm 1 2 faces.png", "2 faces.png"),
            ("-s 1 1 1 -o 0 0.0 0 -t 0 a.png", "a.png"),
            ("-mm 0 1\ta.png", "a.png"),
        ] {
            assert_eq!(texture_name(rest).unwrap(), name);
        }
        assert_eq!(texture_name("-clamp on").ok(), None);
        for moved in ["-s 2 2 2 a.png", "-o 0 0.1 a.png", "-t 1 a.png"] {
            assert!(texture_name(moved).is_err(), "{moved}");
        }
    }

    #[test]
    fn a_comment_behind_a_name_is_no_part_of_it() {
        let mut library = Library::default();
        library.add("newmtl a # soft\nKd 1 0 0\nnewmtl b #1\nnewmtl b #2\n", here()).unwrap();
        for name in ["a # soft", "a", "a # hard"] {
            assert_eq!(library.get(name).unwrap().color, Some([1.0, 0.0, 0.0]), "{name}");
        }
        assert!(library.get("b #1").is_some());
        assert_eq!(library.get("b"), None, "there are two");
    }

    fn here() -> &'static Path {
        Path::new("")
    }
}
