//! Moves of the model's coefficients.

use crate::math;
use crate::rng::Rng;

/// Adds `N(0, sd²)` to every coefficient: symmetric.
pub(super) fn add(coefficients: &mut [f32], sd: f32, rng: &mut Rng) -> Option<f64> {
    for c in coefficients {
        *c += rng.normal_sd(sd);
    }
    Some(0.0)
}

/// Adds `N(0, sd²)` to one coefficient picked at random: symmetric.
pub(super) fn add_to_one(coefficients: &mut [f32], sd: f32, rng: &mut Rng) -> Option<f64> {
    let index = rng.below(coefficients.len() as u32) as usize;
    *coefficients.get_mut(index)? += rng.normal_sd(sd);
    Some(0.0)
}

/// Multiplies all `n` coefficients by `eᶻ`; the Jacobian is `eⁿᶻ`.
pub(super) fn caricature(coefficients: &mut [f32], z: f32) -> Option<f64> {
    let k = math::exp_f32(z);
    for c in &mut *coefficients {
        *c *= k;
    }
    Some(coefficients.len() as f64 * f64::from(z))
}
