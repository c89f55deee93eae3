//! Binary glTF 2.0 (`.glb`) of a coloured or textured mesh, for viewers and web pages.

use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::mesh::skin::{Colors, Skin};
use onescan_core::math;
use serde_json::Value;

/// glTF's names for what the buffers hold.
mod gl {
    pub(super) const UNSIGNED_SHORT: u32 = 5123;
    pub(super) const UNSIGNED_INT: u32 = 5125;
    pub(super) const FLOAT: u32 = 5126;
    pub(super) const ARRAY_BUFFER: u32 = 34962;
    pub(super) const ELEMENT_ARRAY_BUFFER: u32 = 34963;
    pub(super) const LINEAR: u32 = 9729;
    pub(super) const LINEAR_MIPMAP_LINEAR: u32 = 9987;
    pub(super) const CLAMP_TO_EDGE: u32 = 33071;
}

/// The extension by which a viewer shows colours as they are.
const UNLIT: &str = "KHR_materials_unlit";

/// Metres (glTF's unit) in a millimetre (ours).
const METRE: f32 = 0.001;

/// The bytes of a `.glb` file of a mesh with its own colours, lit: see [`encode_with`].
///
/// # Errors
/// Those of [`encode_with`].
pub fn encode(mesh: &Mesh, name: &str) -> Result<Vec<u8>> {
    let colors = Colors::Vertices(mesh.colors.clone());
    encode_with(mesh, &Skin { colors, lit: true }, name)
}

/// The bytes of a `.glb` file with positions in metres, normals, and a skin's colours.
///
/// Colours per vertex are stored linear, as glTF wants them, in 16 bits: 8-bit sRGB survives exactly
/// and the file has the same bytes everywhere. A texture is in the file, as PNG. The material is fully
/// rough, not metallic and seen from both sides (a face is an open surface); `KHR_materials_unlit` if
/// the colours are not to be lit. An albedo is: unlit, a face looks like a flat mask.
///
/// # Errors
/// A mesh without vertices or triangles, or too large for the format (4 GiB).
pub fn encode_with(mesh: &Mesh, skin: &Skin, name: &str) -> Result<Vec<u8>> {
    if mesh.points.is_empty() || mesh.triangles.is_empty() {
        return Err(Error::new("a mesh without triangles cannot be written as glTF"));
    }
    let points: Vec<[f32; 3]> = mesh.points.iter().map(|p| p.map(|x| x * METRE)).collect();
    // Doubles, so that the decimals are those of exactly these floats.
    let bound = |pick: fn(f32, f32) -> f32| {
        [0, 1, 2].map(|i| f64::from(points.iter().map(|p| p[i]).fold(points[0][i], pick)))
    };
    let (count, corners) = (points.len(), 3 * mesh.triangles.len());
    let mut buffer = Buffer::default();
    let floats =
        |kind: &str| format!(r#""componentType":{},"count":{count},"type":"{kind}""#, gl::FLOAT);
    let bounds =
        format!(r#"{},"max":{:?},"min":{:?}"#, floats("VEC3"), bound(f32::max), bound(f32::min));
    buffer.add(bytemuck::cast_slice(&points), gl::ARRAY_BUFFER, &bounds);
    let normals = mesh.whole_normals();
    buffer.add(bytemuck::cast_slice(&normals), gl::ARRAY_BUFFER, &floats("VEC3"));
    let (attribute, texture) = match &skin.colors {
        Colors::Vertices(colors) => {
            let colors: Vec<[u16; 4]> = colors.iter().map(|&c| linear_rgba(c)).collect();
            let kind = format!(
                r#""componentType":{},"count":{count},"normalized":true,"type":"VEC4""#,
                gl::UNSIGNED_SHORT
            );
            buffer.add(bytemuck::cast_slice(&colors), gl::ARRAY_BUFFER, &kind);
            ("COLOR_0", None)
        }
        Colors::Texture(texture) => {
            let uvs = bytemuck::cast_slice(&texture.uvs);
            buffer.add(uvs, gl::ARRAY_BUFFER, &floats("VEC2"));
            ("TEXCOORD_0", Some(texture))
        }
    };
    let kind = format!(r#""componentType":{},"count":{corners},"type":"SCALAR""#, gl::UNSIGNED_INT);
    buffer.add(bytemuck::cast_slice(&mesh.triangles), gl::ELEMENT_ARRAY_BUFFER, &kind);
    if let Some(texture) = texture {
        buffer.view(&texture.png, None);
    }
    let (parts, material) = look(skin, buffer.accessors.len());
    let text = format!(
        concat!(
            r#"{{"accessors":[{accessors}],"asset":{{"generator":"onescan {version}","version":"2.0"}},"#,
            r#""bufferViews":[{views}],"buffers":[{{"byteLength":{bytes}}}],"#,
            r#"{parts}"materials":[{material}],"#,
            r#""meshes":[{{"name":{name},"primitives":[{{"#,
            r#""attributes":{{"{attribute}":2,"NORMAL":1,"POSITION":0}},"indices":3,"material":0}}]}}],"#,
            r#""nodes":[{{"mesh":0,"name":{name}}}],"scene":0,"scenes":[{{"nodes":[0]}}]}}"#,
        ),
        accessors = buffer.accessors.join(","),
        version = env!("CARGO_PKG_VERSION"),
        views = buffer.views.join(","),
        bytes = buffer.bytes.len(),
        parts = parts,
        material = material,
        attribute = attribute,
        // Quoted.
        name = Value::from(name),
    );
    let mut text = text.into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    container(&text, &buffer.bytes)
}

/// As JSON what a file with such a skin declares, and its material; the view of this number is of the
/// picture, if there is one.
fn look(skin: &Skin, picture: usize) -> (String, String) {
    let (mut parts, mut base, mut unlit) = (String::new(), "", String::new());
    if skin.textured() {
        // One picture for the whole surface: nothing lies beyond its border.
        parts = format!(
            concat!(
                r#""images":[{{"bufferView":{picture},"mimeType":"image/png"}}],"#,
                r#""samplers":[{{"magFilter":{linear},"minFilter":{mipmaps},"#,
                r#""wrapS":{edge},"wrapT":{edge}}}],"textures":[{{"sampler":0,"source":0}}],"#,
            ),
            picture = picture,
            linear = gl::LINEAR,
            mipmaps = gl::LINEAR_MIPMAP_LINEAR,
            edge = gl::CLAMP_TO_EDGE,
        );
        base = r#""baseColorTexture":{"index":0},"#;
    }
    if !skin.lit {
        parts = format!(r#"{parts}"extensionsUsed":["{UNLIT}"],"#);
        unlit = format!(r#""extensions":{{"{UNLIT}":{{}}}},"#);
    }
    let material = format!(
        concat!(
            r#"{{"doubleSided":true,{unlit}"#,
            r#""pbrMetallicRoughness":{{{base}"metallicFactor":0.0,"roughnessFactor":1.0}}}}"#,
        ),
        unlit = unlit,
        base = base,
    );
    (parts, material)
}

/// The binary part, and what is where in it, as JSON.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<String>,
    accessors: Vec<String>,
}

impl Buffer {
    /// Appends bytes, and zeros up to a multiple of four, so that whatever follows is aligned.
    fn view(&mut self, bytes: &[u8], target: Option<u32>) {
        let target = target.map_or_else(String::new, |target| format!(r#","target":{target}"#));
        self.views.push(format!(
            r#"{{"buffer":0,"byteLength":{},"byteOffset":{}{target}}}"#,
            bytes.len(),
            self.bytes.len()
        ));
        self.bytes.extend_from_slice(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
    }

    /// Appends numbers, and what an accessor says of them. Views and accessors have the same numbers.
    fn add(&mut self, bytes: &[u8], target: u32, kind: &str) {
        self.view(bytes, Some(target));
        self.accessors.push(format!(r#"{{"bufferView":{},{kind}}}"#, self.accessors.len()));
    }
}

/// Header, JSON chunk, binary chunk; both chunks already padded to four bytes.
fn container(text: &[u8], binary: &[u8]) -> Result<Vec<u8>> {
    let total = 12 + 8 + text.len() + 8 + binary.len();
    let length = |bytes: usize| {
        u32::try_from(bytes)
            .map(u32::to_le_bytes)
            .map_err(|_| Error::new("the mesh needs more than the 4 GiB of a .glb file"))
    };
    let mut out = Vec::with_capacity(total);
    out.extend_from_slice(b"glTF\x02\0\0\0");
    out.extend_from_slice(&length(total)?);
    for (kind, chunk) in [(b"JSON", text), (b"BIN\0", binary)] {
        out.extend_from_slice(&length(chunk.len())?);
        out.extend_from_slice(kind);
        out.extend_from_slice(chunk);
    }
    Ok(out)
}

/// An sRGB colour as linear 16-bit RGBA.
fn linear_rgba(color: [f32; 3]) -> [u16; 4] {
    let [r, g, b] = color.map(|c| (linear(c) * 65535.0 + 0.5) as u16);
    [r, g, b, u16::MAX]
}

/// An sRGB value, clamped to `[0, 1]`, as linear light: `((c + 0.055)/1.055)^2.4`, `c/12.92` up to
/// 0.04045 (IEC 61966-2-1).
pub(crate) fn linear(c: f32) -> f32 {
    let c = c.clamp(0.0, 1.0);
    if c <= 0.04045 { c / 12.92 } else { math::exp_f32(2.4 * math::ln_f32((c + 0.055) / 1.055)) }
}

/// Linear light, clamped to `[0, 1]`, as an sRGB value: the inverse of [`linear`].
#[cfg(feature = "full")]
pub(crate) fn stored(c: f32) -> f32 {
    let c = c.clamp(0.0, 1.0);
    let value = if c <= 0.003_130_8 {
        12.92 * c
    } else {
        1.055 * math::exp_f32(math::ln_f32(c) / 2.4) - 0.055
    };
    value.clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::skin::Texture;
    use crate::photo::picture::Picture;

    fn tetrahedron() -> Mesh {
        Mesh {
            points: vec![
                [0., 0., 0.],
                [100., 0., 0.],
                [0., 70.1, 0.],
                [0., 0., -33.3],
                [1., 1., 1.],
            ],
            colors: vec![[0.0; 3], [1.0; 3], [0.5, 0.25, 0.02], [2.0, -1.0, 0.5], [0.1; 3]],
            triangles: vec![[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]],
        }
    }

    #[test]
    fn another_reader_finds_the_mesh() {
        let mesh = tetrahedron();
        let glb = encode(&mesh, "a \"face\"\n").unwrap();
        // The reader validates indices, bounds and required fields.
        let gltf = gltf::Gltf::from_slice(&glb).unwrap();
        let blob = gltf.blob.clone().unwrap();
        let primitive = gltf.meshes().next().unwrap().primitives().next().unwrap();
        let reader = primitive.reader(|_| Some(&blob));
        let points: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
        assert_eq!(points, mesh.points.iter().map(|p| p.map(|x| x * METRE)).collect::<Vec<_>>());
        let bounds = primitive.bounding_box();
        assert_eq!((bounds.min, bounds.max[1]), ([0.0, 0.0, -33.3 * METRE], 70.1 * METRE));
        let indices: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
        assert_eq!(indices, mesh.triangles.as_flattened());
        let normals: Vec<[f32; 3]> = reader.read_normals().unwrap().collect();
        for n in &normals {
            assert!((n.iter().map(|x| x * x).sum::<f32>() - 1.0).abs() < 1e-6);
        }
        assert!(normals[4][2] > 0.99, "the loose vertex has some normal");
        let colors: Vec<[u16; 3]> = reader.read_colors(0).unwrap().into_rgb_u16().collect();
        assert_eq!(colors[1], [65535; 3]);
        // sRGB one half is 0.21404 linear.
        assert_eq!(colors[2][0], (0.214_041_14_f64 * 65535.0).round() as u16);
        assert_eq!(colors[3][..2], [65535, 0]);
        assert!(primitive.material().double_sided());
    }

    #[test]
    fn another_reader_finds_the_texture_and_that_it_is_not_to_be_lit() {
        let mesh = tetrahedron();
        let picture = Picture::from_fn(3, 2, |x, y| [x as u8, y as u8, 7]);
        let uvs: Vec<[f32; 2]> = (0..5).map(|i| [0.25 * i as f32, 0.125]).collect();
        let texture = Texture::new(uvs.clone(), picture).unwrap();
        let skin = Skin { colors: Colors::Texture(texture.clone()), lit: false };
        let gltf = gltf::Gltf::from_slice(&encode_with(&mesh, &skin, "face").unwrap()).unwrap();
        let blob = gltf.blob.clone().unwrap();
        let primitive = gltf.meshes().next().unwrap().primitives().next().unwrap();
        let reader = primitive.reader(|_| Some(&blob));
        assert_eq!(reader.read_tex_coords(0).unwrap().into_f32().collect::<Vec<_>>(), uvs);
        assert!(reader.read_colors(0).is_none(), "they would darken the texture");
        assert!(primitive.material().unlit());
        let gltf::image::Source::View { view, mime_type } = gltf.images().next().unwrap().source()
        else {
            panic!("the picture is in the file")
        };
        assert_eq!(mime_type, "image/png");
        assert_eq!(blob[view.offset()..view.offset() + view.length()], texture.png);
    }

    #[test]
    fn chunks_and_views_are_aligned() {
        for name in ["", "a", "ab", "abc"] {
            let glb = encode(&tetrahedron(), name).unwrap();
            let word = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
            assert_eq!(word(8), glb.len());
            let text = word(12);
            assert_eq!((text % 4, &glb[16..20]), (0, &b"JSON"[..]));
            assert_eq!(20 + text + 8 + word(20 + text), glb.len());
            let gltf = gltf::Gltf::from_slice(&glb).unwrap();
            assert!(gltf.views().all(|view| view.offset() % 4 == 0));
        }
    }

    #[test]
    fn eight_bit_colours_survive_the_linear_detour() {
        for byte in 0..=255_u8 {
            let [value, ..] = linear_rgba([f32::from(byte) / 255.0; 3]);
            let back = stored(f32::from(value) / 65535.0);
            assert_eq!((back * 255.0).round() as u8, byte);
        }
    }

    #[test]
    fn an_empty_mesh_is_refused() {
        assert!(encode(&Mesh { triangles: vec![], ..tetrahedron() }, "x").is_err());
    }
}
