//! The command line: one file per command.

mod bench;
mod build;
mod convert;
mod demo;
mod evaluate;
mod experiment;
mod export;
mod fit;
mod info;
mod inspect;
mod landmarks;
mod model;
mod modes;
mod recognise;
mod register;
mod render;
mod running;
mod sample;
mod scan;
mod serve;

use clap::{Parser, Subcommand};
use onescan::error::{Error, Result};
use onescan::files::{folder, has_extension, is_stream, listed, write_atomically};
use onescan::interchange::{self, Format};
use onescan::mesh::ply::{self, Encoding};
use onescan::mesh::{Mesh, glb};
use onescan::model::morphable::{Import, Morphable};
use onescan::progress::Console;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// 3D morphable models from a single 3D scan.
///
/// One coloured mesh in; out comes a generative model of its shape and albedo, which is sampled,
/// rendered, and fitted to photos. Without a command the demo runs: it builds a face model from
/// the built-in template, fits it to three photos and writes out/demo/report.html.
#[derive(Parser)]
#[command(name = "onescan", version, after_help = EXAMPLES)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    /// Say nothing but errors.
    #[arg(long, short, global = true)]
    quiet: bool,
}

const EXAMPLES: &str = "\
Examples:
  onescan                                        the demo
  onescan build scan.ply -o face.3dmm --landmarks landmarks.json
  onescan inspect head.obj --unit cm --mend head.ply
  onescan sample face.3dmm -o samples -n 12
  onescan landmarks photo.jpg --picture marked.png
  onescan fit face.3dmm photo.jpg --landmarks photo.tlms -o fit
  onescan recognise people photo.jpg --model face.3dmm -o who
  onescan render face.3dmm --fit fit -o turned.png --yaw 30
  onescan register face.3dmm scan.ply -o registered
  onescan convert face.3dmm -o face.h5
  onescan serve                                  the same in a browser

Same model, photo, landmarks, settings and seed: same fit, to the last bit.";

// What a command says of itself stands on its arguments, or here if those say nothing: clap drops
// the one for the other.
#[derive(Subcommand)]
enum Command {
    Demo(demo::Demo),
    Build(build::Build),
    Inspect(inspect::Inspect),
    Export(export::Export),
    Convert(convert::Convert),
    Info(info::Info),
    Sample(sample::Sample),
    /// Show what the leading components of a model do: the mean and three deviations to each side.
    ///
    /// Writes modes.png, a row for each component: shape at −3 standard deviations, the mean, shape
    /// at +3, and the same of the albedo. Each picture is beside it as a mesh, such as
    /// `shape_1_plus.ply` and `shape_1_plus.glb`, the mean as mean.ply and mean.glb.
    Modes(modes::Modes),
    /// Make models of models: project, condition, cut out, sum up, learn from meshes.
    ///
    /// Every operation but `project` writes a model: components orthonormal, leading ones first.
    ///
    /// (Fewer components: `onescan export --shape-rank`.)
    #[command(subcommand)]
    Model(model::Model),
    /// Measure compactness, generalization and specificity of a model.
    ///
    /// By number of components (1, 2, 5, 10, 20, 50, 100, all), of shape and of albedo: the
    /// variance they hold (compactness), how near the model comes to meshes it has not seen
    /// (generalization), how near its random instances are to such meshes (specificity); all are
    /// better if less. Writes metrics.json and report.html. The meshes need the model's topology.
    Evaluate(evaluate::Evaluate),
    Experiment(experiment::Experiment),
    Render(render::Render),
    Landmarks(landmarks::Landmarks),
    Fit(fit::Fit),
    Recognise(recognise::Recognise),
    Register(register::Register),
    Serve(serve::Serve),
    Bench(bench::Bench),
}

impl Arguments {
    /// Runs the command.
    pub(crate) fn run(self) -> Result<()> {
        let console = Console::new(self.quiet);
        match self.command {
            None => demo::Demo::default().run(console),
            Some(Command::Demo(command)) => command.run(console),
            Some(Command::Build(command)) => command.run(console),
            Some(Command::Inspect(command)) => command.run(console),
            Some(Command::Export(command)) => command.run(console),
            Some(Command::Convert(command)) => command.run(console),
            Some(Command::Info(command)) => command.run(),
            Some(Command::Sample(command)) => command.run(console),
            Some(Command::Modes(command)) => command.run(console),
            Some(Command::Model(command)) => command.run(console),
            Some(Command::Evaluate(command)) => command.run(console),
            Some(Command::Experiment(command)) => command.run(console),
            Some(Command::Render(command)) => command.run(console),
            Some(Command::Landmarks(command)) => command.run(console),
            Some(Command::Fit(command)) => command.run(console),
            Some(Command::Recognise(command)) => command.run(console),
            Some(Command::Register(command)) => command.run(console),
            Some(Command::Serve(command)) => command.run(),
            Some(Command::Bench(command)) => command.run(console),
        }
    }
}

/// The file's name without directories, for texts that are to be the same on every machine.
fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// A path as it was given, for commands that are to run again.
fn typed(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

/// Makes the output directory, so that a place that cannot be written is known before the work.
fn output_directory(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path).and_then(|()| tempfile::tempfile_in(path).map(drop)).map_err(
        |e| Error::file(path, format_args!("cannot write here: {e}; choose another -o directory")),
    )
}

/// Checks that a file can be written where it is to go, before the work, and that its name says what
/// is in it, by one of these extensions. A device or a pipe may have any name.
fn output_file(path: &Path, extensions: &[&str]) -> Result<()> {
    if is_stream(path) {
        return Ok(());
    }
    if path.is_dir() {
        return Err(Error::file(path, "is a directory; give the name of a file to write"));
    }
    if !has_extension(path, extensions) {
        let known = extensions.join(", .");
        return Err(Error::file(path, format_args!("its name must end in .{known}")));
    }
    tempfile::tempfile_in(folder(path)).map(drop).map_err(|e| {
        Error::file(path, format_args!("cannot write: {e}; give -o in a writable directory"))
    })
}

/// Parses an angle in degrees.
fn degrees(text: &str) -> std::result::Result<f32, String> {
    match text.parse::<f32>() {
        // Beyond, turns of the circle are lost in rounding.
        Ok(x) if x.abs() <= 3600.0 => Ok(x),
        _ => Err("expected an angle in degrees".into()),
    }
}

/// Parses a finite number above 0.
fn positive(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        // In f32, too, as which most are kept.
        Ok(x) if x as f32 > 0.0 && (x as f32).is_finite() => Ok(x),
        _ => Err("expected a number above 0".into()),
    }
}

/// The meshes of files and directories (their `.ply` files by name), with their paths.
fn meshes(places: &[PathBuf]) -> Result<Vec<(PathBuf, Mesh)>> {
    let paths = listed(places, &["ply"], "has no .ply files; give meshes, or their directory")?;
    paths.into_iter().map(|path| ply::read(&path).map(|mesh| (path, mesh))).collect()
}

/// Writes a mesh with its colours, as GLB if the file's name says so, else as PLY.
fn write_mesh(path: &Path, mesh: &Mesh) -> Result<()> {
    if has_extension(path, &["glb"]) {
        let bytes = glb::encode(mesh, &path.file_stem().unwrap_or_default().to_string_lossy())?;
        return write_atomically(path, |out| out.write_all(&bytes));
    }
    write_atomically(path, |out| ply::write(out, mesh, Encoding::default()))
}

/// The same of a model, whose name must tell a format that is written.
fn model_file(path: &Path) -> Result<()> {
    interchange::can_write(path)?;
    output_file(path, &["3dmm", "h5", "hdf5", "h5.json"])
}

/// Reads a model in full precision, of any format; says what in its file is not as it should be.
fn read_model(console: Console, path: &Path) -> Result<Morphable> {
    let Import { model, notes } = interchange::read(path)?;
    for note in notes {
        console.say(Error::file(path, note));
    }
    Ok(model)
}

/// Writes a model that was made of a file, in the format of the name of another; says what that cannot
/// carry.
fn write_model(console: Console, from: &Path, path: &Path, model: &Morphable) -> Result<()> {
    interchange::write(model, from, path)?;
    for lost in interchange::lost(model, Format::of(path)) {
        console.say(format_args!("not in this format: {lost}"));
    }
    console.say(format_args!("wrote {}", path.display()));
    Ok(())
}

/// Parses `WxH`, or the side of a square.
fn size(text: &str) -> std::result::Result<[u32; 2], String> {
    let (w, h) = text.split_once(['x', '×']).unwrap_or((text, text));
    let side = |s: &str| match s.parse() {
        Ok(side) if (1..=8192).contains(&side) => Ok(side),
        _ => Err(format!(
            "{s:?} is not a side of 1 to 8192 pixels; give one, or WIDTHxHEIGHT, like 512x384"
        )),
    };
    Ok([side(w)?, side(h)?])
}
