//! Numbers side by side, for vector registers: a picture in chunks of [`LANES`] pixels, each row padded to
//! whole chunks; equations in groups of [`LANES`] unknowns.

/// Numbers handled together: single precision in the widest vectors there are, of 512 bits.
pub const LANES: usize = 16;

/// Chunks of [`LANES`] pixels of a picture, whose rows start with a new chunk each.
pub const fn chunks(width: usize, height: usize) -> usize {
    width.div_ceil(LANES) * height
}

/// One number per channel or axis, for the pixels of a chunk.
pub type Planes = [[f32; LANES]; 3];

/// Words of memory of three numbers per pixel.
pub const fn planes_words(width: usize, height: usize) -> usize {
    3 * LANES * chunks(width, height)
}
