//! The numbers in a glTF file's buffers.

use super::MAX_VERTICES;
use crate::error::{Error, Result};
use crate::files;
use crate::scan::mesh_file::named::Place;
use ::gltf::accessor::{DataType, Dimensions};
use ::gltf::{Accessor, Document};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use percent_encoding::percent_decode_str;
use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

/// The bytes of all buffers.
pub(super) struct Buffers {
    /// By index: where its bytes are.
    keys: Vec<Option<String>>,
    blob: Vec<u8>,
    files: HashMap<String, Vec<u8>>,
}

impl Buffers {
    pub(super) fn load(
        document: &Document,
        blob: Option<Vec<u8>>,
        place: &Place<'_>,
    ) -> Result<Self> {
        let mut buffers =
            Self { keys: Vec::new(), blob: blob.unwrap_or_default(), files: HashMap::new() };
        for buffer in &document.as_json().buffers {
            if let Some(uri) = &buffer.uri
                && !buffers.files.contains_key(uri)
            {
                buffers.files.insert(uri.clone(), fetch(place, uri)?.into_owned());
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
    pub(super) fn view(&self, view: &::gltf::buffer::View<'_>) -> Result<&[u8]> {
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

    /// The bytes of an accessor's elements, one after the other, and how many each takes. Without a
    /// buffer view they are zero, until the accessor's sparse part says otherwise.
    fn elements(&self, accessor: &Accessor<'_>) -> Result<(Vec<u8>, usize)> {
        let fault = |what: &str| Error::new(format_args!("accessor {} {what}", accessor.index()));
        let (size, count) = (accessor.size(), accessor.count());
        let mut elements = match accessor.view() {
            Some(view) => {
                let stride = view.stride().unwrap_or(size);
                let chunks = self.chunks(&view, accessor.offset(), size, stride, count);
                chunks.map_err(|e| fault(&e))?.concat()
            }
            None if count > MAX_VERTICES => {
                return Err(fault(&format!("promises {count} elements, without any data")));
            }
            None => vec![0; size * count],
        };
        if let Some(sparse) = accessor.sparse() {
            let (indices, values, changed) = (sparse.indices(), sparse.values(), sparse.count());
            let width = indices.index_type().size();
            let places = self.chunks(&indices.view(), indices.offset(), width, width, changed);
            let values = self.chunks(&values.view(), values.offset(), size, size, changed);
            let (places, values) = (places.map_err(|e| fault(&e))?, values.map_err(|e| fault(&e))?);
            for (place, value) in places.iter().zip(values) {
                let place = index(place) as usize;
                let Some(element) = elements.chunks_exact_mut(size.max(1)).nth(place) else {
                    return Err(fault("changes elements it does not have; export the scan again"));
                };
                element.copy_from_slice(value);
            }
        }
        Ok((elements, size))
    }

    /// So many pieces of a view, each of `size` bytes, `stride` apart.
    fn chunks(
        &self,
        view: &::gltf::buffer::View<'_>,
        offset: usize,
        size: usize,
        stride: usize,
        count: usize,
    ) -> Result<Vec<&[u8]>, String> {
        let stride = stride.max(size).max(1);
        let bytes = self.view(view).map_err(|e| e.to_string())?;
        let bytes = bytes.get(offset..).unwrap_or_default();
        // The last element may end before its stride does.
        let there = (bytes.len() + stride).saturating_sub(size) / stride;
        if there < count {
            return Err(format!(
                "promises {count} elements, its buffer view holds {there}; the file is damaged, \
                 export it again"
            ));
        }
        Ok(bytes.chunks(stride).take(count).map(|chunk| &chunk[..size]).collect())
    }

    /// The numbers of an accessor, the first `N` of each element, integers scaled if the file
    /// says so.
    pub(super) fn numbers<const N: usize>(&self, accessor: &Accessor<'_>) -> Result<Vec<[f32; N]>> {
        self.scaled(accessor, accessor.normalized())
    }

    /// Colours: integers are always scaled, since some programs forget to say so.
    pub(super) fn colors(&self, accessor: &Accessor<'_>) -> Result<Vec<[f32; 3]>> {
        self.scaled(accessor, true)
    }

    fn scaled<const N: usize>(
        &self,
        accessor: &Accessor<'_>,
        scaled: bool,
    ) -> Result<Vec<[f32; N]>> {
        let there = match accessor.dimensions() {
            Dimensions::Scalar => 1,
            Dimensions::Vec2 => 2,
            Dimensions::Vec3 => 3,
            Dimensions::Vec4 => 4,
            Dimensions::Mat4 => 16,
            _ => 0,
        };
        if there < N {
            return Err(Error::new(format_args!(
                "accessor {} has {there} numbers to an element, expected {N}; export again",
                accessor.index()
            )));
        }
        let kind = accessor.data_type();
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
        let (elements, width) = self.elements(accessor)?;
        Ok(elements.chunks_exact(width.max(1)).map(element).collect())
    }

    /// Unsigned integers.
    pub(super) fn indices(&self, accessor: &Accessor<'_>) -> Result<Vec<u32>> {
        match (accessor.data_type(), accessor.dimensions()) {
            (DataType::U8 | DataType::U16 | DataType::U32, Dimensions::Scalar) => {
                let (elements, width) = self.elements(accessor)?;
                Ok(elements.chunks_exact(width.max(1)).map(index).collect())
            }
            _ => Err(Error::new(format_args!(
                "accessor {} does not hold indices; the file is damaged, export it again",
                accessor.index()
            ))),
        }
    }
}

/// An unsigned integer of one, two or four bytes.
fn index(bytes: &[u8]) -> u32 {
    match *bytes {
        [a] => a.into(),
        [a, b] => u16::from_le_bytes([a, b]).into(),
        [a, b, c, d] => u32::from_le_bytes([a, b, c, d]),
        _ => u32::MAX,
    }
}

/// The bytes an address in the document means: data in the address itself, or a file beside.
pub(super) fn fetch<'a>(place: &Place<'_>, uri: &'a str) -> Result<Cow<'a, [u8]>> {
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
    let path = place.find(Path::new(""), &name)?;
    let bytes = files::read(&path).map_err(|e| {
        Error::file(&path, format_args!("{e}; put it there, or export one .glb file"))
    })?;
    Ok(Cow::Owned(bytes))
}
