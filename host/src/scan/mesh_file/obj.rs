//! Wavefront OBJ with its materials and textures.
//!
//! Parsed here because landmarks name vertices by their place in the file: the crates that read
//! OBJ for rendering number them anew.

mod library;

use super::named::Place;
use super::paint::{self, Lost, Paint, Wrap};
use super::{Format, Options, Rough, lines, unmarked};
use crate::error::{Error, Result};
use crate::mesh::far;
use crate::mesh::polygon::Cutter;
use crate::photo::picture::Picture;
use crate::scan::subdivide::{Finer, mean, mean_point};
use library::{Library, Material};
use std::collections::{BTreeSet, HashMap};
use std::path::Path;
use std::str::SplitWhitespace;

/// What an OBJ file says of a surface.
#[derive(Default)]
struct Obj {
    points: Vec<[f64; 3]>,
    colors: Vec<Option<[f32; 3]>>,
    /// Texture coordinates, v up.
    uvs: Vec<[f32; 2]>,
    triangles: Vec<Triangle>,
    /// Names, in order of first use.
    materials: Vec<String>,
    /// What stands after `mtllib`.
    libraries: Vec<String>,
}

struct Triangle {
    corners: [u32; 3],
    /// Into `Obj::uvs`, if all three corners have one.
    uvs: Option<[u32; 3]>,
    /// Into `Obj::materials`.
    material: Option<u32>,
}

/// Reads an OBJ file from its bytes. Vertices stay in their order. A vertex is coloured by its
/// corners' texture, or else by itself (`v x y z r g b`), or else by its corners' material.
///
/// # Errors
/// Malformed lines, libraries and textures that are wanted and cannot be read.
pub(super) fn read(path: &Path, bytes: &[u8], options: &Options) -> Result<Rough> {
    let mut obj = parse(&String::from_utf8_lossy(unmarked(bytes)))?;
    let corners: Vec<_> = obj.triangles.iter().map(|t| t.corners).collect();
    if let Some(finer) = options.finer(Format::Obj, &obj.points, &corners)? {
        obj.refine(&finer);
    }
    let (mut notes, mut lost) = (Vec::new(), Lost::default());
    let mut painted = Paint::new(obj.points.len());
    let mut flat = Paint::new(obj.points.len());
    let own = obj.colors.iter().all(Option::is_some);
    if let Some(file) = &options.texture {
        if obj.triangles.iter().all(|t| t.uvs.is_none()) {
            return Err(Error::new("has no texture coordinates; --texture cannot be laid on it"));
        }
        bake(&mut painted, &mut lost, &obj, |_| true, &paint::texture(file)?, options);
    } else {
        let place = Place::new(path, options);
        let library = match Library::read(&place, &obj.libraries) {
            // What stands in it is not needed.
            Err(_) if own || options.color.is_some() => Library::default(),
            library => library?,
        };
        let materials = obj.wanted(&library, own || options.color.is_some())?;
        let material = |t: &Triangle| *materials.get(t.material? as usize)?;
        // One texture at a time: decoded, they are large.
        let mut textures = BTreeSet::new();
        for material in obj.triangles.iter().filter(|t| t.uvs.is_some()).filter_map(material) {
            textures.extend(&material.texture);
        }
        let other = own || options.color.is_some();
        for texture in textures {
            let (below, name) = texture;
            let Some(file) = place.texture(below, name, other, &mut notes)? else { continue };
            let wanted =
                |t: &Triangle| material(t).is_some_and(|m| m.texture.as_ref() == Some(texture));
            bake(&mut painted, &mut lost, &obj, wanted, &paint::texture(&file)?, options);
        }
        let colors = obj.triangles.iter().filter_map(material).filter_map(|m| m.color);
        let mut colors = colors.filter(|_| options.color.is_some());
        let first = colors.next();
        let plain = colors.all(|color| Some(color) == first);
        // One flat colour all over is what programs write for none.
        if options.color.is_none() || !plain {
            for triangle in &obj.triangles {
                if let Some(color) = material(triangle).and_then(|m| m.color) {
                    triangle.corners.iter().for_each(|vertex| flat.add(*vertex, color));
                }
            }
        }
    }
    notes.extend(lost.note(obj.triangles.len()));
    let colors = painted.colors().zip(&obj.colors).zip(flat.colors());
    let colors = colors.map(|((painted, own), flat)| painted.or(*own).or(flat)).collect();
    let triangles = obj.triangles.iter().map(|t| t.corners).collect();
    let (points, origin) = far::settled(&obj.points);
    Ok(Rough { points, triangles, colors, origin, notes })
}

/// Lays a texture on the triangles that want it.
fn bake(
    paint: &mut Paint,
    lost: &mut Lost,
    obj: &Obj,
    wanted: impl Fn(&Triangle) -> bool,
    picture: &Picture,
    options: &Options,
) {
    for triangle in obj.triangles.iter().filter(|t| wanted(t)) {
        let Some(uvs) = triangle.uvs else { continue };
        let uvs = uvs.map(|uv| options.v_down(obj.uvs[uv as usize], false));
        let colors = lost.read(picture, uvs, [Wrap::Repeat; 2]);
        triangle.corners.iter().zip(colors).for_each(|(vertex, color)| paint.add(*vertex, color));
    }
}

/// Parses the text of an OBJ file. Polygons are cut into triangles; lines, points, normals, groups
/// and curves are skipped.
fn parse(text: &str) -> Result<Obj> {
    let mut parser = Parser::default();
    let mut lines = lines(text);
    while let Some((number, line)) = lines.next() {
        // A backslash at the end joins the next line; one that ends a comment does not.
        let mut joined = String::new();
        let mut line = line;
        while let Some(part) = line.strip_suffix('\\').filter(|_| !line.starts_with('#')) {
            joined += part;
            joined.push(' ');
            line = lines.next().map_or("", |(_, line)| line);
            if !line.ends_with('\\') {
                joined += line;
            }
        }
        parser
            .line(if joined.is_empty() { line } else { &joined })
            .map_err(|e| Error::new(format_args!("line {number}: {e}")))?;
    }
    let mut obj = parser.obj;
    obj.colors = colors(&parser.colors)?;
    Ok(obj)
}

/// Numbers behind a vertex's position, and how many.
type Behind = ([f32; 4], u8);

/// The colours of vertices, by what numbers there are behind their positions.
///
/// # Errors
/// Seven numbers to a vertex of which neither the fourth nor the last is the same everywhere.
fn colors(behind: &[Behind]) -> Result<Vec<Option<[f32; 3]>>> {
    // `x y z w r g b`, or `x y z r g b a`: w is 1 except in rational curves, a is that of skin.
    let seven = || behind.iter().filter(|(_, count)| *count == 4).map(|(values, _)| *values);
    let weighted = seven().all(|values| values[0] == 1.0);
    let (mut opaque, mut last) = (true, None);
    for [.., alpha] in seven() {
        opaque &= *last.get_or_insert(alpha) == alpha;
    }
    if !weighted && !opaque {
        return Err(Error::new(
            "seven numbers to a vertex, neither `x y z w r g b` with w = 1 nor `x y z r g b a` of \
             one a; export with six",
        ));
    }
    let color = |&([a, b, c, d], count): &Behind| match count {
        4 if weighted => Some([b, c, d]),
        3.. => Some([a, b, c]),
        _ => None,
    };
    let mut colors: Vec<_> = behind.iter().map(color).collect();
    // Colours of 0 to 255 are not in the format, and in many files: there most are above 1, while
    // rounding or an outlier takes few of those of 0 to 1 there.
    let lit = || colors.iter().flatten().flatten().filter(|c| **c > 0.0);
    if 2 * lit().filter(|c| **c > 1.0).count() > lit().count() {
        for color in colors.iter_mut().flatten() {
            *color = color.map(|c| c / 255.0);
        }
    }
    Ok(colors)
}

/// What has been read, and what the next line needs of it.
#[derive(Default)]
struct Parser {
    obj: Obj,
    colors: Vec<Behind>,
    known: HashMap<String, u32>,
    material: Option<u32>,
    cutter: Cutter,
}

impl Parser {
    fn line(&mut self, line: &str) -> Result<()> {
        let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        match keyword {
            "v" => {
                let ([x, y, z, behind @ ..], count) = numbers::<8>(rest)?;
                if count < 3 {
                    return Err(Error::new(format_args!("{count} numbers, a vertex has three")));
                }
                u32::try_from(self.obj.points.len() + 1)
                    .map_err(|_| Error::new("more vertices than can be numbered; decimate"))?;
                self.obj.points.push([x, y, z]);
                let [a, b, c, d, _] = behind.map(|value| value as f32);
                // Of eight numbers nobody says what the last two are.
                let behind = if count == 8 { 3 } else { count - 3 };
                self.colors.push(([a, b, c, d], behind as u8));
            }
            "vt" => {
                let (values, count) = numbers::<2>(rest)?;
                if count == 0 {
                    return Err(Error::new("no texture coordinate after `vt`"));
                }
                self.obj.uvs.push(values.map(|value| value as f32));
            }
            "f" => self.face(rest.split_whitespace())?,
            "usemtl" => {
                let name = rest.trim();
                let next = self.obj.materials.len() as u32;
                let index = *self.known.entry(name.into()).or_insert(next);
                if index == next {
                    self.obj.materials.push(name.into());
                }
                self.material = Some(index);
            }
            "mtllib" => self.obj.libraries.push(rest.trim().into()),
            _ => {}
        }
        Ok(())
    }

    fn face(&mut self, words: SplitWhitespace<'_>) -> Result<()> {
        let obj = &mut self.obj;
        let mut corners: Vec<(u32, Option<u32>)> = Vec::new();
        for word in words.take_while(|word| !word.starts_with('#')) {
            let mut parts = word.split('/');
            let vertex = index(parts.next().unwrap_or_default(), "vertex", obj.points.len())?;
            let uv = match parts.next() {
                None | Some("") => None,
                Some(part) => Some(index(part, "texture coordinate", obj.uvs.len())?),
            };
            corners.push((vertex, uv));
        }
        if corners.len() < 3 {
            return Err(Error::new(format_args!(
                "{} corners; a face needs at least 3",
                corners.len()
            )));
        }
        let places: Vec<_> = corners.iter().map(|(v, _)| obj.points[*v as usize]).collect();
        let material = self.material;
        self.cutter.cut(&places, |triangle| {
            let [a, b, c] = triangle.map(|k| corners[k]);
            let uvs = a.1.zip(b.1).zip(c.1).map(|((a, b), c)| [a, b, c]);
            obj.triangles.push(Triangle { corners: [a.0, b.0, c.0], uvs, material });
        });
        Ok(())
    }
}

impl Obj {
    /// Splits its triangles.
    fn refine(&mut self, finer: &Finer) {
        finer.extend(&mut self.points, mean_point);
        finer.extend(&mut self.colors, |a, b| a.zip(b).map(|(a, b)| mean(a, b)));
        let triangles = finer.pieces.iter().map(|piece| {
            let old = &self.triangles[piece.of as usize];
            let uvs = old.uvs.map(|uvs| {
                let first = self.uvs.len() as u32;
                self.uvs.extend(piece.mix(uvs.map(|uv| self.uvs[uv as usize])));
                [first, first + 1, first + 2]
            });
            Triangle { corners: piece.corners, uvs, material: old.material }
        });
        self.triangles = triangles.collect();
    }

    /// The materials that are named, as the library has them. If none is, the one material of the
    /// library is meant.
    ///
    /// # Errors
    /// Colours that only the library could give, of several materials none of which is named.
    fn wanted<'a>(
        &mut self,
        library: &'a Library,
        colored: bool,
    ) -> Result<Vec<Option<&'a Material>>> {
        if self.triangles.iter().any(|t| t.material.is_some()) {
            return Ok(self.materials.iter().map(|name| library.get(name)).collect());
        }
        let mut all = library.all();
        match (all.next(), all.next()) {
            (None, _) => Ok(Vec::new()),
            (Some(material), None) => {
                self.triangles.iter_mut().for_each(|t| t.material = Some(0));
                Ok(vec![Some(material)])
            }
            _ if colored => Ok(Vec::new()),
            _ => Err(Error::new(
                "no face names a material (usemtl), and there are several; export the scan again, \
                 or give --texture or --colour",
            )),
        }
    }
}

/// Up to `N` finite numbers, and how many there are.
fn numbers<const N: usize>(rest: &str) -> Result<([f64; N], usize)> {
    let mut values = [0.0; N];
    let mut count = 0;
    let words = rest.split_whitespace().take_while(|word| !word.starts_with('#'));
    for (value, word) in values.iter_mut().zip(words) {
        // In f32, as which most are kept.
        let finite = |v: &f64| (*v as f32).is_finite();
        *value = word.parse().ok().filter(finite).ok_or_else(|| {
            Error::new(format_args!("`{word}` is not a finite number; export the scan again"))
        })?;
        count += 1;
    }
    Ok((values, count))
}

/// An index as the file has it, from 1, or from the end if negative; `count` there are so far.
fn index(word: &str, what: &str, count: usize) -> Result<u32> {
    let value: i64 = word
        .parse()
        .map_err(|_| Error::new(format_args!("`{word}` is not the index of a {what}")))?;
    let index = if value < 0 { value.checked_add_unsigned(count as u64) } else { Some(value - 1) };
    let index = index.and_then(|index| usize::try_from(index).ok()).filter(|index| *index < count);
    index.map(|index| index as u32).ok_or_else(|| {
        Error::new(format_args!(
            "{what} index {value} is out of range, there are {count} so far; the file is damaged, \
             export it again"
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::path::PathBuf;
    use tempfile::tempdir;

    fn options() -> Options {
        Options::default()
    }

    fn read_text(text: &str, options: &Options) -> Result<Rough> {
        read(Path::new("scan.obj"), text.as_bytes(), options)
    }

    #[test]
    fn vertices_keep_their_order_and_polygons_become_triangles() {
        let text = "# a comment\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 9 9 9 0 0 0 # unused\n\
                    v 1 1 0 0 0 1\nv 0 1 0 1 1 1\nvn 0 0 1\nf 1//1 2//1 4//1 5//1\nf -5 -4 -2\n";
        let rough = read_text(text, &options()).unwrap();
        assert_eq!(rough.points[2], [9.0; 3]);
        assert_eq!(rough.triangles, [[0, 1, 3], [0, 3, 4], [0, 1, 3]]);
        assert_eq!(rough.colors[3], Some([0.0, 0.0, 1.0]));
    }

    #[test]
    fn colours_up_to_255_are_brought_to_one() {
        let rough = read_text("v 0 0 0 255 0 51\nv 1 0 0 0 0 0\n", &options()).unwrap();
        assert_eq!(rough.colors[0], Some([1.0, 0.0, 0.2]));
    }

    /// A square of two triangles that share an edge but not its texture coordinates: the first
    /// lies on the red left half of the texture, the second on the blue right half.
    fn textured(place: &Path) -> PathBuf {
        let picture = Picture::from_fn(4, 2, |x, y| match (x, y) {
            (0..2, 0) => [200, 0, 0],
            (0..2, _) => [100, 0, 0],
            _ => [0, 0, 200],
        });
        picture.write_png(&place.join("my skin.png")).unwrap();
        fs::write(
            place.join("scan.mtl"),
            "newmtl skin\nKd 0.8 0.8 0.8\nmap_Kd -clamp on C:\\scans\\my skin.png\n\
             newmtl plain\nKd 0.25 0.5 0.75\n",
        )
        .unwrap();
        let path = place.join("scan.obj");
        fs::write(
            &path,
            "mtllib scan.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 5 5 5\nv 6 5 5\nv 5 6 5\n\
             vt 0.125 0.25\nvt 0.25 0.25\nvt 0.25 0.75\nvt 0.75 0.25\nvt 0.75 0.75\n\
             usemtl skin\nf 1/1 2/2 3/3\nf 1/4 3/5 4/5\nusemtl plain\nf 5 6 7\n",
        )
        .unwrap();
        path
    }

    #[test]
    fn a_seam_gets_the_mean_of_its_sides_and_v_points_up() {
        let place = tempdir().unwrap();
        let path = textured(place.path());
        let rough = read(&path, &fs::read(&path).unwrap(), &options()).unwrap();
        let bytes: Vec<_> =
            rough.colors.iter().map(|c| c.unwrap().map(|c| (255.0 * c).round())).collect();
        // v = ¼ is in the lower row, whose red is 100.
        assert_eq!(bytes[1], [100.0, 0.0, 0.0]);
        assert_eq!(bytes[0], [50.0, 0.0, 100.0]);
        assert_eq!(bytes[2], [100.0, 0.0, 100.0]);
        assert_eq!(bytes[3], [0.0, 0.0, 200.0]);
        assert_eq!(rough.colors[4], Some([0.25, 0.5, 0.75]), "the material's flat colour");
        let flipped = Options { flip_v: true, ..options() };
        let rough = read(&path, &fs::read(&path).unwrap(), &flipped).unwrap();
        assert_eq!(rough.colors[1].unwrap()[0], 200.0 / 255.0);
    }

    #[test]
    fn what_is_missing_is_named_unless_it_is_not_needed() {
        let place = tempdir().unwrap();
        let path = textured(place.path());
        let bytes = fs::read(&path).unwrap();
        let message = |options: &Options| read(&path, &bytes, options).err().map(|e| e.to_string());
        fs::rename(place.path().join("my skin.png"), place.path().join("other.png")).unwrap();
        assert!(message(&options()).unwrap().contains("my skin.png: No such file"));
        fs::remove_file(place.path().join("scan.mtl")).unwrap();
        assert!(message(&options()).unwrap().contains("scan.mtl: No such file"));
        let texture = Some(place.path().join("other.png"));
        assert_eq!(message(&Options { texture: texture.clone(), ..options() }), None);
        assert_eq!(message(&Options { color: Some([0.5; 3]), ..options() }), None);
        let bare = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
        let error = read(&path, bare, &Options { texture, ..options() }).err().unwrap();
        assert!(error.to_string().contains("has no texture coordinates"));
    }

    #[test]
    fn damage_is_named_with_its_line() {
        let start = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\n";
        for (line, part) in [
            ("v 1 2", "line 5: 2 numbers"),
            ("v 1 nan 2", "line 5: `nan`"),
            ("v 1 1e99 2", "line 5: `1e99`"),
            ("vt", "line 5: no texture coordinate"),
            ("f 1 2", "line 5: 2 corners"),
            ("f 1 2 4", "line 5: vertex index 4 is out of range, there are 3"),
            ("f 1 2 0", "line 5: vertex index 0"),
            ("f 1 2 -4", "line 5: vertex index -4"),
            ("f 1/1 2/2 3/1", "line 5: texture coordinate index 2"),
            ("f 1 2 -9223372036854775808", "out of range"),
            ("f a b c", "line 5: `a` is not the index"),
        ] {
            let message = parse(&format!("{start}{line}\n")).err().unwrap().to_string();
            assert!(message.contains(part), "{message:?} does not say {part:?}");
        }
    }
}
