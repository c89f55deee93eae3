//! What tests put into a held density, and its image term once more, slow and obvious.

pub(crate) use super::WIDER;
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
    /// The pixel that showed it, and the slopes of the mode's picture in its block.
    pixel: [usize; 2],
    slopes: [Vec3; 2],
}

impl Point {
    /// Number of its pixel, of rows so long.
    pub(crate) fn pixel(&self, width: usize) -> usize {
        self.pixel[1] * width + self.pixel[0]
    }

    /// By how much it should look different once it has moved to a place.
    pub(crate) fn moved(&self, place: [f64; 2]) -> [f64; 3] {
        let off: [f64; 2] = core::array::from_fn(|axis| place[axis] - self.pixel[axis] as f64);
        core::array::from_fn(|c| {
            off.iter().zip(self.slopes).map(|(off, slope)| off * f64::from(slope[c])).sum()
        })
    }
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

    /// Standard deviation of an albedo coefficient.
    pub(crate) fn albedo_sd(&self, i: usize) -> f32 {
        self.search.common.priors().albedo(i)
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

    /// Has blocks show that, around the pixel of this number.
    pub(crate) fn show(&mut self, color: impl Fn(usize) -> Vec3) {
        let (width, photo) = (self.search.first.width(), &mut self.photos[0]);
        for number in 0..photo.count {
            let [x, y] = photo.pixel(photo.points[number] as usize);
            let look = Look::unpack(&photo.looks[number]);
            photo.looks[number] = Look { color: color(y * width + x), ..look }.pack();
        }
    }

    /// Has the mode's picture be so many times as steep.
    pub(crate) fn flatten(&mut self, k: f32) {
        for packed in self.photos.iter_mut().flat_map(|photo| photo.looks.iter_mut()) {
            let look = Look::unpack(packed);
            *packed = Look { slopes: look.slopes.map(|slope| slope.map(|x| k * x)), ..look }.pack();
        }
    }

    /// What is held, by its definition.
    pub(crate) fn naive(&self) -> Naive {
        let (evidence, photo) = (&self.search.first, &self.photos[0]);
        let config = &self.search.common.problem.config;
        let mut places = Vec::new();
        let mut points = Vec::new();
        for (number, _, look) in photo.points() {
            let [x, y] = photo.pixel(number);
            places.push([x / APART, y / APART]);
            let hit = evidence.frame.hit(x, y).unwrap();
            let [second, third] = hit.weights.map(f64::from);
            let corners = self.search.common.problem.model.triangles.get(hit.triangle).unwrap();
            points.push(Point {
                corners: corners.map(|v| v as usize),
                weights: [1.0 - second - third, second, third],
                count: f64::from(at(photo.counts, number)),
                ln_background: f64::from(look.ln_background),
                share: 0.0,
                around: Vec::new(),
                pixel: [x, y],
                slopes: look.slopes,
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
