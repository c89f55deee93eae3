//! A scan on the command line: which file, and what the file does not say.

use super::file_name;
use clap::Args;
use onescan::error::{Error, Result};
use onescan::mesh::Mesh;
use onescan::progress::Console;
use onescan::scan::mesh_file::{self, Direction, Frame, Options};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// A scan, and how to read it.
#[derive(Args)]
pub(super) struct Scan {
    /// The scan: PLY, OBJ, GLB, glTF, or with --colour STL.
    #[arg(value_name = "SCAN")]
    pub(super) path: PathBuf,
    #[command(flatten)]
    reading: Reading,
}

/// How to read a scan.
#[derive(Args)]
pub(super) struct Reading {
    /// Unit of the scan's coordinates: mm, cm, m, or how many millimetres it is [default: m for
    /// glTF, mm for others].
    #[arg(long, value_parser = unit)]
    unit: Option<f32>,
    /// Axis of the file that points up: x, y, z, -x, -y or -z.
    #[arg(long, value_name = "AXIS", default_value = "y", allow_hyphen_values = true)]
    up: Direction,
    /// Axis of the file the face looks along [default: z; if that is up, -y].
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    front: Option<Direction>,
    /// Colour of what the file gives none: R,G,B up to 255, or #rrggbb. One flat material all over
    /// counts as none.
    #[arg(long, visible_alias = "color", value_name = "R,G,B", value_parser = color)]
    colour: Option<[f32; 3]>,
    /// Texture to lay by the file's coordinates instead of what colours it has, PNG or JPEG.
    #[arg(long, value_name = "FILE")]
    texture: Option<PathBuf>,
    /// The texture's v axis points the other way than the format says.
    #[arg(long)]
    flip_v: bool,
    /// Read textures, materials and buffers that the scan names outside its own directory.
    #[arg(long)]
    allow_outside: bool,
}

fn unit(text: &str) -> std::result::Result<f32, String> {
    match text {
        "mm" => Ok(1.0),
        "cm" => Ok(10.0),
        "m" => Ok(1000.0),
        _ => text
            .parse()
            .ok()
            .filter(|unit: &f32| (1e-9..=1e9).contains(unit))
            .ok_or_else(|| "expected mm, cm, m, or a number of millimetres, like 25.4".into()),
    }
}

fn color(text: &str) -> std::result::Result<[f32; 3], String> {
    let bytes = match text.strip_prefix('#') {
        Some(hex) if hex.len() == 6 && hex.is_ascii() => {
            [0, 2, 4].map(|i| u8::from_str_radix(&hex[i..i + 2], 16).ok())
        }
        _ => {
            let mut parts = text.split(',').map(|part| part.trim().parse().ok());
            let color = [(); 3].map(|()| parts.next().flatten());
            if parts.next().is_some() { [None; 3] } else { color }
        }
    };
    match bytes {
        [Some(r), Some(g), Some(b)] => Ok([r, g, b].map(|c| f32::from(c) / 255.0)),
        _ => Err("expected three numbers of 0 to 255, like 200,160,140, or #c8a08c".into()),
    }
}

/// A scan as it was read.
pub(super) struct Placed {
    pub(super) mesh: Mesh,
    /// How many millimetres its unit is.
    pub(super) unit: f32,
    /// What was subtracted from the file's coordinates.
    pub(super) origin: [f64; 3],
    /// What a person should know of how it was read.
    pub(super) notes: Vec<String>,
}

impl Scan {
    /// Which way the scan stands in its file.
    pub(super) fn frame(&self) -> Result<Frame> {
        self.reading.frame()
    }

    /// Reads the scan, and says what a person should know of that.
    pub(super) fn read(&self, console: Console) -> Result<Placed> {
        let placed = self.reading.read(&self.path)?;
        for note in &placed.notes {
            console.say(Error::file(&self.path, note));
        }
        Ok(placed)
    }
}

impl Reading {
    /// The options that say so, with a space before each.
    pub(super) fn options(&self) -> String {
        let mut text = String::new();
        let mut add = |option: &str, value: Option<String>| {
            if let Some(value) = value {
                // Writing to a string cannot fail.
                let _ = write!(text, " --{option}{value}");
            }
        };
        add("unit", self.unit.map(|unit| format!(" {unit}")));
        // With an equals sign, or a minus would begin another option.
        add("up", (self.up.to_string() != "y").then(|| format!("={}", self.up)));
        add("front", self.front.map(|front| format!("={front}")));
        let bytes = self.colour.map(|color| color.map(|c| (255.0 * c).round().to_string()));
        add("colour", bytes.map(|bytes| format!(" {}", bytes.join(","))));
        add("texture", self.texture.as_deref().map(|path| format!(" {}", file_name(path))));
        add("flip-v", self.flip_v.then(String::new));
        add("allow-outside", self.allow_outside.then(String::new));
        text
    }

    /// Which way the scan stands in its file.
    pub(super) fn frame(&self) -> Result<Frame> {
        Frame::new(self.up, self.front)
    }

    /// Reads a scan.
    pub(super) fn read(&self, path: &Path) -> Result<Placed> {
        let options = Options {
            color: self.colour,
            texture: self.texture.clone(),
            flip_v: self.flip_v,
            allow_outside: self.allow_outside,
            frame: self.frame()?,
        };
        let mesh_file::Scan { mesh, format, origin, notes } = mesh_file::read(path, &options)?;
        let unit = self.unit.unwrap_or(format.millimetres());
        if mesh.points.as_flattened().iter().any(|c| !(c * unit).is_finite()) {
            return Err(Error::file(
                path,
                format_args!("a unit of {unit} mm does not suit this scan; give mm, cm or m"),
            ));
        }
        Ok(Placed { mesh, unit, origin, notes })
    }
}
