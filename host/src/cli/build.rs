//! `onescan build`.

use super::scan::{Placed, Scan};
use super::{file_name, model_file, write_model};
use clap::Args;
use onescan::error::{Error, Result};
use onescan::files::is_stream;
use onescan::interchange::Format;
use onescan::mesh::Axis;
use onescan::mesh::landmarks;
use onescan::model::build::{BuildOptions, Method, build_kept, forget};
use onescan::model::decompose::Truncation;
use onescan::model::kernel::{Hyper, Kernels, PRESETS, Preset};
use onescan::progress::Console;
use onescan::scan::doctor::Findings;
use onescan::scan::symmetry::{self, Plane, Symmetry};
use std::path::PathBuf;

/// Build a model from one coloured scan.
///
/// The mean of the model is the scan; its deviations are Gaussian processes over the scan's
/// vertices, decomposed exactly into their leading components.
///
/// Example: onescan build head.obj --unit cm --landmarks head.json -o face.3dmm
///
/// Of a large scan, what takes long is kept beside the model until that is there (face.3dmm.partial): the
/// same command goes on from it if the first was stopped.
#[derive(Args)]
pub(super) struct Build {
    #[command(flatten)]
    scan: Scan,
    /// The model to write: .3dmm, or for other programs .h5 or .h5.json.
    #[arg(short, long)]
    output: PathBuf,
    /// Kernels: (standard|correlated|symmetric)-(full|rgb|xyz).
    #[arg(long, default_value = "symmetric-full", value_parser = preset)]
    kernels: &'static Preset,
    /// Other hyper-parameters, or kernels of your own, in a TOML file; see docs/kernels.md.
    #[arg(long, value_name = "FILE")]
    kernel_file: Option<PathBuf>,
    /// As the paper's released program does it: 199 components by Nyström's method from 300
    /// vertices, a "full" albedo from 200 samples; see docs/decomposition.md.
    #[arg(long, conflicts_with_all = ["rank", "variance"])]
    reference: bool,
    /// Components of shape and of albedo.
    #[arg(long, default_value_t = 199, value_parser = clap::value_parser!(u32).range(0..=2000))]
    rank: u32,
    /// As many components as hold this fraction of the variance, instead of --rank.
    #[arg(long, conflicts_with = "rank", value_parser = fraction)]
    variance: Option<f64>,
    /// The plane of symmetry: x, y or z, the axis it is perpendicular to in the origin; A,B,C,D, in
    /// the file's coordinates the plane A x + B y + C z = D; `find`, wherever it is; or `none`. A
    /// plane that is given or found is moved to the origin, and the scan with it.
    #[arg(long, default_value = "x", value_parser = mirror, allow_hyphen_values = true)]
    mirror: Mirror,
}

#[derive(Clone, Copy)]
enum Mirror {
    Axis(Axis),
    Plane(Plane),
    Find,
    None,
}

fn mirror(text: &str) -> std::result::Result<Mirror, String> {
    match text {
        "x" => return Ok(Mirror::Axis(Axis::X)),
        "y" => return Ok(Mirror::Axis(Axis::Y)),
        "z" => return Ok(Mirror::Axis(Axis::Z)),
        "find" => return Ok(Mirror::Find),
        "none" => return Ok(Mirror::None),
        _ => {}
    }
    let numbers: std::result::Result<Vec<f64>, _> =
        text.split(',').map(|part| part.trim().parse()).collect();
    numbers
        .ok()
        .and_then(|numbers| numbers.try_into().ok())
        .and_then(|[a, b, c, d]: [f64; 4]| Plane::new([a, b, c], d))
        // Nothing that is scanned lies so far away.
        .filter(|plane| plane.offset.abs() < 1e9)
        .map(Mirror::Plane)
        .ok_or_else(|| {
            "expected x, y, z, find, none, or four numbers A,B,C,D of the plane A x + B y + C z = D"
                .into()
        })
}

fn preset(name: &str) -> std::result::Result<&'static Preset, String> {
    Preset::named(name).ok_or_else(|| {
        let names: Vec<_> = PRESETS.iter().map(|preset| preset.name).collect();
        format!("known kernels: {}", names.join(", "))
    })
}

fn fraction(text: &str) -> std::result::Result<f64, String> {
    match text.parse() {
        Ok(f) if f > 0.0 && f < 1.0 => Ok(f),
        _ => Err("expected a fraction between 0 and 1, like 0.99".into()),
    }
}

impl Build {
    /// The axis at whose plane through the origin the model mirrors; a scan with another plane is moved.
    fn mirror(&self, console: Console, placed: &mut Placed) -> Result<Option<Axis>> {
        let Placed { mesh: scan, unit, origin, .. } = placed;
        let frame = self.scan.frame()?;
        let symmetry = match self.mirror {
            Mirror::None => return Ok(None),
            // What is wrong with it the findings say.
            Mirror::Axis(Axis::X) => return Ok(Some(Axis::X)),
            Mirror::Axis(axis) => {
                let normal = axis.negates().map(|negated| f64::from(u8::from(negated)));
                symmetry::judge(scan, Plane { normal, offset: 0.0 })
            }
            Mirror::Plane(plane) => {
                let plane = plane.moved(origin.map(|c| -c)).turned(|n| frame.turn(n));
                symmetry::judge(scan, plane)
            }
            Mirror::Find => symmetry::find(scan),
        };
        let Symmetry { plane, error } = symmetry.map_err(|e| Error::file(&self.scan.path, e))?;
        console.say(format_args!(
            "plane of symmetry: {}, off by {:.3} mm (root mean square)",
            plane.turned(|n| frame.undo(n)).moved(*origin),
            error * f64::from(*unit)
        ));
        Ok(Some(match self.mirror {
            Mirror::Axis(axis) => axis,
            _ => symmetry::align(&mut scan.points, &plane),
        }))
    }

    /// Where the shape of a long build is kept until the model is there.
    fn kept(&self) -> Option<PathBuf> {
        let mut name = self.output.as_os_str().to_owned();
        name.push(".partial");
        (!is_stream(&self.output)).then(|| name.into())
    }

    pub(super) fn run(self, console: Console) -> Result<()> {
        model_file(&self.output)?;
        let (mut placed, landmarks) = self.scan.read(console)?;
        let mirror = self.mirror(console, &mut placed)?;
        let Placed { mesh: scan, unit: millimetres, .. } = placed;
        let kernels = match &self.kernel_file {
            Some(path) => Kernels::read(path, self.kernels, mirror)?,
            None => self.kernels.kernels(&Hyper::default(), mirror),
        };
        if mirror.is_none()
            && self.kernel_file.is_none()
            && self.kernels.name.starts_with("symmetric")
        {
            console.say(format_args!(
                "without a plane of symmetry {} is {}",
                self.kernels.name,
                self.kernels.name.replace("symmetric", "correlated")
            ));
        }
        // Without an axis in x nothing is said of where the scan lies.
        let findings = Findings::of(&scan, millimetres.into());
        if let (Some(unit), false) = (findings.likely_unit(), self.scan.is_measured()) {
            return Err(Error::file(
                &self.scan.path,
                format_args!(
                    "{:.3} mm across, if its unit is mm; add --unit {unit}, or if it is that small, \
                     --unit {millimetres}",
                    findings.diagonal
                ),
            ));
        }
        for fault in findings.faults(mirror == Some(Axis::X) && kernels.mirror()) {
            console.say(Error::file(&self.scan.path, fault));
        }
        let scan_name = file_name(&self.scan.path);
        let options = BuildOptions {
            scan_name: &scan_name,
            kernels,
            method: match self.variance {
                _ if self.reference => Method::Released,
                Some(fraction) => Method::Exact(Truncation::Variance(fraction)),
                None => Method::Exact(Truncation::Rank(self.rank as usize)),
            },
            millimetres,
        };
        let mut task = console.task("building", 1000);
        let kept = self.kept();
        let progress = &mut |done, what: &str| task.report(done, what);
        let built = build_kept(&scan, &landmarks, &options, kept.as_deref(), progress)
            .map_err(|e| Error::file(&self.scan.path, e))?;
        task.finish();
        console.say(&built.report);
        if Format::of(&self.output) == Format::ThreeDmm {
            built.model.write(&self.output)?;
            console.say(format_args!("wrote {}", self.output.display()));
        } else {
            let mut model = built.into_morphable();
            if let Some(path) = &self.scan.landmarks {
                model.uncertainties = landmarks::read_uncertainties(path)?;
            }
            write_model(console, &self.scan.path, &self.output, &model)?;
        }
        if let Some(path) = kept {
            forget(&path);
        }
        if landmarks.is_empty() {
            console.say("no --landmarks: the model can be sampled and rendered, but not fitted");
        }
        Ok(())
    }
}
