//! How well people are told apart.

use serde::Serialize;

/// A probe's scores against a gallery.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trial {
    /// The score of the person whom the probe shows.
    pub same: f64,
    /// Those of the others.
    pub others: Vec<f64>,
}

impl Trial {
    /// The rank of whom the probe shows, from 1. Of equals the others come first.
    pub fn rank(&self) -> usize {
        1 + self.others.iter().filter(|other| !(self.same > **other)).count()
    }
}

/// A share with its 95 % interval by Wilson's score.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Share {
    /// How many.
    pub hits: usize,
    /// Of how many.
    pub of: usize,
    /// The share.
    pub share: f64,
    /// The interval.
    pub interval: [f64; 2],
}

/// 97.5 % quantile of the standard normal distribution.
const Z: f64 = 1.959_963_984_540_054;

impl Share {
    /// The share of `hits` out of `of`; its interval is `(p + z²/2n ± z √(p(1 − p)/n + z²/4n²)) / (1 + z²/n)`.
    pub fn new(hits: usize, of: usize) -> Self {
        let n = of.max(1) as f64;
        let p = hits as f64 / n;
        let centre = p + Z * Z / (2.0 * n);
        let half = Z * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
        let at = |x: f64| (x / (1.0 + Z * Z / n)).clamp(0.0, 1.0);
        Self { hits, of, share: p, interval: [at(centre - half), at(centre + half)] }
    }
}

/// How often the one shown is first.
pub fn first(trials: &[Trial]) -> Share {
    Share::new(trials.iter().filter(|trial| trial.rank() == 1).count(), trials.len())
}

/// Cumulative match: for each rank from 1 to `most`, the share of probes whose person has that rank or a
/// better one.
pub fn cumulative(trials: &[Trial], most: usize) -> Vec<f64> {
    let ranks: Vec<usize> = trials.iter().map(Trial::rank).collect();
    let within = |rank| ranks.iter().filter(|r| **r <= rank).count();
    (1..=most).map(|rank| within(rank) as f64 / ranks.len().max(1) as f64).collect()
}

/// Means of the scores of the same person and of others.
pub fn means(trials: &[Trial]) -> [f64; 2] {
    moments(trials).map(|(mean, _)| mean)
}

/// d′: by how many pooled standard deviations scores of the same person and of others are apart,
///
/// `(μ₁ − μ₀) / √((σ₁² + σ₀²)/2)`.
pub fn sensitivity(trials: &[Trial]) -> f64 {
    let [(same, a), (other, b)] = moments(trials);
    let pooled = (0.5 * (a + b)).sqrt();
    if pooled > 0.0 { (same - other) / pooled } else { 0.0 }
}

/// Mean and variance of the scores of the same person, and of others.
fn moments(trials: &[Trial]) -> [(f64, f64); 2] {
    let of = |scores: Vec<f64>| {
        let n = scores.len().max(1) as f64;
        let mean = scores.iter().sum::<f64>() / n;
        (mean, scores.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n)
    };
    [
        of(trials.iter().map(|trial| trial.same).collect()),
        of(trials.iter().flat_map(|trial| trial.others.iter().copied()).collect()),
    ]
}

/// Probability, two-sided, that chance makes two ways to recognise the same probes differ by as much
/// (`McNemar`'s exact test): `only` counts the probes that only the first way got right, and only the second.
pub fn by_chance(only: [usize; 2]) -> f64 {
    let n = only[0] + only[1];
    let fewer = only[0].min(only[1]);
    // The binomial distribution of n tosses, from none on.
    let (mut term, mut sum) = (0.5_f64.powi(i32::try_from(n).unwrap_or(i32::MAX)), 0.0);
    for k in 0..=fewer {
        sum += term;
        term *= (n - k) as f64 / (k + 1) as f64;
    }
    (2.0 * sum).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilsons_interval_is_the_textbooks() {
        // Agresti & Coull 1998: 0 of 10; and 81 of 263, Newcombe 1998.
        for (hits, of, low, high) in
            [(0, 10, 0.0, 0.2775), (81, 263, 0.2553, 0.3662), (1, 29, 0.0061, 0.1718)]
        {
            let Share { interval, .. } = Share::new(hits, of);
            assert!((interval[0] - low).abs() < 5e-5, "{interval:?}");
            assert!((interval[1] - high).abs() < 5e-5, "{interval:?}");
        }
        assert_eq!(Share::new(0, 0).share, 0.0);
    }

    #[test]
    fn ranks_count_from_one_and_equals_come_last() {
        let trial = |same, others: &[f64]| Trial { same, others: others.to_vec() };
        assert_eq!(trial(0.9, &[0.1, 0.2]).rank(), 1);
        assert_eq!(trial(0.2, &[0.1, 0.2, 0.7]).rank(), 3);
        assert_eq!(trial(f64::NAN, &[0.1]).rank(), 2);
        let trials = [trial(0.9, &[0.1, 0.2]), trial(0.15, &[0.1, 0.2])];
        assert_eq!(cumulative(&trials, 3), [0.5, 1.0, 1.0]);
        assert_eq!((first(&trials).hits, first(&trials).of), (1, 2));
    }

    #[test]
    fn sensitivity_is_in_pooled_deviations() {
        // Same: 3 ± 1; others: 0 ± 1.
        let trials = [
            Trial { same: 2.0, others: vec![-1.0, 1.0] },
            Trial { same: 4.0, others: vec![1.0, -1.0] },
        ];
        assert!((sensitivity(&trials) - 3.0).abs() < 1e-12);
        assert_eq!(means(&trials), [3.0, 0.0]);
        assert_eq!(sensitivity(&[]), 0.0);
    }

    #[test]
    fn mcnemars_test_is_the_binomials() {
        assert_eq!(by_chance([0, 0]), 1.0);
        assert_eq!(by_chance([5, 5]), 1.0);
        assert!((by_chance([1, 9]) - 2.0 * 11.0 / 1024.0).abs() < 1e-12);
        assert!((by_chance([6, 0]) - 2.0 / 64.0).abs() < 1e-12);
    }
}
