//! MATLAB's `.mat` files, version 5: numeric arrays by name.
//!
//! The format is a header of 128 bytes and elements: a type and a length, 32 bits each, and so
//! many bytes, filled up to a multiple of eight. An element may hold another one, compressed.

use crate::error::{Error, Result};
use flate2::read::ZlibDecoder;
use std::io::Read;

/// Size of the header.
const HEADER: usize = 128;
/// No array of numbers shrinks this much; one that claims to takes more memory than its file
/// deserves.
const MOST_COMPRESSED: usize = 64;

/// Types of elements.
mod kind {
    pub(super) const INT32: u32 = 5;
    pub(super) const UINT32: u32 = 6;
    pub(super) const MATRIX: u32 = 14;
    pub(super) const COMPRESSED: u32 = 15;
}

/// A real matrix.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Rows and columns.
    pub size: [usize; 2],
    /// The entries, column by column.
    pub values: Vec<f64>,
}

/// The arrays of a file that have these names, in the order of the names.
///
/// # Errors
/// When the file is not of version 5 or is damaged, or an array is missing, is not a real matrix, or is larger
/// than its file can hold. Memory taken is bounded by a multiple of the bytes given.
pub fn read<const N: usize>(bytes: &[u8], names: [&str; N]) -> Result<[Array; N]> {
    if bytes.starts_with(b"MATLAB 7.3") || bytes.starts_with(b"\x89HDF") {
        return Err(Error::new("a version 7.3 .mat file; save it with -v7 in MATLAB"));
    }
    match bytes.get(124..HEADER) {
        Some([_, 1, b'I', b'M']) => {}
        Some([1, _, b'M', b'I']) => {
            return Err(Error::new("byte 126: a big-endian .mat file; save it again on a PC"));
        }
        _ => return Err(Error::new("not a MATLAB file of version 5; get it again")),
    }
    let mut found: [Option<Array>; N] = [const { None }; N];
    let mut rest = &bytes[HEADER..];
    while !rest.is_empty() {
        let at = bytes.len() - rest.len();
        let fault = |e| Error::new(format_args!("byte {at}: {e}"));
        let (kind, content) = element(&mut rest).map_err(fault)?;
        let name = |content: &[u8]| Matrix::parse(content).map(|matrix| matrix.name.to_vec());
        let wanted = |name: &[u8]| names.iter().position(|wanted| wanted.as_bytes() == name);
        match kind {
            kind::MATRIX => {
                // What is no array of numbers has other parts, and is nothing to us.
                let Ok(matrix) = Matrix::parse(content) else { continue };
                if let Some(i) = wanted(matrix.name) {
                    found[i] = Some(matrix.array().map_err(fault)?);
                }
            }
            kind::COMPRESSED => {
                // As much as the name is in.
                let start = inflate(content, 1024).map_err(fault)?;
                let Ok(name) = start.get(8..).ok_or_else(cut).and_then(name) else { continue };
                let Some(i) = wanted(&name) else { continue };
                let whole = inflate(content, content.len().saturating_mul(MOST_COMPRESSED));
                let whole = whole.map_err(fault)?;
                let matrix = element(&mut &whole[..]).and_then(|(_, m)| Matrix::parse(m)?.array());
                found[i] = Some(matrix.map_err(fault)?);
            }
            _ => {}
        }
    }
    if let Some(i) = found.iter().position(Option::is_none) {
        return Err(Error::new(format_args!(
            "there is no array {}; expected {}",
            names[i],
            names.join(", ")
        )));
    }
    Ok(found.map(|array| array.unwrap_or(Array { size: [0; 2], values: Vec::new() })))
}

fn cut() -> Error {
    Error::new("the file is cut short or damaged; get it again")
}

/// Takes the first element: its type and its bytes.
fn element<'a>(rest: &mut &'a [u8]) -> Result<(u32, &'a [u8])> {
    let word = |bytes: &[u8]| bytes.first_chunk().copied().map(u32::from_le_bytes);
    let first = word(rest).ok_or_else(cut)?;
    // Few bytes lie within the tag, their number in its upper half.
    let (kind, start, length, end) = if first >> 16 != 0 {
        (first & 0xffff, 4, (first >> 16) as usize, 8)
    } else {
        let length = rest.get(4..).and_then(word).ok_or_else(cut)? as usize;
        let filled = if first == kind::COMPRESSED { length } else { length.next_multiple_of(8) };
        (first, 8, length, 8 + filled)
    };
    let content = rest.get(start..start + length).ok_or_else(cut)?;
    // The last element need not be filled up.
    *rest = rest.get(end..).unwrap_or_default();
    Ok((kind, content))
}

/// The beginning of what was compressed.
fn inflate(content: &[u8], most: usize) -> Result<Vec<u8>> {
    let mut whole = Vec::new();
    let read = ZlibDecoder::new(content).take(most as u64).read_to_end(&mut whole);
    match read {
        Ok(_) => Ok(whole),
        Err(e) => Err(Error::new(format_args!("{e}; the file is damaged, get it again"))),
    }
}

/// The parts of a matrix element.
struct Matrix<'a> {
    is_complex: bool,
    size: Vec<usize>,
    name: &'a [u8],
    data: &'a [u8],
}

impl<'a> Matrix<'a> {
    /// The header of the element; its numbers follow and are not looked at.
    fn parse(mut content: &'a [u8]) -> Result<Self> {
        let (kind, flags) = element(&mut content)?;
        if kind != kind::UINT32 || flags.len() != 8 {
            return Err(cut());
        }
        let (kind, size) = element(&mut content)?;
        if kind != kind::INT32 {
            return Err(cut());
        }
        let size = size.as_chunks().0.iter().map(|n| u32::from_le_bytes(*n) as usize).collect();
        let (_, name) = element(&mut content)?;
        Ok(Self { is_complex: flags[1] & 0x08 != 0, size, name, data: content })
    }

    fn array(&self) -> Result<Array> {
        let name = String::from_utf8_lossy(self.name);
        let &[rows, columns] = &self.size[..] else {
            return Err(Error::new(format_args!(
                "{name}: size {:?}, expected a matrix",
                self.size
            )));
        };
        if self.is_complex {
            return Err(Error::new(format_args!("{name}: complex, expected real numbers")));
        }
        let (kind, data) = element(&mut &self.data[..])?;
        let values = numbers(kind, data)
            .ok_or_else(|| Error::new(format_args!("{name}: type {kind}, expected numbers")))?;
        if rows.checked_mul(columns) != Some(values.len()) {
            return Err(Error::new(format_args!(
                "{name}: {} numbers, expected {rows} x {columns}; the file is damaged, get it again",
                values.len()
            )));
        }
        Ok(Array { size: [rows, columns], values })
    }
}

/// Numbers of any stored type.
fn numbers(kind: u32, data: &[u8]) -> Option<Vec<f64>> {
    fn all<const N: usize>(data: &[u8], number: impl Fn([u8; N]) -> f64) -> Vec<f64> {
        data.as_chunks().0.iter().map(|bytes| number(*bytes)).collect()
    }
    Some(match kind {
        1 => all(data, |b| f64::from(i8::from_le_bytes(b))),
        2 => all(data, |b| f64::from(u8::from_le_bytes(b))),
        3 => all(data, |b| f64::from(i16::from_le_bytes(b))),
        4 => all(data, |b| f64::from(u16::from_le_bytes(b))),
        kind::INT32 => all(data, |b| f64::from(i32::from_le_bytes(b))),
        kind::UINT32 => all(data, |b| f64::from(u32::from_le_bytes(b))),
        7 => all(data, |b| f64::from(f32::from_le_bytes(b))),
        9 => all(data, f64::from_le_bytes),
        _ => return None,
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use flate2::Compression;
    use flate2::write::ZlibEncoder;
    use std::io::Write;

    fn tagged(kind: u32, content: &[u8]) -> Vec<u8> {
        let mut bytes = [kind, content.len() as u32].map(u32::to_le_bytes).concat();
        bytes.extend(content);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    }

    /// A matrix element of 32-bit floats.
    pub(crate) fn matrix(name: &str, size: [usize; 2], values: &[f32]) -> Vec<u8> {
        let mut content = tagged(kind::UINT32, &[7, 0, 0, 0, 0, 0, 0, 0]);
        content.extend(tagged(kind::INT32, &size.map(|n| (n as u32).to_le_bytes()).concat()));
        if name.len() <= 4 {
            content.extend((1 | (name.len() as u32) << 16).to_le_bytes());
            content.extend(name.as_bytes());
            content.resize(content.len().next_multiple_of(8), 0);
        } else {
            content.extend(tagged(1, name.as_bytes()));
        }
        let numbers: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        content.extend(tagged(7, &numbers));
        tagged(kind::MATRIX, &content)
    }

    /// The same, compressed.
    pub(crate) fn compressed(element: &[u8]) -> Vec<u8> {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(element).unwrap();
        let content = encoder.finish().unwrap();
        let mut bytes = [kind::COMPRESSED, content.len() as u32].map(u32::to_le_bytes).concat();
        bytes.extend(content);
        bytes
    }

    /// A file of elements.
    pub(crate) fn file(elements: &[Vec<u8>]) -> Vec<u8> {
        let mut bytes = b"MATLAB 5.0 MAT-file".to_vec();
        bytes.resize(124, b' ');
        bytes.extend([0, 1, b'I', b'M']);
        bytes.extend(elements.concat());
        bytes
    }

    fn example() -> Vec<u8> {
        file(&[
            matrix("other", [1, 1], &[9.0]),
            compressed(&matrix("tl", [2, 1], &[1.0, 2.0])),
            compressed(&matrix("skipped", [1, 1], &[0.0])),
            matrix("shapeMU", [3, 2], &[0.5, 1.0, 1.5, 2.0, 2.5, -3.0]),
        ])
    }

    #[test]
    fn arrays_are_found_by_name() {
        let [mean, triangles] = read(&example(), ["shapeMU", "tl"]).unwrap();
        assert_eq!(mean, Array { size: [3, 2], values: vec![0.5, 1.0, 1.5, 2.0, 2.5, -3.0] });
        assert_eq!(triangles, Array { size: [2, 1], values: vec![1.0, 2.0] });
    }

    #[test]
    fn faults_are_named() {
        let says = |bytes: &[u8], part: &str| {
            let message = read(bytes, ["tl", "shapeMU"]).unwrap_err().to_string();
            assert!(message.contains(part), "{message:?} does not say {part:?}");
        };
        says(b"", "not a MATLAB file");
        says(b"MATLAB 7.3 MAT-file", "-v7");
        says(&example()[..example().len() - 9], "cut short");
        says(&file(&[matrix("tl", [1, 1], &[0.0])]), "no array shapeMU");
        says(&file(&[matrix("tl", [2, 1], &[0.0])]), "1 numbers, expected 2 x 1");
        let mut complex = matrix("tl", [1, 1], &[0.0]);
        complex[17] = 0x08;
        says(&file(&[complex]), "complex");
        // A bomb.
        says(&file(&[compressed(&matrix("tl", [1 << 20, 1], &vec![0.0; 1 << 20]))]), "cut short");
    }

    #[test]
    fn damaged_files_are_refused_or_read_but_never_panic() {
        let whole = example();
        for length in 0..whole.len() {
            let _ = read(&whole[..length], ["tl", "shapeMU"]);
        }
        for at in HEADER..whole.len() {
            for value in [0, 1, 0x7f, 0xff] {
                let mut bytes = whole.clone();
                bytes[at] = value;
                let _ = read(&bytes, ["tl", "shapeMU"]);
            }
        }
    }
}
