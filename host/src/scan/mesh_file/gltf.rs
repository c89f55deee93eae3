//! glTF 2.0, as `.glb` or as `.gltf` with its files.
//!
//! The document is the crate `gltf`'s. Buffers are read here: that crate takes an accessor's word
//! for what lies in the file, and panics where it does not.

mod buffers;
mod document;
mod pose;

use super::named::Place;
use super::paint::{self, Lost, Paint, Wrap};
use super::{Format, Options, Rough};
use crate::error::{Error, Result};
use crate::mesh::{far, glb, weld};
use crate::photo;
use crate::photo::picture::Picture;
use crate::scan::subdivide::{Finer, Subdivision, mean, mean_point};
use ::gltf::mesh::Mode;
use ::gltf::texture::{Info, WrappingMode};
use ::gltf::{Accessor, Document, Material, Primitive, Semantic};
use buffers::{Buffers, fetch};
use pose::{Placed, Pose};
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::path::Path;

/// Most vertices that are read: a small file may place the same mesh any number of times. Chosen, not measured.
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
    let mut primitives = Vec::new();
    let (mut vertices, mut all) = (0, 0);
    for placed in pose::placed(&document)? {
        for primitive in placed.mesh.primitives() {
            let at = format!("mesh {}, primitive {}", placed.mesh.index(), primitive.index());
            let primitive = PlacedPrimitive::read(&buffers, &primitive, &placed, options)
                .map_err(|e| Error::new(format_args!("{at}: {e}")))?;
            let Some(primitive) = primitive else { continue };
            vertices += primitive.points.len();
            all += primitive.triangles.len();
            if vertices > MAX_VERTICES || all > MAX_VERTICES {
                return Err(Error::new(format_args!(
                    "{at}: more than {MAX_VERTICES} vertices in all; decimate, or export one copy"
                )));
            }
            primitives.push(primitive);
        }
    }
    if primitives.is_empty() {
        return Err(Error::new("has no faces; mesh the point cloud first"));
    }
    if options.texture.is_some() && primitives.iter().all(|primitive| primitive.uvs.is_none()) {
        return Err(Error::new("has no texture coordinates; --texture cannot be laid on it"));
    }
    let points = primitives.iter().flat_map(|primitive| primitive.points.iter().copied());
    if let Some(how) = options.subdivision(Format::Gltf, points) {
        for primitive in &mut primitives {
            primitive.refine(how)?;
        }
    }
    let (colors, lost) = bake(&document, &buffers, &place, &primitives, options)?;
    let Joined { points, colors, triangles } = joined(&primitives, &colors);
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
    let triangles: Vec<_> = triangles.filter(|[a, b, c]| a != b && b != c && c != a).collect();
    let colors = paint.colors().collect();
    let notes = lost.note(triangles.len()).into_iter().collect();
    Ok(Rough { points, triangles, colors, origin, notes })
}

/// All primitives in one.
struct Joined {
    points: Vec<[f64; 3]>,
    colors: Colors,
    triangles: Vec<[u32; 3]>,
}

/// Colours of vertices, where they have one.
type Colors = Vec<Option<[f32; 3]>>;

/// Puts the primitives together: first the vertices that the file has, then those that were made, so that
/// the first keep their numbers.
fn joined(primitives: &[PlacedPrimitive], colors: &[Colors]) -> Joined {
    let mut all = Joined { points: Vec::new(), colors: Vec::new(), triangles: Vec::new() };
    let mut firsts = vec![[0, 0]; primitives.len()];
    for made in [0, 1] {
        for ((primitive, colors), firsts) in primitives.iter().zip(colors).zip(&mut firsts) {
            firsts[made] = all.points.len();
            let range = [0..primitive.own, primitive.own..primitive.points.len()][made].clone();
            all.points.extend(&primitive.points[range.clone()]);
            all.colors.extend(&colors[range]);
        }
    }
    for (primitive, [first, made]) in primitives.iter().zip(firsts) {
        let number = |v: u32| match (v as usize).checked_sub(primitive.own) {
            None => first as u32 + v,
            Some(v) => (made + v) as u32,
        };
        all.triangles.extend(primitive.triangles.iter().map(|t| t.map(number)));
    }
    all
}

/// A primitive, in the scene's coordinates.
struct PlacedPrimitive {
    points: Vec<[f64; 3]>,
    /// How many of them the file has; the others were made.
    own: usize,
    triangles: Vec<[u32; 3]>,
    /// `COLOR_0` × factor, linear.
    linear: Vec<[f32; 3]>,
    /// Whether `linear` is no more than the factor.
    factor_only: bool,
    uvs: Option<Vec<[f32; 2]>>,
    /// Index of the image, and how it is continued.
    image: Option<(usize, [Wrap; 2])>,
}

impl PlacedPrimitive {
    /// Reads a primitive; none if it is of points or lines.
    fn read(
        buffers: &Buffers,
        primitive: &Primitive<'_>,
        placed: &Placed<'_>,
        options: &Options,
    ) -> Result<Option<Self>> {
        if matches!(primitive.mode(), Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip)
        {
            return Ok(None);
        }
        let Some(positions) = pose::morphed(buffers, primitive, placed)? else { return Ok(None) };
        let count = positions.len();
        let corners = match primitive.indices() {
            Some(accessor) => buffers.indices(&accessor)?,
            None => (0..count as u32).collect(),
        };
        if let Some(corner) = corners.iter().find(|&&corner| corner as usize >= count) {
            return Err(Error::new(format_args!(
                "index {corner} is out of range, there are {count} vertices; the file is damaged, \
                 export it again"
            )));
        }
        let pose = Pose::of(buffers, primitive, placed, count)?;
        let mirrored = pose.mirrors();
        let points = positions.into_iter().enumerate().map(|(i, p)| pose.place(i, p)).collect();
        let turned = |[a, b, c]: [u32; 3]| if mirrored { [a, c, b] } else { [a, b, c] };
        let triangles = cut(&corners, primitive.mode()).into_iter().map(turned).collect();
        painted(buffers, primitive, points, triangles, options).map(Some)
    }

    /// Splits its triangles.
    fn refine(&mut self, how: Subdivision) -> Result<()> {
        let finer = Finer::of(&self.points, &self.triangles, how)?;
        finer.extend(&mut self.points, mean_point);
        finer.extend(&mut self.linear, mean);
        if let Some(uvs) = &mut self.uvs {
            finer.extend(uvs, mean);
        }
        self.triangles = finer.triangles();
        Ok(())
    }
}

/// A primitive with what colours its vertices.
fn painted(
    buffers: &Buffers,
    primitive: &Primitive<'_>,
    points: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    options: &Options,
) -> Result<PlacedPrimitive> {
    let count = points.len();
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
    Ok(PlacedPrimitive { own: count, points, triangles, linear, factor_only, uvs, image })
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

/// The colours of all primitives' vertices, as stored, and what textures show between them.
fn bake(
    document: &Document,
    buffers: &Buffers,
    place: &Place<'_>,
    primitives: &[PlacedPrimitive],
    options: &Options,
) -> Result<(Vec<Colors>, Lost)> {
    let mut all: Vec<_> =
        primitives.iter().map(|primitive| vec![None; primitive.points.len()]).collect();
    let mut lost = Lost::default();
    let mut lay =
        |primitive: &PlacedPrimitive, colors: &mut Colors, picture: &Picture, wrap, own: bool| {
            let Some(uvs) = &primitive.uvs else { return };
            for triangle in &primitive.triangles {
                let seen = lost.read(picture, triangle.map(|v| uvs[v as usize]), wrap);
                for (v, seen) in triangle.map(|v| v as usize).into_iter().zip(seen) {
                    colors[v] = Some(if own { seen } else { lit(seen, primitive.linear[v]) });
                }
            }
        };
    if let Some(file) = &options.texture {
        let picture = paint::texture(file)?;
        for (primitive, colors) in primitives.iter().zip(&mut all) {
            lay(primitive, colors, &picture, [Wrap::Repeat; 2], true);
        }
    } else {
        // One image at a time: decoded, they are large.
        let textured = |primitive: &&PlacedPrimitive| primitive.uvs.is_some();
        let wanted =
            primitives.iter().filter(textured).filter_map(|primitive| Some(primitive.image?.0));
        for index in wanted.collect::<BTreeSet<_>>() {
            let picture = image(document, buffers, place, index)
                .map_err(|e| Error::new(format_args!("image {index}: {e}")))?;
            for (primitive, colors) in primitives.iter().zip(&mut all) {
                if let Some((image, wrap)) = primitive.image
                    && image == index
                {
                    lay(primitive, colors, &picture, wrap, false);
                }
            }
        }
    }
    let first = |primitive: &PlacedPrimitive| primitive.linear.first().copied();
    // One flat colour all over is what programs write for none.
    let plain = primitives
        .iter()
        .all(|primitive| primitive.factor_only && first(primitive) == first(&primitives[0]));
    for (primitive, colors) in primitives.iter().zip(&mut all) {
        let white = first(primitive) == Some([1.0; 3]);
        if primitive.factor_only && (white || plain && options.color.is_some()) {
            continue;
        }
        for (color, linear) in colors.iter_mut().zip(&primitive.linear) {
            *color = color.or(Some(linear.map(glb::stored)));
        }
    }
    Ok((all, lost))
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
