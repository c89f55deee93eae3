//! How alike two fitted faces are.
//!
//! Faces are coefficients of one model, shape `a` and albedo `b`. The paper takes the cosine of the
//! angle between the vectors `(a, b)`. There a half counts by the square of its length, which is a
//! matter of ranks and priors; so the default is the mean of the halves' cosines. Of a mixture of
//! models the smallest angle over its components counts (paper, "Inference with kernel density
//! estimation").

use crate::fit::Fit;
use crate::fit::summary::{Laplace, Summary};
use onescan_core::scene::Subject;
use onescan_core::search::priors::Widths;
use serde::{Deserialize, Serialize};
use std::fmt;

/// How much the shape's cosine counts beside the albedo's.
pub const SHAPE_SHARE: f64 = 0.6;

/// A face as one model has it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Face {
    /// Shape coefficients.
    pub shape: Vec<f32>,
    /// Albedo coefficients.
    pub albedo: Vec<f32>,
    /// Their standard deviations given the photo, shape's first; none of a chain's fit.
    pub deviations: Option<[Vec<f32>; 2]>,
    /// Log marginal likelihood of the photo, up to a constant that models share.
    pub ln_evidence: f64,
}

impl Face {
    /// The face of a fit.
    pub fn of_fit(fit: &Fit) -> Self {
        let laplace = fit.mode.as_ref().and_then(|mode| mode.laplace.as_ref());
        Self::of(&fit.best.scene.subject, laplace)
    }

    /// The same of what its file says.
    pub fn of_summary(summary: &Summary) -> Self {
        Self::of(&summary.parameters.subject, summary.laplace.as_ref())
    }

    fn of(subject: &Subject, laplace: Option<&Laplace>) -> Self {
        Self {
            shape: subject.shape.to_vec(),
            albedo: subject.albedo.to_vec(),
            deviations: laplace.map(|found| [found.shape.clone(), found.albedo.clone()]),
            ln_evidence: laplace.map_or(0.0, |found| found.ln_evidence),
        }
    }
}

impl fmt::Display for Score {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Cosine => "cosine",
            Self::Joint => "joint",
            Self::Shape => "shape",
            Self::Albedo => "albedo",
            Self::Evidence => "evidence",
        })
    }
}

/// A way to score two faces: more is more alike.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Score {
    /// The mean of the cosines of shape and of albedo, shape counting half as much again.
    #[default]
    Cosine,
    /// The cosine of shape and albedo as one vector, as the paper has it.
    Joint,
    /// The cosine of shape alone.
    Shape,
    /// The cosine of albedo alone.
    Albedo,
    /// The log ratio of evidences: one person in both photos, or two.
    Evidence,
}

impl Score {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::Cosine, Self::Joint, Self::Shape, Self::Albedo, Self::Evidence];

    /// Of two faces of the same model.
    pub fn of(self, a: &Face, b: &Face) -> f64 {
        let shape = || cosine(&a.shape, &b.shape);
        let albedo = || cosine(&a.albedo, &b.albedo);
        match self {
            Self::Cosine => SHAPE_SHARE * shape() + (1.0 - SHAPE_SHARE) * albedo(),
            Self::Joint => joint(a, b),
            Self::Shape => shape(),
            Self::Albedo => albedo(),
            Self::Evidence => ln_ratio(a, b),
        }
    }

    /// Of two people whom several models have fitted, in one order: that of the model by which they
    /// are most alike.
    pub fn of_mixture(self, a: &[Face], b: &[Face]) -> f64 {
        a.iter().zip(b).map(|(a, b)| self.of(a, b)).fold(f64::NEG_INFINITY, f64::max)
    }
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

/// Cosine of the angle between two vectors; 0 if one has no length.
pub fn cosine(a: &[f32], b: &[f32]) -> f64 {
    ratio(dot(a, b), dot(a, a) * dot(b, b))
}

fn ratio(product: f64, squares: f64) -> f64 {
    if squares > 0.0 { product / squares.sqrt() } else { 0.0 }
}

fn joint(a: &Face, b: &Face) -> f64 {
    let both = |a: &Face, b: &Face| dot(&a.shape, &b.shape) + dot(&a.albedo, &b.albedo);
    ratio(both(a, b), both(a, a) * both(b, b))
}

/// Standard deviation, in those of the prior, by which the same person's coefficients differ from photo
/// to photo beyond what the posterior owns to.
pub const UNOWNED: f64 = 0.35;

/// `ln p(I₁, I₂ | one person) / p(I₁ | someone) p(I₂ | someone)`.
///
/// Per coefficient the photo's message about it is `N(m, s)`: what is left of its posterior `N(x, v)`
/// when the prior `N(0, p)` is divided out,
///
/// `1/s₀ = 1/v − 1/p`, `m = x s₀/v`, `s = s₀ + w`,
///
/// with `w` for what the posterior does not own to (light taken for albedo, say, is wrong on the
/// whole picture, and no error of a pixel). Of a person's `z ~ N(0, p)` two messages have the
/// correlation `ρ = p/√((p + s₁)(p + s₂))`, of two persons none; so, standardised to `u` and `t`,
///
/// `ln ratio = Σ −½ ln(1 − ρ²) + (ρ u t − ½ ρ² (u² + t²))/(1 − ρ²)`.
fn ln_ratio(a: &Face, b: &Face) -> f64 {
    let widths = Widths::default();
    let width = |half: usize, i: usize| match (half, i) {
        (0, _) => widths.shape,
        (_, 0) => widths.albedo[0],
        _ => widths.albedo[1],
    };
    let mut sum = 0.0;
    for (half, (x, y)) in [(&a.shape, &b.shape), (&a.albedo, &b.albedo)].into_iter().enumerate() {
        let deviation = |face: &Face, i: usize| {
            face.deviations.as_ref().and_then(|d| d[half].get(i)).map_or(0.0, |d| f64::from(*d))
        };
        for (i, (x, y)) in x.iter().zip(y).enumerate() {
            let p = f64::from(width(half, i)).powi(2);
            let one = message(f64::from(*x), deviation(a, i).powi(2), p);
            let other = message(f64::from(*y), deviation(b, i).powi(2), p);
            sum += ln_ratio_of(one, other, p);
        }
    }
    sum
}

/// Mean and variance `(m, s)` of what a photo says of a coefficient.
fn message(x: f64, v: f64, p: f64) -> (f64, f64) {
    // A photo that says nothing leaves the prior as it is, rounding apart.
    let v = v.clamp(1e-6 * p, (1.0 - 1e-6) * p);
    let s = 1.0 / (1.0 / v - 1.0 / p);
    (x * s / v, s + UNOWNED * UNOWNED * p)
}

fn ln_ratio_of((m, s): (f64, f64), (n, r): (f64, f64), p: f64) -> f64 {
    let square = p * p / ((p + s) * (p + r));
    let (u, t) = (m / (p + s).sqrt(), n / (p + r).sqrt());
    let rest = 1.0 - square;
    -0.5 * rest.ln() + (square.sqrt() * u * t - 0.5 * square * (u * u + t * t)) / rest
}
