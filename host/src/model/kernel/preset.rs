//! The paper's kernels and models, as tables; kernels of a file.

use super::{Kernel, mean_of, rbf, rgb_rbf};
use crate::error::{Error, Result};
use crate::files::read_text;
use crate::mesh::Axis;
use serde::Deserialize;
use std::path::Path;

/// The paper's hyper-parameters (section "Choices of Hyperparameters"). Variances, not
/// amplitudes: the paper's text calls the first ones millimetres, its program's are mm².
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Hyper {
    /// `a_s, b_s, c_s`: variances of the shape's Gaussians, mm².
    pub shape_variances: [f64; 3],
    /// `A_s, B_s, C_s`: their scales, mm.
    pub shape_scales: [f64; 3],
    /// `a_a, b_a, c_a`: variances of the albedo's Gaussians over positions, colour².
    pub position_variances: [f64; 3],
    /// `A_a, B_a, C_a`: their scales, mm.
    pub position_scales: [f64; 3],
    /// `d`: variance of the albedo's Gaussian over colours, colour².
    pub color_variance: f64,
    /// `D`: its scale, colour.
    pub color_scale: f64,
    /// `α`: how much mirror images correlate.
    pub alpha: f64,
    /// `β`: how much channels correlate in kernels over positions.
    pub beta: f64,
    /// `γ`: the same in kernels over colours.
    pub gamma: f64,
}

impl Default for Hyper {
    fn default() -> Self {
        Self {
            shape_variances: [7.0, 5.0, 3.0],
            shape_scales: [100.0, 50.0, 10.0],
            position_variances: [0.02, 0.01, 0.01],
            position_scales: [500.0, 20.0, 2.0],
            color_variance: 0.015,
            color_scale: 0.15,
            alpha: 0.7,
            beta: 0.9375,
            gamma: 0.95,
        }
    }
}

impl Hyper {
    /// `K_s`.
    fn shape(&self) -> Kernel {
        sum(self.shape_variances, self.shape_scales).identity()
    }

    /// `K_a,xyz` with channels that correlate by `beta`.
    fn xyz(&self, beta: f64) -> Kernel {
        sum(self.position_variances, self.position_scales).correlated(beta)
    }

    /// `K_a,rgb` with channels that correlate by `gamma`.
    fn rgb(&self, gamma: f64) -> Kernel {
        (self.color_variance * rgb_rbf(self.color_scale)).correlated(gamma)
    }

    fn check(&self) -> Result<()> {
        let positive = |name: &str, values: &[f64]| {
            let good = values.iter().all(|v| v.is_finite() && *v > 0.0);
            let fault = || Error::new(format_args!("{name} {values:?}: expected positive numbers"));
            if good { Ok(()) } else { Err(fault()) }
        };
        positive("shape_variances", &self.shape_variances)?;
        positive("shape_scales", &self.shape_scales)?;
        positive("position_variances", &self.position_variances)?;
        positive("position_scales", &self.position_scales)?;
        positive("color_variance", &[self.color_variance])?;
        positive("color_scale", &[self.color_scale])?;
        let within = |name: &str, value: f64, range: std::ops::RangeInclusive<f64>| {
            let fault = || {
                let (low, high) = (range.start(), range.end());
                Error::new(format_args!("{name} is {value}, expected {low} to {high}"))
            };
            if range.contains(&value) { Ok(()) } else { Err(fault()) }
        };
        within("alpha", self.alpha, -1.0..=1.0)?;
        within("beta", self.beta, -0.5..=1.0)?;
        within("gamma", self.gamma, -0.5..=1.0)
    }
}

/// `Σ_std`.
fn sum([a, b, c]: [f64; 3], [u, v, w]: [f64; 3]) -> super::Scalar {
    a * rbf(u) + b * rbf(v) + c * rbf(w)
}

/// What a kernel's values are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Field {
    /// Displacements, millimetres.
    Shape,
    /// Differences of colours, RGB in `[0, 1]`.
    Albedo,
}

/// One of the paper's kernels.
#[derive(Debug)]
pub struct Named {
    /// The paper's symbol, in HTML.
    pub symbol: &'static str,
    /// What it is a kernel of.
    pub field: Field,
    /// What one sees in its samples.
    pub shows: &'static str,
    make: fn(&Hyper, Option<Axis>) -> Kernel,
}

impl Named {
    /// The kernel. `mirror` is the object's plane of symmetry; without one, symmetric kernels lose
    /// their mirrored summand.
    pub fn kernel(&self, hyper: &Hyper, mirror: Option<Axis>) -> Kernel {
        (self.make)(hyper, mirror)
    }
}

/// The ten kernels of the paper's figure, in its order.
pub const KERNELS: [Named; 10] = [
    Named {
        symbol: "K<sub>s</sub>",
        field: Field::Shape,
        shows: "Points near each other move together; left and right know nothing of each other.",
        make: |h, _| h.shape(),
    },
    Named {
        symbol: "K<sub>s</sub><sup>sym</sup>",
        field: Field::Shape,
        shows: "Left and right move alike, mirrored.",
        make: |h, mirror| h.shape().mirrored_displacement(mirror, h.alpha),
    },
    Named {
        symbol: "K<sub>a,xyz</sub>",
        field: Field::Albedo,
        shows: "Blots of any colour, of 20 mm and of 2 mm, over a tint of the whole.",
        make: |h, _| h.xyz(0.0),
    },
    Named {
        symbol: "K<sub>a,rgb</sub>",
        field: Field::Albedo,
        shows: "Parts of equal colour change together, wherever they are: lips, brows, eyes.",
        make: |h, _| h.rgb(0.0),
    },
    Named {
        symbol: "K<sub>a</sub>",
        field: Field::Albedo,
        shows: "Both: blots, and parts.",
        make: |h, _| mean_of(h.rgb(0.0), h.xyz(0.0)),
    },
    Named {
        symbol: "K<sub>a,xyz</sub><sup>cor</sup>",
        field: Field::Albedo,
        shows: "Blots, lighter and darker rather than of other colours.",
        make: |h, _| h.xyz(h.beta),
    },
    Named {
        symbol: "K<sub>a,rgb</sub><sup>cor</sup>",
        field: Field::Albedo,
        shows: "Parts, lighter and darker rather than of other colours.",
        make: |h, _| h.rgb(h.gamma),
    },
    Named {
        symbol: "K<sub>a</sub><sup>cor</sup>",
        field: Field::Albedo,
        shows: "Blots and parts, lighter and darker.",
        make: |h, _| mean_of(h.rgb(h.gamma), h.xyz(h.beta)),
    },
    Named {
        symbol: "K<sub>a,xyz</sub><sup>sym</sup>",
        field: Field::Albedo,
        shows: "Blots, lighter and darker, much the same left and right.",
        make: |h, mirror| h.xyz(h.beta).mirrored(mirror, h.alpha),
    },
    Named {
        symbol: "K<sub>a</sub><sup>sym</sup>",
        field: Field::Albedo,
        shows: "Blots and parts, lighter and darker, much the same left and right.",
        make: |h, mirror| mean_of(h.rgb(h.gamma), h.xyz(h.beta).mirrored(mirror, h.alpha)),
    },
];

/// A model of the paper's: one of [`KERNELS`] each for shape and albedo.
#[derive(Debug)]
pub struct Preset {
    /// Name on the command line.
    pub name: &'static str,
    shape: usize,
    albedo: usize,
}

/// The paper's nine face models; fish and birds have the full and xyz ones of standard and
/// symmetric. Shape: `K_s` or `K_s^sym`. Albedo: by position (xyz), by colour (rgb), or the mean of
/// both (full); channels independent (standard) or correlated (correlated, symmetric); mirrored
/// (symmetric, position part only: a colour kernel of a symmetric object is symmetric already).
pub const PRESETS: [Preset; 9] = [
    Preset { name: "standard-full", shape: 0, albedo: 4 },
    Preset { name: "standard-rgb", shape: 0, albedo: 3 },
    Preset { name: "standard-xyz", shape: 0, albedo: 2 },
    Preset { name: "correlated-full", shape: 0, albedo: 7 },
    Preset { name: "correlated-rgb", shape: 0, albedo: 6 },
    Preset { name: "correlated-xyz", shape: 0, albedo: 5 },
    Preset { name: "symmetric-full", shape: 1, albedo: 9 },
    Preset { name: "symmetric-rgb", shape: 1, albedo: 6 },
    Preset { name: "symmetric-xyz", shape: 1, albedo: 8 },
];

impl Preset {
    /// Finds a preset by its name.
    pub fn named(name: &str) -> Option<&'static Self> {
        PRESETS.iter().find(|preset| preset.name == name)
    }

    /// The kernel of displacements, with the paper's hyper-parameters.
    pub fn shape(&self, mirror: Option<Axis>) -> Kernel {
        self.kernels(&Hyper::default(), mirror).shape
    }

    /// The kernel of colours, with the paper's hyper-parameters.
    pub fn albedo(&self, mirror: Option<Axis>) -> Kernel {
        self.kernels(&Hyper::default(), mirror).albedo
    }

    /// Both, see [`Named::kernel`].
    pub fn kernels(&self, hyper: &Hyper, mirror: Option<Axis>) -> Kernels {
        let kernel = |index: usize| KERNELS[index].kernel(hyper, mirror);
        Kernels {
            name: self.name.to_string(),
            shape: kernel(self.shape),
            albedo: kernel(self.albedo),
        }
    }
}

/// The kernels of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct Kernels {
    /// Their name, for people.
    pub name: String,
    /// Of displacements, mm².
    pub shape: Kernel,
    /// Of colours, squares of `[0, 1]`.
    pub albedo: Kernel,
}

/// A kernel file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    preset: Option<String>,
    #[serde(default)]
    hyper: Hyper,
    shape: Option<String>,
    albedo: Option<String>,
}

impl Kernels {
    /// Whether mirror images depend on each other under these kernels.
    pub fn mirror(&self) -> bool {
        let terms = [&self.shape, &self.albedo].map(Kernel::terms);
        terms.iter().flatten().any(|term| term.negates != [false; 3])
    }

    /// Those of a preset, with the paper's hyper-parameters.
    ///
    /// # Errors
    /// A name that no preset has.
    pub fn named(name: &str, mirror: Option<Axis>) -> Result<Self> {
        let preset = Preset::named(name).ok_or_else(|| unknown(name))?;
        Ok(preset.kernels(&Hyper::default(), mirror))
    }

    /// Reads a kernel file, see [`Kernels::parse`].
    ///
    /// # Errors
    /// Those of reading and parsing; they name the file.
    pub fn read(path: &Path, preset: &Preset, mirror: Option<Axis>) -> Result<Self> {
        let text = read_text(path)?;
        let mut kernels = Self::parse(&text, preset, mirror).map_err(|e| Error::file(path, e))?;
        let file = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy();
        kernels.name = format!("{} by {file}", kernels.name);
        Ok(kernels)
    }

    /// Kernels described in TOML: a `preset`, other values for its hyper-parameters under
    /// `[hyper]` (the fields of [`Hyper`]), or a kernel of one's own as algebra for `shape`,
    /// `albedo` or both. `preset` and `mirror` are those taken when the text does not say.
    ///
    /// # Errors
    /// TOML that is malformed or has other keys; hyper-parameters and kernels that are not
    /// those of a covariance.
    pub fn parse(text: &str, preset: &Preset, mirror: Option<Axis>) -> Result<Self> {
        let file: File = toml::from_str(text).map_err(|e| Error::toml(text, &e))?;
        let preset = match &file.preset {
            Some(name) => Preset::named(name).ok_or_else(|| unknown(name))?,
            None => preset,
        };
        file.hyper.check().map_err(|e| Error::new(format_args!("[hyper]: {e}")))?;
        let mut kernels = preset.kernels(&file.hyper, mirror);
        for (name, text, kernel) in [
            ("shape", &file.shape, &mut kernels.shape),
            ("albedo", &file.albedo, &mut kernels.albedo),
        ] {
            if let Some(text) = text {
                *kernel = text.parse().map_err(|e| Error::new(format_args!("{name}: {e}")))?;
            }
        }
        Ok(kernels)
    }
}

fn unknown(preset: &str) -> Error {
    let names = PRESETS.map(|preset| preset.name).join(", ");
    Error::new(format_args!("preset {preset:?} is unknown; there are {names}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn preset() -> &'static Preset {
        Preset::named("symmetric-full").unwrap()
    }

    #[test]
    fn an_empty_file_changes_nothing() {
        let kernels = Kernels::parse("", preset(), Some(Axis::X)).unwrap();
        assert_eq!(kernels, preset().kernels(&Hyper::default(), Some(Axis::X)));
    }

    #[test]
    fn a_file_overrides_what_it_names() {
        let text = "preset = \"correlated-xyz\"\nalbedo = \"0.5 (I (2 rgb_rbf(0.1)))\"\n\
                    [hyper]\nshape_scales = [90, 40, 5]\n";
        let kernels = Kernels::parse(text, preset(), None).unwrap();
        assert_eq!(kernels.name, "correlated-xyz");
        assert_eq!(kernels.shape.to_string(), "I (7 rbf(90) + 5 rbf(40) + 3 rbf(5))");
        assert_eq!(kernels.albedo, 0.5 * (2.0 * rgb_rbf(0.1)).identity());
    }

    #[test]
    fn files_that_describe_no_covariance_are_refused() {
        for (text, expected) in [
            ("[hyper]\nbeta = 2", "beta is 2, expected -0.5 to 1"),
            ("[hyper]\nshape_scales = [1, 0, 2]", "expected positive numbers"),
            ("\n[hyper]\nshapes = 1", "line 3: unknown field `shapes`"),
            ("preset = \"best\"", "there are standard-full, standard-rgb"),
            ("shape = \"I (rbf(-1))\"", "shape: "),
            ("shape = ", "line 1: "),
        ] {
            let error = Kernels::parse(text, preset(), None).unwrap_err().to_string();
            assert!(error.contains(expected), "{text:?} gives {error:?}");
        }
    }
}
