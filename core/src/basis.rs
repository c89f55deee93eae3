//! Mean plus scaled eigenvectors: coefficients in, a field over all vertices out.
//!
//! A *field* holds three numbers per vertex (x y z, or R G B) as three planes of
//! [`padded`]`(vertices)` numbers, so that one loop over a plane is one loop over vertices.
//! The eigenbasis is stored in blocks of [`LANES`] field entries, and within a block component
//! after component: an instance streams the bytes once, front to back, with the accumulators in
//! registers. Every entry is one sum in component order, whatever the vector width.
//!
//! An instance is bounded by memory, so entries are 16-bit integers in units of their component's
//! *quantum*: 1/32767 of its largest entry, which is far below what its samples differ by (or a
//! coarser one, for files that compress better).

/// Field entries per block of the basis.
pub const LANES: usize = 32;

/// Length of one plane of a field: `vertices` rounded up to whole blocks.
pub const fn padded(vertices: usize) -> usize {
    vertices.div_ceil(LANES) * LANES
}

/// Length of a field: three planes.
pub const fn field_len(vertices: usize) -> usize {
    3 * padded(vertices)
}

/// One half of a model: `field = mean + Σ_k c_k·√λ_k·u_k` (the shape or the albedo).
#[derive(Clone, Copy, Debug)]
pub struct Basis<'a> {
    pub(crate) mean: &'a [[f32; LANES]],
    /// `[block][component]`, already multiplied by `√λ`, in quanta.
    pub(crate) columns: &'a [[i16; LANES]],
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
        let (out, _) = vertices.as_chunks_mut::<LANES>();
        for (block, out) in (0..blocks).zip(out) {
            // Three streams at a time hide the memory's latency.
            let start = [block, blocks + block, 2 * blocks + block];
            let mut sum = start.map(|at| self.mean.get(at).copied().unwrap_or([0.0; LANES]));
            let [x, y, z] = start.map(|at| self.columns.get(at * rank..).unwrap_or_default());
            let columns = x.iter().zip(y).zip(z);
            for ((c, quantum), ((x, y), z)) in coefficients.iter().zip(self.quantum).zip(columns) {
                let c = c * quantum;
                for l in 0..LANES {
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
    /// Vertices that cost nothing are skipped by the block.
    #[inline(always)]
    pub fn transposed(&self, cost: &[[f32; 4]], coefficients: &mut [f32]) {
        let rank = self.rank();
        let blocks = self.mean.len() / 3;
        let (cost, _) = cost.as_chunks::<LANES>();
        for (block, cost) in (0..blocks).zip(cost) {
            if cost.as_flattened().iter().all(|&c| c == 0.0) {
                continue;
            }
            let mut planes = [[0.0; LANES]; 3];
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
                let mut lanes = [0.0_f32; LANES];
                for l in 0..LANES {
                    lanes[l] = planes[0][l] * f32::from(x[l])
                        + planes[1][l] * f32::from(y[l])
                        + planes[2][l] * f32::from(z[l]);
                }
                let mut half = LANES / 2;
                while half > 0 {
                    for l in 0..half {
                        lanes[l] += lanes[l + half];
                    }
                    half /= 2;
                }
                *c += quantum * lanes[0];
            }
        }
    }

    /// The mean at a vertex; zero if there is no such vertex.
    pub fn mean_at(&self, vertex: usize) -> [f32; 3] {
        let blocks = self.mean.len() / 3;
        core::array::from_fn(|axis| {
            let block = self.mean.get(axis * blocks + vertex / LANES);
            block.map_or(0.0, |block| block[vertex % LANES])
        })
    }

    /// Fills `components` with the first components at a vertex, each scaled by its standard
    /// deviation. What is out of range stays as it is.
    pub fn at(&self, vertex: usize, components: &mut [[f32; 3]]) {
        let rank = self.rank();
        let blocks = self.mean.len() / 3;
        let (block, lane) = (vertex / LANES, vertex % LANES);
        let [x, y, z]: [&[_]; 3] = core::array::from_fn(|axis| {
            self.columns.get((axis * blocks + block) * rank..).unwrap_or_default()
        });
        let columns = x.iter().zip(y).zip(z).zip(self.quantum);
        for (out, (((x, y), z), quantum)) in components.iter_mut().zip(columns) {
            *out = [x[lane], y[lane], z[lane]].map(|entry| quantum * f32::from(entry));
        }
    }

    /// What coefficient `c` of component `k` adds to one field entry; nothing if there is none.
    pub fn term(&self, entry: usize, k: usize, c: f32) -> f32 {
        let column = self.columns.get(entry / LANES * self.rank() + k);
        match (column, self.quantum.get(k)) {
            (Some(column), Some(quantum)) => c * quantum * f32::from(column[entry % LANES]),
            _ => 0.0,
        }
    }
}
