//! How much memory a chain needs.

use crate::basis::padded;
use crate::lanes::planes_words;
use crate::likelihood::background::HISTOGRAM_LEN;
use crate::likelihood::landmarks;
use crate::likelihood::pixels::target_words;
use crate::render::rasterize::frame_words;

/// The sizes that determine a chain's memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dimensions {
    /// Vertices of the model.
    pub vertices: usize,
    /// Shape coefficients to infer.
    pub shape_rank: usize,
    /// Albedo coefficients to infer.
    pub albedo_rank: usize,
    /// Observed landmarks.
    pub landmarks: usize,
    /// Columns of the picture.
    pub width: usize,
    /// Rows of the picture.
    pub height: usize,
    /// Whether memory is scarce, see [`Problem::lean`](super::Problem::lean).
    pub lean: bool,
}

impl Dimensions {
    /// Words (`u32`) of memory [`Chain::new`](super::Chain::new) takes.
    ///
    /// Two slots (the current and the proposed state's) of positions, normals and albedo per
    /// vertex, and of what is visible per pixel; its normal and albedo; window coordinates; the
    /// target picture; the landmarks' rows of the basis.
    pub const fn words(&self) -> usize {
        let Self { width, height, lean, .. } = *self;
        let (slots, planes) = if lean { (1, 0) } else { (2, 2) };
        let vertices = 4 * padded(self.vertices);
        // A vertex has a position and, twice as long, its attributes.
        let slot = 3 * vertices + frame_words(width, height);
        let rest = slots * slot
            + vertices
            + planes * planes_words(width, height)
            + landmarks::rows_words(self.landmarks, self.shape_rank);
        // The background histogram is needed once, before the rest is.
        target_words(width, height) + if rest > HISTOGRAM_LEN { rest } else { HISTOGRAM_LEN }
    }
}
