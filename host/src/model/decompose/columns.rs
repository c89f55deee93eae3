//! Columns of matrices side by side, so that one row's values fill a vector register.

use faer::MatRef;

/// Columns that are done side by side: in single precision a vector of 512 bits.
pub(super) const ABREAST: usize = 16;

/// A value of each: a cache line. In single precision, whose rounding is less than what either way
/// of a product leaves out.
pub(super) type Row = [f32; ABREAST];

/// What is summed for each: of many values, so in double precision.
pub(super) type Sum = [f64; ABREAST];

/// At most [`ABREAST`] columns, their rows in some order and scaled; columns that are missing are zero.
pub(super) fn gathered(columns: MatRef<'_, f64>, order: &[usize], scales: &[f64]) -> Vec<Row> {
    let mut rows = vec![[0.0; ABREAST]; order.len()];
    for (lane, column) in columns.col_iter().enumerate() {
        for (row, &i) in rows.iter_mut().zip(order) {
            row[lane] = (scales[i] * column[i]) as f32;
        }
    }
    rows
}

/// So many rows at the start of a cache line: reading and writing them takes half the time.
pub(super) fn aligned(memory: &mut Vec<f32>, rows: usize) -> &mut [Row] {
    memory.resize((rows + 1) * ABREAST, 0.0);
    let start = memory.as_ptr().align_offset(64).min(ABREAST);
    &mut memory[start..].as_chunks_mut().0[..rows]
}
