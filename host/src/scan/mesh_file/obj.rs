//! Wavefront OBJ with its materials and textures.
//!
//! Parsed here because landmarks name vertices by their place in the file: the crates that read
//! OBJ for rendering number them anew.

use super::paint::{self, Paint, Wrap};
use super::{Options, Rough};
use crate::error::{Error, Result};
use crate::photo::picture::Picture;
use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::str::SplitWhitespace;

/// What an OBJ file says of a surface.
struct Obj {
    points: Vec<[f32; 3]>,
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

/// A material of a library: a flat colour, and the file of its texture.
#[derive(Clone, Debug, Default, PartialEq)]
struct Material {
    color: Option<[f32; 3]>,
    texture: Option<PathBuf>,
}

/// Reads an OBJ file from its bytes. Vertices stay in their order. A vertex is coloured by its
/// corners' texture, or else by itself (`v x y z r g b`), or else by its corners' material.
///
/// # Errors
/// Malformed lines, libraries and textures that are wanted and cannot be read.
pub(super) fn read(path: &Path, bytes: &[u8], options: &Options) -> Result<Rough> {
    let obj = parse(&String::from_utf8_lossy(bytes))?;
    let directory = path.parent().unwrap_or(Path::new(""));
    let mut painted = Paint::new(obj.points.len());
    let mut flat = Paint::new(obj.points.len());
    if let Some(file) = &options.texture {
        if obj.triangles.iter().all(|t| t.uvs.is_none()) {
            return Err(Error::new("has no texture coordinates; --texture cannot be laid on it"));
        }
        bake(&mut painted, &obj, |_| true, &paint::texture(file)?, options);
    } else {
        let library = match library(directory, &obj.libraries) {
            // What stands in it is not needed.
            Err(_) if obj.colors.iter().all(Option::is_some) || options.color.is_some() => {
                HashMap::new()
            }
            library => library?,
        };
        let material = |t: &Triangle| library.get(obj.materials.get(t.material? as usize)?);
        // One texture at a time: decoded, they are large.
        let mut textures = BTreeSet::new();
        for material in obj.triangles.iter().filter(|t| t.uvs.is_some()).filter_map(material) {
            textures.extend(&material.texture);
        }
        for file in textures {
            let wanted =
                |t: &Triangle| material(t).is_some_and(|m| m.texture.as_ref() == Some(file));
            bake(&mut painted, &obj, wanted, &paint::texture(file)?, options);
        }
        for triangle in obj.triangles.iter().filter(|_| options.color.is_none()) {
            if let Some(color) = material(triangle).and_then(|m| m.color) {
                for vertex in triangle.corners {
                    flat.add(vertex, color);
                }
            }
        }
    }
    let colors = painted.colors().zip(&obj.colors).zip(flat.colors());
    let colors = colors.map(|((painted, own), flat)| painted.or(*own).or(flat)).collect();
    let triangles = obj.triangles.iter().map(|t| t.corners).collect();
    Ok(Rough { points: obj.points, triangles, colors })
}

/// Lays a texture on the triangles that want it.
fn bake(
    paint: &mut Paint,
    obj: &Obj,
    wanted: impl Fn(&Triangle) -> bool,
    picture: &Picture,
    options: &Options,
) {
    for triangle in obj.triangles.iter().filter(|t| wanted(t)) {
        let Some(uvs) = triangle.uvs else { continue };
        for (&vertex, uv) in triangle.corners.iter().zip(uvs) {
            let uv = options.v_down(obj.uvs[uv as usize], false);
            paint.add(vertex, paint::sample(picture, uv, [Wrap::Repeat; 2]));
        }
    }
}

/// Parses the text of an OBJ file. Polygons are cut into fans; lines, points, normals, groups
/// and curves are skipped.
fn parse(text: &str) -> Result<Obj> {
    let mut obj = Obj {
        points: Vec::new(),
        colors: Vec::new(),
        uvs: Vec::new(),
        triangles: Vec::new(),
        materials: Vec::new(),
        libraries: Vec::new(),
    };
    let mut known = HashMap::new();
    let mut material = None;
    for (number, line) in text.lines().enumerate() {
        obj.line(line.trim(), &mut known, &mut material)
            .map_err(|e| Error::new(format_args!("line {}: {e}", number + 1)))?;
    }
    // Colours of 0 to 255 are not in the format, and in many files.
    if obj.colors.iter().flatten().flatten().any(|&c| c > 1.0) {
        for color in obj.colors.iter_mut().flatten() {
            *color = color.map(|c| c / 255.0);
        }
    }
    Ok(obj)
}

impl Obj {
    fn line(
        &mut self,
        line: &str,
        known: &mut HashMap<String, u32>,
        material: &mut Option<u32>,
    ) -> Result<()> {
        let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        match keyword {
            "v" => {
                let (values, count) = numbers(rest)?;
                if count < 3 {
                    return Err(Error::new(format_args!("{count} numbers, a vertex has three")));
                }
                u32::try_from(self.points.len() + 1)
                    .map_err(|_| Error::new("more vertices than can be numbered; decimate"))?;
                self.points.push([values[0], values[1], values[2]]);
                self.colors.push((count >= 6).then_some([values[3], values[4], values[5]]));
            }
            "vt" => {
                let (values, count) = numbers(rest)?;
                if count == 0 {
                    return Err(Error::new("no texture coordinate after `vt`"));
                }
                self.uvs.push([values[0], values[1]]);
            }
            "f" => self.face(rest.split_whitespace(), *material)?,
            "usemtl" => {
                let name = rest.trim();
                let next = self.materials.len() as u32;
                let index = *known.entry(name.into()).or_insert(next);
                if index == next {
                    self.materials.push(name.into());
                }
                *material = Some(index);
            }
            "mtllib" => self.libraries.push(rest.trim().into()),
            _ => {}
        }
        Ok(())
    }

    fn face(&mut self, words: SplitWhitespace<'_>, material: Option<u32>) -> Result<()> {
        let mut corners: Vec<(u32, Option<u32>)> = Vec::new();
        for word in words.take_while(|word| !word.starts_with('#')) {
            let mut parts = word.split('/');
            let vertex = index(parts.next().unwrap_or_default(), "vertex", self.points.len())?;
            let uv = match parts.next() {
                None | Some("") => None,
                Some(part) => Some(index(part, "texture coordinate", self.uvs.len())?),
            };
            corners.push((vertex, uv));
        }
        if corners.len() < 3 {
            return Err(Error::new(format_args!(
                "{} corners; a face needs at least 3",
                corners.len()
            )));
        }
        for edge in corners[1..].windows(2) {
            let [a, b, c] = [corners[0], edge[0], edge[1]];
            let uvs = a.1.zip(b.1).zip(c.1).map(|((a, b), c)| [a, b, c]);
            self.triangles.push(Triangle { corners: [a.0, b.0, c.0], uvs, material });
        }
        Ok(())
    }
}

/// Up to eight finite numbers, and how many there are.
fn numbers(rest: &str) -> Result<([f32; 8], usize)> {
    let mut values = [0.0; 8];
    let mut count = 0;
    let words = rest.split_whitespace().take_while(|word| !word.starts_with('#'));
    for (value, word) in values.iter_mut().zip(words) {
        *value = word.parse().ok().filter(|v: &f32| v.is_finite()).ok_or_else(|| {
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

/// Reads the libraries a file names, one or several to a line, in names that may hold spaces.
fn library(directory: &Path, lines: &[String]) -> Result<HashMap<String, Material>> {
    let mut materials = HashMap::new();
    for line in lines {
        let whole = located(directory, line);
        let files = if whole.is_file() {
            vec![whole]
        } else {
            line.split_whitespace().map(|name| located(directory, name)).collect()
        };
        for file in files {
            let bytes = std::fs::read(&file).map_err(|e| {
                Error::file(
                    &file,
                    format_args!("{e}; put the materials there, or give --texture or --colour"),
                )
            })?;
            let directory = file.parent().unwrap_or(directory);
            parse_library(&String::from_utf8_lossy(&bytes), directory, &mut materials)
                .map_err(|e| Error::file(&file, e))?;
        }
    }
    Ok(materials)
}

/// A file named in another: beside it, also if the name is a path of the author's machine.
fn located(directory: &Path, name: &str) -> PathBuf {
    let name = name.trim().trim_matches('"').replace('\\', "/");
    let path = directory.join(&name);
    let beside = directory.join(name.rsplit('/').next().unwrap_or(&name));
    if !path.is_file() && beside.is_file() { beside } else { path }
}

fn parse_library(
    text: &str,
    directory: &Path,
    materials: &mut HashMap<String, Material>,
) -> Result<()> {
    let mut name = None;
    for (number, line) in text.lines().enumerate() {
        let fault = |e: Error| Error::new(format_args!("line {}: {e}", number + 1));
        let line = line.trim();
        let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        if keyword == "newmtl" {
            materials.entry(rest.into()).or_default();
            name = Some(rest);
        }
        let Some(material) = name.and_then(|name| materials.get_mut(name)) else { continue };
        match keyword {
            // Other notations (`Kd spectral`, `Kd xyz`) are left alone.
            "Kd" if rest.starts_with(|c: char| c.is_ascii_digit() || c == '.') => {
                let ([r, g, b, ..], count) = numbers(rest).map_err(fault)?;
                let color = if count < 3 { [r; 3] } else { [r, g, b] };
                material.color = Some(color.map(|c| c.clamp(0.0, 1.0)));
            }
            "map_Kd" => {
                material.texture = Some(located(directory, texture_name(rest).map_err(fault)?));
            }
            _ => {}
        }
    }
    Ok(())
}

/// The file name of a `map_Kd` line, behind its options.
fn texture_name(mut rest: &str) -> Result<&str> {
    while rest.starts_with('-') {
        let (option, mut after) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
        if matches!(option, "-o" | "-s" | "-t") {
            return Err(Error::new(format_args!(
                "textures that are moved or scaled ({option}) are not read; export without"
            )));
        }
        // Arguments are numbers, on, off, or a channel; what remains is the name.
        loop {
            let (word, next) =
                after.trim_start().split_once(char::is_whitespace).unwrap_or((after, ""));
            let channel = option == "-imfchan" && word.len() == 1;
            if !(channel || matches!(word, "on" | "off") || word.parse::<f32>().is_ok()) {
                break;
            }
            after = next;
        }
        rest = after.trim_start();
    }
    if rest.is_empty() {
        return Err(Error::new("map_Kd names no file"));
    }
    Ok(rest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use tempfile::tempdir;

    fn options() -> Options {
        Options::default()
    }

    fn read_text(text: &str, options: &Options) -> Result<Rough> {
        read(Path::new("scan.obj"), text.as_bytes(), options)
    }

    #[test]
    fn vertices_keep_their_order_and_polygons_become_fans() {
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

    #[test]
    fn options_of_textures_are_skipped() {
        assert_eq!(texture_name("a b.png").unwrap(), "a b.png");
        assert_eq!(texture_name("-blendu on -bm 0.5 -imfchan r a.png").unwrap(), "a.png");
        assert_eq!(texture_name("-clamp on").ok(), None);
        assert!(texture_name("-s 2 2 2 a.png").is_err());
    }
}
