//! The normal density.

/// `log 2π`.
pub const LN_2PI: f64 = 1.837_877_066_409_345_5;

/// Log density of `N(mean, sd²)` at `x`.
pub fn ln_normal(x: f64, mean: f64, sd: f64) -> f64 {
    let z = (x - mean) / sd;
    -0.5 * LN_2PI - crate::math::ln(sd) - 0.5 * z * z
}
