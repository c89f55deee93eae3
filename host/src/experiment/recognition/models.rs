//! The models of the experiment: the paper's kernels on the template, the same kernels on single
//! scans, and principal components of few and of many people.

use crate::demo;
use crate::error::{Error, Result};
use crate::experiment::faces::{identity_meshes, scan_meshes};
use crate::mesh::Axis;
use crate::model::build::{BuildOptions, Method, build};
use crate::model::decompose::{Progress, Truncation};
use crate::model::kernel::Kernels;
use crate::model::morphable::Morphable;
use crate::model_file::OwnedModel;
use std::path::Path;

/// Kernels of the models on single scans.
const ON_SCANS: &str = "symmetric-full";
/// The scans there are.
const SCANS: usize = 10;

/// How a model comes about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// Kernels of this name on the template.
    Kernels(&'static str),
    /// The symmetric kernels on the scan of this number.
    Scan(usize),
    /// Principal components of the ten scans.
    TenScans,
    /// Principal components of the 60 people, in the role of the Basel face model.
    SixtyPeople,
}

/// A model of the experiment.
#[derive(Clone, Debug, PartialEq)]
pub struct Named {
    /// Its name, good for a file.
    pub name: String,
    /// How it comes about.
    pub origin: Origin,
    /// What the paper's table has for it at 15, 30 and 45°, %.
    pub paper: [f64; 3],
}

/// The paper's table (and its supplement's) for models on the mean of the Basel face model, whose
/// place the template takes.
const ON_MEAN: [(&str, [f64; 3]); 9] = [
    ("standard-full", [84.7, 69.9, 54.2]),
    ("standard-rgb", [76.3, 57.8, 28.9]),
    ("standard-xyz", [77.1, 62.7, 35.7]),
    ("correlated-full", [92.4, 87.1, 66.7]),
    ("correlated-rgb", [71.5, 58.6, 37.8]),
    ("correlated-xyz", [76.7, 61.4, 45.8]),
    ("symmetric-full", [93.2, 85.9, 72.3]),
    ("symmetric-rgb", [73.5, 61.4, 40.2]),
    ("symmetric-xyz", [73.1, 58.6, 44.2]),
];
/// Its rows for single scans, which are other scans than ours.
const ON_SINGLE: [[f64; 3]; SCANS] = [
    [78.7, 62.2, 49.8],
    [78.7, 70.7, 48.6],
    [77.5, 63.9, 38.2],
    [71.9, 59.0, 47.8],
    [88.0, 72.3, 50.6],
    [85.9, 73.5, 59.4],
    [85.9, 71.5, 55.0],
    [84.3, 76.7, 55.4],
    [85.5, 74.3, 59.8],
    [87.6, 76.3, 55.4],
];
/// Its row of principal components of ten scans.
const TEN_SCANS: [f64; 3] = [86.0, 65.9, 42.2];
/// Its mixture of ten scans (kernel density estimate).
pub(super) const MIXTURE: [f64; 3] = [94.0, 85.9, 71.5];
/// Its row of the Basel face model of 2017.
const BASEL: [f64; 3] = [98.8, 98.0, 90.0];

impl Named {
    /// All models, in the order of the paper's table.
    pub fn all() -> Vec<Self> {
        let kernels = ON_MEAN.map(|(name, paper)| (name.into(), Origin::Kernels(name), paper));
        let scan = |(i, paper)| (format!("scan-{i:02}"), Origin::Scan(i), paper);
        let learnt = [
            ("ten-scan-pca".into(), Origin::TenScans, TEN_SCANS),
            ("sixty-people-pca".into(), Origin::SixtyPeople, BASEL),
        ];
        let scans = ON_SINGLE.into_iter().enumerate().map(scan);
        let all = kernels.into_iter().chain(scans).chain(learnt);
        all.map(|(name, origin, paper)| Self { name, origin, paper }).collect()
    }

    /// Those of these names, in the order of the table; all if none is named.
    ///
    /// # Errors
    /// A name that no model has.
    pub fn of_names(names: &[&str]) -> Result<Vec<Self>> {
        let mut models = Self::all();
        if let Some(other) = names.iter().find(|name| models.iter().all(|m| m.name != **name)) {
            let known: Vec<_> = models.iter().map(|model| &*model.name).collect();
            return Err(Error::new(format_args!(
                "no model {other:?}; there are {}",
                known.join(", ")
            )));
        }
        if !names.is_empty() {
            models.retain(|model| names.contains(&&*model.name));
        }
        Ok(models)
    }

    /// Whether it is a component of the mixture.
    pub fn is_of_mixture(&self) -> bool {
        matches!(self.origin, Origin::Scan(_))
    }

    /// Builds the model, kernels' of `rank` components.
    ///
    /// # Errors
    /// Fixtures that cannot be read; those of building.
    pub fn build(
        &self,
        fixtures: &Path,
        rank: usize,
        progress: &mut Progress<'_>,
    ) -> Result<OwnedModel> {
        let (template, landmarks) = demo::template()?;
        let (scan, kernels) = match self.origin {
            Origin::Kernels(name) => (template, name),
            Origin::Scan(number) => {
                let scan = scan_meshes(fixtures)?.into_iter().nth(number);
                (scan.ok_or_else(|| Error::new("no such scan"))?, ON_SCANS)
            }
            Origin::TenScans => {
                let scans = scan_meshes(fixtures)?;
                return Morphable::of_meshes(&scans, landmarks)?.to_model(i16::MAX);
            }
            Origin::SixtyPeople => {
                let people = identity_meshes(fixtures)?;
                return Morphable::of_meshes(&people, landmarks)?.to_model(i16::MAX);
            }
        };
        let options = BuildOptions {
            scan_name: &self.name,
            kernels: Kernels::named(kernels, Some(Axis::X))?,
            method: Method::Exact(Truncation::Rank(rank)),
            millimetres: 1.0,
        };
        Ok(build(&scan, &landmarks, &options, progress)?.model)
    }
}
