//! A scan on the command line: which file, and what the file does not say.

use super::typed;
use clap::Args;
use onescan::error::{Error, Result};
use onescan::fit::output::quoted;
use onescan::mesh::Mesh;
use onescan::mesh::landmarks::{self, Landmark};
use onescan::progress::Console;
use onescan::scan::crop::crop;
use onescan::scan::holes;
use onescan::scan::mesh_file::{self, Direction, Frame, Options, Scale};
use onescan::scan::subdivide::Subdivision;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// A scan, and how to read it.
#[derive(Args)]
pub(super) struct Scan {
    /// The scan: PLY, OBJ, GLB, glTF, OFF, or with --colour STL.
    #[arg(value_name = "SCAN")]
    pub(super) path: PathBuf,
    /// Landmarks of the scan, JSON; a fit needs them, and --crop. By vertex number for PLY, OBJ and OFF; in
    /// glTF and STL equal vertices are joined: name them by coordinates, which are the file's.
    #[arg(long)]
    pub(super) landmarks: Option<PathBuf>,
    /// Close holes whose rim is no longer than this [default: a fifth of the scan's diagonal], with
    /// colours from the rim.
    #[arg(long, value_name = "MM", num_args = 0..=1, require_equals = true, value_parser = length)]
    #[expect(
        clippy::option_option,
        reason = "clap's way to write an option with or without a value"
    )]
    fill_holes: Option<Option<f32>>,
    /// Keep what is within so many millimetres of one of the --landmarks: center.nose.tip,120.
    #[arg(long, value_name = "LANDMARK,MM", value_parser = ball, requires = "landmarks")]
    crop: Option<(String, f32)>,
    #[command(flatten, next_help_heading = "How the scan is read")]
    reading: Reading,
}

/// How to read a scan.
#[derive(Args)]
pub(super) struct Reading {
    /// Unit of the scan's coordinates: mm, cm, m, or how many millimetres it is [default: m for
    /// glTF, mm for others].
    #[arg(long, value_parser = unit)]
    unit: Option<f32>,
    /// Length of the scan's longest side, millimetres, if its unit is not known: 300, say.
    #[arg(long, value_name = "MM", value_parser = length, conflicts_with = "unit")]
    size: Option<f32>,
    /// Axis of the file that points up: x, y, z, -x, -y or -z.
    #[arg(long, value_name = "AXIS", default_value = "y", allow_hyphen_values = true)]
    up: Direction,
    /// Axis of the file that points to the front [default: z; if that is up, -y].
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
    /// Split every triangle in four, so often, so that vertices hold what a texture shows; landmarks'
    /// vertices keep their numbers.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=8),
          conflicts_with = "edge")]
    subdivide: Option<u32>,
    /// The same, of edges longer than this, millimetres, until none is.
    #[arg(long, value_name = "MM", value_parser = length)]
    edge: Option<f32>,
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

fn length(text: &str) -> std::result::Result<f32, String> {
    let length = text.parse().ok().filter(|length: &f32| (1e-6..=1e9).contains(length));
    length.ok_or_else(|| "expected a length in millimetres, like 300".into())
}

fn ball(text: &str) -> std::result::Result<(String, f32), String> {
    let (name, radius) =
        text.rsplit_once(',').ok_or("expected LANDMARK,MM, like center.nose.tip,120")?;
    Ok((name.trim().to_owned(), length(radius.trim())?))
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

    /// Whether it was said how large the scan is.
    pub(super) fn is_measured(&self) -> bool {
        self.reading.unit.is_some() || self.reading.size.is_some()
    }

    /// Reads the scan and its landmarks, closes and crops it as asked, and says what a person should know
    /// of that.
    pub(super) fn read(&self, console: Console) -> Result<(Placed, Vec<Landmark>)> {
        let mut placed = self.reading.read(&self.path)?;
        let say = |what: &dyn std::fmt::Display| console.say(Error::file(&self.path, what));
        for note in &placed.notes {
            say(note);
        }
        let Placed { mesh, unit, origin, .. } = &mut placed;
        let mut landmarks = match &self.landmarks {
            Some(path) => {
                // Their coordinates are the file's.
                let frame = self.frame()?;
                let points: Vec<_> = mesh.points.iter().map(|p| frame.undo(*p)).collect();
                landmarks::read_moved(path, &points, *origin, *unit)?
            }
            None => Vec::new(),
        };
        if let Some(longest) = self.fill_holes {
            let filled = holes::fill(mesh, longest.map(|mm| f64::from(mm / *unit)));
            say(&format_args!("{filled} hole{} closed", if filled == 1 { "" } else { "s" }));
        }
        if let Some((name, radius)) = &self.crop {
            let before = mesh.triangles.len();
            let dropped = crop(mesh, &mut landmarks, name, radius / *unit)
                .map_err(|e| Error::file(&self.path, e))?;
            say(&format_args!("{} of {before} triangles are near {name}", mesh.triangles.len()));
            if !dropped.is_empty() {
                say(&format_args!("landmarks cropped away: {}", dropped.join(", ")));
            }
        }
        Ok((placed, landmarks))
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
        add("size", self.size.map(|size| format!(" {size}")));
        // With an equals sign, or a minus would begin another option.
        add("up", (self.up.to_string() != "y").then(|| format!("={}", self.up)));
        add("front", self.front.map(|front| format!("={front}")));
        let bytes = self.colour.map(|color| color.map(|c| (255.0 * c).round().to_string()));
        add("colour", bytes.map(|bytes| format!(" {}", bytes.join(","))));
        add("texture", self.texture.as_deref().map(|path| format!(" {}", quoted(&typed(path)))));
        add("flip-v", self.flip_v.then(String::new));
        add("subdivide", self.subdivide.map(|times| format!(" {times}")));
        add("edge", self.edge.map(|edge| format!(" {edge}")));
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
            scale: match (self.unit, self.size) {
                (Some(unit), _) => Scale::Unit(unit),
                (None, Some(size)) => Scale::Size(size),
                (None, None) => Scale::Format,
            },
            subdivision: match (self.subdivide, self.edge) {
                (Some(times), _) => Some(Subdivision::Times(times)),
                (None, edge) => edge.map(|edge| Subdivision::Edge(edge.into())),
            },
        };
        let mesh_file::Scan { mesh, millimetres: unit, origin, notes } =
            mesh_file::read(path, &options)?;
        Ok(Placed { mesh, unit, origin, notes })
    }
}
