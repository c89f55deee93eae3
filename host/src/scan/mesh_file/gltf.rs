//! glTF 2.0, as `.glb` or as `.gltf` with its files.
//!
//! The document is the crate `gltf`'s. Buffers are read here: that crate takes an accessor's word
//! for what lies in the file, and panics where it does not.

use super::paint::{self, Paint, Wrap};
use super::{Options, Rough};
use crate::error::{Error, Result};
use crate::mesh::glb;
use crate::mesh::weld;
use crate::photo;
use crate::photo::picture::Picture;
use ::gltf::accessor::{DataType, Dimensions};
use ::gltf::json::Root;
use ::gltf::mesh::Mode;
use ::gltf::texture::{Info, WrappingMode};
use ::gltf::{Accessor, Document, Gltf, Material, Mesh, Primitive, Semantic};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use percent_encoding::percent_decode_str;
use std::borrow::Cow;
use std::collections::{BTreeSet, HashMap, HashSet};
use std::path::Path;

/// Extensions a file may require: those that do not change positions or albedo, and those that
/// are read.
const EXTENSIONS: [&str; 13] = [
    "KHR_lights_punctual",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// Most vertices that are read: a small file may place the same mesh any number of times.
const MAX_VERTICES: usize = 50_000_000;

type Matrix = [[f64; 4]; 4];

/// Reads a glTF file from its bytes: all triangles of the default scene, in the scene's
/// coordinates. Exactly equal positions become one vertex, in order of first appearance, whose
/// colour is the mean over its corners.
///
/// A corner's colour is base colour texture × `COLOR_0` × base colour factor, brought from linear
/// light to sRGB; a factor alone counts only if the options give no colour. Skins, morph targets
/// and animations are left alone: the mesh is as it was modelled.
///
/// # Errors
/// Malformed documents and containers, extensions that are required and not read, buffers and
/// textures that are missing or too short, accessors and indices out of range.
pub(super) fn read(path: &Path, bytes: &[u8], options: &Options) -> Result<Rough> {
    let (document, blob) = open(bytes)?;
    let directory = path.parent().unwrap_or(Path::new(""));
    let buffers = Buffers::load(&document, blob, directory)?;
    let mut points = Vec::new();
    let mut triangles = Vec::new();
    let mut parts = Vec::new();
    for (mesh, matrix) in placed(&document)? {
        for primitive in mesh.primitives() {
            let place = format!("mesh {}, primitive {}", mesh.index(), primitive.index());
            buffers
                .primitive(&primitive, &matrix, options, &mut points, &mut triangles)
                .map(|part| parts.extend(part))
                .map_err(|e| Error::new(format_args!("{place}: {e}")))?;
        }
    }
    if parts.is_empty() {
        return Err(Error::new("has no faces; mesh the point cloud first"));
    }
    if options.texture.is_some() && parts.iter().all(|part| part.uvs.is_none()) {
        return Err(Error::new("has no texture coordinates; --texture cannot be laid on it"));
    }
    let colors = bake(&document, &buffers, directory, &parts, points.len(), options)?;
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
    Ok(Rough { points, triangles, colors })
}

/// Parses container and document, and checks what the crate's own checks take for granted.
fn open(bytes: &[u8]) -> Result<(Document, Option<Vec<u8>>)> {
    let malformed = |e: ::gltf::Error| {
        let message: String = e.to_string().trim_end_matches(';').chars().take(240).collect();
        Error::new(format_args!("{message}; not a good glTF 2.0 file, export it again"))
    };
    if bytes.starts_with(b"glTF") {
        let length = bytes.get(8..12).and_then(<[u8]>::first_chunk);
        let length = length.map_or(0, |length| u32::from_le_bytes(*length) as usize);
        if length < 12 || length > bytes.len() {
            return Err(Error::new(format_args!(
                "header: {length} bytes promised, {} there; the file is cut short or damaged, \
                 export it again",
                bytes.len()
            )));
        }
    } else if !bytes.trim_ascii_start().starts_with(b"{") {
        return Err(Error::new("not a glTF file; export the scan again"));
    }
    let Gltf { document, blob } = Gltf::from_slice_without_validation(bytes).map_err(malformed)?;
    let mut root = document.into_json();
    for name in std::mem::take(&mut root.extensions_required) {
        if !EXTENSIONS.contains(&name.as_str()) {
            return Err(unsupported(&name));
        }
    }
    let accessors = root.accessors.len();
    let attributes = |root: &Root| {
        let primitives = root.meshes.iter().flat_map(|mesh| &mesh.primitives);
        primitives
            .flat_map(|p| p.attributes.values())
            .map(::gltf::json::Index::value)
            .max()
            .unwrap_or(0)
    };
    if !root.meshes.is_empty() && attributes(&root) >= accessors {
        return Err(Error::new(format_args!(
            "accessor {} is out of range, there are {accessors}; the file is damaged, export it \
             again",
            attributes(&root)
        )));
    }
    Ok((Document::from_json(root).map_err(malformed)?, blob))
}

fn unsupported(extension: &str) -> Error {
    let mend = match extension {
        "KHR_draco_mesh_compression" => "export without Draco compression",
        "EXT_meshopt_compression" | "KHR_meshopt_compression" => {
            "export without meshopt compression (gltfpack: without -c)"
        }
        "KHR_texture_basisu" | "EXT_texture_webp" | "MSFT_texture_dds" => {
            "export with PNG or JPEG textures"
        }
        _ => "export without it",
    };
    Error::new(format_args!("requires {extension}, which is not read; {mend}"))
}

const IDENTITY: Matrix = [[1., 0., 0., 0.], [0., 1., 0., 0.], [0., 0., 1., 0.], [0., 0., 0., 1.]];

/// The meshes of the default scene (or the first; or, without scenes, of the file), each with
/// its nodes' transforms, columns first.
fn placed(document: &Document) -> Result<Vec<(Mesh<'_>, Matrix)>> {
    let Some(scene) = document.default_scene().or_else(|| document.scenes().next()) else {
        return Ok(document.meshes().map(|mesh| (mesh, IDENTITY)).collect());
    };
    let mut found = Vec::new();
    let mut seen = HashSet::new();
    let mut open: Vec<_> = scene.nodes().map(|node| (node, IDENTITY)).collect();
    // Taken from the end: so the file's order is kept.
    open.reverse();
    while let Some((node, parent)) = open.pop() {
        // A node that occurs again makes a circle, or an avalanche.
        if !seen.insert(node.index()) {
            return Err(Error::new(format_args!(
                "node {} has two parents; the file is damaged, export it again",
                node.index()
            )));
        }
        let local = node.transform().matrix().map(|column| column.map(f64::from));
        let matrix = local.map(|column| transform(&parent, column));
        if let Some(mesh) = node.mesh() {
            found.push((mesh, matrix));
        }
        let next = open.len();
        open.extend(node.children().map(|child| (child, matrix)));
        open[next..].reverse();
    }
    if found.is_empty() {
        return Err(Error::new("the scene holds no mesh; export the scan with its mesh"));
    }
    Ok(found)
}

fn transform(matrix: &Matrix, v: [f64; 4]) -> [f64; 4] {
    std::array::from_fn(|i| (0..4).map(|k| matrix[k][i] * v[k]).sum())
}

/// Whether a transform turns inside out.
fn mirrors([a, b, c, _]: &Matrix) -> bool {
    let cofactor = |i: usize, j: usize| b[i] * c[j] - b[j] * c[i];
    a[0] * cofactor(1, 2) + a[1] * cofactor(2, 0) + a[2] * cofactor(0, 1) < 0.0
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

/// The bytes of all buffers.
struct Buffers {
    /// By index: where its bytes are.
    keys: Vec<Option<String>>,
    blob: Vec<u8>,
    files: HashMap<String, Vec<u8>>,
}

impl Buffers {
    fn load(document: &Document, blob: Option<Vec<u8>>, directory: &Path) -> Result<Self> {
        let mut buffers =
            Self { keys: Vec::new(), blob: blob.unwrap_or_default(), files: HashMap::new() };
        for buffer in &document.as_json().buffers {
            if let Some(uri) = &buffer.uri
                && !buffers.files.contains_key(uri)
            {
                buffers.files.insert(uri.clone(), fetch(directory, uri)?.into_owned());
            }
            buffers.keys.push(buffer.uri.clone());
            let index = buffers.keys.len() - 1;
            let there = buffers.bytes(index).len();
            if (there as u64) < buffer.byte_length.0 {
                return Err(Error::new(format_args!(
                    "buffer {index} has {there} bytes, {} are promised; a file is cut short, \
                     export again",
                    buffer.byte_length.0
                )));
            }
        }
        Ok(buffers)
    }

    fn bytes(&self, buffer: usize) -> &[u8] {
        match self.keys.get(buffer) {
            Some(Some(uri)) => self.files.get(uri).map_or(&[], Vec::as_slice),
            Some(None) => &self.blob,
            None => &[],
        }
    }

    /// The bytes of a view.
    fn view(&self, view: &::gltf::buffer::View<'_>) -> Result<&[u8]> {
        let end = view.offset().checked_add(view.length());
        end.and_then(|end| self.bytes(view.buffer().index()).get(view.offset()..end)).ok_or_else(
            || {
                Error::new(format_args!(
                    "buffer view {} reaches beyond its buffer; the file is damaged, export it again",
                    view.index()
                ))
            },
        )
    }

    /// The bytes of each element of an accessor.
    fn elements(&self, accessor: &Accessor<'_>) -> Result<impl ExactSizeIterator<Item = &[u8]>> {
        let fault = |what: &str| Error::new(format_args!("accessor {} {what}", accessor.index()));
        if accessor.sparse().is_some() {
            return Err(fault("is sparse, which is not read; export without morph targets"));
        }
        let view = accessor.view().ok_or_else(|| fault("has no buffer view; export again"))?;
        let (size, count) = (accessor.size(), accessor.count());
        let stride = view.stride().unwrap_or(size).max(size).max(1);
        let bytes = self.view(&view)?.get(accessor.offset()..).unwrap_or_default();
        // The last element may end before its stride does.
        let there = (bytes.len() + stride).saturating_sub(size) / stride;
        if there < count {
            return Err(fault(&format!(
                "promises {count} elements, its buffer view holds {there}; the file is damaged, \
                 export it again"
            )));
        }
        Ok(bytes.chunks(stride).take(count).map(move |chunk| &chunk[..size]))
    }

    /// The numbers of an accessor, the first `N` of each element, integers scaled if the file
    /// says so.
    fn numbers<const N: usize>(&self, accessor: &Accessor<'_>) -> Result<Vec<[f32; N]>> {
        let there = match accessor.dimensions() {
            Dimensions::Scalar => 1,
            Dimensions::Vec2 => 2,
            Dimensions::Vec3 => 3,
            Dimensions::Vec4 => 4,
            _ => 0,
        };
        if there < N {
            return Err(Error::new(format_args!(
                "accessor {} has {there} numbers to an element, expected {N}; export again",
                accessor.index()
            )));
        }
        let (kind, scaled) = (accessor.data_type(), accessor.normalized());
        let scale = |value: f32, full: f32| if scaled { (value / full).max(-1.0) } else { value };
        let number = |b: &[u8]| match (kind, b) {
            (DataType::I8, &[a]) => scale(a.cast_signed().into(), 127.0),
            (DataType::U8, &[a]) => scale(a.into(), 255.0),
            (DataType::I16, &[a, b]) => scale(i16::from_le_bytes([a, b]).into(), 32767.0),
            (DataType::U16, &[a, b]) => scale(u16::from_le_bytes([a, b]).into(), 65535.0),
            (DataType::U32, &[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]) as f32,
            (DataType::F32, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
            _ => f32::NAN,
        };
        let size = kind.size();
        let element = |bytes: &[u8]| {
            std::array::from_fn(|i| bytes.get(i * size..(i + 1) * size).map_or(f32::NAN, number))
        };
        Ok(self.elements(accessor)?.map(element).collect())
    }

    /// Unsigned integers.
    fn indices(&self, accessor: &Accessor<'_>) -> Result<Vec<u32>> {
        let index = |bytes: &[u8]| match *bytes {
            [a] => a.into(),
            [a, b] => u16::from_le_bytes([a, b]).into(),
            [a, b, c, d] => u32::from_le_bytes([a, b, c, d]),
            _ => u32::MAX,
        };
        match (accessor.data_type(), accessor.dimensions()) {
            (DataType::U8 | DataType::U16 | DataType::U32, Dimensions::Scalar) => {
                Ok(self.elements(accessor)?.map(index).collect())
            }
            _ => Err(Error::new(format_args!(
                "accessor {} does not hold indices; the file is damaged, export it again",
                accessor.index()
            ))),
        }
    }

    /// Appends the vertices and triangles of a primitive; nothing if it is of points or lines.
    fn primitive(
        &self,
        primitive: &Primitive<'_>,
        matrix: &Matrix,
        options: &Options,
        points: &mut Vec<[f32; 3]>,
        triangles: &mut Vec<[u32; 3]>,
    ) -> Result<Option<Part>> {
        if matches!(primitive.mode(), Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip)
        {
            return Ok(None);
        }
        let Some(positions) = primitive.get(&Semantic::Positions) else { return Ok(None) };
        let first = points.len();
        let positions = self.numbers::<3>(&positions)?;
        let count = positions.len();
        let corners = match primitive.indices() {
            Some(accessor) => self.indices(&accessor)?,
            None => (0..count as u32).collect(),
        };
        if first + count > MAX_VERTICES || triangles.len() + corners.len() > 3 * MAX_VERTICES {
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
        points.extend(positions.into_iter().map(|p| {
            let [x, y, z] = p.map(f64::from);
            let [x, y, z, _] = transform(matrix, [x, y, z, 1.0]);
            [x as f32, y as f32, z as f32]
        }));
        let mirrored = mirrors(matrix);
        triangles.extend(cut(&corners, primitive.mode()).into_iter().map(|[a, b, c]| {
            let corners = if mirrored { [a, c, b] } else { [a, b, c] };
            corners.map(|corner| corner + first as u32)
        }));
        let material = primitive.material();
        let (factor, info) = base_color(&material);
        let own = match primitive.get(&Semantic::Colors(0)) {
            Some(accessor) => Some(self.numbers::<3>(&accessor)?),
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
            Some(accessor) => Some(self.uvs(&accessor, info.as_ref(), count, options)?),
            None => None,
        };
        let image = info.map(|info| {
            let (texture, sampler) = (info.texture(), info.texture().sampler());
            (texture.source().index(), [sampler.wrap_s(), sampler.wrap_t()].map(wrap))
        });
        Ok(Some(Part { first, count, linear, factor_only, uvs, image }))
    }

    /// Texture coordinates, v down, as the texture's transform moves them.
    fn uvs(
        &self,
        accessor: &Accessor<'_>,
        info: Option<&Info<'_>>,
        count: usize,
        options: &Options,
    ) -> Result<Vec<[f32; 2]>> {
        let mut uvs = self.numbers::<2>(accessor)?;
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
}

/// Factor, linear, and texture of a material's albedo.
fn base_color<'a>(material: &Material<'a>) -> ([f32; 3], Option<Info<'a>>) {
    let ([r, g, b, _], texture) = if let Some(old) = material.pbr_specular_glossiness() {
        (old.diffuse_factor(), old.diffuse_texture())
    } else {
        let pbr = material.pbr_metallic_roughness();
        (pbr.base_color_factor(), pbr.base_color_texture())
    };
    ([r, g, b], texture)
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
    directory: &Path,
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
            let picture = image(document, buffers, directory, index)
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
    for part in parts {
        let white = part.linear.first() == Some(&[1.0; 3]);
        if part.factor_only && (white || options.color.is_some()) {
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
    directory: &Path,
    index: usize,
) -> Result<Picture> {
    let image = document.as_json().images.get(index);
    let view = image.and_then(|image| image.buffer_view);
    let uri = image.and_then(|image| image.uri.as_deref());
    let bytes = match (view.and_then(|view| document.views().nth(view.value())), uri) {
        (Some(view), _) => Cow::Borrowed(buffers.view(&view)?),
        (None, Some(uri)) => fetch(directory, uri)?,
        (None, None) => return Err(Error::new("no data; give the texture by --texture")),
    };
    photo::decode_stored(&bytes)
}

/// The bytes an address in the document means: data in the address itself, or a file beside.
fn fetch<'a>(directory: &Path, uri: &'a str) -> Result<Cow<'a, [u8]>> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (kind, data) = data.split_once(',').unwrap_or((data, ""));
        if !kind.ends_with(";base64") {
            return Ok(percent_decode_str(data).into());
        }
        return STANDARD.decode(data).map(Cow::Owned).map_err(|e| {
            Error::new(format_args!("embedded data: {e}; the file is damaged, export it again"))
        });
    }
    if uri.contains("://") {
        let uri: String = uri.chars().take(120).collect();
        return Err(Error::new(format_args!("`{uri}` is not on this computer; download it")));
    }
    let name = percent_decode_str(uri).decode_utf8_lossy();
    let path = directory.join(&*name);
    let bytes = std::fs::read(&path).map_err(|e| {
        Error::file(&path, format_args!("{e}; put it there, or export one .glb file"))
    })?;
    Ok(Cow::Owned(bytes))
}
