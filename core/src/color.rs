//! What a camera does to colours: gain, contrast and offset.

use serde::{Deserialize, Serialize};

/// Colour transform applied after shading: `out = gain ∘ (c·colour + (1−c)·lum) + offset`,
/// `lum = 0.3 R + 0.59 G + 0.11 B`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ColorTransform {
    /// Factor per channel.
    pub gain: [f32; 3],
    /// Contrast `c`: 1 keeps the colour, 0 leaves its luminance.
    pub contrast: f32,
    /// Added per channel.
    pub offset: [f32; 3],
}

/// Luminance weights of the colour transform, the reference engine's: those of Rec. 601, rounded.
pub const LUMINANCE: [f32; 3] = [0.3, 0.59, 0.11];

impl ColorTransform {
    /// Changes nothing.
    pub const NEUTRAL: Self = Self { gain: [1.0; 3], contrast: 1.0, offset: [0.0; 3] };

    /// Applies the transform to one colour.
    pub fn apply(&self, color: [f32; 3]) -> [f32; 3] {
        let lum = LUMINANCE[0] * color[0] + LUMINANCE[1] * color[1] + LUMINANCE[2] * color[2];
        let grey = (1.0 - self.contrast) * lum;
        let channel = |c: usize| self.gain[c] * (self.contrast * color[c] + grey) + self.offset[c];
        [channel(0), channel(1), channel(2)]
    }

    /// The inverse transform; `None` where gain or contrast is zero and no inverse exists.
    ///
    /// The transform keeps luminance apart from gain and offset, so the inverse first undoes
    /// these, then `(m − (1−c)·lum)/c`.
    pub fn invert(&self, color: [f32; 3]) -> Option<[f32; 3]> {
        if self.contrast == 0.0 || self.gain.contains(&0.0) {
            return None;
        }
        let m = |c: usize| (color[c] - self.offset[c]) / self.gain[c];
        let m = [m(0), m(1), m(2)];
        let lum = LUMINANCE[0] * m[0] + LUMINANCE[1] * m[1] + LUMINANCE[2] * m[2];
        Some(m.map(|v| (v - (1.0 - self.contrast) * lum) / self.contrast))
    }
}

/// The transform as a 3×3 matrix: `out = M·colour + offset`.
pub fn color_matrix(color: &ColorTransform) -> [[f32; 3]; 3] {
    core::array::from_fn(|i| {
        core::array::from_fn(|j| {
            let direct = if i == j { color.contrast } else { 0.0 };
            color.gain[i] * (direct + (1.0 - color.contrast) * LUMINANCE[j])
        })
    })
}
