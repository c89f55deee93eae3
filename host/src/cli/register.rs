//! `onescan register`.

use super::scan::{Placed, Reading};
use super::{file_name, output_directory, typed};
use clap::Args;
use onescan::error::{Error, Result};
use onescan::files::{listed, read_text, write_atomically};
use onescan::fit::output::quoted;
use onescan::interchange;
use onescan::mesh::landmarks;
use onescan::progress::{Console, Task};
use onescan::registration::{self, Names, Options, Registration};
use onescan::scan::mesh_file::EXTENSIONS;
use onescan_core::model::Model;
use serde_json::json;
use std::fmt::{Display, Write as _};
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Register a scan: deform a model onto it, so that it has the model's topology.
///
/// The scan may have any topology, holes, and show a part only; it may be turned by some tens of
/// degrees. Its pose is found by itself, or by --landmarks. Colours hold eyes, brows and lips where
/// they belong, unless --shape-only.
///
/// Writes to the output directory: registered.ply and .glb (the model's topology in the scan's place,
/// millimetres, with the scan's colours), aligned.ply (the same on the model's mean: `onescan model pca`
/// learns a model from many), distances.ply (coloured by the distance to the scan), report.html, and
/// register.json with chamfer and Hausdorff distances and, with landmarks, how far they are off.
///
/// Same model, scan and settings: same registration, to the last bit.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Register {
    /// The model: .3dmm, .h5, .h5.json or .mat.
    model: PathBuf,
    /// The scan: PLY, OBJ, GLB, glTF, OFF, or with --colour STL; with --batch several, or directories.
    #[arg(value_name = "SCAN", required = true, num_args = 1..)]
    scans: Vec<PathBuf>,
    /// Directory to write to; of a batch, a folder named like its scan for each.
    #[arg(short, long)]
    output: PathBuf,
    /// Look at shape alone, not at colours.
    #[arg(long)]
    shape_only: bool,
    /// Landmarks on the scan, JSON of {"id", "coordinates"} in its unit, with the model's names; of a
    /// batch a file for each scan, in the same order. Three say the pose.
    #[arg(long, value_name = "FILE", num_args = 1..)]
    landmarks: Vec<PathBuf>,
    /// How sure landmarks are: standard deviation, mm.
    #[arg(long, value_name = "MM", default_value_t = 1.0, value_parser = within::<1, 20>)]
    landmark_sd: f32,
    /// How far shape and albedo may go: standard deviation of coefficients, .1 to 2. The default suits
    /// kernels, which allow for more than people differ by; 1 suits a model learnt from people.
    #[arg(long, value_name = "SD", default_value_t = Options::default().width,
          value_parser = within::<1, 2>)]
    width: f32,
    /// Also say how far each vertex is known: uncertainty.ply, black to white at 6 mm, by Laplace's
    /// approximation. Where the scan says nothing, the model's prior shows.
    #[arg(long)]
    uncertainty: bool,
    /// Register many scans, and go on if one fails; those that the same command has registered before
    /// are left as they are.
    #[arg(long)]
    batch: bool,
    #[command(flatten, next_help_heading = "How the scan is read")]
    reading: Reading,
}

const EXAMPLES: &str = "\
Examples:
  onescan register face.3dmm scan.ply -o registered
  onescan register face.3dmm scan.obj -o registered --unit cm --landmarks points.json
  onescan register face.3dmm scans -o registered --batch
  onescan model pca registered/*/aligned.ply -o people.3dmm";

/// Parses a number of tenths `LOW` to whole `HIGH`.
fn within<const LOW: u8, const HIGH: u8>(text: &str) -> std::result::Result<f32, String> {
    let (low, high) = (f32::from(LOW) / 10.0, f32::from(HIGH));
    match text.parse::<f32>() {
        Ok(x) if x >= low && x <= high => Ok(x),
        _ => Err(format!("expected a number from {low} to {high}")),
    }
}

impl Register {
    pub(super) fn run(self, console: Console) -> Result<()> {
        let scans = self.paths()?;
        if !self.landmarks.is_empty() && self.landmarks.len() != scans.len() {
            return Err(Error::new(format_args!(
                "{} scan(s) and {} --landmarks file(s); name one per scan, in the same order",
                scans.len(),
                self.landmarks.len()
            )));
        }
        output_directory(&self.output)?;
        let file = interchange::open(&self.model)?;
        let model = file.view();
        let steps = u64::from(Registration::ITERATIONS);
        let mut task = console.task("registering", steps * scans.len() as u64);
        let mut lines = Vec::new();
        let mut failed = 0;
        for (i, scan) in scans.iter().enumerate() {
            let directory =
                if self.batch { self.output.join(folder(scan)) } else { self.output.clone() };
            let marks = self.landmarks.get(i);
            task.name(&file_name(scan));
            if let Some(value) = self.known(scan, marks, &directory) {
                let again = "registered already; remove its folder to do it anew";
                console.say(format_args!("{}: {again}", file_name(scan)));
                lines.push(value);
                continue;
            }
            match self.one(console, &model, scan, marks, &directory, (&mut task, steps * i as u64))
            {
                Ok((line, value)) => {
                    console.say(line);
                    lines.push(value);
                }
                Err(error) if self.batch => {
                    failed += 1;
                    console.say(&error);
                    lines.push(json!({ "scan": file_name(scan), "error": error.to_string() }));
                }
                Err(error) => return Err(error),
            }
        }
        task.finish();
        if self.batch {
            let text = format!("{:#}\n", json!(lines));
            let path = self.output.join("batch.json");
            write_atomically(&path, |out| out.write_all(text.as_bytes()))?;
            if failed > 0 {
                return Err(Error::file(
                    &path,
                    format_args!(
                        "{failed} of {} scans were not registered; it says why",
                        scans.len()
                    ),
                ));
            }
        } else {
            console.say(format_args!("open {}", self.output.join("report.html").display()));
        }
        Ok(())
    }

    /// The scans that are named, and those in directories.
    fn paths(&self) -> Result<Vec<PathBuf>> {
        if !self.batch {
            return match &self.scans[..] {
                [scan] if !scan.is_dir() => Ok(self.scans.clone()),
                [scan, ..] => Err(Error::file(
                    scan,
                    "is a directory, or one of several scans; add --batch to register many",
                )),
                [] => Ok(Vec::new()),
            };
        }
        let none = "holds no scan; give PLY, OBJ, GLB, glTF or STL";
        let paths = listed(&self.scans, &EXTENSIONS, none)?;
        let mut names: Vec<String> = paths.iter().map(|path| folder(path)).collect();
        names.sort();
        if let Some((name, _)) = names.iter().zip(names.iter().skip(1)).find(|(a, b)| a == b) {
            return Err(Error::new(format_args!(
                "two scans are called {name}; their folders would be the same, rename one"
            )));
        }
        Ok(paths)
    }

    /// Of a batch that is repeated, what the same program has found of a scan by the same command, if neither
    /// scan nor landmarks nor model are younger.
    fn known(
        &self,
        scan: &Path,
        marks: Option<&PathBuf>,
        directory: &Path,
    ) -> Option<serde_json::Value> {
        let age = |path: &Path| std::fs::metadata(path).and_then(|known| known.modified()).ok();
        let path = directory.join("register.json");
        let written = age(&path).filter(|_| self.batch)?;
        let mut inputs = [scan, &self.model].into_iter().chain(marks.map(|file| &**file));
        if inputs.any(|input| age(input).is_none_or(|age| age >= written)) {
            return None;
        }
        let value: serde_json::Value = serde_json::from_str(&read_text(&path).ok()?).ok()?;
        let command = self.command(scan, marks.map(|file| &**file));
        let same = value["onescan"] == env!("CARGO_PKG_VERSION") && value["command"] == command;
        same.then(|| summary(scan, &value))
    }

    fn one(
        &self,
        console: Console,
        model: &Model<'_>,
        path: &Path,
        marks: Option<&PathBuf>,
        directory: &Path,
        (task, before): (&mut Task, u64),
    ) -> Result<(String, serde_json::Value)> {
        let Placed { mesh: mut scan, unit, origin, notes } = self.reading.read(path)?;
        for note in notes {
            console.say(Error::file(path, note));
        }
        scan.points.as_flattened_mut().iter_mut().for_each(|c| *c *= unit);
        let known = match marks {
            Some(file) => self.marks(model, file, unit, origin)?,
            None => Vec::new(),
        };
        let places: Vec<_> = known.iter().map(|(_, at, vertex)| (*vertex, *at)).collect();
        let options = Options {
            albedo: !self.shape_only,
            landmark_sd: self.landmark_sd,
            width: self.width,
            ..Options::default()
        };
        let mut done = before;
        let found =
            registration::register(model, &scan, &places, options, self.uncertainty, &mut |_| {
                done += 1;
                task.set(done);
            })
            .map_err(|e| Error::file(path, e))?;
        output_directory(directory)?;
        let names = Names {
            model: file_name(&self.model),
            scan: file_name(path),
            command: self.command(path, marks.map(|file| &**file)),
        };
        let mut inputs = vec![&*self.model, path];
        inputs.extend(marks.map(|file| &**file));
        registration::write(directory, &found, &known, &names, &inputs)?;
        if let Some(doubt) = found.doubt() {
            console.say(Error::file(path, doubt));
        }
        let measures = &found.measures;
        let line = format!(
            "{}: chamfer {:.2} mm, Hausdorff {:.1} mm ({:.1} mm at 95 %)",
            names.scan,
            measures.chamfer(),
            measures.hausdorff(),
            measures.hausdorff_95()
        );
        let value = json!({
            "chamfer_mm": measures.chamfer(),
            "hausdorff_mm": measures.hausdorff(),
            "hausdorff_95_mm": measures.hausdorff_95(),
            "doubt": found.doubt(),
        });
        Ok((line, summary(path, &value)))
    }

    /// Landmarks on the scan that the model has too: names, places in mm, vertices.
    fn marks(
        &self,
        model: &Model<'_>,
        file: &Path,
        unit: f32,
        origin: [f64; 3],
    ) -> Result<Vec<(String, [f32; 3], u32)>> {
        let frame = self.reading.frame()?;
        let points = landmarks::read_points(file)?;
        let marks: Vec<_> = points
            .into_iter()
            .filter_map(|point| {
                let (_, vertex) = model.landmarks().find(|(name, _)| *name == point.id)?;
                let at = std::array::from_fn(|i| (point.coordinates[i] - origin[i]) as f32);
                let at = frame.turn(at).map(|c| c * unit);
                Some((point.id, at, vertex))
            })
            .collect();
        if marks.is_empty() {
            return Err(Error::file(
                file,
                "no landmark has a name that the model knows; `onescan info` lists the model's",
            ));
        }
        Ok(marks)
    }

    /// The command that does the same for one scan.
    fn command(&self, scan: &Path, marks: Option<&Path>) -> String {
        let shown = |path: &Path| quoted(&typed(path));
        let defaults = Options::default();
        let mut command = format!("onescan register {} {} -o DIR", shown(&self.model), shown(scan));
        let mut add = |option: &str, value: &dyn Display, differs: bool| {
            if differs {
                // Writing to a string cannot fail.
                let _ = write!(command, " --{option}{value}");
            }
        };
        add("shape-only", &"", self.shape_only);
        let landmarks = marks.map(|path| format!(" {}", shown(path))).unwrap_or_default();
        add("landmarks", &landmarks, marks.is_some());
        let sd = format!(" {}", self.landmark_sd);
        add("landmark-sd", &sd, self.landmark_sd != defaults.landmark_sd);
        add("width", &format!(" {}", self.width), self.width != defaults.width);
        add("uncertainty", &"", self.uncertainty);
        command + &self.reading.options()
    }
}

/// What batch.json says of a scan.
fn summary(scan: &Path, found: &serde_json::Value) -> serde_json::Value {
    json!({
        "scan": file_name(scan),
        "folder": folder(scan),
        "chamfer_mm": found["chamfer_mm"],
        "hausdorff_mm": found["hausdorff_mm"],
        "hausdorff_95_mm": found["hausdorff_95_mm"],
        "doubt": found["doubt"],
    })
}

/// A scan's folder in a batch.
fn folder(scan: &Path) -> String {
    scan.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}
