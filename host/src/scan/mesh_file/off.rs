//! OFF, Geomview's object file format, as text: vertices and polygons, with colours or without.

use super::{Rough, unmarked};
use crate::error::{Error, Result};
use crate::mesh::far;
use crate::mesh::polygon::Cutter;

/// Whether a file begins with one of the format's words.
pub(super) fn is_off(bytes: &[u8]) -> bool {
    let start = unmarked(bytes).trim_ascii_start();
    start.split(u8::is_ascii_whitespace).next().is_some_and(|word| kind(word).is_some())
}

/// What a vertex has before and behind its position, by the file's first word: numbers of a normal, of a
/// texture coordinate, and whether there are colours. Those of other dimensions are not known.
fn kind(word: &[u8]) -> Option<(usize, usize, bool)> {
    let word = word.strip_suffix(b"OFF")?;
    let (texture, word) = word.strip_prefix(b"ST").map_or((0, word), |rest| (2, rest));
    let (color, word) = word.strip_prefix(b"C").map_or((false, word), |rest| (true, rest));
    let (normal, word) = word.strip_prefix(b"N").map_or((0, word), |rest| (3, rest));
    word.is_empty().then_some((normal, texture, color))
}

/// Parses the text of a file. Vertices keep their order; polygons are cut into triangles. Colours are 0 to
/// 255, or 0 to 1 if none is larger; those of a polygon count where vertices have none.
///
/// # Errors
/// Rows that are missing, too short or no numbers, with their line; corners out of range.
pub(super) fn parse(bytes: &[u8]) -> Result<Rough> {
    let text = String::from_utf8_lossy(unmarked(bytes));
    // Comments and blank lines may stand anywhere.
    let plain = |line: &'_ str| line.split('#').next().unwrap_or_default().trim().to_owned();
    let mut rows =
        super::lines(&text).map(|(n, line)| (n, plain(line))).filter(|l| !l.1.is_empty());
    let fault = |line: usize, what: &str| {
        Error::new(format_args!("line {line}: {what}; the file is damaged, export it again"))
    };
    let end = || Error::new("ends before its last row; the file is cut short, export it again");
    let (first, mut line) = rows.next().ok_or_else(end)?;
    let word = line.split_whitespace().next().unwrap_or_default().to_owned();
    let (normal, texture, _) = match kind(word.as_bytes()) {
        Some(kind) => {
            line.replace_range(..word.len(), "");
            kind
        }
        // The word may be left out.
        None if word.parse::<usize>().is_ok() => (0, 0, false),
        None => return Err(fault(first, "not OFF of three dimensions")),
    };
    if line.contains("BINARY") {
        return Err(Error::new("binary OFF, which is not read; export it as text, or as PLY"));
    }
    let (number, counts) =
        if line.trim().is_empty() { rows.next().ok_or_else(end)? } else { (first, line) };
    let counts = numbers(&counts).ok_or_else(|| fault(number, "expected numbers"))?;
    let [vertices, faces, ..] = counts[..] else {
        return Err(fault(number, "expected the numbers of vertices, faces and edges"));
    };
    let (mut points, mut colors, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    while (points.len() as f64) < vertices {
        let (number, row) = rows.next().ok_or_else(end)?;
        let row = numbers(&row).filter(|row| row.len() >= 3 + normal + texture);
        let row = row.ok_or_else(|| fault(number, "expected the numbers of a vertex"))?;
        points.push([row[0], row[1], row[2]]);
        // What is behind position and normal, but for a texture's coordinates, is a colour.
        colors.push(color(&row[3 + normal..row.len() - texture]));
    }
    let mut painted = super::Paint::new(points.len());
    let (mut cutter, mut read) = (Cutter::default(), 0.0);
    while read < faces {
        let (number, row) = rows.next().ok_or_else(end)?;
        let row = numbers(&row).ok_or_else(|| fault(number, "expected the numbers of a face"))?;
        let count = row.first().map_or(0, |count| *count as usize);
        let Some(corners) = row.get(1..=count).filter(|corners| corners.len() > 2) else {
            return Err(fault(number, "a face has fewer corners than it says"));
        };
        let vertex = |c: &f64| (0.0..points.len() as f64).contains(c).then_some(*c as u32);
        let corners: Option<Vec<u32>> = corners.iter().map(vertex).collect();
        let corners =
            corners.ok_or_else(|| fault(number, "a corner is none of the vertices before"))?;
        if let Some(color) = color(&row[1 + count..]) {
            for corner in &corners {
                painted.add(*corner, color);
            }
        }
        let places: Vec<_> = corners.iter().map(|c| points[*c as usize]).collect();
        cutter.cut(&places, |triangle| triangles.push(triangle.map(|k| corners[k])));
        read += 1.0;
    }
    let mut colors: Vec<_> =
        colors.into_iter().zip(painted.colors()).map(|(v, f)| v.or(f)).collect();
    if colors.iter().flatten().flatten().any(|c| *c > 1.0) {
        colors.iter_mut().flatten().for_each(|color| *color = color.map(|c| c / 255.0));
    }
    let (points, origin) = far::settled(&points);
    Ok(Rough { points, triangles, colors, origin, notes: Vec::new() })
}

/// The first three of what may be more, for transparency.
fn color(numbers: &[f64]) -> Option<[f32; 3]> {
    Some(numbers.first_chunk::<3>()?.map(|c| c as f32))
}

fn numbers(row: &str) -> Option<Vec<f64>> {
    row.split_whitespace().map(|word| word.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vertices_and_faces_are_read_with_either_s_colours() {
        let vertices = "COFF # coloured\n4 1 0\n\n0 0 0 255 0 0 255\n1 0 0 0 255 0 255\n\
                        1 1 0 0 0 255 255\n0 1 0 51 51 51 255\n4 0 1 2 3\n";
        let rough = parse(vertices.as_bytes()).unwrap();
        assert_eq!(rough.triangles.len(), 2);
        assert_eq!((rough.colors[0], rough.colors[3]), (Some([1.0, 0.0, 0.0]), Some([0.2; 3])));
        let faces = "OFF 3 1 3\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 0.5 0.25 1\n";
        assert_eq!(parse(faces.as_bytes()).unwrap().colors, [Some([0.5, 0.25, 1.0]); 3]);
        let normals = "NOFF\n3 1 0\n0 0 0 0 0 1\n1 0 0 0 0 1\n0 1 0 0 0 1\n3 0 1 2\n";
        assert_eq!(parse(normals.as_bytes()).unwrap().colors, [None; 3]);
        assert!(is_off(b"STCNOFF\n") && is_off(b"OFF 3") && !is_off(b"4OFF") && !is_off(b"solid"));
    }

    #[test]
    fn what_is_no_off_is_told_with_its_line() {
        for (text, part) in [
            ("", "cut short"),
            ("OFF\n3 1", "cut short"),
            ("OFF\nfour\n", "line 2"),
            ("OFF\n1 1 0\n0 0\n", "line 3"),
            ("OFF\n1 1 0\n0 0 0\n3 0 1 2\n", "none of the vertices"),
            ("OFF\n1 1 0\n0 0 0\n3 0 0\n", "fewer corners"),
            ("OFF\n1 1 0\n0 0 0\n-1\n", "fewer corners"),
            ("OFF BINARY\n", "binary"),
            ("4OFF\n", "three dimensions"),
        ] {
            let message = parse(text.as_bytes()).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(message.contains(part), "{text:?}: {message:?} does not say {part:?}");
        }
    }
}
