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
    let [same, other] = moments(trials);
    apart(same, other)
}

/// By how many pooled standard deviations two means are apart, of means and variances.
fn apart((same, a): (f64, f64), (other, b): (f64, f64)) -> f64 {
    let pooled = (0.5 * (a + b)).sqrt();
    if pooled > 0.0 { (same - other) / pooled } else { 0.0 }
}

/// By how much d′ of one way to recognise is above that of another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Gap {
    /// The difference.
    pub difference: f64,
    /// Its standard error over people, by leaving out one after the other (the jackknife).
    pub error: f64,
}

impl Gap {
    /// Of two ways that have met the same probes. Everybody is a probe once and once in the gallery, and
    /// probes come in the order of the gallery; `None` if not, or of fewer than three people.
    pub fn between([one, other]: [&[Trial]; 2]) -> Option<Self> {
        let people = one.len();
        let whole = |trials: &[Trial]| trials.iter().all(|t| t.others.len() + 1 == people);
        if people < 3 || other.len() != people || !whole(one) || !whole(other) {
            return None;
        }
        let left_out: Vec<f64> =
            left_out(one).iter().zip(left_out(other)).map(|(one, other)| one - other).collect();
        let n = people as f64;
        let mean = left_out.iter().sum::<f64>() / n;
        let squares: f64 = left_out.iter().map(|x| (x - mean).powi(2)).sum();
        let difference = sensitivity(one) - sensitivity(other);
        Some(Self { difference, error: ((n - 1.0) / n * squares).sqrt() })
    }

    /// Whether zero is outside of the difference's 95 % interval.
    pub fn is_told(&self) -> bool {
        self.difference.abs() > Z * self.error
    }
}

/// d′ without each person in turn, as a probe and in the gallery.
fn left_out(trials: &[Trial]) -> Vec<f64> {
    // Number, sum and sum of squares.
    let sums = |scores: &mut dyn Iterator<Item = f64>| {
        scores.fold([0.0; 3], |[n, sum, squares], x| [n + 1.0, sum + x, squares + x * x])
    };
    let minus = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|k| a[k] - b[k]);
    let same = sums(&mut trials.iter().map(|trial| trial.same));
    let other = sums(&mut trials.iter().flat_map(|trial| trial.others.iter().copied()));
    let moments = |[n, sum, squares]: [f64; 3]| {
        let mean = sum / n;
        (mean, (squares / n - mean * mean).max(0.0))
    };
    (0..trials.len())
        .map(|person| {
            let own = sums(&mut trials[person].others.iter().copied());
            // Their place among the others of whoever comes later is one further to the front.
            let place = |i: usize| if person > i { person - 1 } else { person };
            let taken_for = trials.iter().enumerate().filter(|(i, _)| *i != person);
            let taken_for = sums(&mut taken_for.map(|(i, trial)| trial.others[place(i)]));
            let same = minus(same, sums(&mut std::iter::once(trials[person].same)));
            apart(moments(same), moments(minus(minus(other, own), taken_for)))
        })
        .collect()
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
    use onescan_core::rng::Rng;

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

    /// Scores of people who are more alike to themselves than to others by `apart`; each is somewhat alike to
    /// all, as a probe and in the gallery.
    fn scored(people: usize, apart: f64, rng: &mut Rng) -> Vec<Trial> {
        let manners: Vec<[f64; 2]> =
            (0..people).map(|_| [0; 2].map(|_| 0.3 * rng.normal())).collect();
        let score = |probe: usize, other: usize, rng: &mut Rng| {
            manners[probe][0] + manners[other][1] + rng.normal()
        };
        let trial = |probe: usize| Trial {
            same: apart + score(probe, probe, rng),
            others: (0..people).filter(|i| *i != probe).map(|i| score(probe, i, rng)).collect(),
        };
        (0..people).map(trial).collect()
    }

    #[test]
    fn leaving_out_a_person_is_recognising_without_them() {
        let trials = scored(7, 1.0, &mut Rng::new(7, 1));
        for (person, found) in left_out(&trials).into_iter().enumerate() {
            let rest: Vec<Trial> = (0..7)
                .filter(|i| *i != person)
                .map(|i| {
                    let mut trial = trials[i].clone();
                    trial.others.remove(person - usize::from(person > i));
                    trial
                })
                .collect();
            assert!((found - sensitivity(&rest)).abs() < 1e-12);
        }
    }

    #[test]
    fn the_error_of_a_gap_is_how_far_gaps_differ() {
        let mut rng = Rng::new(7, 2);
        let gaps: Vec<Gap> = (0..300)
            .map(|_| {
                let [one, other] = [2.0, 1.5].map(|apart| scored(40, apart, &mut rng));
                Gap::between([&one, &other]).unwrap()
            })
            .collect();
        let n = gaps.len() as f64;
        let mean = gaps.iter().map(|gap| gap.difference).sum::<f64>() / n;
        let variance = gaps.iter().map(|gap| (gap.difference - mean).powi(2)).sum::<f64>() / n;
        let squares = gaps.iter().map(|gap| gap.error.powi(2)).sum::<f64>() / n;
        // The variance of 300 gaps is off by 8 %, one standard deviation: a third is four of them, a false
        // alarm in 20,000 seeds; the jackknife itself is a little too wide.
        assert!((0.67..1.5).contains(&(squares / variance)), "{squares} for {variance}");
        assert!((mean - 0.48).abs() < 0.06, "{mean}");

        let one = scored(40, 1.0, &mut rng);
        let same = Gap::between([&one, &one]).unwrap();
        assert_eq!([same.difference, same.error], [0.0; 2]);
        assert!(!same.is_told());
        assert!(
            Gap::between([&one, &one[1..]]).is_none() && Gap::between([&one[..2]; 2]).is_none()
        );
    }

    #[test]
    fn mcnemars_test_is_the_binomials() {
        assert_eq!(by_chance([0, 0]), 1.0);
        assert_eq!(by_chance([5, 5]), 1.0);
        assert!((by_chance([1, 9]) - 2.0 * 11.0 / 1024.0).abs() < 1e-12);
        assert!((by_chance([6, 0]) - 2.0 / 64.0).abs() < 1e-12);
    }
}
