//! PLY meshes with vertex colours or a texture: reading of ascii and both binary encodings, and writing.
//!
//! Grammar and payload are the crate `ply-rs-bw`'s; this module bounds what a header may claim
//! by what the file holds, splits text into rows (of which that crate takes one way to write them),
//! picks out positions, colours and faces, and checks them.

mod row;

use crate::error::{Error, Result};
use crate::files;
use crate::mesh::polygon::Cutter;
use crate::mesh::{Mesh, in_range};
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{
    ElementDef, Encoding as Stored, Header, PropertyAccess, PropertyType, ScalarType,
};
use row::{FACE_UV_NAME, Face, PAGE_NAME, POSITION_NAMES, UV_NAMES, Vertex};
use std::io::{self, ErrorKind, Write};
use std::path::Path;

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
/// Guarantees: those of [`Mesh`], but for the colours; as many entries per triangle, where there are
/// any, as triangles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parts {
    /// Vertex positions.
    pub points: Vec<[f64; 3]>,
    /// Vertex colours, RGB in `[0, 1]`.
    pub colors: Option<Vec<[f32; 3]>>,
    /// Corner indices.
    pub triangles: Vec<[u32; 3]>,
    /// Colours of the triangles.
    pub face_colors: Option<Vec<[f32; 3]>>,
    /// Texture coordinates of the triangles' corners, v up; not checked.
    pub uvs: Option<Vec<[[f32; 2]; 3]>>,
    /// Which of the textures lies on each triangle; not checked.
    pub pages: Option<Vec<i64>>,
    /// The files of the textures (`comment TextureFile name`).
    pub textures: Vec<String>,
}

/// Reads a PLY file.
///
/// # Errors
/// When the file cannot be read, and those of [`parse`]; they name the file.
pub fn read(path: &Path) -> Result<Mesh> {
    let bytes = files::read(path).map_err(|e| Error::file(path, e))?;
    parse(&bytes).map_err(|e| Error::file(path, e))
}

/// Parses the bytes of a PLY file.
///
/// Positions keep the file's unit, in f32. Colours become RGB in `[0, 1]`: 16-bit unsigned ones
/// divided by 65535, unless none exceeds 255, other integers by 255, floats as they are. Polygons and
/// strips are cut into triangles. Other properties and elements are skipped.
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
    let points: Vec<_> = points.iter().map(|p| p.map(|c| c as f32)).collect();
    if let Some((i, point)) = points.iter().enumerate().find(|(_, p)| !finite(**p)) {
        return Err(not_finite(i, point));
    }
    Ok(Mesh { points, colors, triangles })
}

fn finite<T: Copy + Into<f64>>(point: [T; 3]) -> bool {
    point.into_iter().all(|c| c.into().is_finite())
}

fn not_finite(vertex: usize, point: &dyn std::fmt::Debug) -> Error {
    Error::new(format_args!("vertex {vertex}: position {point:?} is not finite; remove the vertex"))
}

/// Parses the bytes of a PLY file whose colours may be elsewhere: in a texture, or nowhere.
///
/// # Errors
/// Those of [`parse`], but for missing colours.
pub fn parse_parts(bytes: &[u8]) -> Result<Parts> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let (text, body) = split(bytes)?;
    let header = header(&text)?;
    let properties = text.lines().filter(|l| l.trim_start().starts_with("property")).count();
    if properties != header.elements.values().map(|e| e.properties.len()).sum::<usize>() {
        return Err(Error::new("header: an element or property is declared twice; rename one"));
    }
    for element in header.elements.values() {
        let least = least_size(element, header.encoding);
        if element.count.saturating_mul(least) > body.len() {
            return Err(Error::new(format_args!(
                "header: {} x {} cannot fit into the {} bytes that follow; \
                 the file is cut short or damaged, export it again",
                element.count,
                element.name,
                body.len()
            )));
        }
    }
    let head = &bytes[..bytes.len() - body.len()];
    let end = if head.contains(&b'\n') { b'\n' } else { b'\r' };
    let lines = head.split(|b| *b == end).count();
    let mut rows = Rows { header: &header, rest: body, line: lines };
    let mut vertices: (Vec<Vertex>, Option<&ElementDef>) = (Vec::new(), None);
    let mut faces: (Vec<Face>, Option<&ElementDef>) = (Vec::new(), None);
    let mut strips = Vec::new();
    for element in header.elements.values() {
        match element.name.as_str() {
            "vertex" => {
                if !has_all(element, &POSITION_NAMES) {
                    return Err(Error::new("vertices have no x, y, z; export the scan as a mesh"));
                }
                vertices = (rows.read(element)?, Some(element));
            }
            "face" => faces = (rows.read(element)?, Some(element)),
            "tristrips" => strips = rows.read(element)?,
            _ => {
                rows.read::<row::Skipped>(element)?;
            }
        }
    }
    let ((vertices, vertex), (faces, face)) = (vertices, faces);
    let (mut parts, cuts) = assemble(&vertices, &faces, &strips)?;
    let colors = vertex.and_then(|element| row::colors(element, &vertices));
    parts.colors = colors.map(|colors| checked(colors, "vertex")).transpose()?;
    let uv = vertex.and_then(|e| UV_NAMES.iter().position(|names| has_all(e, names)));
    if let Some(face) = face.filter(|_| strips.is_empty()) {
        let of_faces = |i: &u32| *i as usize;
        if let Some(colors) = row::colors(face, &faces) {
            let colors = checked(colors, "face")?;
            parts.face_colors = Some(cuts.iter().map(|(i, _)| colors[of_faces(i)]).collect());
        }
        if face.properties.contains_key(PAGE_NAME) {
            parts.pages = Some(cuts.iter().map(|(i, _)| faces[of_faces(i)].page).collect());
        }
        if face.properties.contains_key(FACE_UV_NAME) {
            parts.uvs = Some(corner_uvs(&faces, &cuts)?);
        }
    }
    if let (None, Some(uv)) = (&parts.uvs, uv) {
        let corners = |t: &[u32; 3]| t.map(|v| vertices[v as usize].uvs[uv]);
        parts.uvs = Some(parts.triangles.iter().map(corners).collect());
    }
    let named = |line: &str| Some(line.trim().strip_prefix("comment TextureFile")?.to_owned());
    parts.textures = text
        .lines()
        .filter_map(named)
        .map(|name| name.trim_start_matches([':', ' ', '\t']).trim_end().to_owned())
        .collect();
    Ok(parts)
}

/// The header's last line.
const END: &[u8] = b"end_header";

/// The header's text, its lines ended by line feeds and none of them blank, and the bytes behind it.
fn split(bytes: &[u8]) -> Result<(String, &[u8])> {
    let Some(after) = bytes
        .strip_prefix(b"ply")
        .filter(|rest| rest.starts_with(b"\n") || rest.starts_with(b"\r"))
    else {
        return Err(Error::new(
            "not a PLY file (the first line is not `ply`); export the scan as PLY",
        ));
    };
    // A lone carriage return ends the lines of a header that has no line feed behind the first.
    let lone = after.starts_with(b"\r") && !after.starts_with(b"\r\n");
    let starts = |at: usize| at > 0 && matches!(bytes[at - 1], b'\n' | b'\r');
    let end = bytes.windows(END.len()).enumerate().find(|(at, w)| *w == END && starts(*at));
    let Some((end, _)) = end else {
        return Err(Error::new(
            "header: has no line `end_header`; the file is cut short or damaged, export it again",
        ));
    };
    // Comments are in whatever encoding the author's machine had.
    let text = String::from_utf8_lossy(&bytes[..end + END.len()]);
    let lines = text.split(['\n', '\r']).filter(|line| !line.trim().is_empty());
    let text = lines.fold(String::new(), |text, line| text + line.trim() + "\n");
    let mut body = &bytes[end + END.len()..];
    while let [b' ' | b'\t', rest @ ..] = body {
        body = rest;
    }
    let body = match body {
        [b'\r', b'\n', rest @ ..] if !lone => rest,
        [b'\r' | b'\n', rest @ ..] | rest => rest,
    };
    Ok((text, body))
}

/// Parses the header's text.
fn header(text: &str) -> Result<Header> {
    let read = Parser::<row::Skipped>::new().read_header(&mut Reader::new(text.as_bytes()));
    read.map_err(|e| {
        let line = e.line().and_then(|line| text.lines().nth(line.saturating_sub(1)));
        let what = match line {
            Some(line) => format!("`{}` is not understood", row::start(line)),
            None => "has no line `format` with a version".into(),
        };
        Error::new(format_args!("header: {what}; the file is damaged, export it again"))
    })
}

/// What follows the header, element by element.
struct Rows<'a> {
    header: &'a Header,
    rest: &'a [u8],
    /// Of a text: the line that `rest` begins with, from 1.
    line: usize,
}

impl Rows<'_> {
    fn read<E: PropertyAccess>(&mut self, element: &ElementDef) -> Result<Vec<E>> {
        let parser = Parser::<E>::new();
        if self.header.encoding != Stored::Ascii {
            let mut reader = Reader::new(self.rest);
            let read = parser.read_payload_for_element(&mut reader, element, self.header);
            self.rest = reader.into_inner();
            return read.map_err(|e| {
                let what = match e.kind() {
                    ErrorKind::UnexpectedEof => "the file ends before their last",
                    _ => "one holds numbers that are not read there",
                };
                let (count, name) = (element.count, &element.name);
                Error::new(format_args!(
                    "element {name}, {count} of them: {what}; the file is cut short or damaged, \
                     export it again"
                ))
            });
        }
        let mut elements = Vec::new();
        while elements.len() < element.count {
            let Some((number, line)) = self.line() else {
                return Err(Error::new(format_args!(
                    "line {}: the file ends after {} of {} rows of element {}; it is cut short, \
                     export it again",
                    self.line,
                    elements.len(),
                    element.count,
                    element.name
                )));
            };
            let row = parser.read_ascii_element(&row::plain(&line), element).map_err(|_| {
                let names: Vec<&str> = element.properties.keys().map(String::as_str).collect();
                Error::new(format_args!(
                    "line {number}: `{}` is no row of element {} ({}); the file is damaged, export \
                     it again",
                    row::start(&line),
                    element.name,
                    row::start(&names.join(" "))
                ))
            })?;
            elements.push(row);
        }
        Ok(elements)
    }

    /// The next line of a text that is not blank, and its number; no line end is like another.
    fn line(&mut self) -> Option<(usize, String)> {
        while !self.rest.is_empty() {
            let end = self.rest.iter().position(|b| matches!(b, b'\n' | b'\r'));
            let (line, rest) = match end {
                Some(end) => (&self.rest[..end], &self.rest[end + 1..]),
                None => (self.rest, &self.rest[self.rest.len()..]),
            };
            let number = self.line;
            // Of a pair one counts.
            let pair = end.is_some_and(|end| self.rest[end] == b'\r') && rest.starts_with(b"\n");
            self.line += usize::from(!pair);
            self.rest = rest;
            if !line.trim_ascii().is_empty() {
                return Some((number, String::from_utf8_lossy(line).into_owned()));
            }
        }
        None
    }
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

fn has_all<const N: usize>(element: &ElementDef, names: &[&str; N]) -> bool {
    names.iter().all(|name| element.properties.contains_key(*name))
}

/// Colours in `[0, 1]`.
fn checked(mut colors: Vec<[f32; 3]>, what: &str) -> Result<Vec<[f32; 3]>> {
    for (i, color) in colors.iter_mut().enumerate() {
        *color = in_range(*color).ok_or_else(|| {
            Error::new(format_args!(
                "{what} {i}: colour {color:?} lies outside [0, 1]; export colours as uchar or \
                 scale them to [0, 1]"
            ))
        })?;
    }
    Ok(colors)
}

/// Of a triangle: the face it was cut from, and which of its corners.
type Cut = (u32, [u32; 3]);

/// Positions, and triangles of faces or of strips; of faces also where each was cut from.
fn assemble(vertices: &[Vertex], faces: &[Face], strips: &[Face]) -> Result<(Parts, Vec<Cut>)> {
    if vertices.is_empty() {
        return Err(Error::new("the mesh is empty: no vertices; export the scan again"));
    }
    let count = u32::try_from(vertices.len()).map_err(|_| {
        Error::new(format_args!("{} vertices are too many; decimate", vertices.len()))
    })?;
    if let Some((i, vertex)) = vertices.iter().enumerate().find(|(_, v)| !finite(v.position)) {
        return Err(not_finite(i, &vertex.position));
    }
    let in_range = |i: usize, name: &str, corner: i64| {
        u32::try_from(corner).ok().filter(|corner| *corner < count).ok_or_else(|| {
            Error::new(format_args!(
                "{name} {i}: vertex index {corner} is out of range, there are {count} vertices; \
                 the file is damaged, export it again"
            ))
        })
    };
    let (mut triangles, mut cuts) = (Vec::new(), Vec::new());
    let (mut cutter, mut places) = (Cutter::default(), Vec::new());
    for (i, Face { corners, .. }) in faces.iter().enumerate() {
        if corners.len() < 3 {
            return Err(Error::new(format_args!(
                "face {i}: {} corners (no vertex_indices?); a face needs at least 3",
                corners.len()
            )));
        }
        places.clear();
        for &corner in corners {
            places.push(vertices[in_range(i, "face", corner)? as usize].position);
        }
        cutter.cut(&places, |triangle| {
            triangles.push(triangle.map(|k| corners[k] as u32));
            cuts.push((i as u32, triangle.map(|k| k as u32)));
        });
    }
    for (i, Face { corners, .. }) in strips.iter().enumerate() {
        // Negative numbers stand between strips, of which every other triangle is turned over.
        for strip in corners.split(|corner| *corner < 0) {
            for (k, window) in strip.windows(3).enumerate() {
                let turned = [window[k % 2], window[1 - k % 2], window[2]];
                let mut triangle = [0; 3];
                for (to, corner) in triangle.iter_mut().zip(turned) {
                    *to = in_range(i, "strip", corner)?;
                }
                let [a, b, c] = triangle;
                if a != b && b != c && c != a {
                    triangles.push(triangle);
                }
            }
        }
    }
    if triangles.is_empty() {
        return Err(Error::new("has no faces; mesh the point cloud first"));
    }
    let points = vertices.iter().map(|v| v.position).collect();
    Ok((Parts { points, triangles, ..Parts::default() }, cuts))
}

/// The texture coordinates of the corners of triangles.
fn corner_uvs(faces: &[Face], cuts: &[Cut]) -> Result<Vec<[[f32; 2]; 3]>> {
    for (i, Face { corners, texcoord, .. }) in faces.iter().enumerate() {
        if texcoord.len() / 2 < corners.len() {
            return Err(Error::new(format_args!(
                "face {i}: {} numbers of texcoord, {} corners need two each; export the scan again",
                texcoord.len(),
                corners.len()
            )));
        }
    }
    let uv = |face: u32, k: u32| faces[face as usize].texcoord.as_chunks().0[k as usize];
    Ok(cuts.iter().map(|(face, triangle)| triangle.map(|k| uv(*face, k))).collect())
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
