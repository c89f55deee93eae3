//! What tests put into a held density, and its image term once more, slow and obvious.

use super::*;
use crate::chain::Problem;
use crate::search::image_term::HOPELESS;
use crate::search::priors::Widths;
use std::vec::Vec;

/// A point of the surface that is held.
pub(crate) struct Point {
    /// Its triangle's corners, and their weights.
    pub(crate) corners: [usize; 3],
    pub(crate) weights: [f64; 3],
    /// `a`.
    count: f64,
    ln_background: f64,
    /// `1/√G'a`.
    share: f64,
    /// Other points, and `G'` between.
    around: Vec<(usize, f64)>,
}

/// What is held of a photo.
pub(crate) struct Naive {
    pub(crate) points: Vec<Point>,
    /// Standard deviation of a channel.
    sd: f64,
    /// `W/Σa · 1/patch`.
    unit: f64,
}

impl<'a> Held<'a, '_, 0> {
    /// What is fitted to what.
    pub(crate) fn problem(&self) -> &Problem<'a> {
        &self.search.common.problem
    }

    /// Widths of the search's priors.
    pub(crate) fn widths(&self) -> Widths {
        self.search.common.widths
    }

    /// Vertices of the landmarks.
    pub(crate) fn landmarks(&self) -> Vec<usize> {
        let problem = self.problem();
        let observed = problem.photo.check(problem.model).unwrap();
        observed.iter().map(|(vertex, _)| *vertex as usize).collect()
    }

    /// Has landmarks observed there.
    pub(crate) fn observe(&mut self, places: &[[f32; 2]]) {
        self.search.first.landmarks.observe(places);
    }

    /// Has the photo, as the lens shows it, show that at a pixel of this number.
    pub(crate) fn show(&mut self, color: impl Fn(usize) -> Vec3) {
        for (c, plane) in self.search.first.planes.photo.iter_mut().enumerate() {
            for (index, value) in plane.iter_mut().enumerate() {
                *value = color(index)[c];
            }
        }
    }

    /// What is held, by its definition.
    pub(crate) fn naive(&self) -> Naive {
        let (evidence, photo) = (&self.search.first, &self.photos[0]);
        let config = &self.search.common.problem.config;
        let mut places = Vec::new();
        let mut points = Vec::new();
        for (number, _) in photo.points() {
            let [x, y] = photo.pixel(number);
            places.push([x / APART, y / APART]);
            let hit = evidence.frame.hit(x, y).unwrap();
            let [second, third] = hit.weights.map(f64::from);
            let corners = self.search.common.problem.model.triangles.get(hit.triangle).unwrap();
            points.push(Point {
                corners: corners.map(|v| v as usize),
                weights: [1.0 - second - third, second, third],
                count: f64::from(at(photo.counts, number)),
                ln_background: f64::from(evidence.planes.ln_background[y * evidence.width() + x]),
                share: 0.0,
                around: Vec::new(),
            });
        }
        let sd = f64::from(SHADE) / APART as f64;
        let tap = |a: usize, b: usize| {
            let off = a.abs_diff(b) as f64;
            if off > (3.0 * sd).ceil() { 0.0 } else { (-0.5 * off * off / (sd * sd)).exp() }
        };
        for (point, [x, y]) in points.iter_mut().zip(&places) {
            let near = places.iter().map(|[u, v]| tap(*x, *u) * tap(*y, *v)).enumerate();
            point.around = near.filter(|(_, k)| *k > 0.0).collect();
        }
        for p in 0..points.len() {
            let sum: f64 = points[p].around.iter().map(|(q, k)| k * points[*q].count).sum();
            points[p].share = 1.0 / sum.sqrt();
        }
        let sd = f64::from(config.pixel_sd);
        Naive { points, sd, unit: f64::from(photo.share / config.pixel_patch) }
    }
}

impl Naive {
    /// Sum of what all points count, `W/patch`.
    pub(crate) fn weight(&self) -> f64 {
        self.unit * self.points.iter().map(|point| point.count).sum::<f64>()
    }

    /// Mean of what points have, each as much as it counts.
    pub(crate) fn mean(&self, values: &[[f64; 3]]) -> [f64; 3] {
        core::array::from_fn(|c| {
            let all = self.points.iter().zip(values);
            self.unit * all.map(|(point, value)| point.count * value[c]).sum::<f64>()
                / self.weight()
        })
    }

    /// The image term of differences between the photo and the points' colours.
    pub(crate) fn energy(&self, differences: &[[f64; 3]]) -> f64 {
        let most = f64::from(shade_most(self.sd as f32));
        let shaded: Vec<f64> =
            differences.iter().map(|[r, g, b]| ((r + g + b) / 3.0).clamp(-most, most)).collect();
        let k = 0.5 / (self.sd * self.sd);
        let normaliser = -1.5 * (2.0 * core::f64::consts::PI).ln() - 3.0 * self.sd.ln();
        let mut sum = 0.0;
        for ((point, d), m) in self.points.iter().zip(differences).zip(&shaded) {
            let around = point.around.iter().map(|(q, k)| {
                let other = &self.points[*q];
                k * other.count * other.share * shaded[*q]
            });
            let shade = f64::from(SHADE_SHARE) * point.share * around.sum::<f64>();
            let square: f64 = d.iter().map(|d| d * d).sum();
            let ratio = normaliser - k * (square - 3.0 * m * shade) - point.ln_background;
            sum += point.count * (ratio.exp() + (-f64::from(HOPELESS)).exp()).ln();
        }
        -self.unit * sum
    }
}
