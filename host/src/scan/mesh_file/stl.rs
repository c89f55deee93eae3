//! STL: triangles without colour and without shared corners, as text or binary.

use super::{Rough, lines, unmarked};
use crate::error::{Error, Result};
use crate::mesh::{far, weld};

/// Bytes before the first triangle of a binary file: a free text and the number of triangles.
const HEADER: usize = 84;
/// Bytes of a triangle: its normal, three corners, and two bytes nobody agrees on.
const FACET: usize = 50;

/// Parses STL; exactly equal corners become one vertex, in order of their first appearance.
///
/// # Errors
/// Text whose facets do not have three corners of three numbers, with the line; a binary file
/// shorter than its header promises.
pub(super) fn parse(bytes: &[u8]) -> Result<Rough> {
    // Binary files may begin with `solid`, too; their length gives them away.
    let promised = bytes
        .get(HEADER - 4..)
        .and_then(<[u8]>::first_chunk)
        .map(|count| u32::from_le_bytes(*count) as usize);
    let length = promised.and_then(|count| count.checked_mul(FACET)?.checked_add(HEADER));
    let (corners, origin) = match (promised, length) {
        (Some(_), Some(length)) if length == bytes.len() => (binary(&bytes[HEADER..]), [0.0; 3]),
        _ if is_text(bytes) => far::settled(&ascii(&String::from_utf8_lossy(unmarked(bytes)))?),
        (Some(count), Some(length)) if length < bytes.len() => {
            (binary(&bytes[HEADER..HEADER + count * FACET]), [0.0; 3])
        }
        (Some(count), _) => {
            return Err(Error::new(format_args!(
                "header: {count} triangles do not fit into the {} bytes that follow; not an STL \
                 file, or cut short: export it again",
                bytes.len() - HEADER
            )));
        }
        (None, _) => return Err(Error::new("not an STL file; export the scan again")),
    };
    if u32::try_from(corners.len()).is_err() {
        return Err(Error::new(format_args!("{} corners are too many; decimate", corners.len())));
    }
    let (map, points) = weld(&corners);
    let triangles =
        map.as_chunks().0.iter().copied().filter(|[a, b, c]| a != b && b != c && c != a);
    let (triangles, colors) = (triangles.collect(), vec![None; points.len()]);
    Ok(Rough { triangles, colors, points, origin, notes: Vec::new() })
}

/// Whether a file begins as text does.
pub(super) fn is_text(bytes: &[u8]) -> bool {
    let start = unmarked(bytes).trim_ascii_start();
    start.get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"))
}

fn binary(facets: &[u8]) -> Vec<[f32; 3]> {
    let mut corners = Vec::with_capacity(3 * (facets.len() / FACET));
    for facet in facets.as_chunks::<FACET>().0 {
        let (numbers, _) = facet.as_chunks::<4>();
        let (vectors, _) = numbers.as_chunks::<3>();
        // The first is the normal, which the corners have, too.
        corners.extend(vectors.iter().skip(1).map(|v| v.map(f32::from_le_bytes)));
    }
    corners
}

fn ascii(text: &str) -> Result<Vec<[f64; 3]>> {
    let mut corners = Vec::new();
    let (mut last, mut whole) = (0, false);
    for (line, content) in lines(text) {
        let fault = |what: std::fmt::Arguments<'_>| {
            Error::new(format_args!("line {line}: {what}; the file is damaged, export it again"))
        };
        let mut words = content.split_whitespace();
        let Some(keyword) = words.next() else { continue };
        last = line;
        match keyword.to_ascii_lowercase().as_str() {
            "vertex" => {
                let mut corner = [0.0; 3];
                for value in &mut corner {
                    let word = words.next().unwrap_or_default();
                    *value = word
                        .parse()
                        .map_err(|_| fault(format_args!("`{word}` is not a coordinate")))?;
                }
                corners.push(corner);
            }
            "endfacet" if !corners.len().is_multiple_of(3) => {
                return Err(fault(format_args!("a facet needs three vertices")));
            }
            "endsolid" => whole = true,
            _ => {}
        }
    }
    if !corners.len().is_multiple_of(3) || !whole {
        return Err(Error::new(format_args!(
            "line {last}: the file ends without `endsolid`; it is cut short, export it again"
        )));
    }
    Ok(corners)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ASCII: &str = "solid a square\n\
        facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 1 1 0\nendloop\nendfacet\n\
        facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 1 0\nvertex 0 1 -0\nendloop\nendfacet\n\
        endsolid\n";

    fn binary_file(start: &[u8]) -> Vec<u8> {
        let mut bytes = start.to_vec();
        bytes.resize(HEADER - 4, b' ');
        bytes.extend(2_u32.to_le_bytes());
        for corners in [[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]] {
            bytes.extend([0; 12]);
            for [x, y] in corners {
                for value in [x as f32, y as f32, 0.0] {
                    bytes.extend(value.to_le_bytes());
                }
            }
            bytes.extend([0xab, 0xcd]);
        }
        bytes
    }

    #[test]
    fn text_and_binary_say_the_same() {
        let capitals = ASCII.to_uppercase();
        let mac = format!("\u{feff}{}", ASCII.replace('\n', "\r"));
        let binary = [&b"made by hand"[..], b"solid lie", b"\xef\xbb\xbfsolid"].map(binary_file);
        for bytes in [ASCII.into(), capitals.into(), mac.into()].into_iter().chain(binary) {
            let rough = parse(&bytes).unwrap();
            assert_eq!(rough.points, [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]]);
            assert_eq!(rough.triangles, [[0, 1, 2], [0, 2, 3]]);
        }
    }

    #[test]
    fn damage_is_named_with_its_place() {
        let bad = |bytes: &[u8], part: &str| {
            let message = parse(bytes).err().unwrap().to_string();
            assert!(message.contains(part), "{message:?} does not say {part:?}");
        };
        bad(b"", "not an STL file");
        bad(ASCII.replace("vertex 1 0 0", "vertex 1 o 0").as_bytes(), "line 5: `o`");
        bad(ASCII.replace("vertex 1 0 0\n", "").as_bytes(), "line 7: a facet needs three");
        bad(&ASCII.as_bytes()[..ASCII.len() - 10], "line 15: the file ends without");
        let whole = binary_file(b"x");
        bad(&whole[..whole.len() - 1], "2 triangles do not fit");
        let mut vast = whole;
        vast[HEADER - 4..HEADER].fill(0xff);
        bad(&vast, "4294967295 triangles do not fit");
    }
}
