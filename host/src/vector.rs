//! Three numbers as a vector.

use std::ops::{Add, Mul, Sub};

/// What vectors are made of.
pub(crate) trait Number:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self>
{
    /// Square root.
    fn sqrt(self) -> Self;
}

impl Number for f32 {
    fn sqrt(self) -> Self {
        self.sqrt()
    }
}

impl Number for f64 {
    fn sqrt(self) -> Self {
        self.sqrt()
    }
}

/// `a − b`.
pub(crate) fn minus<T: Number>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a · b`.
pub(crate) fn dot<T: Number>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `a × b`.
pub(crate) fn cross<T: Number>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `|v|`.
pub(crate) fn length<T: Number>(v: [T; 3]) -> T {
    dot(v, v).sqrt()
}

/// `|a − b|`.
pub(crate) fn distance<T: Number>(a: [T; 3], b: [T; 3]) -> T {
    length(minus(a, b))
}

/// `M v`, of a matrix row by row.
pub(crate) fn turned<T: Number>(m: &[[T; 3]; 3], v: [T; 3]) -> [T; 3] {
    m.map(|row| dot(row, v))
}

/// Normal of a triangle, counter-clockwise seen from its tip, as long as twice its area.
pub(crate) fn normal<T: Number>([a, b, c]: [[T; 3]; 3]) -> [T; 3] {
    cross(minus(b, a), minus(c, a))
}
