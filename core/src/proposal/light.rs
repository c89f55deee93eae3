//! Moves of the spherical-harmonics light (Schönborn et al. 2017), with the corrections that make them
//! reversible.

use crate::light::Light;
use crate::math;
use crate::rng::Rng;
use core::ops::Range;

/// Coefficients of each band.
const BANDS: [Range<usize>; 3] = [0..1, 1..4, 4..9];

/// The same `N(0, sd²)` to the three channels, independent per coefficient: symmetric.
pub(super) fn spatial(light: &mut Light, sd: f32, rng: &mut Rng) -> Option<f64> {
    for coefficient in light {
        let shift = rng.normal_sd(sd);
        for channel in coefficient {
            *channel += shift;
        }
    }
    Some(0.0)
}

/// Band `l` times `exp(z_l)`: the Jacobian is `exp Σ 3(2l+1) z_l`.
pub(super) fn bands(light: &mut Light, sd: f32, rng: &mut Rng) -> Option<f64> {
    let mut ratio = 0.0;
    for band in BANDS {
        ratio += intensity_of(light.get_mut(band).unwrap_or_default(), rng.normal_sd(sd));
    }
    Some(ratio)
}

/// All 27 numbers times `eᶻ`: the Jacobian is `e²⁷ᶻ`.
pub(super) fn intensity(light: &mut Light, z: f32) -> Option<f64> {
    Some(intensity_of(light, z))
}

fn intensity_of(coefficients: &mut [[f32; 3]], z: f32) -> f64 {
    let k = math::exp_f32(z);
    for coefficient in &mut *coefficients {
        for channel in coefficient {
            *channel *= k;
        }
    }
    3.0 * coefficients.len() as f64 * f64::from(z)
}

/// Independent `N(0, sd²)` on all 27 numbers, rescaled to the old energy. The noise is isotropic,
/// so on the sphere of constant energy the density depends on the angle alone: symmetric.
pub(super) fn perturb(light: &mut Light, sd: f32, rng: &mut Rng) -> Option<f64> {
    let before = energy(light);
    for channel in light.iter_mut().flatten() {
        *channel += rng.normal_sd(sd);
    }
    rescale(light, before)?;
    Some(0.0)
}

/// One RGB shift `δ ~ N(0, sd²I₃)` added to all nine coefficients (`A δ`), rescaled to the old
/// energy: `x' = s(x + Aδ)`.
///
/// The reverse move draws `δ' = −sδ`. `(x, δ) → (x + Aδ, δ)` is a shear; the rest,
/// `(y, δ) → (s y, −s δ)` with `s` homogeneous of degree 0, has the determinant `s³⁰`. Hence
/// `log ratio = 30 log s − (s² − 1)‖δ‖²/(2 sd²)`.
pub(super) fn tint(light: &mut Light, sd: f32, rng: &mut Rng) -> Option<f64> {
    let before = energy(light);
    let z = [rng.normal(), rng.normal(), rng.normal()];
    let shift = z.map(|z| (z * f64::from(sd)) as f32);
    for coefficient in &mut *light {
        for (channel, shift) in coefficient.iter_mut().zip(shift) {
            *channel += shift;
        }
    }
    let s = rescale(light, before)?;
    let norm2: f64 = z.iter().map(|z| z * z).sum();
    Some(30.0 * math::ln(s) - 0.5 * (s * s - 1.0) * norm2)
}

/// Sum of squares over coefficients and channels.
fn energy(light: &Light) -> f64 {
    light.iter().flatten().map(|&x| f64::from(x) * f64::from(x)).sum()
}

/// Multiplies to the given energy and returns the factor; `None` for a dark light.
fn rescale(light: &mut Light, wanted: f64) -> Option<f64> {
    let found = energy(light);
    if !(found > 0.0 && wanted > 0.0) {
        return None;
    }
    let s = math::sqrt_f64(wanted / found);
    for channel in light.iter_mut().flatten() {
        *channel = (f64::from(*channel) * s) as f32;
    }
    Some(s)
}
