//! Three numbers as a vector.

/// A point, direction or colour.
pub(crate) type Vec3 = [f32; 3];

#[inline(always)]
pub(crate) fn dot(a: Vec3, b: Vec3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(crate) fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
pub(crate) fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(crate) fn add(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub(crate) fn times(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2]]
}

#[inline(always)]
pub(crate) fn scale(a: Vec3, k: f32) -> Vec3 {
    [k * a[0], k * a[1], k * a[2]]
}

/// `M a`.
#[inline(always)]
pub(crate) fn apply(m: &[Vec3; 3], a: Vec3) -> Vec3 {
    [dot(m[0], a), dot(m[1], a), dot(m[2], a)]
}

/// `Mᵀ a`.
#[inline(always)]
pub(crate) fn apply_transposed(m: &[Vec3; 3], a: Vec3) -> Vec3 {
    add(add(scale(m[0], a[0]), scale(m[1], a[1])), scale(m[2], a[2]))
}

#[inline(always)]
pub(crate) fn xyz([x, y, z, _]: [f32; 4]) -> Vec3 {
    [x, y, z]
}
