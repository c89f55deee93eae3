//! Meshes from whatever program scanned or made them: PLY, OBJ, glTF, STL, OFF.
//!
//! A reader gives points, triangles, and colours as far as its format has them; textures are
//! baked to vertex colours on the way. [`read`] sees to what all have in common.

mod frame;
mod gltf;
mod named;
mod obj;
mod off;
mod paint;
mod stl;

pub use frame::{Direction, Frame};

use crate::error::{Error, Result};
use crate::files::{self, FileKind};
use crate::mesh::{Mesh, far, in_range, ply};
use crate::scan::subdivide::{Finer, Piece, Subdivision, mean, mean_point};
use named::Place;
use paint::{Lost, Paint, Wrap};
use std::path::{Path, PathBuf};

/// What a file does not say about itself.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Colour for what has none in the file, RGB in `[0, 1]` as stored. One flat colour all over counts as
    /// none: most programs write a material for what has no colour.
    pub color: Option<[f32; 3]>,
    /// A texture to lay on by the file's coordinates, in place of all colours it has.
    pub texture: Option<PathBuf>,
    /// Whether the texture's v axis points the other way than the format says.
    pub flip_v: bool,
    /// Whether files are read that the scan names outside its own directory.
    pub allow_outside: bool,
    /// Which way the scan stands.
    pub frame: Frame,
    /// How long its unit is.
    pub scale: Scale,
    /// How triangles are split before textures are read off at their corners; lengths are millimetres.
    pub subdivision: Option<Subdivision>,
}

/// How long a scan's unit is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Scale {
    /// The format's own unit.
    #[default]
    Format,
    /// So many millimetres.
    Unit(f32),
    /// Such that the longest side of the box around the mesh is so many millimetres.
    Size(f32),
}

impl Options {
    /// Texture coordinates with v down, as pictures have it. `down`: the format has it so, too.
    fn v_down(&self, [u, v]: [f32; 2], down: bool) -> [f32; 2] {
        [u, if down == self.flip_v { 1.0 - v } else { v }]
    }

    /// Millimetres in the unit of a mesh's points.
    fn millimetres(&self, format: Format, points: impl Iterator<Item = [f64; 3]>) -> f32 {
        match self.scale {
            Scale::Format => format.millimetres(),
            Scale::Unit(millimetres) => millimetres,
            Scale::Size(size) => {
                let (low, high) = points.fold(([f64::MAX; 3], [f64::MIN; 3]), |(low, high), p| {
                    let [low, high]: [[f64; 3]; 2] = [
                        std::array::from_fn(|i| p[i].min(low[i])),
                        std::array::from_fn(|i| p[i].max(high[i])),
                    ];
                    (low, high)
                });
                let longest = (0..3).map(|i| high[i] - low[i]).fold(0.0, f64::max);
                (f64::from(size) / longest) as f32
            }
        }
    }

    /// How triangles are split, in the unit of the mesh's points.
    fn subdivision(
        &self,
        format: Format,
        points: impl Iterator<Item = [f64; 3]>,
    ) -> Option<Subdivision> {
        match self.subdivision? {
            Subdivision::Edge(most) => {
                Some(Subdivision::Edge(most / f64::from(self.millimetres(format, points))))
            }
            times @ Subdivision::Times(_) => Some(times),
        }
    }

    /// A mesh's triangles split as asked; none if that was not.
    fn finer(
        &self,
        format: Format,
        points: &[[f64; 3]],
        triangles: &[[u32; 3]],
    ) -> Result<Option<Finer>> {
        let how = self.subdivision(format, points.iter().copied());
        how.map(|how| Finer::of(points, triangles, how)).transpose()
    }
}

/// Extensions of the files that are read.
pub const EXTENSIONS: [&str; 6] = ["ply", "obj", "glb", "gltf", "stl", "off"];

/// A kind of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Polygon file format.
    Ply,
    /// Wavefront, with its materials.
    Obj,
    /// glTF 2.0, `.glb` or `.gltf`.
    Gltf,
    /// Stereolithography.
    Stl,
    /// Object file format.
    Off,
}

impl Format {
    /// The format by the file's extension, or, if it has none of ours, by its content.
    pub fn of(path: &Path, bytes: &[u8]) -> Option<Self> {
        let bytes = unmarked(bytes);
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        match extension.to_str() {
            Some("ply") => Some(Self::Ply),
            Some("obj") => Some(Self::Obj),
            Some("glb" | "gltf") => Some(Self::Gltf),
            Some("stl") => Some(Self::Stl),
            Some("off") => Some(Self::Off),
            _ if bytes.starts_with(b"ply") => Some(Self::Ply),
            _ if bytes.starts_with(b"glTF") => Some(Self::Gltf),
            _ if stl::is_text(bytes) => Some(Self::Stl),
            _ if off::is_off(bytes) => Some(Self::Off),
            _ => None,
        }
    }

    /// Millimetres in the format's unit: glTF is in metres by definition, of the others most are
    /// in millimetres.
    pub fn millimetres(self) -> f32 {
        if self == Self::Gltf { 1000.0 } else { 1.0 }
    }
}

/// A scan as it was read.
#[derive(Clone, Debug, PartialEq)]
pub struct Scan {
    /// Positions in the file's unit and the options' frame, a colour for every vertex.
    pub mesh: Mesh,
    /// Millimetres in the unit of its positions.
    pub millimetres: f32,
    /// What was subtracted from the file's coordinates, in its own frame: not zero if they lay so far
    /// from the origin that f32 would not hold them.
    pub origin: [f64; 3],
    /// What a person should know of how it was read, a line each.
    pub notes: Vec<String>,
}

/// Reads a mesh.
///
/// Vertices keep their order in PLY and OBJ; glTF and STL repeat vertices for each normal and
/// texture seam, which are joined. Vertices of no triangle get the mean colour if they have none.
///
/// # Errors
/// Unknown formats, and what the formats' readers find; no vertices, no triangles, numbers that
/// are not finite; vertices without colour if the options have none either.
pub fn read(path: &Path, options: &Options) -> Result<Scan> {
    let bytes = files::read(path).map_err(|e| Error::file(path, e))?;
    let named = |e| Error::file(path, e);
    let format = Format::of(path, &bytes).ok_or_else(|| {
        let what = foreign(path, &bytes).unwrap_or("not a mesh this program reads");
        let what = format_args!("{what}; export it as PLY, OBJ, GLB or glTF");
        FileKind::Scan.or_misplaced(path, what)
    })?;
    parse(path, &bytes, format, options).map_err(named)
}

/// What files of other formats are called.
fn foreign(path: &Path, bytes: &[u8]) -> Option<&'static str> {
    let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
    Some(match extension.to_str() {
        Some("fbx") => "FBX, which is not read",
        Some("blend") => "a file of Blender's, which is not read",
        Some("usd" | "usda" | "usdc" | "usdz") => "USD, which is not read",
        Some("dae") => "COLLADA, which is not read",
        Some("3ds" | "max" | "ma" | "mb" | "c4d" | "ztl") => {
            "a file of a modelling program's own, which is not read"
        }
        Some("drc") => "a mesh compressed by Draco, which is not read",
        Some("wrl" | "x3d" | "vrml") => "VRML or X3D, which is not read",
        Some("3mf" | "amf") => "a file for printers, which is not read",
        _ if bytes.starts_with(b"Kaydara FBX") => "FBX, which is not read",
        _ if bytes.starts_with(b"DRACO") => "a mesh compressed by Draco, which is not read",
        _ => return None,
    })
}

/// Bytes without the mark that some editors begin a text with.
fn unmarked(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

/// The lines of a text with their numbers, from 1, without blanks around them; on old Macintoshes
/// they end by a carriage return alone.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let end = if text.contains('\n') { '\n' } else { '\r' };
    (1..).zip(text.split(end).map(str::trim))
}

/// The same as [`read`], from bytes; `path` tells where the files lie that they name.
///
/// # Errors
/// As [`read`], without the file's name.
pub fn parse(path: &Path, bytes: &[u8], format: Format, options: &Options) -> Result<Scan> {
    let rough = match format {
        Format::Ply => from_ply(path, bytes, options)?,
        Format::Obj => obj::read(path, bytes, options)?,
        Format::Gltf => gltf::read(path, bytes, options)?,
        Format::Off => off::parse(bytes)?.finer(format, options)?,
        Format::Stl if options.color.is_none() => {
            return Err(Error::new(
                "an STL file has no colours, and a model needs them; export as PLY, OBJ or GLB, \
                 or give the whole scan one by --colour R,G,B",
            ));
        }
        Format::Stl => stl::parse(bytes)?.finer(format, options)?,
    };
    rough.finish(format, options)
}

/// A PLY with its textures, if it names or is given any. A vertex is coloured by them, or else by
/// itself, or else by its faces.
fn from_ply(path: &Path, bytes: &[u8], options: &Options) -> Result<Rough> {
    let mut parts = ply::parse_parts(bytes)?;
    if let Some(finer) = options.finer(Format::Ply, &parts.points, &parts.triangles)? {
        refine(&mut parts, &finer);
    }
    let ply::Parts { points, colors, triangles, face_colors, uvs, pages, textures } = parts;
    if options.texture.is_some() && uvs.is_none() {
        return Err(Error::new("has no texture coordinates; --texture cannot be laid on it"));
    }
    let mut notes = Vec::new();
    let (mut paint, mut lost) = (Paint::new(points.len()), Lost::default());
    if let Some(uvs) = uvs {
        let named = textures.len();
        if options.texture.is_none() && named > 1 && pages.is_none() {
            return Err(Error::new(format_args!(
                "names {named} textures and does not say by `texnumber` which lies where; export it \
                 with one, or give that by --texture"
            )));
        }
        let place = Place::new(path, options);
        let other = options.color.is_some() || colors.is_some() || face_colors.is_some();
        let files = match &options.texture {
            Some(file) => vec![Some(file.clone())],
            None => textures
                .iter()
                // `<this>` is MeshLab's word for the name of the file.
                .map(|name| name.replace("<this>", &place.stem()))
                .map(|name| place.texture(Path::new(""), &name, other, &mut notes))
                .collect::<Result<_>>()?,
        };
        for (page, file) in (0..).zip(files) {
            let Some(picture) = file.map(|file| paint::texture(&file)).transpose()? else {
                continue;
            };
            for (i, (triangle, uvs)) in triangles.iter().zip(&uvs).enumerate() {
                // Of one texture all numbers are its; a negative one is none's.
                let elsewhere = |on: i64| if named > 1 { on != page } else { on < 0 };
                let on = pages.as_ref().filter(|_| options.texture.is_none());
                if on.is_some_and(|pages| elsewhere(pages[i])) {
                    continue;
                }
                let uvs = uvs.map(|uv| options.v_down(uv, false));
                let colors = lost.read(&picture, uvs, [Wrap::Repeat; 2]);
                triangle.iter().zip(colors).for_each(|(vertex, color)| paint.add(*vertex, color));
            }
        }
    }
    notes.extend(lost.note(triangles.len()));
    let mut faces = Paint::new(points.len());
    for (triangle, color) in triangles.iter().zip(face_colors.iter().flatten()) {
        for vertex in triangle {
            faces.add(*vertex, *color);
        }
    }
    let mut merged: Vec<_> = paint.colors().collect();
    if let Some(colors) = colors {
        for (color, own) in merged.iter_mut().zip(colors) {
            *color = color.or(Some(own));
        }
    }
    for (color, face) in merged.iter_mut().zip(faces.colors()) {
        *color = color.or(face);
    }
    let (points, origin) = far::settled(&points);
    Ok(Rough { points, triangles, colors: merged, origin, notes })
}

/// Splits the triangles of a PLY.
fn refine(parts: &mut ply::Parts, finer: &Finer) {
    finer.extend(&mut parts.points, mean_point);
    if let Some(colors) = &mut parts.colors {
        finer.extend(colors, mean);
    }
    let of = |piece: &Piece| piece.of as usize;
    let pieces = || finer.pieces.iter();
    parts.uvs = parts.uvs.take().map(|uvs| pieces().map(|p| p.mix(uvs[of(p)])).collect());
    parts.pages = parts.pages.take().map(|pages| pieces().map(|p| pages[of(p)]).collect());
    let colors = parts.face_colors.take();
    parts.face_colors = colors.map(|colors| pieces().map(|p| colors[of(p)]).collect());
    parts.triangles = finer.triangles();
}

/// A mesh as a format's reader leaves it. Guarantees: as many colours as points, every index of a
/// triangle below their number, which fits into u32.
struct Rough {
    points: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    colors: Vec<Option<[f32; 3]>>,
    /// See [`Scan::origin`].
    origin: [f64; 3],
    notes: Vec<String>,
}

impl Rough {
    /// With its triangles split as asked, of a format without textures.
    fn finer(mut self, format: Format, options: &Options) -> Result<Self> {
        let points: Vec<_> = self.points.iter().map(|p| p.map(f64::from)).collect();
        if let Some(finer) = options.finer(format, &points, &self.triangles)? {
            finer.extend(&mut self.points, mean);
            finer.extend(&mut self.colors, |a, b| a.zip(b).map(|(a, b)| mean(a, b)));
            self.triangles = finer.triangles();
        }
        Ok(self)
    }

    fn finish(self, format: Format, options: &Options) -> Result<Scan> {
        let Self { mut points, triangles, mut colors, origin, mut notes } = self;
        if points.is_empty() {
            return Err(Error::new("the mesh is empty: no vertices; export the scan again"));
        }
        if triangles.is_empty() {
            return Err(Error::new("has no faces; mesh the point cloud first"));
        }
        if let Some(color) = options.color {
            if colors.iter().all(Option::is_some) {
                notes.push("--colour was not used: the file gives every vertex a colour".into());
            }
            for own in &mut colors {
                *own = own.or(Some(color));
            }
        }
        let mut used = vec![false; points.len()];
        for &corner in triangles.as_flattened() {
            used[corner as usize] = true;
        }
        let bare = colors.iter().zip(&used).filter(|(color, used)| color.is_none() && **used);
        let (bare, drawn) = (bare.count(), used.iter().filter(|used| **used).count());
        if bare == drawn {
            return Err(Error::new(
                "has no vertex colours and no texture; a model's albedo comes from them: export \
                 with either, or give --texture FILE or --colour R,G,B",
            ));
        }
        if bare > 0 {
            return Err(Error::new(format_args!(
                "{bare} of {drawn} vertices have no colour; export all of them coloured, or give \
                 them one by --colour R,G,B"
            )));
        }
        for (i, (point, color)) in points.iter().zip(&mut colors).enumerate() {
            if !point.iter().all(|c| c.is_finite()) {
                return Err(Error::new(format_args!(
                    "vertex {i}: position {point:?} is not finite; remove the vertex"
                )));
            }
            if let Some(color) = color {
                *color = in_range(*color).ok_or_else(|| {
                    Error::new(format_args!(
                        "vertex {i}: colour {color:?} lies outside [0, 1]; export the scan again"
                    ))
                })?;
            }
        }
        let mut mean = Paint::new(1);
        colors.iter().flatten().for_each(|&color| mean.add(0, color));
        let mean = mean.colors().flatten().next().unwrap_or_default();
        if options.frame != Frame::default() {
            for point in &mut points {
                *point = options.frame.turn(*point);
            }
        }
        let colors = colors.into_iter().map(|color| color.unwrap_or(mean)).collect();
        if origin != [0.0; 3] {
            let [x, y, z] = origin;
            notes.push(format!(
                "{x} {y} {z} was subtracted from its coordinates, which lie too far from their \
                 origin; those of landmarks and planes are the file's as before"
            ));
        }
        let exact = points.iter().map(|p| p.map(f64::from));
        let millimetres = options.millimetres(format, exact);
        if points.as_flattened().iter().any(|c| !(c * millimetres).is_finite()) {
            return Err(Error::new(format_args!(
                "a unit of {millimetres} mm does not suit this scan; give mm, cm or m"
            )));
        }
        Ok(Scan { mesh: Mesh { points, colors, triangles }, millimetres, origin, notes })
    }
}

#[cfg(test)]
mod tests;
