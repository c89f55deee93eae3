//! glTF 2.0, as `.glb` or as `.gltf` with its files.
//!
//! The document is the crate `gltf`'s. Buffers are read here: that crate takes an accessor's word
//! for what lies in the file, and panics where it does not.

mod buffers;
mod document;
mod pose;

use super::named::Place;
use super::paint::{self, Paint, Wrap};
use super::{Options, Rough};
use crate::error::{Error, Result};
use crate::mesh::{far, glb, weld};
use crate::photo;
use crate::photo::picture::Picture;
use ::gltf::mesh::Mode;
use ::gltf::texture::{Info, WrappingMode};
use ::gltf::{Accessor, Document, Material, Primitive, Semantic};
use buffers::{Buffers, fetch};
use pose::{Placed, Pose};
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::path::Path;

/// Most vertices that are read: a small file may place the same mesh any number of times.
const MAX_VERTICES: usize = 50_000_000;

/// Reads a glTF file from its bytes: all triangles of the default scene, in the scene's
/// coordinates. Exactly equal positions become one vertex, in order of first appearance, whose
/// colour is the mean over its corners.
///
/// A corner's colour is base colour texture × `COLOR_0` × base colour factor, brought from linear
/// light to sRGB; of a black material that emits a texture, this is taken. Skins lie as their joints
/// do, morph targets have their default weights; animations are left alone.
///
/// # Errors
/// Malformed documents and containers, extensions that are required and not read, buffers and
/// textures that are missing or too short, accessors and indices out of range.
pub(super) fn read(path: &Path, bytes: &[u8], options: &Options) -> Result<Rough> {
    let (document, blob) = document::open(bytes)?;
    let place = Place::new(path, options);
    let buffers = Buffers::load(&document, blob, &place)?;
    let mut whole = Whole::default();
    for placed in pose::placed(&document)? {
        for primitive in placed.mesh.primitives() {
            let at = format!("mesh {}, primitive {}", placed.mesh.index(), primitive.index());
            whole
                .add(&buffers, &primitive, &placed, options)
                .map_err(|e| Error::new(format_args!("{at}: {e}")))?;
        }
    }
    let Whole { points, triangles, parts } = whole;
    if parts.is_empty() {
        return Err(Error::new("has no faces; mesh the point cloud first"));
    }
    if options.texture.is_some() && parts.iter().all(|part| part.uvs.is_none()) {
        return Err(Error::new("has no texture coordinates; --texture cannot be laid on it"));
    }
    let colors = bake(&document, &buffers, &place, &parts, points.len(), options)?;
    let (points, origin) = far::settled(&points);
    let (map, points) = weld(&points);
    let mut paint = Paint::new(points.len());
    for &corner in triangles.as_flattened() {
        let colors = colors.get(corner as usize).copied().flatten();
        if let (Some(color), Some(&vertex)) = (colors, map.get(corner as usize)) {
            paint.add(vertex, color);
        }
    }
    let triangles = triangles.into_iter().map(|t| t.map(|v| map[v as usize]));
    let triangles = triangles.filter(|[a, b, c]| a != b && b != c && c != a).collect();
    let colors = paint.colors().collect();
    Ok(Rough { points, triangles, colors, origin, notes: Vec::new() })
}

/// What colours the vertices of a primitive.
struct Part {
    /// Their numbers among all vertices.
    first: usize,
    count: usize,
    /// `COLOR_0` × factor, linear.
    linear: Vec<[f32; 3]>,
    /// Whether `linear` is no more than the factor.
    factor_only: bool,
    uvs: Option<Vec<[f32; 2]>>,
    /// Index of the image, and how it is continued.
    image: Option<(usize, [Wrap; 2])>,
}

/// All primitives so far, in the scene's coordinates.
#[derive(Default)]
struct Whole {
    points: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    parts: Vec<Part>,
}

impl Whole {
    /// Appends the vertices and triangles of a primitive; nothing if it is of points or lines.
    fn add(
        &mut self,
        buffers: &Buffers,
        primitive: &Primitive<'_>,
        placed: &Placed<'_>,
        options: &Options,
    ) -> Result<()> {
        if matches!(primitive.mode(), Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip)
        {
            return Ok(());
        }
        let Some(positions) = pose::morphed(buffers, primitive, placed)? else { return Ok(()) };
        let first = self.points.len();
        let count = positions.len();
        let corners = match primitive.indices() {
            Some(accessor) => buffers.indices(&accessor)?,
            None => (0..count as u32).collect(),
        };
        if first + count > MAX_VERTICES || self.triangles.len() + corners.len() > 3 * MAX_VERTICES {
            return Err(Error::new(format_args!(
                "more than {MAX_VERTICES} vertices in all; decimate, or export one copy"
            )));
        }
        if let Some(corner) = corners.iter().find(|&&corner| corner as usize >= count) {
            return Err(Error::new(format_args!(
                "index {corner} is out of range, there are {count} vertices; the file is damaged, \
                 export it again"
            )));
        }
        let pose = Pose::of(buffers, primitive, placed, count)?;
        let mirrored = pose.mirrors();
        self.points.extend(positions.into_iter().enumerate().map(|(i, p)| pose.place(i, p)));
        self.triangles.extend(cut(&corners, primitive.mode()).into_iter().map(|[a, b, c]| {
            let corners = if mirrored { [a, c, b] } else { [a, b, c] };
            corners.map(|corner| corner + first as u32)
        }));
        self.parts.push(part(buffers, primitive, first..first + count, options)?);
        Ok(())
    }
}

/// What colours the vertices of a primitive, which have these numbers.
fn part(
    buffers: &Buffers,
    primitive: &Primitive<'_>,
    vertices: std::ops::Range<usize>,
    options: &Options,
) -> Result<Part> {
    let count = vertices.len();
    let material = primitive.material();
    let (factor, info) = base_color(&material);
    let own = match primitive.get(&Semantic::Colors(0)) {
        Some(accessor) => Some(buffers.colors(&accessor)?),
        None => None,
    };
    let factor_only = own.is_none();
    let mut linear = own.unwrap_or_else(|| vec![[1.0; 3]; count]);
    linear.resize(count, [1.0; 3]);
    for color in &mut linear {
        *color = std::array::from_fn(|i| color[i] * factor[i]);
    }
    // A texture of the user's own is laid by the first coordinates there are.
    let set = info.as_ref().filter(|_| options.texture.is_none()).map_or(0, coordinates);
    let uvs = match primitive.get(&Semantic::TexCoords(set)) {
        Some(accessor) => {
            Some(texture_coordinates(buffers, &accessor, info.as_ref(), count, options)?)
        }
        None => None,
    };
    let image = match info.filter(|_| options.texture.is_none()) {
        Some(info) => {
            let (texture, sampler) = (info.texture(), info.texture().sampler());
            let source = texture.source().ok_or_else(|| {
                Error::new(format_args!(
                    "texture {} has no picture in PNG or JPEG; export with these, or give one by \
                     --texture",
                    texture.index()
                ))
            })?;
            Some((source.index(), [sampler.wrap_s(), sampler.wrap_t()].map(wrap)))
        }
        None => None,
    };
    Ok(Part { first: vertices.start, count, linear, factor_only, uvs, image })
}

/// Texture coordinates, v down, as the texture's transform moves them.
fn texture_coordinates(
    buffers: &Buffers,
    accessor: &Accessor<'_>,
    info: Option<&Info<'_>>,
    count: usize,
    options: &Options,
) -> Result<Vec<[f32; 2]>> {
    let mut uvs = buffers.numbers::<2>(accessor)?;
    uvs.resize(count, [0.0; 2]);
    let moved = info.filter(|_| options.texture.is_none()).and_then(Info::texture_transform);
    for uv in &mut uvs {
        if let Some(moved) = &moved {
            // Scaled, turned, moved: in this order (KHR_texture_transform).
            let ([x, y], [u, v]) = (moved.offset(), *uv);
            let (sin, cos) = moved.rotation().sin_cos();
            let [u, v] = [moved.scale()[0] * u, moved.scale()[1] * v];
            *uv = [x + cos * u + sin * v, y - sin * u + cos * v];
        }
        *uv = options.v_down(*uv, true);
    }
    Ok(uvs)
}

/// Factor, linear, and texture of a material's albedo: what it emits, if it is else black.
fn base_color<'a>(material: &Material<'a>) -> ([f32; 3], Option<Info<'a>>) {
    let ([r, g, b, _], texture) = if let Some(old) = material.pbr_specular_glossiness() {
        (old.diffuse_factor(), old.diffuse_texture())
    } else {
        let pbr = material.pbr_metallic_roughness();
        (pbr.base_color_factor(), pbr.base_color_texture())
    };
    match material.emissive_texture() {
        Some(emitted) if [r, g, b] == [0.0; 3] => (material.emissive_factor(), Some(emitted)),
        _ => ([r, g, b], texture),
    }
}

/// The set of coordinates a texture is laid by.
fn coordinates(info: &Info<'_>) -> u32 {
    info.texture_transform().and_then(|moved| moved.tex_coord()).unwrap_or(info.tex_coord())
}

fn wrap(mode: WrappingMode) -> Wrap {
    match mode {
        WrappingMode::ClampToEdge => Wrap::Clamp,
        WrappingMode::MirroredRepeat => Wrap::Mirror,
        WrappingMode::Repeat => Wrap::Repeat,
    }
}

/// The triangles of a list, strip or fan of corners, without those of a strip that only join it.
fn cut(corners: &[u32], mode: Mode) -> Vec<[u32; 3]> {
    let all: Vec<[u32; 3]> = match mode {
        Mode::TriangleStrip => corners
            .windows(3)
            .enumerate()
            .map(|(i, w)| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] })
            .collect(),
        Mode::TriangleFan => match corners {
            [hub, rest @ ..] => rest.windows(2).map(|w| [*hub, w[0], w[1]]).collect(),
            [] => Vec::new(),
        },
        _ => corners.as_chunks().0.to_vec(),
    };
    all.into_iter().filter(|[a, b, c]| a != b && b != c && c != a).collect()
}

/// The colours of all vertices, as stored.
fn bake(
    document: &Document,
    buffers: &Buffers,
    place: &Place<'_>,
    parts: &[Part],
    vertices: usize,
    options: &Options,
) -> Result<Vec<Option<[f32; 3]>>> {
    let mut colors = vec![None; vertices];
    if let Some(file) = &options.texture {
        let picture = paint::texture(file)?;
        for part in parts {
            let uvs = part.uvs.iter().flatten();
            for (color, uv) in colors[part.first..].iter_mut().zip(uvs) {
                *color = Some(paint::sample(&picture, *uv, [Wrap::Repeat; 2]));
            }
        }
    } else {
        // One image at a time: decoded, they are large.
        let textured = |part: &&Part| part.uvs.is_some();
        let wanted = parts.iter().filter(textured).filter_map(|part| Some(part.image?.0));
        for index in wanted.collect::<BTreeSet<_>>() {
            let picture = image(document, buffers, place, index)
                .map_err(|e| Error::new(format_args!("image {index}: {e}")))?;
            for part in parts {
                let (Some(uvs), Some((image, wrap))) = (&part.uvs, part.image) else { continue };
                if image != index {
                    continue;
                }
                for ((color, uv), linear) in
                    colors[part.first..].iter_mut().zip(uvs).zip(&part.linear)
                {
                    *color = Some(lit(paint::sample(&picture, *uv, wrap), *linear));
                }
            }
        }
    }
    let first = |part: &Part| part.linear.first().copied();
    // One flat colour all over is what programs write for none.
    let plain = parts.iter().all(|part| part.factor_only && first(part) == first(&parts[0]));
    for part in parts {
        let white = first(part) == Some([1.0; 3]);
        if part.factor_only && (white || plain && options.color.is_some()) {
            continue;
        }
        for (color, linear) in colors[part.first..][..part.count].iter_mut().zip(&part.linear) {
            *color = color.or(Some(linear.map(glb::stored)));
        }
    }
    Ok(colors)
}

/// A stored colour times a linear one.
fn lit(stored: [f32; 3], linear: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| {
        // Untouched where there is nothing to do.
        if linear[i] == 1.0 { stored[i] } else { glb::stored(glb::linear(stored[i]) * linear[i]) }
    })
}

/// Decodes an image of the document.
fn image(
    document: &Document,
    buffers: &Buffers,
    place: &Place<'_>,
    index: usize,
) -> Result<Picture> {
    let image = document.as_json().images.get(index);
    let view = image.and_then(|image| image.buffer_view);
    let uri = image.and_then(|image| image.uri.as_deref());
    let bytes = match (view.and_then(|view| document.views().nth(view.value())), uri) {
        (Some(view), _) => Cow::Borrowed(buffers.view(&view)?),
        (None, Some(uri)) => fetch(place, uri)?,
        (None, None) => return Err(Error::new("no data; give the texture by --texture")),
    };
    photo::decode_stored(&bytes)
}
