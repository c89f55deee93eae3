//! A picture as it is observed.

/// An 8-bit RGB picture, row by row from the top.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Image<'a> {
    /// `width · height` pixels.
    pub pixels: &'a [[u8; 3]],
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}
