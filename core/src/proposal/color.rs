//! Moves of the colour transform.

use crate::color::ColorTransform;
use crate::rng::Rng;

/// Adds to gain (each channel), contrast and offset (each channel): symmetric.
///
/// The reference engine draws new gains and contrasts and then discards them; here all
/// seven numbers move, held near neutral by the prior.
pub(super) fn perturb(
    color: &mut ColorTransform,
    gain_sd: f32,
    contrast_sd: f32,
    offset_sd: f32,
    rng: &mut Rng,
) -> Option<f64> {
    for gain in &mut color.gain {
        *gain += rng.normal_sd(gain_sd);
    }
    color.contrast += rng.normal_sd(contrast_sd);
    for offset in &mut color.offset {
        *offset += rng.normal_sd(offset_sd);
    }
    Some(0.0)
}
