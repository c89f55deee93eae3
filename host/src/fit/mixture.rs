//! Which component of a mixture a photo shows (paper, "Kernel Density Estimation").

use super::{Control, Fit, Job, find_mode};
use crate::error::{Error, Result};
use rayon::prelude::*;

/// The fits of a mixture's components.
pub struct Found {
    /// By component, the fits photo by photo.
    pub fits: Vec<Vec<Fit>>,
    /// By component, how likely it is now that the photos were seen.
    pub weights: Vec<f64>,
    /// The likeliest component.
    pub best: usize,
}

/// Searches for the mode under every component, in parallel on rayon's threads. `components` are each
/// one's jobs, the same photos of one subject in the same crops; `before` is how likely each is before
/// they are seen. `None` if [`Control::stop`] was set.
///
/// # Errors
/// Those of [`find_mode`]; a component without a marginal likelihood.
pub fn find(
    components: &[Vec<Job<'_>>],
    before: &[f64],
    control: &Control<'_>,
) -> Result<Option<Found>> {
    let fits = components.par_iter().map(|jobs| find_mode(jobs, control));
    let Some(fits) = fits.collect::<Result<Option<Vec<_>>>>()? else { return Ok(None) };
    let ln: Option<Vec<f64>> = fits.iter().map(|fits| fits.first()?.ln_evidence()).collect();
    let ln = ln.ok_or_else(|| {
        Error::new("a component's fit has no curvature, so nothing says how likely it is")
    })?;
    let weights = weights(before, &ln);
    let mut best = 0;
    for (i, weight) in weights.iter().enumerate() {
        // The first of equals.
        if *weight > weights[best] {
            best = i;
        }
    }
    Ok(Some(Found { fits, weights, best }))
}

/// The weights of components once a photo was seen,
///
/// `w_k ∝ π_k p(photo | k)`,
///
/// given those before, `π_k > 0`, and the logarithms of the marginal likelihoods.
pub fn weights(before: &[f64], ln_evidence: &[f64]) -> Vec<f64> {
    let ln: Vec<f64> = before.iter().zip(ln_evidence).map(|(p, ln)| p.ln() + ln).collect();
    let most = ln.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let shares: Vec<f64> = ln.iter().map(|x| (x - most).exp()).collect();
    let sum: f64 = shares.iter().sum();
    shares.iter().map(|x| x / sum).collect()
}

#[cfg(test)]
mod tests {
    use super::weights;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn weights_sum_to_one_and_do_not_mind_a_constant(
            parts in prop::collection::vec((0.01_f64..1.0, -1e5_f64..1e5), 1..8),
            constant in -1e4_f64..1e4,
        ) {
            let (before, ln): (Vec<f64>, Vec<f64>) = parts.into_iter().unzip();
            let found = weights(&before, &ln);
            prop_assert!((found.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            let moved: Vec<f64> = ln.iter().map(|x| x + constant).collect();
            for (a, b) in found.iter().zip(weights(&before, &moved)) {
                prop_assert!((a - b).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn equal_evidence_leaves_the_weights_as_they_were() {
        let found = weights(&[0.75, 0.25], &[-3e4, -3e4]);
        assert!((found[0] - 0.75).abs() < 1e-12 && (found[1] - 0.25).abs() < 1e-12);
        let found = weights(&[0.5, 0.5], &[3_f64.ln(), 0.0]);
        assert!((found[0] - 0.75).abs() < 1e-12);
    }
}
