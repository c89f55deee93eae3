//! Covariance kernels as values that compose: `(7.0 * rbf(100.0) + 5.0 * rbf(50.0)).identity()`.
//!
//! A kernel says how the deformations of two vertices of the scan covary. Scalar kernels
//! ([`Scalar`]) are sums of Gaussians `w·exp(−‖x − y‖²/σ²)` — no factor 2 — in position space
//! ([`rbf`], σ in millimetres) or colour space ([`rgb_rbf`], RGB in `[0, 1]³`); the weights are
//! variances (mm² for shapes, squared colour for albedo). Matrix-valued kernels ([`Kernel`])
//! give a 3×3 block per pair of vertices. [`PRESETS`] lists the paper's nine face models
//! (sections "Shape Covariance Kernels", "Albedo Covariance Kernels"), made of its ten
//! [`KERNELS`]. A kernel prints as algebra, and is parsed from it.

mod algebra;
mod preset;

pub use preset::{Field, Hyper, KERNELS, Kernels, Named, PRESETS, Preset};

use crate::mesh::Axis;
use std::fmt;
use std::ops::{Add, Mul};

/// A 3×3 matrix, row-major.
pub type Matrix3 = [[f64; 3]; 3];

/// What kernels are evaluated on: a vertex of the scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// Position, millimetres.
    pub position: [f64; 3],
    /// Colour, RGB in `[0, 1]`.
    pub color: [f64; 3],
}

/// The metric a Gaussian uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Space {
    /// Euclidean distance of positions.
    Position,
    /// Euclidean distance of colours taken as points of `[0, 1]³`.
    Color,
}

/// One Gaussian of a scalar kernel: `weight·exp(−r²/sigma²)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gaussian {
    /// Variance at distance 0.
    pub weight: f64,
    /// Scale, in the unit of `space`.
    pub sigma: f64,
    /// The metric.
    pub space: Space,
}

/// A scalar kernel: a sum of Gaussians.
#[derive(Clone, Debug, PartialEq)]
pub struct Scalar(Vec<Gaussian>);

/// `exp(−‖x − y‖²/sigma²)` over positions; `sigma > 0` in millimetres.
pub fn rbf(sigma: f64) -> Scalar {
    Scalar(vec![Gaussian { weight: 1.0, sigma, space: Space::Position }])
}

/// `exp(−‖x − y‖²/sigma²)` over colours; `sigma > 0` in units of full colour range.
pub fn rgb_rbf(sigma: f64) -> Scalar {
    Scalar(vec![Gaussian { weight: 1.0, sigma, space: Space::Color }])
}

impl Mul<Scalar> for f64 {
    type Output = Scalar;
    fn mul(self, mut kernel: Scalar) -> Scalar {
        for gaussian in &mut kernel.0 {
            gaussian.weight *= self;
        }
        kernel
    }
}

impl Add for Scalar {
    type Output = Self;
    fn add(mut self, other: Self) -> Self {
        self.0.extend(other.0);
        self
    }
}

impl Scalar {
    /// `k(x, y)·I₃`: three independent channels.
    pub fn identity(self) -> Kernel {
        self.correlated(0.0)
    }

    /// `k(x, y)·M_β` with the paper's `M_β`: 1 on the diagonal, `beta` off it, for channels
    /// that vary together. Positive semidefinite for `−½ ≤ beta ≤ 1`.
    pub fn correlated(self, beta: f64) -> Kernel {
        Kernel::Correlated(self, beta)
    }
}

/// A matrix-valued kernel: a 3×3 covariance block for every pair of vertices.
#[derive(Clone, Debug, PartialEq)]
pub enum Kernel {
    /// `k(x, y)·M_β`, see [`Scalar::correlated`].
    Correlated(Scalar, f64),
    /// `K(x, y) + α·K(x, Φy)` or, for displacements, `K(x, y) + α·Φ·K(x, Φy)`.
    Mirrored {
        /// `K`.
        inner: Box<Self>,
        /// The mirror `Φ`.
        axis: Axis,
        /// `α`.
        alpha: f64,
        /// Whether the values are displacements, which `Φ` turns round as well.
        displacement: bool,
    },
    /// A multiple of a kernel.
    Scaled(f64, Box<Self>),
    /// A sum of two kernels.
    Sum(Box<Self>, Box<Self>),
}

/// One summand of a [`Kernel`] in flat form: `matrix·exp(−‖x − Φy‖²/sigma²)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Term {
    /// The 3×3 factor, weights included.
    pub matrix: Matrix3,
    /// Scale of the Gaussian.
    pub sigma: f64,
    /// Metric of the Gaussian.
    pub space: Space,
    /// Which coordinates `Φ` negates; none in colour space, where a mirror changes nothing.
    pub negates: [bool; 3],
}

impl Kernel {
    /// `K(x, y) + alpha·K(x, Φy)`: values (colours) on both sides of the mirror correlate.
    /// Unchanged without an axis. Positive semidefinite for `|alpha| ≤ 1`.
    #[must_use]
    pub fn mirrored(self, axis: Option<Axis>, alpha: f64) -> Self {
        self.with_mirror(axis, alpha, false)
    }

    /// `K(x, y) + alpha·Φ·K(x, Φy)`: displacements on both sides of the mirror correlate, the
    /// component along `axis` with opposite sign. Unchanged without an axis.
    #[must_use]
    pub fn mirrored_displacement(self, axis: Option<Axis>, alpha: f64) -> Self {
        self.with_mirror(axis, alpha, true)
    }

    fn with_mirror(self, axis: Option<Axis>, alpha: f64, displacement: bool) -> Self {
        match axis {
            None => self,
            Some(axis) => Self::Mirrored { inner: Box::new(self), axis, alpha, displacement },
        }
    }

    /// The 3×3 covariance block of vertices `x` and `y`.
    pub fn evaluate(&self, x: &Vertex, y: &Vertex) -> Matrix3 {
        block(&self.terms(), x, y)
    }

    /// The kernel as a flat sum. Terms of the same Gaussian and mirror are not merged.
    pub fn terms(&self) -> Vec<Term> {
        match self {
            Self::Correlated(Scalar(gaussians), beta) => gaussians
                .iter()
                .map(|g| Term {
                    matrix: matrix(|i, j| g.weight * if i == j { 1.0 } else { *beta }),
                    sigma: g.sigma,
                    space: g.space,
                    negates: [false; 3],
                })
                .collect(),
            Self::Mirrored { inner, axis, alpha, displacement } => {
                let phi = axis.negates();
                let mut terms = inner.terms();
                for i in 0..terms.len() {
                    let mut term = terms[i];
                    term.matrix = matrix(|r, c| {
                        let turn = if *displacement && phi[r] { -1.0 } else { 1.0 };
                        alpha * turn * terms[i].matrix[r][c]
                    });
                    if term.space == Space::Position {
                        term.negates = std::array::from_fn(|k| phi[k] != term.negates[k]);
                    }
                    terms.push(term);
                }
                terms
            }
            Self::Scaled(factor, inner) => {
                let mut terms = inner.terms();
                for term in &mut terms {
                    term.matrix = term.matrix.map(|row| row.map(|m| factor * m));
                }
                terms
            }
            Self::Sum(a, b) => [a.terms(), b.terms()].concat(),
        }
    }
}

impl Term {
    fn gaussian(&self, x: &Vertex, y: &Vertex) -> f64 {
        let (a, b) = match self.space {
            Space::Position => (x.position, reflect(y.position, self.negates)),
            Space::Color => (x.color, y.color),
        };
        let r2: f64 = (0..3).map(|k| (a[k] - b[k]).powi(2)).sum();
        (-r2 / (self.sigma * self.sigma)).exp()
    }
}

impl Vertex {
    /// The vertices of a mesh: as many positions, in millimetres, as colours.
    pub fn all(points: &[[f32; 3]], colors: &[[f32; 3]]) -> Vec<Self> {
        let of = |(p, c): (&[f32; 3], &[f32; 3])| Self {
            position: p.map(f64::from),
            color: c.map(f64::from),
        };
        points.iter().zip(colors).map(of).collect()
    }
}

/// The sum of a kernel's terms at vertices `x` and `y`.
pub fn block(terms: &[Term], x: &Vertex, y: &Vertex) -> Matrix3 {
    let mut block = [[0.0; 3]; 3];
    for term in terms {
        let g = term.gaussian(x, y);
        for (row, m) in block.iter_mut().zip(term.matrix) {
            for (b, m) in row.iter_mut().zip(m) {
                *b += m * g;
            }
        }
    }
    block
}

/// Sum of the diagonal.
pub fn trace(matrix: &Matrix3) -> f64 {
    matrix[0][0] + matrix[1][1] + matrix[2][2]
}

/// `Φ p` for the reflection that negates some coordinates.
pub fn reflect(p: [f64; 3], negates: [bool; 3]) -> [f64; 3] {
    std::array::from_fn(|k| if negates[k] { -p[k] } else { p[k] })
}

fn matrix(entry: impl Fn(usize, usize) -> f64) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)))
}

/// `0.5 (a + b)`, the paper's combination of position and colour kernels.
pub fn mean_of(a: Kernel, b: Kernel) -> Kernel {
    0.5 * (a + b)
}

impl Mul<Kernel> for f64 {
    type Output = Kernel;
    fn mul(self, kernel: Kernel) -> Kernel {
        Kernel::Scaled(self, Box::new(kernel))
    }
}

impl Add for Kernel {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self::Sum(Box::new(self), Box::new(other))
    }
}

impl fmt::Display for Scalar {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, g) in self.0.iter().enumerate() {
            let name = if g.space == Space::Position { "rbf" } else { "rgb_rbf" };
            let plus = if i == 0 { "" } else { " + " };
            write!(f, "{plus}{} {name}({})", g.weight, g.sigma)?;
        }
        Ok(())
    }
}

impl fmt::Display for Kernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Correlated(k, 0.0) => write!(f, "I ({k})"),
            Self::Correlated(k, beta) => write!(f, "M({beta}) ({k})"),
            Self::Mirrored { inner, axis, alpha, displacement } => {
                let name = if *displacement { "mirrored_displacement" } else { "mirrored" };
                write!(f, "[{inner}].{name}({axis}, {alpha})")
            }
            Self::Scaled(factor, inner) => write!(f, "{factor} ({inner})"),
            Self::Sum(a, b) => write!(f, "{a} + {b}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const X: Vertex = Vertex { position: [10.0, 20.0, 30.0], color: [0.5, 0.4, 0.3] };
    const Y: Vertex = Vertex { position: [40.0, -5.0, 12.0], color: [0.6, 0.35, 0.32] };

    fn preset(name: &str) -> &'static Preset {
        Preset::named(name).unwrap()
    }

    #[track_caller]
    fn assert_block(block: Matrix3, expected: Matrix3) {
        for (got, want) in block.as_flattened().iter().zip(expected.as_flattened()) {
            assert!((got - want).abs() < 1e-12, "{block:?} is not {expected:?}");
        }
    }

    /// Golden values: computed from the formulas in float64 by an independent script.
    #[test]
    fn blocks_of_the_papers_kernels() {
        let diagonal = |d: [f64; 3]| matrix(|i, j| if i == j { d[i] } else { 0.0 });
        let correlated = |d: f64, o: f64| matrix(|i, j| if i == j { d } else { o });
        let shape = |name| preset(name).shape(Some(Axis::X)).evaluate(&X, &Y);
        let albedo = |name| preset(name).albedo(Some(Axis::X)).evaluate(&X, &Y);
        assert_block(shape("standard-full"), diagonal([8.204835813351288; 3]));
        let (xx, yy) = (3.8533318198990694, 12.556339806803507);
        assert_block(shape("symmetric-full"), diagonal([xx, yy, yy]));
        assert_block(albedo("standard-xyz"), diagonal([0.019950907610446145; 3]));
        let (on, off) = (0.03376034987966694, 0.031650328012187756);
        assert_block(albedo("symmetric-xyz"), correlated(on, off));
        let rgb = 0.008454652383358111;
        assert_block(albedo("symmetric-rgb"), correlated(rgb, 0.95 * rgb));
        let mean = correlated(0.5 * (on + rgb), 0.5 * (off + 0.95 * rgb));
        assert_block(albedo("symmetric-full"), mean);
    }

    #[test]
    fn on_the_mid_line_the_mirror_quiets_x_and_strengthens_y_and_z() {
        let middle = Vertex { position: [0.0, 3.0, 4.0], color: [0.5; 3] };
        let block = preset("symmetric-full").shape(Some(Axis::X)).evaluate(&middle, &middle);
        assert_block(block, [[4.5, 0.0, 0.0], [0.0, 25.5, 0.0], [0.0, 0.0, 25.5]]);
    }

    #[test]
    fn without_a_mirror_symmetric_is_correlated() {
        let (a, b) = (preset("symmetric-full"), preset("correlated-full"));
        assert_eq!(a.albedo(None), b.albedo(None));
        assert_eq!(a.shape(None), b.shape(None));
    }

    #[test]
    fn a_kernel_prints_as_algebra() {
        let preset = preset("symmetric-full");
        assert_eq!(
            preset.shape(Some(Axis::X)).to_string(),
            "[I (7 rbf(100) + 5 rbf(50) + 3 rbf(10))].mirrored_displacement(x, 0.7)"
        );
        assert_eq!(
            preset.albedo(Some(Axis::X)).to_string(),
            "0.5 (M(0.95) (0.015 rgb_rbf(0.15)) + \
             [M(0.9375) (0.02 rbf(500) + 0.01 rbf(20) + 0.01 rbf(2))].mirrored(x, 0.7))"
        );
    }

    proptest! {
        /// A covariance of any handful of vertices is symmetric and has no negative variance
        /// along any direction.
        #[test]
        fn kernels_are_positive_semidefinite(
            vertices in prop::collection::vec(
                (prop::array::uniform3(-150.0..150.0), prop::array::uniform3(0.0..1.0))
                    .prop_map(|(position, color)| Vertex { position, color }), 1..7),
            direction in prop::collection::vec(-1.0..1.0, 18),
            preset in 0..PRESETS.len(),
            axis in prop::sample::select(vec![None, Some(Axis::X), Some(Axis::Y), Some(Axis::Z)]),
        ) {
            // Mirrored kernels are covariances of a set that contains its mirror images'
            // values; over any finite set they stay positive semidefinite.
            for kernel in [PRESETS[preset].shape(axis), PRESETS[preset].albedo(axis)] {
                let mut variance = 0.0;
                for (i, x) in vertices.iter().enumerate() {
                    for (j, y) in vertices.iter().enumerate() {
                        let (block, back) = (kernel.evaluate(x, y), kernel.evaluate(y, x));
                        for r in 0..3 {
                            for c in 0..3 {
                                prop_assert!((block[r][c] - back[c][r]).abs() < 1e-12);
                                variance += direction[3 * i + r] * block[r][c] * direction[3 * j + c];
                            }
                        }
                    }
                }
                prop_assert!(variance > -1e-10, "{kernel}: variance {variance}");
            }
        }
    }
}
