//! Checked, zero-copy view of a `.3dmm` model, in RAM or in flash.
//!
//! # File layout, version 1
//! Little-endian; every section starts at a multiple of 64 bytes, gaps are zero.
//!
//! | offset | size | field |
//! |---|---|---|
//! | 0 | 8 | magic `89 33 44 4D 4D 0D 0A 1A` |
//! | 8 | 4 | version, 1 |
//! | 12 | 4 | vertices `V` |
//! | 16 | 8 | checksum: FNV-1a 64 of every byte from offset 24 on |
//! | 24 | 8 | length of the file |
//! | 32 | 4 | triangles `T` |
//! | 36 | 4 | shape rank |
//! | 40 | 4 | albedo rank |
//! | 44 | 4 | landmarks `L` |
//! | 48 | 4 | bytes per vertex index: 2 (`V ≤ 65536`) or 4 |
//! | 52 | 4 | how bases are stored: 0 = i16 in quanta |
//! | 56 | 8 | total shape variance, f64, mm² (trace of the covariance before truncation) |
//! | 64 | 8 | total albedo variance, f64 |
//! | 72 | 96 | twelve sections: offset in units of 64 bytes (u32), length in bytes (u32) |
//! | 168 | 8 | section 12, likewise; zero if there is none |
//! | 176 | 16 | zero |
//!
//! Sections: 0 shape mean, 1 shape basis, 2 shape variance (per component), 3 shape quantum (per
//! component), 4 to 7 the same of the albedo, 8 triangles, 9 landmarks (`u32` vertex, name offset,
//! name length), 10 landmark names, 11 provenance; 12, which a model need not have, occlusion (a
//! byte per vertex: 255 times the prior probability that the surface is hidden there). Means and
//! variances are f32, bases i16; fields and bases are laid out as [`crate::basis`] says.

use crate::basis::{BLOCK, Basis, field_len, padded};
use crate::hash;
use core::fmt;

/// First eight bytes of a model; like PNG's, they catch text-mode damage.
pub const MAGIC: [u8; 8] = *b"\x893DMM\r\n\x1a";
/// The version this build reads and writes.
pub const VERSION: u32 = 1;
/// Size of the header, and the offset of the first section.
pub const HEADER_BYTES: usize = 192;
/// Alignment of sections within the file.
pub const SECTION_ALIGN: usize = 64;
/// First byte covered by the checksum.
pub const CHECKED_FROM: usize = 24;
/// The most triangles a mesh may have: their indices fit into the low bits of a float.
pub const MAX_TRIANGLES: usize = 1 << 23;
/// Where the section table starts.
pub const TABLE_AT: usize = 72;

/// The sections, in file order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Section {
    ShapeMean,
    ShapeBasis,
    ShapeVariance,
    ShapeQuantum,
    AlbedoMean,
    AlbedoBasis,
    AlbedoVariance,
    AlbedoQuantum,
    Triangles,
    Landmarks,
    Names,
    Provenance,
    Occlusion,
}

impl Section {
    /// All that every model has, in file order; [`Section::Occlusion`] follows.
    pub const ALL: [Self; 12] = [
        Self::ShapeMean,
        Self::ShapeBasis,
        Self::ShapeVariance,
        Self::ShapeQuantum,
        Self::AlbedoMean,
        Self::AlbedoBasis,
        Self::AlbedoVariance,
        Self::AlbedoQuantum,
        Self::Triangles,
        Self::Landmarks,
        Self::Names,
        Self::Provenance,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::ShapeMean => "shape mean",
            Self::ShapeBasis => "shape basis",
            Self::ShapeVariance => "shape variance",
            Self::ShapeQuantum => "shape quantum",
            Self::AlbedoMean => "albedo mean",
            Self::AlbedoBasis => "albedo basis",
            Self::AlbedoVariance => "albedo variance",
            Self::AlbedoQuantum => "albedo quantum",
            Self::Triangles => "triangles",
            Self::Landmarks => "landmarks",
            Self::Names => "landmark names",
            Self::Provenance => "provenance",
            Self::Occlusion => "occlusion",
        }
    }
}

/// Why bytes are not a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum ModelError {
    /// The slice does not start at a multiple of four bytes.
    Misaligned,
    /// The first bytes are not [`MAGIC`].
    NotAModel,
    /// Another format version.
    Version { found: u32 },
    /// Fewer or more bytes than the header says.
    Length { found: u64, expected: u64 },
    /// The checksum does not match: the bytes are damaged.
    Checksum,
    /// A header field has a value that no model has.
    Header { offset: u32 },
    /// A section lies outside the file or has the wrong length.
    SectionBounds { section: Section },
    /// A section holds something that is not allowed there.
    Content { section: Section, index: u32 },
}

impl fmt::Display for ModelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Misaligned => write!(f, "model bytes must start at a multiple of 4 bytes"),
            Self::NotAModel => write!(f, "byte 0: not a .3dmm model (no 3DMM signature)"),
            Self::Version { found } => write!(
                f,
                "byte 8: .3dmm version {found}, this build reads version {VERSION}; build it again"
            ),
            Self::Length { found, expected } => write!(
                f,
                "byte 24: {found} bytes, but the header says {expected}; the file is incomplete"
            ),
            Self::Checksum => {
                write!(f, "byte 16: the checksum does not match; the file is damaged")
            }
            Self::Header { offset } => {
                write!(f, "byte {offset}: header field out of range; the file is damaged")
            }
            Self::SectionBounds { section } => {
                write!(f, "section {}: wrong place or length; the file is damaged", section.name())
            }
            Self::Content { section, index } => write!(
                f,
                "section {}: entry {index} is out of range or not finite; the file is damaged",
                section.name()
            ),
        }
    }
}

impl core::error::Error for ModelError {}

/// Corner indices of the triangles, counter-clockwise seen from outside; all below the number of
/// vertices.
#[derive(Clone, Copy, Debug)]
pub enum Triangles<'a> {
    /// Meshes of at most 65,536 vertices.
    U16(&'a [[u16; 3]]),
    /// Larger meshes.
    U32(&'a [[u32; 3]]),
}

impl Triangles<'_> {
    /// Number of triangles.
    pub fn len(&self) -> usize {
        match self {
            Self::U16(t) => t.len(),
            Self::U32(t) => t.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Corners of triangle `index`, `None` past the end.
    pub fn get(&self, index: usize) -> Option<[u32; 3]> {
        match self {
            Self::U16(t) => t.get(index).map(|t| t.map(u32::from)),
            Self::U32(t) => t.get(index).copied(),
        }
    }
}

/// A checked model.
#[derive(Clone, Copy, Debug)]
pub struct Model<'a> {
    vertices: usize,
    checksum: u64,
    /// Vertex positions, millimetres.
    pub shape: Basis<'a>,
    /// Vertex albedo, RGB in `[0, 1]`.
    pub albedo: Basis<'a>,
    /// The mesh's faces.
    pub triangles: Triangles<'a>,
    landmarks: &'a [[u32; 3]],
    names: &'a str,
    provenance: &'a str,
    occlusion: Option<&'a [u8]>,
}

impl<'a> Model<'a> {
    /// Checks the bytes and gives the view. After this every vertex index is in range, every
    /// number finite, every name valid UTF-8; the bytes must not change while the view lives
    /// (the borrow sees to it).
    ///
    /// # Errors
    /// See [`ModelError`]; a checksum mismatch is found before anything else in the content.
    pub fn new_checked(bytes: &'a [u8]) -> Result<Self, ModelError> {
        if bytes.as_ptr().align_offset(4) != 0 {
            return Err(ModelError::Misaligned);
        }
        if bytes.first_chunk() != Some(&MAGIC) {
            return Err(ModelError::NotAModel);
        }
        let short = |expected: u64| ModelError::Length { found: bytes.len() as u64, expected };
        if bytes.len() < HEADER_BYTES {
            return Err(short(HEADER_BYTES as u64));
        }
        let header = Header(bytes);
        let found = header.u32(8);
        if found != VERSION {
            return Err(ModelError::Version { found });
        }
        let expected = header.u64(24);
        if expected != bytes.len() as u64 {
            return Err(short(expected));
        }
        let checksum = header.u64(16);
        if hash::fnv64(bytes.get(CHECKED_FROM..).unwrap_or_default()) != checksum {
            return Err(ModelError::Checksum);
        }
        Self::from_header(&header, checksum)
    }

    fn from_header(header: &Header<'a>, checksum: u64) -> Result<Self, ModelError> {
        let vertices = header.u32(12) as usize;
        let index_bytes = header.u32(48);
        // One block short of overflow in `padded` on 32-bit targets.
        if vertices == 0 || vertices > (1 << 28) {
            return Err(ModelError::Header { offset: 12 });
        }
        if !(index_bytes == 4 || index_bytes == 2 && vertices <= 65_536) {
            return Err(ModelError::Header { offset: 48 });
        }
        if header.u32(52) != 0 {
            return Err(ModelError::Header { offset: 52 });
        }
        let shape = [
            Section::ShapeMean,
            Section::ShapeBasis,
            Section::ShapeVariance,
            Section::ShapeQuantum,
        ];
        let shape = header.basis(vertices, shape, header.u32(36), 56)?;
        let albedo = [
            Section::AlbedoMean,
            Section::AlbedoBasis,
            Section::AlbedoVariance,
            Section::AlbedoQuantum,
        ];
        let albedo = header.basis(vertices, albedo, header.u32(40), 64)?;

        let count = header.u32(32) as usize;
        if count == 0 || count > MAX_TRIANGLES {
            return Err(ModelError::Header { offset: 32 });
        }
        let bad_triangle =
            |index: usize| ModelError::Content { section: Section::Triangles, index: index as u32 };
        let triangles = if index_bytes == 2 {
            let t: &[[u16; 3]] = header.section(Section::Triangles, count)?;
            if let Some(i) = t.iter().position(|t| t.iter().any(|&v| usize::from(v) >= vertices)) {
                return Err(bad_triangle(i));
            }
            Triangles::U16(t)
        } else {
            let t: &[[u32; 3]] = header.section(Section::Triangles, count)?;
            if let Some(i) = t.iter().position(|t| t.iter().any(|&v| v as usize >= vertices)) {
                return Err(bad_triangle(i));
            }
            Triangles::U32(t)
        };

        let landmarks: &[[u32; 3]] = header.section(Section::Landmarks, header.u32(44) as usize)?;
        let names = header.text(Section::Names)?;
        let name_fits = |&[_, at, len]: &[u32; 3]| {
            let end = (at as usize).checked_add(len as usize);
            end.is_some_and(|end| names.get(at as usize..end).is_some())
        };
        if let Some(index) =
            landmarks.iter().position(|l| l[0] as usize >= vertices || !name_fits(l))
        {
            let index = index as u32;
            return Err(ModelError::Content { section: Section::Landmarks, index });
        }
        Ok(Self {
            vertices,
            checksum,
            shape,
            albedo,
            triangles,
            landmarks,
            names,
            provenance: header.text(Section::Provenance)?,
            occlusion: header.optional(Section::Occlusion, vertices)?,
        })
    }

    /// A mesh of so many vertices without landmarks and names, whose bases have as many and whose triangles
    /// no others; `None` if a basis has not.
    pub(crate) fn part(
        vertices: usize,
        shape: Basis<'a>,
        albedo: Basis<'a>,
        triangles: Triangles<'a>,
    ) -> Option<Self> {
        let fits = |basis: &Basis<'_>| basis.mean().len() == field_len(vertices);
        (fits(&shape) && fits(&albedo)).then_some(Self {
            vertices,
            checksum: 0,
            shape,
            albedo,
            triangles,
            landmarks: &[],
            names: "",
            provenance: "",
            occlusion: None,
        })
    }

    /// Number of vertices.
    pub fn vertices(&self) -> usize {
        self.vertices
    }

    /// The file's checksum, by which this model is told from others.
    pub fn checksum(&self) -> u64 {
        self.checksum
    }

    /// Landmarks: name and vertex.
    pub fn landmarks(&self) -> impl ExactSizeIterator<Item = (&'a str, u32)> + use<'a> {
        let names = self.names;
        self.landmarks.iter().map(move |&[vertex, at, len]| {
            (names.get(at as usize..(at + len) as usize).unwrap_or(""), vertex)
        })
    }

    /// The vertex of a landmark.
    pub fn landmark(&self, name: &str) -> Option<u32> {
        self.landmarks().find(|&(n, _)| n == name).map(|(_, vertex)| vertex)
    }

    /// Where the model comes from: `key = value` lines (scan, kernels, ranks, captured variance).
    pub fn provenance(&self) -> &'a str {
        self.provenance
    }

    /// Where the surface is likely to be hidden, by hair say, before a picture is seen: per vertex
    /// the probability times 255. `None` if the model does not know.
    pub fn occlusion(&self) -> Option<&'a [u8]> {
        self.occlusion
    }
}

/// Reads fields of the header and the sections it describes.
struct Header<'a>(&'a [u8]);

impl<'a> Header<'a> {
    /// The bytes have been found to be as many as a header's, so none is missing.
    fn u32(&self, offset: usize) -> u32 {
        let field = self.0.get(offset..).and_then(|rest| rest.first_chunk());
        u32::from_le_bytes(field.copied().unwrap_or_default())
    }

    fn u64(&self, offset: usize) -> u64 {
        u64::from(self.u32(offset)) | u64::from(self.u32(offset + 4)) << 32
    }

    fn bytes(&self, section: Section) -> Result<&'a [u8], ModelError> {
        let entry = TABLE_AT + 8 * section as usize;
        let start = self.u32(entry) as usize;
        let error = ModelError::SectionBounds { section };
        let start = start.checked_mul(SECTION_ALIGN).ok_or(error)?;
        let end = start.checked_add(self.u32(entry + 4) as usize).ok_or(error)?;
        self.0.get(start..end).ok_or(error)
    }

    fn section<T: bytemuck::Pod>(
        &self,
        section: Section,
        count: usize,
    ) -> Result<&'a [T], ModelError> {
        let error = ModelError::SectionBounds { section };
        let items: &[T] = bytemuck::try_cast_slice(self.bytes(section)?).map_err(|_| error)?;
        if items.len() == count { Ok(items) } else { Err(error) }
    }

    /// A section that an entry of zeros says is absent.
    fn optional(&self, section: Section, count: usize) -> Result<Option<&'a [u8]>, ModelError> {
        if self.u64(TABLE_AT + 8 * section as usize) == 0 {
            return Ok(None);
        }
        self.section(section, count).map(Some)
    }

    fn text(&self, section: Section) -> Result<&'a str, ModelError> {
        core::str::from_utf8(self.bytes(section)?)
            .map_err(|e| ModelError::Content { section, index: e.valid_up_to() as u32 })
    }

    /// The basis in four sections.
    fn basis(
        &self,
        vertices: usize,
        [mean, columns, variance, quantum]: [Section; 4],
        rank: u32,
        total_at: usize,
    ) -> Result<Basis<'a>, ModelError> {
        let blocks = 3 * padded(vertices) / BLOCK;
        let rank = rank as usize;
        let count =
            blocks.checked_mul(rank).ok_or(ModelError::SectionBounds { section: columns })?;
        let total_variance = f64::from_bits(self.u64(total_at));
        if !total_variance.is_finite() || total_variance < 0.0 {
            return Err(ModelError::Header { offset: total_at as u32 });
        }
        let basis = Basis {
            mean: self.section(mean, blocks)?,
            columns: self.section(columns, count)?,
            variance: self.section(variance, rank)?,
            quantum: self.section(quantum, rank)?,
            total_variance,
        };
        for (section, numbers) in [
            (mean, basis.mean.as_flattened()),
            (variance, basis.variance),
            (quantum, basis.quantum),
        ] {
            if let Some(index) = numbers.iter().position(|x| !x.is_finite()) {
                return Err(ModelError::Content { section, index: index as u32 });
            }
        }
        Ok(basis)
    }
}
