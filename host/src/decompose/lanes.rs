//! Columns of matrices side by side, so that one row's values fill a vector register.

use faer::MatRef;

/// Columns that are done side by side.
pub(super) const LANES: usize = 8;

/// A value of each.
pub(super) type Lanes = [f64; LANES];

/// At most [`LANES`] columns; those that are missing are zero.
pub(super) fn gathered(columns: MatRef<'_, f64>) -> Vec<Lanes> {
    let mut rows = vec![[0.0; LANES]; columns.nrows()];
    for (lane, column) in columns.col_iter().enumerate() {
        rows.iter_mut().zip(column.iter()).for_each(|(row, x)| row[lane] = *x);
    }
    rows
}

/// So many rows at the start of a cache line: reading and writing them takes half the time.
pub(super) fn aligned(memory: &mut Vec<f64>, rows: usize) -> &mut [Lanes] {
    memory.resize((rows + 1) * LANES, 0.0);
    let start = memory.as_ptr().align_offset(64).min(LANES);
    &mut memory[start..].as_chunks_mut().0[..rows]
}
