//! The only door to transcendental functions, so that every target computes the same bits.
//!
//! `+ − × ÷ √` and conversions are correctly rounded by IEEE 754 everywhere; everything else
//! comes from `libm`'s portable code, never from the platform's. With the feature `micromath` the
//! exponential and the logarithm in single precision are that crate's: the same on all targets, too,
//! but with other bits. Angles are not: an error of 0.002, which its sines and arcs have, turns a face.

/// `eˣ`.
#[inline]
pub fn exp(x: f64) -> f64 {
    libm::exp(x)
}

/// `eˣ` in single precision, for factors and pixels; to 0.3 % with `micromath`.
#[inline]
pub fn exp_f32(x: f32) -> f32 {
    #[cfg(feature = "micromath")]
    return micromath::F32(x).exp().0;
    #[cfg(not(feature = "micromath"))]
    libm::expf(x)
}

/// Natural logarithm.
#[inline]
pub fn ln(x: f64) -> f64 {
    libm::log(x)
}

/// Natural logarithm in single precision, for pixels; to 0.0001 with `micromath`.
#[inline]
pub fn ln_f32(x: f32) -> f32 {
    #[cfg(feature = "micromath")]
    return quick_ln(x);
    #[cfg(not(feature = "micromath"))]
    libm::logf(x)
}

/// The crate's logarithm of what is below 1 is wrong by 0.1, since so is its reciprocal.
#[cfg(feature = "micromath")]
#[inline]
fn quick_ln(x: f32) -> f32 {
    if x >= 1.0 {
        micromath::F32(x).ln().0
    } else if x > 0.0 {
        -micromath::F32(1.0 / x).ln().0
    } else {
        f32::NAN
    }
}

/// Sine and cosine of an angle in radians.
#[inline]
pub fn sin_cos(x: f32) -> (f32, f32) {
    (libm::sinf(x), libm::cosf(x))
}

/// Angle of the point `(x, y)`, radians in `(−π, π]`.
#[inline]
pub fn atan2(y: f32, x: f32) -> f32 {
    libm::atan2f(y, x)
}

/// Square root, correctly rounded.
#[inline]
pub fn sqrt(x: f32) -> f32 {
    libm::sqrtf(x)
}

/// Square root in double precision, correctly rounded.
#[inline]
pub fn sqrt_f64(x: f64) -> f64 {
    libm::sqrt(x)
}

/// `1/√x` for normal positive `x`, to about 2⁻²² relative, from integer and multiply operations
/// only: unlike a call into libm it vectorises, and unlike the processors' estimates it has the
/// same bits everywhere. Zero gives a large finite number, so `0 · rsqrt(0)` is 0.
///
/// A magic-constant guess (relative error 3.4 %) and three Newton steps `y ← y(3 − xy²)/2`.
#[inline(always)]
pub fn rsqrt(x: f32) -> f32 {
    let half = 0.5 * x;
    let mut y = f32::from_bits(0x5f37_59df_u32.wrapping_sub(x.to_bits() >> 1));
    y *= 1.5 - half * y * y;
    y *= 1.5 - half * y * y;
    y *= 1.5 - half * y * y;
    y
}

/// The smaller of two numbers, the second if one is NaN: one instruction, unlike `f32::min`.
#[inline(always)]
pub fn less(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The larger of two numbers, the second if one is NaN: one instruction, unlike `f32::max`.
#[inline(always)]
pub fn more(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// `f` of the numbers of two vectors, one by one. What is handed to it are numbers, not indices, so
/// nothing needs to be checked, however little the compiler inlines.
#[inline(always)]
pub(crate) fn zip<const N: usize>(
    a: [f32; N],
    b: [f32; N],
    f: impl Fn(f32, f32) -> f32,
) -> [f32; N] {
    let mut out = a;
    for (out, b) in out.iter_mut().zip(b) {
        *out = f(*out, b);
    }
    out
}

/// The largest integer not above `x`, saturating at the ends of `i32` (NaN gives 0).
#[inline]
pub fn floor(x: f32) -> i32 {
    let t = x as i32;
    t.saturating_sub(i32::from(t as f32 > x))
}

/// The smallest integer not below `x`, saturating at the ends of `i32` (NaN gives 0).
#[inline]
pub fn ceil(x: f32) -> i32 {
    let t = x as i32;
    t.saturating_add(i32::from((t as f32) < x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rsqrt_is_accurate_over_the_whole_range() {
        let mut x = 1e-30_f32;
        while x < 1e30 {
            let exact = 1.0 / f64::from(x).sqrt();
            assert!((f64::from(rsqrt(x)) / exact - 1.0).abs() < 5e-7, "{x}");
            x *= 1.37;
        }
        assert_eq!(0.0 * rsqrt(0.0), 0.0);
    }

    #[test]
    fn pixels_get_exponentials_and_logarithms_as_near_as_declared() {
        let [far, off] = if cfg!(feature = "micromath") { [3e-3, 1e-4] } else { [2e-7, 2e-6] };
        for i in -1000..=1000 {
            let x = 0.02 * i as f32;
            let exact = f64::from(x).exp();
            let found = f64::from(exp_f32(x));
            assert!((found / exact - 1.0).abs() < far, "exp {x} = {found}");
            let found = f64::from(ln_f32(exact as f32));
            assert!((found - f64::from(x)).abs() < off, "ln {exact} = {found}");
        }
        assert!(ln_f32(-1.0).is_nan());
    }

    #[test]
    fn floor_and_ceil_agree_with_std() {
        for x in [-2.5_f32, -2.0, -0.1, -0.0, 0.0, 0.1, 7.0, 7.9, 1e20, -1e20, f32::NAN] {
            assert_eq!(floor(x), x.floor() as i32);
            assert_eq!(ceil(x), x.ceil() as i32);
        }
    }
}
