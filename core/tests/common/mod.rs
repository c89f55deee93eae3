//! A small model of a mask, made of formulas: bytes to fit, to draw and to break.

use onescan_core::basis::{BLOCK, padded};
use onescan_core::hash::fnv64;
use onescan_core::model::{
    CHECKED_FROM, HEADER_BYTES, MAGIC, Model, SECTION_ALIGN, Section, TABLE_AT, VERSION,
};
use onescan_core::proposal::CENTRES;
use std::f32::consts::PI;

/// A model file in memory that starts at a multiple of four bytes.
pub(crate) struct ModelBytes(Vec<u32>);

impl ModelBytes {
    pub(crate) fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.0)
    }

    pub(crate) fn model(&self) -> Model<'_> {
        Model::new_checked(self.bytes()).expect("the mask is a model")
    }
}

/// A bumpy mask of `columns × rows` vertices, 160 mm wide and 200 mm high, that faces +z. Its
/// landmarks are [`CENTRES`].
pub(crate) fn mask(
    columns: usize,
    rows: usize,
    shape_rank: usize,
    albedo_rank: usize,
) -> ModelBytes {
    let vertices = columns * rows;
    // Across and up, −1 to 1.
    let place = |v: usize| {
        let (i, j) = (v % columns, v / columns);
        let across = 2.0 * i as f32 / (columns - 1) as f32 - 1.0;
        (across, 2.0 * j as f32 / (rows - 1) as f32 - 1.0)
    };
    let shape = |v: usize, axis: usize| {
        let (a, b) = place(v);
        let nose = 30.0 * (-30.0 * (a * a + 0.5 * b * b)).exp();
        let forehead = 70.0 * (0.4 * PI * a).cos() * (0.35 * PI * b).cos();
        [80.0 * a, 100.0 * b, forehead + nose][axis]
    };
    let albedo = |v: usize, channel: usize| {
        let (a, b) = place(v);
        [0.7, 0.5, 0.4][channel] + 0.1 * (3.0 * a - 2.0 * b + channel as f32).sin()
    };
    let component = |scale: f32| {
        move |v: usize, channel: usize, k: usize| {
            let (a, b) = place(v);
            let (k, phase) = (k as f32, (2 * k + 3 * channel) as f32);
            scale / (1.0 + k) * ((1.0 + 0.5 * k) * a + (2.0 - 0.3 * k) * b + phase).cos()
        }
    };
    let at = |a: f32, b: f32| {
        let i = (0.5 * (a + 1.0) * (columns - 1) as f32) as usize;
        let j = (0.5 * (b + 1.0) * (rows - 1) as f32) as usize;
        (j * columns + i) as u32
    };
    let corners = [at(-0.5, 0.4), at(0.5, 0.4), at(-0.4, -0.5), at(0.4, -0.5)];

    let mut names = String::new();
    let mut landmarks = Vec::new();
    for (name, vertex) in CENTRES.iter().zip(corners) {
        landmarks.extend([vertex, names.len() as u32, name.len() as u32]);
        names.push_str(name);
    }
    let triangles: Vec<u16> = (0..rows - 1)
        .flat_map(|j| (0..columns - 1).map(move |i| j * columns + i))
        .flat_map(|v| [v, v + 1, v + columns, v + 1, v + columns + 1, v + columns])
        .map(|v| v as u16)
        .collect();
    let counts = [triangles.len() / 3, shape_rank, albedo_rank, CENTRES.len(), 2, 0];
    let sections = [
        bytes(&field(vertices, shape)),
        bytes(&basis(vertices, shape_rank, component(8.0), 8.0)),
        bytes(&vec![1.0_f32; shape_rank]),
        bytes(&vec![8.0_f32 / 32767.0; shape_rank]),
        bytes(&field(vertices, albedo)),
        bytes(&basis(vertices, albedo_rank, component(0.05), 0.05)),
        bytes(&vec![1.0_f32; albedo_rank]),
        bytes(&vec![0.05_f32 / 32767.0; albedo_rank]),
        bytes(&triangles),
        bytes(&landmarks),
        names.into_bytes(),
        b"scan = formulas\n".to_vec(),
    ];
    assemble(vertices, counts, &sections)
}

/// Planes of a field, from a function of vertex and axis.
fn field(vertices: usize, f: impl Fn(usize, usize) -> f32) -> Vec<f32> {
    let plane = padded(vertices);
    (0..3 * plane)
        .map(|entry| if entry % plane < vertices { f(entry % plane, entry / plane) } else { 0.0 })
        .collect()
}

/// Blocks of [`BLOCK`] field entries, component after component, in units of `largest / 32767`.
fn basis(
    vertices: usize,
    rank: usize,
    f: impl Fn(usize, usize, usize) -> f32,
    largest: f32,
) -> Vec<i16> {
    let columns: Vec<_> = (0..rank).map(|k| field(vertices, |v, axis| f(v, axis, k))).collect();
    (0..3 * padded(vertices) / BLOCK)
        .flat_map(|block| columns.iter().map(move |column| &column[block * BLOCK..]))
        .flat_map(|column| &column[..BLOCK])
        .map(|x| (x / largest * 32767.0).round() as i16)
        .collect()
}

fn bytes<T: bytemuck::NoUninit>(numbers: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(numbers).to_vec()
}

/// Header, table and sections, as `onescan_core::model` lays them out.
fn assemble(vertices: usize, counts: [usize; 6], sections: &[Vec<u8>; 12]) -> ModelBytes {
    let mut file = vec![0; HEADER_BYTES];
    let mut table = Vec::new();
    for section in sections {
        file.resize(file.len().next_multiple_of(SECTION_ALIGN), 0);
        table.extend([(file.len() / SECTION_ALIGN) as u32, section.len() as u32]);
        file.extend(section);
    }
    file.resize(file.len().next_multiple_of(SECTION_ALIGN), 0);
    assert_eq!(sections.len(), Section::ALL.len());

    let mut put = |at: usize, bytes: &[u8]| file[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &MAGIC);
    put(8, &VERSION.to_le_bytes());
    put(12, &(vertices as u32).to_le_bytes());
    for (i, count) in counts.iter().enumerate() {
        put(32 + 4 * i, &(*count as u32).to_le_bytes());
    }
    // Total variances: all of it is in the components.
    put(56, &1000.0_f64.to_le_bytes());
    put(64, &1.0_f64.to_le_bytes());
    for (i, word) in table.iter().enumerate() {
        put(TABLE_AT + 4 * i, &word.to_le_bytes());
    }
    let length = file.len() as u64;
    file[24..32].copy_from_slice(&length.to_le_bytes());
    let checksum = fnv64(&file[CHECKED_FROM..]);
    file[16..24].copy_from_slice(&checksum.to_le_bytes());

    let mut words = vec![0_u32; file.len() / 4];
    bytemuck::cast_slice_mut(&mut words).copy_from_slice(&file);
    ModelBytes(words)
}
