//! PLY meshes with vertex colours or a texture: reading of ascii and both binary encodings, and writing.
//!
//! Grammar and payload are the crate `ply-rs-bw`'s; this module bounds what a header may claim
//! by what the file holds, picks out positions, colours and faces, and checks them.

use crate::error::{Error, Result};
use crate::mesh::Mesh;
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{
    ElementDef, Encoding as Stored, Property, PropertyAccess, PropertyAccessResult, PropertyType,
    ScalarType,
};
use std::io::{self, Read, Write};
use std::path::Path;

/// What programs call the colour of a vertex; the first complete triple is taken.
const COLOR_NAMES: [[&str; 3]; 3] =
    [["red", "green", "blue"], ["diffuse_red", "diffuse_green", "diffuse_blue"], ["r", "g", "b"]];
const POSITION_NAMES: [&str; 3] = ["x", "y", "z"];
const CORNER_NAMES: [&str; 2] = ["vertex_indices", "vertex_index"];
/// What programs call the texture coordinates of a vertex; the first complete pair is taken.
const UV_NAMES: [[&str; 2]; 3] = [["texture_u", "texture_v"], ["s", "t"], ["u", "v"]];
/// And those of a face's corners: u and v of each in turn.
const FACE_UV_NAME: &str = "texcoord";

/// How numbers are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Encoding {
    /// Little-endian binary.
    #[default]
    Binary,
    /// Text, in the shortest form that reads back to the same f32.
    Ascii,
}

/// What a PLY file says of a surface.
///
/// Guarantees: those of [`Mesh`], but for the colours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parts {
    /// Vertex positions.
    pub points: Vec<[f32; 3]>,
    /// Vertex colours, RGB in `[0, 1]`.
    pub colors: Option<Vec<[f32; 3]>>,
    /// Corner indices.
    pub triangles: Vec<[u32; 3]>,
    /// Texture coordinates of the triangles' corners, v up; not checked.
    pub uvs: Option<Vec<[[f32; 2]; 3]>>,
    /// The file of the texture (`comment TextureFile name`).
    pub texture: Option<String>,
}

/// Reads a PLY file.
///
/// # Errors
/// When the file cannot be read, and those of [`parse`]; they name the file.
pub fn read(path: &Path) -> Result<Mesh> {
    let bytes = std::fs::read(path).map_err(|e| Error::file(path, e))?;
    parse(&bytes).map_err(|e| Error::file(path, e))
}

/// Parses the bytes of a PLY file.
///
/// Positions keep the file's unit, in f32. Colours become RGB in `[0, 1]`: 16-bit unsigned ones
/// divided by 65535, other integers by 255, floats as they are. Polygons are cut into fans.
/// Other properties and elements are skipped.
///
/// # Errors
/// Anything that would break the guarantees of [`Mesh`], each with its place in the file; float
/// colours outside `[0, 1]` (there is no telling what their range is). Memory taken is bounded
/// by a multiple of the bytes given, whatever the header claims.
pub fn parse(bytes: &[u8]) -> Result<Mesh> {
    let Parts { points, colors, triangles, .. } = parse_parts(bytes)?;
    let colors = colors.ok_or_else(|| {
        Error::new(
            "has no vertex colours; onescan builds albedo from them: \
             bake the texture to vertex colours and export again",
        )
    })?;
    Ok(Mesh { points, colors, triangles })
}

/// Parses the bytes of a PLY file whose colours may be elsewhere: in a texture, or nowhere.
///
/// # Errors
/// Those of [`parse`], but for missing colours.
pub fn parse_parts(bytes: &[u8]) -> Result<Parts> {
    if !(bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r")) {
        return Err(Error::new(
            "not a PLY file (the first line is not `ply`); export the scan as PLY",
        ));
    }
    let end = bytes.windows(10).position(|w| w == b"end_header").unwrap_or(bytes.len());
    // Comments are in whatever encoding the author's machine had.
    let text = String::from_utf8_lossy(&bytes[..end]);
    let mut reader = Reader::new(text.as_bytes().chain(&bytes[end..]));
    let header = Parser::<Skipped>::new().read_header(&mut reader).map_err(malformed)?;
    let properties = text.lines().filter(|l| l.trim_start().starts_with("property")).count();
    if properties != header.elements.values().map(|e| e.properties.len()).sum::<usize>() {
        return Err(Error::new("header: an element or property is declared twice; rename one"));
    }
    let available = bytes.len() - end;
    for element in header.elements.values() {
        let least = least_size(element, header.encoding);
        if element.count.saturating_mul(least) > available {
            return Err(Error::new(format_args!(
                "header: {} x {} cannot fit into the {available} bytes that follow; \
                 the file is cut short or damaged, export it again",
                element.count, element.name
            )));
        }
    }

    let mut vertices = Vec::new();
    let mut faces = Vec::new();
    let (mut colored, mut vertex_uvs, mut face_uvs) = (false, false, false);
    for element in header.elements.values() {
        match element.name.as_str() {
            "vertex" => {
                if !has_all(element, &POSITION_NAMES) {
                    return Err(Error::new("vertices have no x, y, z; export the scan as a mesh"));
                }
                colored = COLOR_NAMES.iter().any(|names| has_all(element, names));
                vertex_uvs = UV_NAMES.iter().any(|names| has_all(element, names));
                vertices = Parser::<Vertex>::new()
                    .read_payload_for_element(&mut reader, element, &header)
                    .map_err(malformed)?;
                choose_names(element, &mut vertices);
            }
            "face" => {
                face_uvs = element.properties.contains_key(FACE_UV_NAME);
                faces = Parser::<Face>::new()
                    .read_payload_for_element(&mut reader, element, &header)
                    .map_err(malformed)?;
            }
            _ => {
                Parser::<Skipped>::new()
                    .read_payload_for_element(&mut reader, element, &header)
                    .map_err(malformed)?;
            }
        }
    }
    let mesh = assemble(&vertices, &faces, colored)?;
    let uvs = if face_uvs {
        Some(corner_uvs(&faces)?)
    } else {
        let corners = |t: &[u32; 3]| t.map(|v| vertices[v as usize].uvs[0]);
        vertex_uvs.then(|| mesh.triangles.iter().map(corners).collect())
    };
    let named = |line: &str| Some(line.trim().strip_prefix("comment TextureFile")?.trim().into());
    Ok(Parts {
        points: mesh.points,
        colors: colored.then_some(mesh.colors),
        triangles: mesh.triangles,
        uvs,
        texture: text.lines().find_map(named),
    })
}

/// Fewest bytes an element of this kind takes (in text a digit and a separator per property,
/// but for the last separator of the file).
fn least_size(element: &ElementDef, stored: Stored) -> usize {
    let size = |p: &PropertyType| match p {
        _ if stored == Stored::Ascii => 1,
        PropertyType::Scalar(scalar) | PropertyType::List(scalar, _) => match scalar {
            ScalarType::Char | ScalarType::UChar => 1,
            ScalarType::Short | ScalarType::UShort => 2,
            ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
            ScalarType::Double => 8,
        },
    };
    element.properties.values().map(|p| size(&p.data_type)).sum::<usize>().max(1)
}

#[allow(clippy::needless_pass_by_value)] // for `map_err`
fn malformed(error: ParseError) -> Error {
    // The crate quotes the whole offending line; a person needs its beginning.
    let message: String = error.to_string().chars().take(240).collect();
    Error::new(format_args!("{message}; the file is damaged, export it again"))
}

fn has_all<const N: usize>(element: &ElementDef, names: &[&str; N]) -> bool {
    names.iter().all(|name| element.properties.contains_key(*name))
}

/// Moves the colour and the texture coordinates the file has to the front.
fn choose_names(element: &ElementDef, vertices: &mut [Vertex]) {
    let color = COLOR_NAMES.iter().position(|names| has_all(element, names)).unwrap_or(0);
    let uv = UV_NAMES.iter().position(|names| has_all(element, names)).unwrap_or(0);
    for vertex in vertices {
        vertex.colors.swap(0, color);
        vertex.uvs.swap(0, uv);
    }
}

/// The texture coordinates of the corners of the fans that [`assemble`] makes.
fn corner_uvs(faces: &[Face]) -> Result<Vec<[[f32; 2]; 3]>> {
    let mut uvs = Vec::new();
    for (i, Face { corners, texcoord }) in faces.iter().enumerate() {
        let pairs: &[[f32; 2]] = texcoord.as_chunks().0;
        if pairs.len() < corners.len() {
            return Err(Error::new(format_args!(
                "face {i}: {} numbers of texcoord, {} corners need two each; export the scan again",
                texcoord.len(),
                corners.len()
            )));
        }
        uvs.extend(pairs[1..corners.len()].windows(2).map(|edge| [pairs[0], edge[0], edge[1]]));
    }
    Ok(uvs)
}

fn assemble(vertices: &[Vertex], faces: &[Face], colored: bool) -> Result<Mesh> {
    if vertices.is_empty() {
        return Err(Error::new("the mesh is empty: no vertices; export the scan again"));
    }
    if faces.is_empty() {
        return Err(Error::new("has no faces; mesh the point cloud first"));
    }
    let count = u32::try_from(vertices.len()).map_err(|_| {
        Error::new(format_args!("{} vertices are too many; decimate", vertices.len()))
    })?;
    for (i, vertex) in vertices.iter().enumerate() {
        if !vertex.position.iter().all(|c| c.is_finite()) {
            return Err(Error::new(format_args!(
                "vertex {i}: position {:?} is not finite; remove the vertex",
                vertex.position
            )));
        }
        if colored && !vertex.colors[0].iter().all(|c| (0.0..=1.0).contains(c)) {
            return Err(Error::new(format_args!(
                "vertex {i}: colour {:?} lies outside [0, 1]; export colours as uchar or \
                 scale them to [0, 1]",
                vertex.colors[0]
            )));
        }
    }
    let mut triangles = Vec::new();
    for (i, Face { corners, .. }) in faces.iter().enumerate() {
        if corners.len() < 3 {
            return Err(Error::new(format_args!(
                "face {i}: {} corners (no vertex_indices?); a face needs at least 3",
                corners.len()
            )));
        }
        if let Some(corner) = corners.iter().find(|c| !(0..i64::from(count)).contains(*c)) {
            return Err(Error::new(format_args!(
                "face {i}: vertex index {corner} is out of range, there are {count} vertices; \
                 the file is damaged, export it again"
            )));
        }
        let fan = corners[1..].windows(2);
        triangles.extend(fan.map(|edge| [corners[0], edge[0], edge[1]].map(|c| c as u32)));
    }
    Ok(Mesh {
        points: vertices.iter().map(|v| v.position).collect(),
        colors: vertices.iter().map(|v| v.colors[0]).collect(),
        triangles,
    })
}

/// Position, and what stands under each of [`COLOR_NAMES`] and [`UV_NAMES`].
#[derive(Default)]
struct Vertex {
    position: [f32; 3],
    uvs: [[f32; 2]; UV_NAMES.len()],
    colors: [[f32; 3]; COLOR_NAMES.len()],
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let index = |names: &[&str; 3]| names.iter().position(|n| *n == name);
        if let Some(k) = index(&POSITION_NAMES)
            && let Some(value) = number(&property)
        {
            self.position[k] = value as f32;
            return PropertyAccessResult::Set;
        }
        for (names, color) in COLOR_NAMES.iter().zip(&mut self.colors) {
            if let Some(k) = index(names)
                && let Some(value) = number(&property)
            {
                let full = match property {
                    Property::Float(_) | Property::Double(_) => 1.0,
                    Property::UShort(_) => f64::from(u16::MAX),
                    _ => f64::from(u8::MAX),
                };
                color[k] = (value / full) as f32;
                return PropertyAccessResult::Set;
            }
        }
        for (names, uv) in UV_NAMES.iter().zip(&mut self.uvs) {
            if let Some(k) = names.iter().position(|n| *n == name)
                && let Some(value) = number(&property)
            {
                uv[k] = value as f32;
                return PropertyAccessResult::Set;
            }
        }
        PropertyAccessResult::Ignored
    }
}

fn number(property: &Property) -> Option<f64> {
    Some(match *property {
        Property::Char(v) => v.into(),
        Property::UChar(v) => v.into(),
        Property::Short(v) => v.into(),
        Property::UShort(v) => v.into(),
        Property::Int(v) => v.into(),
        Property::UInt(v) => v.into(),
        Property::Float(v) => v.into(),
        Property::Double(v) => v,
        _ => return None,
    })
}

#[derive(Default)]
struct Face {
    corners: Vec<i64>,
    texcoord: Vec<f32>,
}

impl PropertyAccess for Face {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        if name == FACE_UV_NAME {
            self.texcoord = match property {
                Property::ListFloat(v) => v,
                Property::ListDouble(v) => v.into_iter().map(|x| x as f32).collect(),
                _ => return PropertyAccessResult::UnsupportedType,
            };
            return PropertyAccessResult::Set;
        }
        if !CORNER_NAMES.contains(&name) {
            return PropertyAccessResult::Ignored;
        }
        self.corners = match property {
            Property::ListChar(v) => widened(v),
            Property::ListUChar(v) => widened(v),
            Property::ListShort(v) => widened(v),
            Property::ListUShort(v) => widened(v),
            Property::ListInt(v) => widened(v),
            Property::ListUInt(v) => widened(v),
            _ => return PropertyAccessResult::UnsupportedType,
        };
        PropertyAccessResult::Set
    }
}

fn widened<T: Into<i64>>(list: Vec<T>) -> Vec<i64> {
    list.into_iter().map(Into::into).collect()
}

/// An element of no interest; its data is read past.
struct Skipped;

impl PropertyAccess for Skipped {
    fn new() -> Self {
        Self
    }
}

/// Writes a mesh: float positions and normals, uchar colours (clamped and rounded), int corner indices.
///
/// # Errors
/// Those of `out`.
pub fn write(out: &mut impl Write, mesh: &Mesh, encoding: Encoding) -> io::Result<()> {
    let format = match encoding {
        Encoding::Binary => "binary_little_endian",
        Encoding::Ascii => "ascii",
    };
    write!(
        out,
        "ply\nformat {format} 1.0\ncomment onescan\nelement vertex {}\n\
         property float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.points.len(),
        mesh.triangles.len()
    )?;
    let normals = mesh.whole_normals();
    for ((point, normal), color) in mesh.points.iter().zip(&normals).zip(&mesh.colors) {
        let rgb = color.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8);
        match encoding {
            Encoding::Binary => {
                let mut numbers = point.iter().chain(normal);
                numbers.try_for_each(|c| out.write_all(&c.to_le_bytes()))?;
                out.write_all(&rgb)?;
            }
            Encoding::Ascii => {
                let ([x, y, z], [nx, ny, nz], [r, g, b]) = (point, normal, rgb);
                writeln!(out, "{x} {y} {z} {nx} {ny} {nz} {r} {g} {b}")?;
            }
        }
    }
    for triangle in &mesh.triangles {
        match encoding {
            Encoding::Binary => {
                out.write_all(&[3])?;
                triangle.iter().try_for_each(|c| out.write_all(&c.to_le_bytes()))?;
            }
            Encoding::Ascii => {
                let [a, b, c] = triangle;
                writeln!(out, "3 {a} {b} {c}")?;
            }
        }
    }
    Ok(())
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // values that f32 holds exactly
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HEADER: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\n\
        property float y\nproperty float z\nproperty uchar red\nproperty uchar green\n\
        property uchar blue\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";
    const VERTICES: &str = "0 0 0 255 0 51\n1 0 0 0 0 0\n1 1 0 0 0 0\n0 1 0 0 0 0\n";

    #[test]
    fn normals_are_written_beside_the_points() {
        let mesh = Mesh {
            points: vec![[0.0; 3], [2.0, 0.0, 0.0], [0.0, 0.0, 2.0], [5.0; 3]],
            colors: vec![[1.0, 0.0, 0.2]; 4],
            triangles: vec![[0, 1, 2]],
        };
        let mut text = Vec::new();
        write(&mut text, &mesh, Encoding::Ascii).unwrap();
        assert_eq!(parse(&text).unwrap(), mesh);
        let text = String::from_utf8(text).unwrap();
        assert!(text.contains("float nz") && text.contains("\n2 0 0 0 -1 0 255 0 51\n"), "{text}");
        assert!(text.contains("\n5 5 5 0 0 1 255 0 51\n"), "one without a triangle: {text}");
    }

    #[track_caller]
    fn assert_error(bytes: impl AsRef<[u8]>, part: &str) {
        let message = parse(bytes.as_ref()).unwrap_err().to_string();
        assert!(message.contains(part), "{message:?} does not say {part:?}");
    }

    #[test]
    fn a_quad_becomes_a_fan_of_two() {
        let mesh = parse(format!("{HEADER}{VERTICES}4 0 1 2 3\n").as_bytes()).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.points[2], [1.0, 1.0, 0.0]);
        assert_eq!(mesh.colors[0], [1.0, 0.0, 0.2]);
    }

    #[test]
    fn other_names_types_elements_and_properties() {
        let mut bytes = b"ply\r\nformat binary_big_endian 1.0\r\ncomment caf\xe9\r\n\
            element material 1\nproperty list ushort short junk\nelement vertex 3\n\
            property double x\nproperty double y\nproperty float confidence\nproperty double z\n\
            property ushort diffuse_red\nproperty float diffuse_green\nproperty uint8 diffuse_blue\n\
            element face 1\nproperty uchar flags\nproperty list uint uint16 vertex_index\n\
            end_header\n"
            .to_vec();
        bytes.extend([0, 2, 7, 7, 7, 7]);
        for i in 0..3_u8 {
            for c in [f64::from(i), 2.0] {
                bytes.extend(c.to_be_bytes());
            }
            bytes.extend(9.0_f32.to_be_bytes());
            bytes.extend((-3.5_f64).to_be_bytes());
            bytes.extend(u16::MAX.to_be_bytes());
            bytes.extend(0.25_f32.to_be_bytes());
            bytes.push(255);
        }
        bytes.extend([9, 0, 0, 0, 3, 0, 2, 0, 1, 0, 0]);
        let mesh = parse(&bytes).unwrap();
        assert_eq!(mesh.points, [[0.0, 2.0, -3.5], [1.0, 2.0, -3.5], [2.0, 2.0, -3.5]]);
        assert_eq!(mesh.colors, [[1.0, 0.25, 1.0]; 3]);
        assert_eq!(mesh.triangles, [[2, 1, 0]]);
    }

    #[test]
    fn damage_is_named_with_its_place() {
        assert_error("solid stl", "not a PLY file");
        assert_error("ply\nformat ascii 1.0\n", "end_header");
        assert_error(format!("{HEADER}{VERTICES}"), "face");
        assert_error(format!("{HEADER}{VERTICES}3 0 1 4\n"), "face 0: vertex index 4");
        assert_error(format!("{HEADER}{VERTICES}3 0 1 -1\n"), "face 0: vertex index -1");
        assert_error(format!("{HEADER}{VERTICES}2 0 1\n"), "face 0: 2 corners");
        let huge = VERTICES.replacen("0 0 0", "0 1e99 0", 1);
        assert_error(format!("{HEADER}{huge}3 0 1 2\n"), "vertex 0: position");
        let floats = HEADER.replace("uchar red", "float red");
        assert_error(format!("{floats}{VERTICES}3 0 1 2\n"), "vertex 0: colour");
        let grey = HEADER.replace("uchar red", "uchar intensity");
        assert_error(format!("{grey}{VERTICES}3 0 1 2\n"), "has no vertex colours");
        let faceless = HEADER.replace("face 1", "face 0");
        assert_error(format!("{faceless}{VERTICES}"), "has no faces");
        let empty = HEADER.replace("vertex 4", "vertex 0");
        assert_error(format!("{empty}3 0 1 2\n"), "the mesh is empty");
        let twice = HEADER.replace("float y", "float x");
        assert_error(format!("{twice}{VERTICES}3 0 1 2\n"), "declared twice");
    }

    #[test]
    fn a_header_that_claims_a_trillion_vertices_costs_nothing() {
        for format in ["ascii", "binary_little_endian"] {
            let header =
                HEADER.replace("vertex 4", "vertex 1000000000000").replace("ascii", format);
            assert_error(format!("{header}{VERTICES}3 0 1 2\n"), "cannot fit");
        }
    }

    fn meshes() -> impl Strategy<Value = Mesh> {
        (3..20_usize).prop_flat_map(|n| {
            let vertex = (prop::array::uniform3(-1e3_f32..1e3), prop::array::uniform3(0_u8..=255));
            let corner = 0..n as u32;
            (
                prop::collection::vec(vertex, n),
                prop::collection::vec([corner.clone(), corner.clone(), corner], 1..9),
            )
                .prop_map(|(vertices, triangles)| Mesh {
                    points: vertices.iter().map(|v| v.0).collect(),
                    colors: vertices.iter().map(|v| v.1.map(|c| f32::from(c) / 255.0)).collect(),
                    triangles,
                })
        })
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(mesh in meshes(), ascii in any::<bool>()) {
            let mut bytes = Vec::new();
            write(&mut bytes, &mesh, if ascii { Encoding::Ascii } else { Encoding::Binary }).unwrap();
            prop_assert_eq!(parse(&bytes).unwrap(), mesh);
        }

        #[test]
        fn damaged_files_never_panic(mesh in meshes(), at in any::<prop::sample::Index>(), byte: u8, cut: bool) {
            let mut bytes = Vec::new();
            write(&mut bytes, &mesh, Encoding::Binary).unwrap();
            let at = at.index(bytes.len());
            if cut { bytes.truncate(at) } else { bytes[at] = byte }
            let _ = parse(&bytes);
        }
    }
}
