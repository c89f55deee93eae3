//! TensorFlow Lite models, as far as convolutional networks of floats go: a `FlatBuffer`, every offset
//! of which is checked before it is followed.
//!
//! A table begins with the distance back to its list of fields; each field is at an offset from the
//! table, or absent (offset 0), and then has its default. Vectors and strings begin with their
//! length. Numbers are little-endian. The tables' fields are numbered as in TensorFlow's
//! `schema.fbs`.

use super::network::{Kind, Network, Node, Padding, Tensor};

/// What is wrong with a file.
type Fault = &'static str;

const TRUNCATED: Fault = "truncated or damaged";

/// A position in a file.
#[derive(Clone, Copy)]
struct Table<'a> {
    bytes: &'a [u8],
    at: usize,
}

fn number<const N: usize>(bytes: &[u8], at: usize) -> Result<[u8; N], Fault> {
    bytes.get(at..).and_then(|rest| rest.first_chunk()).copied().ok_or(TRUNCATED)
}

fn offset(bytes: &[u8], at: usize) -> Result<usize, Fault> {
    let distance = u32::from_le_bytes(number(bytes, at)?) as usize;
    at.checked_add(distance).ok_or(TRUNCATED)
}

/// A vector: where its elements begin, and how many there are.
#[derive(Clone, Copy)]
struct Vector {
    at: usize,
    length: usize,
}

impl<'a> Table<'a> {
    fn root(bytes: &'a [u8]) -> Result<Self, Fault> {
        Ok(Self { bytes, at: offset(bytes, 0)? })
    }

    /// Where a field is, if it is not at its default.
    fn field(&self, number_of: usize) -> Result<Option<usize>, Fault> {
        let back = i32::from_le_bytes(number(self.bytes, self.at)?);
        let fields = self.at.checked_add_signed((back as isize).wrapping_neg()).ok_or(TRUNCATED)?;
        let size = u16::from_le_bytes(number(self.bytes, fields)?) as usize;
        let entry = 4 + 2 * number_of;
        if entry + 2 > size {
            return Ok(None);
        }
        let at = u16::from_le_bytes(number(self.bytes, fields + entry)?) as usize;
        Ok(if at == 0 { None } else { Some(self.at + at) })
    }

    fn byte(&self, field: usize) -> Result<i8, Fault> {
        self.field(field)?.map_or(Ok(0), |at| Ok(i8::from_le_bytes(number(self.bytes, at)?)))
    }

    fn int(&self, field: usize) -> Result<i32, Fault> {
        self.field(field)?.map_or(Ok(0), |at| Ok(i32::from_le_bytes(number(self.bytes, at)?)))
    }

    /// A count or an index.
    fn size(&self, field: usize) -> Result<usize, Fault> {
        usize::try_from(self.int(field)?).map_err(|_| "a size is negative")
    }

    fn table(&self, field: usize) -> Result<Option<Self>, Fault> {
        let follow = |at| Ok(Self { bytes: self.bytes, at: offset(self.bytes, at)? });
        self.field(field)?.map(follow).transpose()
    }

    /// A vector whose elements take so many bytes each.
    fn vector(&self, field: usize, element: usize) -> Result<Vector, Fault> {
        let Some(at) = self.field(field)? else { return Ok(Vector { at: 0, length: 0 }) };
        let at = offset(self.bytes, at)?;
        let length = u32::from_le_bytes(number(self.bytes, at)?) as usize;
        let whole = length.checked_mul(element).and_then(|bytes| bytes.checked_add(at + 4));
        if whole.is_none_or(|end| end > self.bytes.len()) {
            return Err(TRUNCATED);
        }
        Ok(Vector { at: at + 4, length })
    }

    /// The tables of a vector.
    fn tables(&self, field: usize) -> Result<Vec<Self>, Fault> {
        let Vector { at, length } = self.vector(field, 4)?;
        let table = |i| Ok(Self { bytes: self.bytes, at: offset(self.bytes, at + 4 * i)? });
        (0..length).map(table).collect()
    }

    fn bytes(&self, field: usize) -> Result<&'a [u8], Fault> {
        let Vector { at, length } = self.vector(field, 1)?;
        Ok(&self.bytes[at..at + length])
    }

    fn sizes(&self, field: usize) -> Result<Vec<usize>, Fault> {
        let Vector { at, length } = self.vector(field, 4)?;
        let element = |i| {
            let value = i32::from_le_bytes(number(self.bytes, at + 4 * i)?);
            usize::try_from(value).map_err(|_| "a size or index is negative")
        };
        (0..length).map(element).collect()
    }
}

/// A number of 16 bits.
fn half(bits: u16) -> f32 {
    let sign = u32::from(bits >> 15) << 31;
    let (exponent, fraction) = (u32::from(bits >> 10 & 31), u32::from(bits & 1023));
    match exponent {
        0 => {
            let size = fraction as f32 / 16_777_216.0;
            if sign == 0 { size } else { -size }
        }
        31 => f32::from_bits(sign | 0x7f80_0000 | fraction << 13),
        _ => f32::from_bits(sign | (exponent + 112) << 23 | fraction << 13),
    }
}

/// Kinds of a tensor's elements.
const FLOAT: i8 = 0;
const HALF: i8 = 1;
const INT: i8 = 2;

/// A tensor: its shape as batch, rows, columns and channels, and what it holds if that is constant.
fn tensor(table: &Table<'_>, buffers: &[Table<'_>]) -> Result<Tensor, Fault> {
    let sizes = table.sizes(0)?;
    let mut shape = [1; 4];
    let free = 4_usize.checked_sub(sizes.len()).ok_or("a tensor has more than four dimensions")?;
    shape[free..].copy_from_slice(&sizes);
    let buffer = buffers.get(table.size(2)?).ok_or(TRUNCATED)?;
    let bytes = buffer.bytes(0)?;
    let (mut floats, mut ints) = (None, Vec::new());
    if !bytes.is_empty() {
        let words = || bytes.as_chunks().0.iter();
        match table.byte(1)? {
            FLOAT => floats = Some(words().map(|w| f32::from_le_bytes(*w)).collect()),
            HALF => {
                let halves = bytes.as_chunks().0.iter();
                floats = Some(halves.map(|h| half(u16::from_le_bytes(*h))).collect());
            }
            INT => ints = words().map(|w| i32::from_le_bytes(*w)).collect(),
            _ => return Err("a constant is of a type that is not known"),
        }
    }
    Ok(Tensor { shape, rank: sizes.len(), floats, ints })
}

/// What an operator's code stands for, with its options, and whether a rectifier follows.
fn kind(code: i32, options: Option<Table<'_>>) -> Result<(Kind, bool), Fault> {
    let int = |field| options.map_or(Ok(0), |options| options.size(field));
    let byte = |field| options.map_or(Ok(0), |options| options.byte(field));
    let padding = || match byte(0)? {
        0 => Ok(Padding::Same),
        1 => Ok(Padding::Valid),
        _ => Err("a padding is not known"),
    };
    let strides = || Ok::<_, Fault>([int(2)?, int(1)?]);
    let dilated = |at: usize| Ok::<_, Fault>([int(at)?, int(at + 1)?].iter().any(|d| *d > 1));
    let (kind, activation) = match code {
        0 => (Kind::Add, byte(0)?),
        2 => (Kind::Concatenation { axis: int(0)? }, byte(1)?),
        3 if !dilated(4)? => {
            (Kind::Convolution { padding: padding()?, strides: strides()? }, byte(3)?)
        }
        4 if !dilated(5)? => {
            (Kind::Depthwise { padding: padding()?, strides: strides()? }, byte(4)?)
        }
        6 => (Kind::Dequantize, 0),
        17 => {
            let window = [int(4)?, int(3)?];
            (Kind::MaxPool { padding: padding()?, strides: strides()?, window }, byte(5)?)
        }
        19 => (Kind::Relu, 0),
        22 => (Kind::Reshape, 0),
        34 => (Kind::Pad, 0),
        54 => (Kind::Prelu, 0),
        _ => return Err("a layer is of a kind that is not known"),
    };
    match activation {
        0 => Ok((kind, false)),
        1 => Ok((kind, true)),
        _ => Err("an activation is not known"),
    }
}

/// Reads a model's first network.
///
/// # Errors
/// What is damaged or not known, in a few words.
pub(super) fn read(bytes: &[u8]) -> Result<Network, Fault> {
    if bytes.get(4..8) != Some(b"TFL3") {
        return Err("not a TensorFlow Lite model");
    }
    let model = Table::root(bytes)?;
    let (codes, buffers) = (model.tables(1)?, model.tables(4)?);
    let graphs = model.tables(2)?;
    let graph = graphs.first().ok_or("it has no network")?;
    let tensors = graph.tables(0)?;
    let tensors = tensors.iter().map(|t| tensor(t, &buffers)).collect::<Result<Vec<_>, _>>()?;
    let mut nodes = Vec::new();
    for operator in graph.tables(3)? {
        let code = codes.get(operator.size(0)?).ok_or(TRUNCATED)?;
        // The first field was too small once codes were many.
        let code = i32::from(code.byte(0)?).max(code.int(3)?);
        let (kind, rectified) = kind(code, operator.table(4)?)?;
        let (inputs, outputs) = (operator.sizes(1)?, operator.sizes(2)?);
        let [output] = outputs[..] else { return Err("a layer has not one output") };
        nodes.push(Node { kind, inputs, output });
        if rectified {
            nodes.push(Node { kind: Kind::Relu, inputs: vec![output], output });
        }
    }
    let inputs = graph.sizes(1)?;
    let [input] = inputs[..] else { return Err("it has not one input") };
    Network::new(tensors, nodes, input, graph.sizes(2)?)
}
