//! Meshes from whatever program scanned them: PLY, OBJ, glTF, STL.
//!
//! A reader gives points, triangles, and colours as far as its format has them; textures are
//! baked to vertex colours on the way. [`read`] sees to what all have in common.

mod frame;
mod gltf;
mod obj;
mod paint;
mod stl;

pub use frame::{Direction, Frame};

use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::mesh::ply;
use paint::{Paint, Wrap};
use std::path::{Path, PathBuf};

/// What a file does not say of itself.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Colour of what the file gives none, RGB in `[0, 1]` as stored.
    pub color: Option<[f32; 3]>,
    /// A texture to lay by the file's coordinates, instead of all colours it has.
    pub texture: Option<PathBuf>,
    /// The texture's v axis points the other way than the format says.
    pub flip_v: bool,
    /// Which way the scan stands.
    pub frame: Frame,
}

impl Options {
    /// Texture coordinates with v down, as pictures have it. `down`: the format has it so, too.
    fn v_down(&self, [u, v]: [f32; 2], down: bool) -> [f32; 2] {
        [u, if down == self.flip_v { 1.0 - v } else { v }]
    }
}

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
}

impl Format {
    /// The format by the file's extension, or, if it has none of ours, by its content.
    pub fn of(path: &Path, bytes: &[u8]) -> Option<Self> {
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        match extension.to_str() {
            Some("ply") => Some(Self::Ply),
            Some("obj") => Some(Self::Obj),
            Some("glb" | "gltf") => Some(Self::Gltf),
            Some("stl") => Some(Self::Stl),
            _ if bytes.starts_with(b"ply") => Some(Self::Ply),
            _ if bytes.starts_with(b"glTF") => Some(Self::Gltf),
            _ if bytes.starts_with(b"solid") => Some(Self::Stl),
            _ => None,
        }
    }

    /// Millimetres in the format's unit: glTF is in metres by definition, of the others most are
    /// in millimetres.
    pub fn millimetres(self) -> f32 {
        if self == Self::Gltf { 1000.0 } else { 1.0 }
    }
}

/// Reads a mesh, and says in which format: positions in the file's unit and the options' frame,
/// a colour for every vertex.
///
/// Vertices keep their order in PLY and OBJ; glTF and STL repeat vertices for each normal and
/// texture seam, which are joined. Vertices of no triangle get the mean colour if they have none.
///
/// # Errors
/// Unknown formats, and what the formats' readers find; no vertices, no triangles, numbers that
/// are not finite; vertices without colour if the options have none either.
pub fn read(path: &Path, options: &Options) -> Result<(Mesh, Format)> {
    let bytes = std::fs::read(path).map_err(|e| Error::file(path, e))?;
    let named = |e| Error::file(path, e);
    let format = Format::of(path, &bytes).ok_or_else(|| {
        named(Error::new("not a mesh this program reads; export the scan as PLY, OBJ, GLB or glTF"))
    })?;
    parse(path, &bytes, format, options).map(|mesh| (mesh, format)).map_err(named)
}

/// [`read`] of bytes; `path` tells where the files lie that they name.
///
/// # Errors
/// As [`read`], without the file's name.
pub fn parse(path: &Path, bytes: &[u8], format: Format, options: &Options) -> Result<Mesh> {
    let rough = match format {
        Format::Ply => from_ply(path, bytes, options)?,
        Format::Obj => obj::read(path, bytes, options)?,
        Format::Gltf => gltf::read(path, bytes, options)?,
        Format::Stl if options.color.is_none() => {
            return Err(Error::new(
                "an STL file has no colours, and a model needs them; export as PLY, OBJ or GLB, \
                 or give the whole scan one by --colour R,G,B",
            ));
        }
        Format::Stl => stl::parse(bytes)?,
    };
    rough.finish(options)
}

/// A PLY with its texture, if it names or is given one.
fn from_ply(path: &Path, bytes: &[u8], options: &Options) -> Result<Rough> {
    let ply::Parts { points, colors, triangles, uvs, texture } = ply::parse_parts(bytes)?;
    if options.texture.is_some() && uvs.is_none() {
        return Err(Error::new("has no texture coordinates; --texture cannot be laid on it"));
    }
    let directory = path.parent().unwrap_or(Path::new(""));
    let texture = options.texture.clone().or_else(|| texture.map(|name| directory.join(name)));
    let mut paint = Paint::new(points.len());
    if let (Some(texture), Some(uvs)) = (texture, uvs) {
        let picture = paint::texture(&texture)?;
        for (triangle, uvs) in triangles.iter().zip(uvs) {
            for (&vertex, uv) in triangle.iter().zip(uvs) {
                let uv = options.v_down(uv, false);
                paint.add(vertex, paint::sample(&picture, uv, [Wrap::Repeat; 2]));
            }
        }
    }
    let mut merged: Vec<_> = paint.colors().collect();
    if let Some(colors) = colors {
        for (color, own) in merged.iter_mut().zip(colors) {
            *color = color.or(Some(own));
        }
    }
    Ok(Rough { points, triangles, colors: merged })
}

/// A mesh as a format's reader leaves it. Guarantees: as many colours as points, every index of a
/// triangle below their number, which fits into u32.
struct Rough {
    points: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    colors: Vec<Option<[f32; 3]>>,
}

impl Rough {
    fn finish(self, options: &Options) -> Result<Mesh> {
        let Self { mut points, triangles, mut colors } = self;
        if points.is_empty() {
            return Err(Error::new("the mesh is empty: no vertices; export the scan again"));
        }
        if triangles.is_empty() {
            return Err(Error::new("has no faces; mesh the point cloud first"));
        }
        if let Some(color) = options.color {
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
        for (i, (point, color)) in points.iter().zip(&colors).enumerate() {
            if !point.iter().all(|c| c.is_finite()) {
                return Err(Error::new(format_args!(
                    "vertex {i}: position {point:?} is not finite; remove the vertex"
                )));
            }
            if let Some(color) = color
                && !color.iter().all(|c| (0.0..=1.0).contains(c))
            {
                return Err(Error::new(format_args!(
                    "vertex {i}: colour {color:?} lies outside [0, 1]; export the scan again"
                )));
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
        Ok(Mesh { points, colors, triangles })
    }
}

#[cfg(test)]
mod tests;
