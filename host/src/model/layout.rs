//! The bytes of `.3dmm` files: laying them out.
//!
//! The layout is documented with its reader, [`onescan_core::model`].

use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::mesh::landmarks::Landmark;
use crate::model::process::{Deviation, Half};
use crate::model_file::OwnedModel;
use onescan_core::basis::{BLOCK, padded};
use onescan_core::hash::fnv64;
use onescan_core::model::MAX_TRIANGLES;
use onescan_core::model::{
    CHECKED_FROM, HEADER_BYTES, MAGIC, SECTION_ALIGN, Section, TABLE_AT, VERSION,
};
use rayon::prelude::*;

/// A model of one mesh that never deviates from it: for drawing the mesh.
///
/// # Errors
/// Never for a mesh that keeps its guarantees.
pub fn rigid(mesh: &Mesh, landmarks: &[Landmark]) -> Result<OwnedModel> {
    let parts = ModelParts {
        shape: Half { mean: &mesh.points, deviation: &Rigid },
        albedo: Half { mean: &mesh.colors, deviation: &Rigid },
        triangles: &mesh.triangles,
        landmarks,
        provenance: "",
        occlusion: None,
        levels: i16::MAX,
    };
    OwnedModel::from_bytes(&parts.to_bytes()?)
}

/// No deviation at all.
struct Rigid;

impl Deviation for Rigid {
    fn variances(&self) -> &[f64] {
        &[]
    }

    fn total_variance(&self) -> f64 {
        0.0
    }

    fn column(&self, _: usize, _: usize) -> (f64, &[f64]) {
        (0.0, &[])
    }
}

/// Everything a model file holds.
pub struct ModelParts<'a> {
    /// Shape.
    pub shape: Half<'a>,
    /// Albedo, over as many vertices.
    pub albedo: Half<'a>,
    /// Faces, indices below the number of vertices, at least one.
    pub triangles: &'a [[u32; 3]],
    /// Landmarks, vertices in range.
    pub landmarks: &'a [Landmark],
    /// `key = value` lines.
    pub provenance: &'a str,
    /// Per vertex, 255 times the prior probability that it is hidden; `None` if that is not known.
    pub occlusion: Option<&'a [u8]>,
    /// The integer that stands for a component's largest entry: [`i16::MAX`], or less for a file
    /// that compresses better.
    pub levels: i16,
}

impl ModelParts<'_> {
    /// The bytes of the model file.
    ///
    /// # Errors
    /// When a basis exceeds the 4 GiB a section may have, and of too many triangles.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let vertices = self.shape.mean.len();
        check_size(vertices, self.triangles.len(), 0)?;
        let small = vertices <= 1 << 16;
        let triangles = self.triangles.as_flattened();
        let corners: Vec<u8> = if small {
            triangles.iter().flat_map(|&v| (v as u16).to_le_bytes()).collect()
        } else {
            triangles.iter().flat_map(|v| v.to_le_bytes()).collect()
        };
        let (landmarks, names) = self.named();
        let [(shape, shape_quanta), (albedo, albedo_quanta)] =
            [&self.shape, &self.albedo].map(|half| half.columns(self.levels));
        // In the order of `Section::ALL`, and what may follow.
        let always: [Vec<u8>; Section::ALL.len()] = [
            little_endian(&self.shape.mean()),
            little_endian(&shape),
            little_endian(&self.shape.variances()),
            little_endian(&shape_quanta),
            little_endian(&self.albedo.mean()),
            little_endian(&albedo),
            little_endian(&self.albedo.variances()),
            little_endian(&albedo_quanta),
            corners,
            landmarks.iter().flat_map(|v| v.to_le_bytes()).collect(),
            names.into_bytes(),
            self.provenance.as_bytes().to_vec(),
        ];

        let mut bytes = vec![0; HEADER_BYTES];
        let sections = always.into_iter().chain(self.occlusion.map(<[u8]>::to_vec));
        for (i, section) in sections.enumerate() {
            bytes.resize(bytes.len().next_multiple_of(SECTION_ALIGN), 0);
            let length = u32::try_from(section.len()).map_err(|_| too_large(section.len()))?;
            let (entry, start) = (TABLE_AT + 8 * i, (bytes.len() / SECTION_ALIGN) as u32);
            put(&mut bytes, entry, &start.to_le_bytes());
            put(&mut bytes, entry + 4, &length.to_le_bytes());
            bytes.extend(section);
        }

        put(&mut bytes, 0, &MAGIC);
        for (offset, value) in [
            (8, VERSION),
            (12, vertices as u32),
            (32, self.triangles.len() as u32),
            (36, self.shape.rank() as u32),
            (40, self.albedo.rank() as u32),
            (44, self.landmarks.len() as u32),
            (48, if small { 2 } else { 4 }),
        ] {
            put(&mut bytes, offset, &value.to_le_bytes());
        }
        put(&mut bytes, 56, &self.shape.deviation.total_variance().to_le_bytes());
        put(&mut bytes, 64, &self.albedo.deviation.total_variance().to_le_bytes());
        let length = bytes.len() as u64;
        put(&mut bytes, 24, &length.to_le_bytes());
        let checksum = fnv64(&bytes[CHECKED_FROM..]);
        put(&mut bytes, 16, &checksum.to_le_bytes());
        Ok(bytes)
    }

    /// Landmarks as (vertex, name offset, name length), and the names end to end.
    fn named(&self) -> (Vec<u32>, String) {
        let (mut table, mut names) = (Vec::new(), String::new());
        for Landmark { name, vertex } in self.landmarks {
            table.extend([*vertex, names.len() as u32, name.len() as u32]);
            names.push_str(name);
        }
        (table, names)
    }
}

impl Half<'_> {
    /// The mean as a field: three planes, padded with zeros.
    fn mean(&self) -> Vec<f32> {
        let plane = padded(self.mean.len());
        let mut field = vec![0.0; 3 * plane];
        for (i, value) in self.mean.iter().enumerate() {
            for (channel, v) in value.iter().enumerate() {
                field[channel * plane + i] = *v;
            }
        }
        field
    }

    /// Columns `√λ_k·u_k` in blocks of [`BLOCK`] field entries, component after component, in
    /// units of the quanta, and these.
    fn columns(&self, levels: i16) -> (Vec<i16>, Vec<f32>) {
        let rank = self.rank();
        let plane_blocks = padded(self.mean.len()) / BLOCK;
        let mut columns = vec![0; 3 * plane_blocks * rank * BLOCK];
        let components: Vec<_> =
            (0..rank).map(|k| [0, 1, 2].map(|channel| self.deviation.column(k, channel))).collect();
        let largest = |values: &[f64]| values.iter().fold(0.0_f64, |max, x| max.max(x.abs()));
        let quanta: Vec<f32> = components
            .iter()
            .map(|channels| {
                let entries = channels.map(|(factor, values)| factor.abs() * largest(values));
                (largest(&entries) / f64::from(levels)) as f32
            })
            .collect();
        columns.par_chunks_mut((rank * BLOCK).max(1)).enumerate().for_each(|(block, out)| {
            let (channel, first) = (block / plane_blocks, block % plane_blocks * BLOCK);
            for ((channels, quantum), lanes) in
                components.iter().zip(&quanta).zip(out.chunks_exact_mut(BLOCK))
            {
                let (factor, values) = channels[channel];
                let factor = factor / f64::from(*quantum);
                for (out, value) in lanes.iter_mut().zip(&values[first..]) {
                    // Saturates; of a component without entries 0/0 gives 0.
                    *out = (factor * value).round() as i16;
                }
            }
        });
        (columns, quanta)
    }

    fn rank(&self) -> usize {
        self.deviation.variances().len()
    }

    fn variances(&self) -> Vec<f32> {
        self.deviation.variances().iter().map(|&v| v as f32).collect()
    }
}

/// The core reads numbers in place, so machines are as little-endian as files.
fn little_endian<T: bytemuck::NoUninit>(values: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(values).to_vec()
}

fn put(bytes: &mut [u8], offset: usize, value: &[u8]) {
    bytes[offset..offset + value.len()].copy_from_slice(value);
}

/// What is known of [`ModelParts::to_bytes`] before there is a basis.
///
/// # Errors
/// When a basis would exceed the 4 GiB a section may have, and of too many triangles.
pub(super) fn check_size(vertices: usize, triangles: usize, rank: usize) -> Result<()> {
    if triangles > MAX_TRIANGLES {
        return Err(Error::new(format_args!(
            "{triangles} triangles are more than the {MAX_TRIANGLES} a model holds; simplify the mesh"
        )));
    }
    let basis = vertices.saturating_mul(rank).saturating_mul(3 * size_of::<i16>());
    if u32::try_from(basis).is_err() { Err(too_large(basis)) } else { Ok(()) }
}

fn too_large(basis: usize) -> Error {
    Error::new(format_args!(
        "a basis of {basis} bytes is more than a model file holds; ask for a lower rank, or give a \
         coarser mesh"
    ))
}
