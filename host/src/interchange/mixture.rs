//! Mixtures of models (the paper's kernel density estimate): models, and how likely each is before a
//! photo is seen. Their file is TOML, `.toml`:
//!
//! ```toml
//! [[component]]
//! model = "anna.3dmm"     # beside this file, or a whole path
//! weight = 2              # in proportion to the others'; 1 if it is left out
//!
//! [[component]]
//! model = "ben.3dmm"
//! ```

use super::open;
use crate::error::{Error, Result};
use crate::files::{has_extension, read_text};
use crate::model_file::OwnedModel;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Models and their weights.
///
/// Guarantees: weights are positive and sum to 1, names differ.
pub struct Mixture {
    /// The models, in the order they were given.
    pub components: Vec<Component>,
}

/// One of them.
pub struct Component {
    /// Its file's name, with as many directories as it takes to tell it from others of the same name.
    pub name: String,
    /// The model.
    pub model: OwnedModel,
    /// How likely it is before a photo is seen.
    pub weight: f64,
}

/// Whether a file's name is that of a mixture.
pub fn is_mixture(path: &Path) -> bool {
    has_extension(path, &["toml"])
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct File {
    component: Vec<Entry>,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    model: PathBuf,
    #[serde(default = "one")]
    weight: f64,
}

fn one() -> f64 {
    1.0
}

impl Mixture {
    /// Opens models and mixtures, to be fitted to photos. Each file is as likely as any other, and a mixture's
    /// models share its weight in the mixture's proportions. Without paths there are no components.
    ///
    /// # Errors
    /// Files that cannot be read or are not models, models without landmarks, a model that is given twice.
    pub fn open(paths: &[PathBuf]) -> Result<Self> {
        let mut files: Vec<(PathBuf, f64)> = Vec::new();
        for path in paths {
            if is_mixture(path) {
                files.extend(entries(path)?);
            } else {
                files.push((path.clone(), 1.0));
            }
        }
        let sum: f64 = files.iter().map(|(_, weight)| weight).sum();
        let names = names(&files.iter().map(|(path, _)| &**path).collect::<Vec<_>>())?;
        let components = files.iter().zip(names).map(|((path, weight), name)| {
            let model = open(path)?;
            if model.view().landmarks().next().is_none() {
                return Err(Error::file(
                    path,
                    "has no landmarks, so nothing says where it is in a photo; build it with --landmarks",
                ));
            }
            Ok(Component { name, model, weight: weight / sum })
        });
        Ok(Self { components: components.collect::<Result<_>>()? })
    }

    /// The contents of a mixture's file that is to lie at `place`: models in its directory, or below,
    /// are named from there, others by their whole path.
    ///
    /// # Errors
    /// Models that are missing, or given twice.
    pub fn text(models: &[PathBuf], weights: &[f64], place: &Path) -> Result<String> {
        names(&models.iter().map(|path| &**path).collect::<Vec<_>>())?;
        let whole = |path: &Path| path.canonicalize().map_err(|e| Error::file(path, e));
        let parent = place.parent().filter(|parent| *parent != Path::new(""));
        let directory = whole(parent.unwrap_or(Path::new(".")))?;
        let entry = |(model, weight): (&PathBuf, &f64)| {
            let path = whole(model)?;
            let near = path.strip_prefix(&directory).unwrap_or(&path).to_path_buf();
            if near.to_str().is_none() {
                let unwritten = "its name is not UTF-8, which a mixture is; rename it";
                return Err(Error::file(model, unwritten));
            }
            Ok(Entry { model: near, weight: *weight })
        };
        let component = models.iter().zip(weights).map(entry).collect::<Result<_>>()?;
        toml::to_string(&File { component }).map_err(Error::new)
    }
}

/// Models and weights of a mixture's file; the weights sum to 1.
fn entries(path: &Path) -> Result<Vec<(PathBuf, f64)>> {
    let text = read_text(path)?;
    let all = parse(&text).map_err(|e| Error::file(path, e))?;
    let directory = path.parent().unwrap_or(Path::new(""));
    Ok(all.into_iter().map(|(model, weight)| (directory.join(model), weight)).collect())
}

fn parse(text: &str) -> Result<Vec<(PathBuf, f64)>> {
    let file: File = toml::from_str(text).map_err(|e| Error::toml(text, &e))?;
    if file.component.is_empty() {
        return Err(Error::new("names no [[component]]; a mixture needs a model"));
    }
    for Entry { model, weight } in &file.component {
        let name = model.display();
        // In f32, too, so that they can be added up.
        if !(*weight as f32 > 0.0 && (*weight as f32).is_finite()) {
            return Err(Error::new(format_args!(
                "weight {weight} of {name}: expected a number above 0"
            )));
        }
        if is_mixture(model) {
            return Err(Error::new(format_args!("{name} is a mixture itself; name its models")));
        }
    }
    let sum: f64 = file.component.iter().map(|entry| entry.weight).sum();
    Ok(file.component.into_iter().map(|Entry { model, weight }| (model, weight / sum)).collect())
}

/// Names by which to tell files apart: without directories if that will do.
fn names(paths: &[&Path]) -> Result<Vec<String>> {
    let short = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut all: Vec<String> = Vec::new();
    // What is not there will be missed when it is read.
    let places: Vec<_> =
        paths.iter().map(|path| path.canonicalize().unwrap_or(path.to_path_buf())).collect();
    for (i, path) in paths.iter().enumerate() {
        if places[..i].contains(&places[i]) {
            return Err(Error::file(path, "is named twice; give each model once, with its weight"));
        }
        let own = short(path);
        let alone = paths.iter().filter(|other| short(other) == own).count() == 1;
        all.push(if alone { own } else { path.to_string_lossy().into_owned() });
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_proportions() {
        let text =
            "[[component]]\nmodel = \"a.3dmm\"\nweight = 3\n[[component]]\nmodel = \"b.h5\"\n";
        let found = parse(text).unwrap();
        assert_eq!(found, [("a.3dmm".into(), 0.75), ("b.h5".into(), 0.25)]);
    }

    #[test]
    fn what_is_no_mixture_is_refused_by_line() {
        for (text, expected) in [
            ("", "missing field `component`"),
            ("component = []", "names no [[component]]"),
            ("[[component]]\nmodel = \"a\"\nweigth = 1", "line 3: unknown field `weigth`"),
            ("[[component]]\nmodel = \"a\"\nweight = 0", "weight 0 of a: expected"),
            ("[[component]]\nmodel = \"a\"\nweight = nan", "weight NaN of a: expected"),
            ("[[component]]\nmodel = \"a\"\nweight = 1e308", "expected a number"),
            ("[[component]]\nmodel = \"a\"\nweight = 1e-308", "expected a number"),
            ("[[component]]\nmodel = \"a.toml\"", "a.toml is a mixture itself"),
            ("[[component]\n", "line 1: "),
        ] {
            let error = parse(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{text:?} gives {error:?}");
        }
    }

    #[test]
    fn files_of_one_name_keep_their_directories() {
        let [a, b, c] = ["x/m.3dmm", "y/m.3dmm", "y/n.3dmm"].map(Path::new);
        assert_eq!(names(&[a, b, c]).unwrap(), ["x/m.3dmm", "y/m.3dmm", "n.3dmm"]);
        let error = names(&[a, c, a]).unwrap_err().to_string();
        assert!(error.starts_with("x/m.3dmm: is named twice"), "{error}");
        // This file, by another way.
        let error = names(&["Cargo.toml", "src/../Cargo.toml"].map(Path::new)).unwrap_err();
        assert!(error.to_string().contains("is named twice"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn a_name_that_is_no_text_is_told() {
        use std::os::unix::ffi::OsStrExt;
        let place = tempfile::tempdir().unwrap();
        let model = place.path().join(std::ffi::OsStr::from_bytes(b"m\xff.3dmm"));
        std::fs::write(&model, "").unwrap();
        let error = Mixture::text(&[model], &[1.0], &place.path().join("mix.toml")).unwrap_err();
        assert!(error.to_string().ends_with("rename it"), "{error}");
    }

    #[test]
    fn strings_survive_toml() {
        let name = "a \"b\"\\\t.3dmm";
        let component = vec![Entry { model: name.into(), weight: 1.0 }];
        let text = toml::to_string(&File { component }).unwrap();
        assert_eq!(parse(&text).unwrap(), [(name.into(), 1.0)]);
    }
}
