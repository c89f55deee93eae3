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
use serde::{Deserialize, Serialize};
use std::fmt;

/// The share of the shape's cosine: on clean pictures .6 tells people further apart, on rough ones, where
/// shadows become skin, shape alone (docs/recognition.md).
pub const SHAPE_SHARE: f64 = 0.75;

/// A face as one model describes it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Face {
    /// Shape coefficients.
    pub shape: Vec<f32>,
    /// Albedo coefficients.
    pub albedo: Vec<f32>,
    /// Log marginal likelihood of the photo, up to a constant that models share.
    pub ln_evidence: f64,
}

impl Face {
    /// The face of a fit.
    pub fn of_fit(fit: &Fit) -> Self {
        let laplace = fit.mode.as_ref().and_then(|mode| mode.laplace.as_ref());
        Self::of(&fit.best.scene.subject, laplace)
    }

    /// The face of a fit's file.
    pub fn of_summary(summary: &Summary) -> Self {
        Self::of(&summary.parameters.subject, summary.laplace.as_ref())
    }

    fn of(subject: &Subject, laplace: Option<&Laplace>) -> Self {
        Self {
            shape: subject.shape.to_vec(),
            albedo: subject.albedo.to_vec(),
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
        })
    }
}

/// A way to score two faces: more is more alike.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Score {
    /// The mean of the cosines of shape and of albedo, shape counting three times as much.
    #[default]
    Cosine,
    /// The cosine of shape and albedo as one vector, as the paper has it.
    Joint,
    /// The cosine of shape alone.
    Shape,
    /// The cosine of albedo alone.
    Albedo,
}

impl Score {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Cosine, Self::Joint, Self::Shape, Self::Albedo];

    /// Scores two faces of the same model.
    pub fn of(self, a: &Face, b: &Face) -> f64 {
        let shape = || cosine(&a.shape, &b.shape);
        let albedo = || cosine(&a.albedo, &b.albedo);
        match self {
            Self::Cosine => SHAPE_SHARE * shape() + (1.0 - SHAPE_SHARE) * albedo(),
            Self::Joint => joint(a, b),
            Self::Shape => shape(),
            Self::Albedo => albedo(),
        }
    }

    /// Scores two people, each fitted by the same models in the same order: the score by that model which finds
    /// them most alike.
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn face(shape: &[f32], albedo: &[f32]) -> Face {
        Face { shape: shape.to_vec(), albedo: albedo.to_vec(), ln_evidence: 0.0 }
    }

    #[test]
    fn cosines_are_of_the_angle_between_faces() {
        assert!((cosine(&[3.0, 4.0], &[4.0, 3.0]) - 0.96).abs() < 1e-12);
        assert_eq!(cosine(&[0.0, 0.0], &[1.0, 2.0]), 0.0);
        let (a, b) = (face(&[1.0, 0.0], &[2.0]), face(&[0.0, 1.0], &[2.0]));
        assert_eq!(Score::Shape.of(&a, &b), 0.0);
        assert_eq!(Score::Albedo.of(&a, &b), 1.0);
        assert!((Score::Joint.of(&a, &b) - 0.8).abs() < 1e-12);
        assert!((Score::Cosine.of(&a, &b) - (1.0 - SHAPE_SHARE)).abs() < 1e-12);
    }

    #[test]
    fn of_a_mixture_the_smallest_angle_counts() {
        let (x, y) = (face(&[1.0, 0.0], &[1.0]), face(&[0.0, 1.0], &[1.0]));
        let score = |a: &[Face], b: &[Face]| Score::Shape.of_mixture(a, b);
        assert_eq!(score(&[x.clone(), x.clone()], &[y.clone(), x.clone()]), 1.0);
        assert_eq!(score(&[x.clone(), y.clone()], &[y, x]), 0.0);
        assert_eq!(score(&[], &[]), f64::NEG_INFINITY);
    }

    fn coefficients() -> impl Strategy<Value = Vec<f32>> {
        prop::collection::vec(-4.0_f32..4.0, 6)
    }

    proptest! {
        #[test]
        fn scores_are_symmetric_and_do_not_mind_caricature(
            (a, b, c, d) in (coefficients(), coefficients(), coefficients(), coefficients()),
            factor in 0.1_f32..10.0,
        ) {
            let (one, other) = (face(&a, &b), face(&c, &d));
            let times = |x: &[f32]| x.iter().map(|x| factor * x).collect::<Vec<_>>();
            let more = face(&times(&a), &times(&b));
            for score in Score::ALL {
                let value = score.of(&one, &other);
                prop_assert!((value - score.of(&other, &one)).abs() < 1e-12);
                prop_assert!(value.abs() < 1.0 + 1e-9);
                prop_assert!((value - score.of(&more, &other)).abs() < 1e-5);
            }
        }
    }
}
