//! Writing `.h5` files in the format's first version: superblock 0, symbol tables, datasets in
//! one piece without filters. Every reader of HDF5 reads that, and equal contents give equal
//! bytes: nothing of the machine or the time goes in.
//!
//! Structure names are those of the HDF5 File Format Specification, version 3.0.

use super::{Dataset, Group, Node, Values};
use std::io::{self, Write};

/// An address that leads nowhere.
const NOWHERE: u64 = u64::MAX;
/// Size of the superblock.
const SUPERBLOCK: usize = 96;
/// Half the links of a node of a group's B-tree; as the C library has it.
const INTERNAL_K: usize = 16;
/// Half the entries of a symbol table node.
const LEAF_K: usize = Group::MOST / 2;
/// End of the free list of a local heap.
const NO_FREE: u64 = 1;

/// Message types of object headers.
mod message {
    pub(super) const DATASPACE: u16 = 0x01;
    pub(super) const DATATYPE: u16 = 0x03;
    pub(super) const FILL_VALUE: u16 = 0x05;
    pub(super) const LAYOUT: u16 = 0x08;
    pub(super) const ATTRIBUTE: u16 = 0x0c;
    pub(super) const SYMBOL_TABLE: u16 = 0x11;
}

impl Group {
    /// Writes the group as the root of a file.
    ///
    /// # Errors
    /// Those of `out`, and when a group has more than [`Group::MOST`] members.
    pub fn write(&self, out: &mut impl Write) -> io::Result<()> {
        // Numbers come after all that describes them; how much that is, the first round finds.
        let mut layout = Layout::default();
        layout.file(self)?;
        let mut layout = Layout { data: layout.bytes.len() as u64, ..Layout::default() };
        layout.file(self)?;
        out.write_all(&layout.bytes)?;
        self.write_data(out)
    }

    fn write_data(&self, out: &mut impl Write) -> io::Result<()> {
        for (_, node) in &self.members {
            match node {
                Node::Group(group) => group.write_data(out)?,
                Node::Dataset(dataset) => dataset.write_data(out)?,
            }
        }
        Ok(())
    }
}

impl Values {
    /// Bytes they take in the file.
    fn size(&self) -> usize {
        match self {
            Self::F32(values) => 4 * values.len(),
            Self::I32(values) => 4 * values.len(),
            Self::Text(text) => text.len().max(1),
        }
    }

    /// The datatype message.
    fn datatype(&self) -> Vec<u8> {
        match self {
            // Class 1, version 1; little-endian, leading one implied, sign in bit 31; 4 bytes;
            // bits 0 to 31, exponent 8 bits from 23, mantissa 23 bits from 0, bias 127.
            Self::F32(_) => {
                vec![0x11, 0x20, 0x1f, 0, 4, 0, 0, 0, 0, 0, 32, 0, 23, 8, 0, 23, 127, 0, 0, 0]
            }
            // Class 0, version 1; little-endian, signed; 4 bytes; bits 0 to 31.
            Self::I32(_) => vec![0x10, 0x08, 0, 0, 4, 0, 0, 0, 0, 0, 32, 0],
            Self::Text(text) => text_type(text, self.size()),
        }
    }
}

/// Class 3, version 1: zeros close the text where there is room for them.
fn text_type(text: &str, size: usize) -> Vec<u8> {
    let utf8 = u8::from(!text.is_ascii());
    let mut datatype = vec![0x13, utf8 << 4, 0, 0];
    datatype.extend((size as u32).to_le_bytes());
    datatype
}

/// The dataspace message, version 1.
fn dataspace(shape: &[usize]) -> Vec<u8> {
    let mut space = vec![1, shape.len() as u8, 0, 0, 0, 0, 0, 0];
    space.extend(shape.iter().flat_map(|&n| (n as u64).to_le_bytes()));
    space
}

impl Dataset {
    /// Bytes taken in the file, to the next multiple of eight.
    fn room(&self) -> usize {
        self.values.size().next_multiple_of(8)
    }

    fn write_data(&self, out: &mut impl Write) -> io::Result<()> {
        match &self.values {
            // Machines are as little-endian as files here.
            Values::F32(values) => out.write_all(bytemuck::cast_slice(values))?,
            Values::I32(values) => out.write_all(bytemuck::cast_slice(values))?,
            Values::Text(text) if text.is_empty() => out.write_all(&[0])?,
            Values::Text(text) => out.write_all(text.as_bytes())?,
        }
        out.write_all(&[0; 8][..self.room() - self.values.size()])
    }
}

/// All of the file but the numbers, which follow from `data` on.
#[derive(Default)]
struct Layout {
    bytes: Vec<u8>,
    data: u64,
}

/// Where a group's parts are.
struct Placed {
    header: u64,
    tree: u64,
    heap: u64,
}

impl Layout {
    fn file(&mut self, root: &Group) -> io::Result<()> {
        self.bytes = vec![0; SUPERBLOCK];
        let placed = self.group(root)?;
        let mut superblock = b"\x89HDF\r\n\x1a\n".to_vec();
        // Versions, then sizes of addresses and lengths.
        superblock.extend([0, 0, 0, 0, 0, 8, 8, 0]);
        superblock.extend((LEAF_K as u16).to_le_bytes());
        superblock.extend((INTERNAL_K as u16).to_le_bytes());
        superblock.extend([0; 4]);
        // The end is known in the second round.
        for address in [0, NOWHERE, self.data, NOWHERE] {
            superblock.extend(address.to_le_bytes());
        }
        superblock.extend(symbol(0, &placed));
        self.bytes[..SUPERBLOCK].copy_from_slice(&superblock);
        Ok(())
    }

    /// Appends, at a multiple of eight; the address.
    fn place(&mut self, bytes: &[u8]) -> u64 {
        let at = self.bytes.len();
        self.bytes.extend(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(8), 0);
        at as u64
    }

    fn group(&mut self, group: &Group) -> io::Result<Placed> {
        if group.members.len() > Group::MOST {
            return Err(io::Error::other("more members than a group is written with"));
        }
        // Names end to end, the empty one first; symbols in the order of names.
        let mut names = vec![0; 8];
        let mut symbols = Vec::new();
        for (name, node) in &group.members {
            let placed = match node {
                Node::Group(group) => self.group(group)?,
                Node::Dataset(dataset) => {
                    Placed { header: self.dataset(dataset), tree: NOWHERE, heap: NOWHERE }
                }
            };
            symbols.push((name, symbol(names.len() as u64, &placed), names.len() as u64));
            names.extend(name.as_bytes());
            names.resize((names.len() + 1).next_multiple_of(8), 0);
        }
        symbols.sort_by_key(|(name, ..)| *name);

        let names_at = self.place(&names);
        let mut heap = b"HEAP\0\0\0\0".to_vec();
        for field in [names.len() as u64, NO_FREE, names_at] {
            heap.extend(field.to_le_bytes());
        }
        let heap = self.place(&heap);

        let mut leaf = b"SNOD\x01\0".to_vec();
        leaf.extend((symbols.len() as u16).to_le_bytes());
        leaf.extend(symbols.iter().flat_map(|(_, symbol, _)| symbol));
        leaf.resize(8 + 2 * LEAF_K * 40, 0);
        let leaf = self.place(&leaf);

        let mut tree = b"TREE\0\0".to_vec();
        tree.extend(u16::from(!symbols.is_empty()).to_le_bytes());
        for field in [NOWHERE, NOWHERE] {
            tree.extend(field.to_le_bytes());
        }
        // All names lie above the empty one and up to the last one.
        let last = symbols.last().map_or(0, |&(.., name)| name);
        for field in [0, leaf, last] {
            tree.extend(field.to_le_bytes());
        }
        tree.resize(24 + 8 * (4 * INTERNAL_K + 1), 0);
        let tree = self.place(&tree);

        let mut messages =
            vec![(message::SYMBOL_TABLE, [tree, heap].map(u64::to_le_bytes).concat())];
        messages.extend(
            group.attributes.iter().map(|(name, text)| (message::ATTRIBUTE, attribute(name, text))),
        );
        Ok(Placed { header: self.header(&messages), tree, heap })
    }

    /// The address of a dataset's header. Its values get the next place among the data.
    fn dataset(&mut self, dataset: &Dataset) -> u64 {
        // Version 3, in one piece.
        let mut layout = vec![3, 1];
        let place = if dataset.room() > 0 { self.data } else { NOWHERE };
        layout.extend(place.to_le_bytes());
        layout.extend((dataset.values.size() as u64).to_le_bytes());
        self.data += dataset.room() as u64;
        self.header(&[
            (message::DATASPACE, dataspace(&dataset.shape)),
            (message::DATATYPE, dataset.values.datatype()),
            // Version 2: room is taken late, filled when asked for, with nothing.
            (message::FILL_VALUE, vec![2, 2, 2, 1, 0, 0, 0, 0]),
            (message::LAYOUT, layout),
        ])
    }

    /// An object header, version 1.
    fn header(&mut self, messages: &[(u16, Vec<u8>)]) -> u64 {
        let mut block = Vec::new();
        for (kind, content) in messages {
            let size = content.len().next_multiple_of(8);
            block.extend(kind.to_le_bytes());
            block.extend((size as u16).to_le_bytes());
            block.extend([0; 4]);
            block.extend(content);
            block.resize(block.len() + size - content.len(), 0);
        }
        let mut header = vec![1, 0];
        header.extend((messages.len() as u16).to_le_bytes());
        header.extend(1_u32.to_le_bytes());
        header.extend((block.len() as u32).to_le_bytes());
        header.extend([0; 4]);
        header.extend(block);
        self.place(&header)
    }
}

/// A symbol table entry; a group's says where its tree and heap are.
fn symbol(name: u64, placed: &Placed) -> Vec<u8> {
    let is_group = placed.tree != NOWHERE;
    let mut entry = Vec::with_capacity(40);
    entry.extend(name.to_le_bytes());
    entry.extend(placed.header.to_le_bytes());
    entry.extend(u32::from(is_group).to_le_bytes());
    entry.extend([0; 4]);
    for address in [placed.tree, placed.heap] {
        entry.extend(if is_group { address } else { 0 }.to_le_bytes());
    }
    entry
}

/// An attribute message, version 1: a list of one text, with a closing zero.
fn attribute(name: &str, text: &str) -> Vec<u8> {
    let (datatype, space) = (text_type(text, text.len() + 1), dataspace(&[1]));
    let mut message = vec![1, 0];
    for length in [name.len() + 1, datatype.len(), space.len()] {
        message.extend((length as u16).to_le_bytes());
    }
    for (part, zeros) in [(name.as_bytes(), 1), (&datatype, 0), (&space, 0)] {
        message.extend(part);
        message.resize((message.len() + zeros).next_multiple_of(8), 0);
    }
    message.extend(text.as_bytes());
    message.push(0);
    message
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::interchange::hdf5::{BinaryFile, Store};

    fn example() -> Group {
        let mut root = Group::default();
        root.put("a/numbers", &[2, 3], Values::F32(vec![1.0, -2.5, 3e-9, f32::MAX, 0.0, -0.0]));
        root.put("a/whole", &[], Values::I32(vec![-7]));
        root.put("text", &[1], Values::Text("bird".into()));
        root.put("wide", &[1], Values::Text("œil".into()));
        root.put("empty", &[1], Values::Text(String::new()));
        root.group("a").attributes = vec![("name", "first::Of"), ("datasetType", "MESH")];
        root.group("b/c/d");
        root
    }

    fn written(group: &Group) -> Vec<u8> {
        let mut bytes = Vec::new();
        group.write(&mut bytes).unwrap();
        bytes
    }

    #[test]
    fn what_is_written_reads_back() {
        let file = BinaryFile::parse(written(&example())).unwrap();
        assert_eq!(file.shape("a/numbers").unwrap().unwrap(), [2, 3]);
        let numbers = [1.0, -2.5, 3e-9_f32, f32::MAX, 0.0, -0.0].map(f64::from);
        assert_eq!(file.numbers("a/numbers").unwrap(), numbers);
        assert_eq!(file.shape("a/whole").unwrap().unwrap(), [0_u64; 0]);
        assert_eq!(file.numbers("a/whole").unwrap(), [-7.0]);
        assert_eq!(file.text("text").unwrap(), "bird");
        assert_eq!(file.text("wide").unwrap(), "œil");
        assert_eq!(file.text("empty").unwrap(), "");
        assert_eq!(file.shape("a/none").unwrap(), None);
        assert_eq!(file.shape("none/at/all").unwrap(), None);
    }

    #[test]
    fn the_end_of_file_is_where_the_superblock_says() {
        let bytes = written(&example());
        assert_eq!(bytes[8], 0, "version of the superblock");
        let end = u64::from_le_bytes(bytes[40..48].try_into().unwrap());
        assert_eq!(end, bytes.len() as u64);
    }

    #[test]
    fn a_group_too_large_is_refused() {
        let mut root = Group::default();
        for i in 0..=Group::MOST {
            root.put(&format!("n{i}"), &[], Values::I32(vec![0]));
        }
        assert!(root.write(&mut Vec::new()).is_err());
    }

    #[test]
    fn damaged_files_are_refused_or_read_but_never_panic() {
        let whole = written(&example());
        let walk = |bytes: Vec<u8>| {
            let Ok(file) = BinaryFile::parse(bytes) else { return };
            for path in ["a/numbers", "a/whole", "text", "wide", "b/c", "empty"] {
                let _ = (file.shape(path), file.numbers(path), file.text(path));
            }
        };
        for length in 0..whole.len() {
            walk(whole[..length].to_vec());
        }
        for at in 0..whole.len() {
            for value in [0, 0xff, whole[at] ^ 1] {
                let mut bytes = whole.clone();
                bytes[at] = value;
                walk(bytes);
            }
        }
    }
}
