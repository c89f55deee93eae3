//! Mean plus scaled eigenvectors: coefficients in, a field over all vertices out.
//!
//! A *field* holds three numbers per vertex (x y z, or R G B) as three planes of
//! [`padded`]`(vertices)` numbers, so that one loop over a plane is one loop over vertices.
//! The eigenbasis is stored in blocks of [`BLOCK`] field entries, and within a block component
//! after component: an instance streams the bytes once, front to back, with the accumulators in
//! registers. Every entry is one sum in component order, whatever the vector width.
//!
//! An instance is bounded by memory, so entries are 16-bit integers in units of their component's
//! *quantum*: 1/32767 of its largest entry, far less than a decomposition is wrong by (or a coarser one, for
//! files that compress better).

use crate::lanes::LANES;
use crate::memory::Carver;
use crate::scene::MAX_RANK;

/// Field entries per block of the basis, as the file format has it: a cache line of 64 bytes.
pub const BLOCK: usize = 32;

/// Length of one plane of a field: `vertices` rounded up to whole blocks.
pub const fn padded(vertices: usize) -> usize {
    vertices.div_ceil(BLOCK) * BLOCK
}

/// Length of a field: three planes.
pub const fn field_len(vertices: usize) -> usize {
    3 * padded(vertices)
}

/// One half of a model: `field = mean + Σ_k c_k·√λ_k·u_k` (the shape or the albedo).
#[derive(Clone, Copy, Debug)]
pub struct Basis<'a> {
    pub(crate) mean: &'a [[f32; BLOCK]],
    /// `[block][component]`, already multiplied by `√λ`, in quanta.
    pub(crate) columns: &'a [[i16; BLOCK]],
    /// Per component.
    pub(crate) quantum: &'a [f32],
    pub(crate) variance: &'a [f32],
    pub(crate) total_variance: f64,
}

impl<'a> Basis<'a> {
    /// Number of components.
    pub fn rank(&self) -> usize {
        self.variance.len()
    }

    /// Eigenvalues `λ` of the 3V×3V covariance, descending.
    pub fn variance(&self) -> &'a [f32] {
        self.variance
    }

    /// Trace of the whole covariance, before truncation to [`Basis::rank`] components.
    pub fn total_variance(&self) -> f64 {
        self.total_variance
    }

    /// The mean as a field.
    pub fn mean(&self) -> &'a [f32] {
        self.mean.as_flattened()
    }

    /// Fills `vertices` (length [`padded`]`(vertices)`) with the instance of the coefficients,
    /// `[x, y, z, 0]` or `[R, G, B, 0]` each. Coefficients beyond the rank are ignored, missing
    /// ones count as zero.
    #[inline(always)]
    pub fn instance(&self, coefficients: &[f32], vertices: &mut [[f32; 4]]) {
        let rank = self.rank();
        let blocks = self.mean.len() / 3;
        let (out, _) = vertices.as_chunks_mut::<BLOCK>();
        for (block, out) in (0..blocks).zip(out) {
            // Three streams at a time hide the memory's latency.
            let start = [block, blocks + block, 2 * blocks + block];
            let mut sum = start.map(|at| self.mean.get(at).copied().unwrap_or([0.0; BLOCK]));
            let [x, y, z] = start.map(|at| self.columns.get(at * rank..).unwrap_or_default());
            let columns = x.iter().zip(y).zip(z);
            for ((c, quantum), ((x, y), z)) in coefficients.iter().zip(self.quantum).zip(columns) {
                let c = c * quantum;
                for l in 0..BLOCK {
                    sum[0][l] += c * f32::from(x[l]);
                    sum[1][l] += c * f32::from(y[l]);
                    sum[2][l] += c * f32::from(z[l]);
                }
            }
            for (l, vertex) in out.iter_mut().enumerate() {
                *vertex = [sum[0][l], sum[1][l], sum[2][l], 0.0];
            }
        }
    }

    /// The transpose of [`Basis::instance`]: adds `Σ_v Σ_axis √λ_k u_k[v, axis]·cost[v][axis]` to
    /// `coefficients[k]`, so that what a field's entries cost becomes what the coefficients cost.
    /// Blocks of vertices that all cost nothing are skipped.
    #[inline(always)]
    pub fn transposed(&self, cost: &[[f32; 4]], coefficients: &mut [f32]) {
        let rank = self.rank();
        let blocks = self.mean.len() / 3;
        let (cost, _) = cost.as_chunks::<BLOCK>();
        for (block, cost) in (0..blocks).zip(cost) {
            if cost.as_flattened().iter().all(|&c| c == 0.0) {
                continue;
            }
            let mut planes = [[0.0; BLOCK]; 3];
            for (l, vertex) in cost.iter().enumerate() {
                for axis in 0..3 {
                    planes[axis][l] = vertex[axis];
                }
            }
            let start = [block, blocks + block, 2 * blocks + block];
            let [x, y, z] = start.map(|at| self.columns.get(at * rank..).unwrap_or_default());
            let columns = x.iter().zip(y).zip(z);
            for ((c, quantum), ((x, y), z)) in
                coefficients.iter_mut().zip(self.quantum).zip(columns)
            {
                let mut terms = [0.0_f32; BLOCK];
                for l in 0..BLOCK {
                    terms[l] = planes[0][l] * f32::from(x[l])
                        + planes[1][l] * f32::from(y[l])
                        + planes[2][l] * f32::from(z[l]);
                }
                let mut half = BLOCK / 2;
                while half > 0 {
                    for l in 0..half {
                        terms[l] += terms[l + half];
                    }
                    half /= 2;
                }
                *c += quantum * terms[0];
            }
        }
    }

    /// The mean at a vertex; zero if there is no such vertex.
    pub fn mean_at(&self, vertex: usize) -> [f32; 3] {
        let blocks = self.mean.len() / 3;
        core::array::from_fn(|axis| {
            let block = self.mean.get(axis * blocks + vertex / BLOCK);
            block.map_or(0.0, |block| block[vertex % BLOCK])
        })
    }

    /// How even a component is, from 0 to 1, where it is the same at all vertices: the share of its sum of
    /// squares that is left if each axis is replaced by its mean over the vertices. As components are
    /// orthogonal, the evennesses of all of them add up to 3 at most.
    pub fn evenness(&self, component: usize) -> f32 {
        let (rank, blocks) = (self.rank().max(1), self.mean.len() / 3);
        let (mut even, mut all) = (0.0_f64, 0.0_f64);
        for plane in self.columns.chunks_exact((blocks * rank).max(1)) {
            let (mut sum, mut squares) = (0_i64, 0_i64);
            let blocks = plane.chunks_exact(rank).filter_map(|block| block.get(component));
            for entry in blocks.flatten() {
                let entry = i64::from(*entry);
                sum += entry;
                squares += entry * entry;
            }
            even += sum as f64 * sum as f64;
            all += squares as f64;
        }
        let entries = (BLOCK * blocks) as f64;
        if all > 0.0 { (even / (entries * all)) as f32 } else { 0.0 }
    }

    /// Fills `components` with the first components at a vertex, each scaled by its standard
    /// deviation. What is out of range stays as it is.
    pub fn at(&self, vertex: usize, components: &mut [[f32; 3]]) {
        let rank = self.rank();
        let blocks = self.mean.len() / 3;
        let (block, place) = (vertex / BLOCK, vertex % BLOCK);
        let [x, y, z]: [&[_]; 3] = core::array::from_fn(|axis| {
            self.columns.get((axis * blocks + block) * rank..).unwrap_or_default()
        });
        let columns = x.iter().zip(y).zip(z).zip(self.quantum);
        for (out, (((x, y), z), quantum)) in components.iter_mut().zip(columns) {
            *out = [x[place], y[place], z[place]].map(|entry| quantum * f32::from(entry));
        }
    }

    /// Fills `rows[f][k]` with `Σ √λ_k u_k[v, axis]·cost[f][axis]`, summed over axes and over `(v, cost)` of
    /// `costs`: how three functions change with the coefficients, given how they change with a few vertices.
    /// `entries` is a copy of this basis by vertex, if there was memory for one. Without it the sums are the
    /// same, but slower, since the entries of a vertex lie far apart.
    #[inline(always)]
    pub fn rows(&self, entries: Option<&ByVertex<'_>>, costs: &[Costs], rows: [&mut [f32]; 3]) {
        let mut sums = [[[0.0; LANES]; GROUPS]; 3];
        let groups = rows[0].len().min(self.rank()).div_ceil(LANES);
        for (vertex, costs) in costs {
            if let Some(entries) = entries {
                add_rows(entries.at(*vertex).iter().take(groups).copied(), costs, &mut sums);
            } else {
                let entries = (0..groups).map(|group| self.group(*vertex, group));
                add_rows(entries, costs, &mut sums);
            }
        }
        for (row, sums) in rows.into_iter().zip(&sums) {
            for ((out, sum), quantum) in row.iter_mut().zip(sums.as_flattened()).zip(self.quantum) {
                *out = quantum * sum;
            }
        }
    }

    /// A group of components at a vertex.
    fn group(&self, vertex: usize, group: usize) -> Entries {
        let rank = self.rank();
        let blocks = self.mean.len() / 3;
        let (block, place) = (vertex / BLOCK, vertex % BLOCK);
        let first = group * LANES;
        let mut entries = [[0; LANES]; 3];
        for (axis, entries) in entries.iter_mut().enumerate() {
            let columns = self.columns.get((axis * blocks + block) * rank + first..);
            for (entry, column) in entries.iter_mut().zip(columns.unwrap_or_default()) {
                *entry = column[place];
            }
        }
        entries
    }

    /// What coefficient `c` of component `k` adds to one field entry; nothing if there is none.
    pub fn term(&self, entry: usize, k: usize, c: f32) -> f32 {
        let column = self.columns.get(entry / BLOCK * self.rank() + k);
        match (column, self.quantum.get(k)) {
            (Some(column), Some(quantum)) => c * quantum * f32::from(column[entry % BLOCK]),
            _ => 0.0,
        }
    }
}

/// Adds to three functions what a vertex's axes cost them.
#[inline(always)]
fn add_rows(
    entries: impl Iterator<Item = Entries>,
    costs: &[[f32; 3]; 3],
    [r, g, b]: &mut [[[f32; LANES]; GROUPS]; 3],
) {
    for (entries, ((r, g), b)) in entries.zip(r.iter_mut().zip(g).zip(b)) {
        for l in 0..LANES {
            let [x, y, z] = [entries[0][l], entries[1][l], entries[2][l]].map(f32::from);
            r[l] += costs[0][0] * x + costs[0][1] * y + costs[0][2] * z;
            g[l] += costs[1][0] * x + costs[1][1] * y + costs[1][2] * z;
            b[l] += costs[2][0] * x + costs[2][1] * y + costs[2][2] * z;
        }
    }
}

/// A vertex, and what three functions change by per axis of it, `[function][axis]`.
pub type Costs = (usize, [[f32; 3]; 3]);

/// The most groups of components.
const GROUPS: usize = MAX_RANK.div_ceil(LANES);

/// Some components of a vertex's entries, per axis, in quanta.
type Entries = [[i16; LANES]; 3];

/// Type of [`Basis::rows`].
pub type Rows = fn(&Basis<'_>, Option<&ByVertex<'_>>, &[Costs], [&mut [f32]; 3]);

/// Words of memory that a [`ByVertex`] with `rank` components needs.
pub const fn by_vertex_words(vertices: usize, rank: usize) -> usize {
    vertices * rank.div_ceil(LANES) * size_of::<Entries>() / size_of::<u32>()
}

/// A copy of a basis's leading components in another order: what belongs to a vertex lies together.
pub struct ByVertex<'w> {
    /// `[vertex][group of components]`.
    entries: &'w [Entries],
    groups: usize,
}

impl<'w> ByVertex<'w> {
    /// Copies the first `rank` components; `None` if there is too little memory.
    pub fn carve(
        carver: &mut Carver<'w>,
        basis: &Basis<'_>,
        vertices: usize,
        rank: usize,
    ) -> Option<Self> {
        let words = carver.words(by_vertex_words(vertices, rank))?;
        let entries: &mut [Entries] = bytemuck::try_cast_slice_mut(words).ok()?;
        let groups = rank.div_ceil(LANES);
        for (v, entries) in entries.chunks_exact_mut(groups.max(1)).enumerate() {
            for (group, entries) in entries.iter_mut().enumerate() {
                *entries = basis.group(v, group);
            }
        }
        Some(Self { entries, groups })
    }

    /// All groups of a vertex.
    #[inline(always)]
    fn at(&self, vertex: usize) -> &[Entries] {
        let first = vertex * self.groups;
        self.entries.get(first..first + self.groups).unwrap_or_default()
    }
}
