//! What is known of pose, camera, light and colours before the picture is seen.

use super::unknowns::{LIGHT, Layout};
use crate::least_squares::Equations;
use crate::light::{self, Light, SCALE};
use crate::likelihood::prior::Prior;
use crate::math;
use crate::scene::Scene;

/// Band of each spherical-harmonics coefficient.
const BAND: [usize; 9] = [0, 1, 1, 1, 2, 2, 2, 2, 2];

/// Widths of the priors that only the search uses. Radiances are of a white surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Widths {
    /// Of the radiance of surfaces that face the camera, on average over a cap of 60°.
    pub level: f32,
    /// Of the mean of the channels' light, by band: radiance at the band's brightest normal.
    pub intensity: [f32; 3],
    /// Of a channel's light about that mean, by band.
    pub chroma: [f32; 3],
    /// Standard deviation of a shape coefficient; the model's is 1.
    pub shape: f32,
    /// Standard deviations of the albedo's leading coefficient, which is complexion all over, and of
    /// the others; the model's is 1. Gaussian processes allow for more spots than people have,
    /// and shadow and gloss would become skin.
    pub albedo: [f32; 2],
    /// Of the logarithm of the focal length about the default camera's.
    pub focal: f32,
    /// Of the object's place, mm across.
    pub translation: f32,
}

impl Default for Widths {
    /// A face lit by about white light, more or less from the front.
    fn default() -> Self {
        Self {
            level: 0.1,
            intensity: [0.3, 0.25, 0.15],
            chroma: [0.04, 0.03, 0.02],
            shape: 0.95,
            albedo: [1.0, 0.45],
            focal: 0.5,
            translation: 200.0,
        }
    }
}

/// `½ (x/sd)²`.
fn energy(x: f32, sd: f32) -> f64 {
    let z = f64::from(x) / f64::from(sd);
    0.5 * z * z
}

fn precision(sd: f32) -> f32 {
    1.0 / (sd * sd)
}

fn sum_of_squares(values: &[f32]) -> f64 {
    values.iter().map(|&x| f64::from(x) * f64::from(x)).sum()
}

/// The priors of a search.
pub(super) struct Priors<'a> {
    pub(super) prior: &'a Prior,
    pub(super) widths: Widths,
    /// The default camera's focal length.
    pub(super) focal_length: f32,
}

impl Priors<'_> {
    fn ln_distance(&self, scene: &Scene) -> f32 {
        math::ln_f32(-scene.view.pose.translation[2] / self.prior.distance)
    }

    fn ln_focal(&self, scene: &Scene) -> f32 {
        math::ln_f32(scene.view.camera.focal_length / self.focal_length)
    }

    /// Standard deviation of an albedo coefficient.
    fn albedo(&self, i: usize) -> f32 {
        let [complexion, other] = self.widths.albedo;
        if i == 0 { complexion } else { other }
    }

    /// Standard deviations of a light coefficient's mean and of its channels about it.
    fn light(&self, i: usize) -> (f32, f32) {
        let band = BAND.get(i).copied().unwrap_or(0);
        let at = |widths: [f32; 3]| widths.get(band).copied().unwrap_or(1.0);
        let scale = [SCALE[0], SCALE[1], SCALE[4]];
        let scale = scale.get(band).copied().unwrap_or(1.0);
        (at(self.widths.intensity) / scale, at(self.widths.chroma) / scale)
    }

    /// Negative log density, up to a constant; infinite if the object is not before the camera.
    pub(super) fn energy(&self, scene: &Scene) -> f64 {
        let Self { prior, widths, .. } = self;
        if !(scene.view.pose.translation[2] < 0.0) || !(scene.view.camera.focal_length > 0.0) {
            return f64::INFINITY;
        }
        let squares = sum_of_squares(&scene.subject.shape);
        let mut sum = 0.5 * f64::from(precision(widths.shape)) * squares
            + energy(self.ln_distance(scene), prior.distance_sd)
            + energy(self.ln_focal(scene), widths.focal);
        for (i, &c) in scene.subject.albedo.iter().enumerate() {
            sum += energy(c, self.albedo(i));
        }
        for axis in 0..2 {
            sum += energy(scene.view.pose.translation[axis], widths.translation);
        }
        for c in 0..3 {
            sum += energy(scene.view.color.gain[c] - 1.0, prior.gain_sd)
                + energy(scene.view.color.offset[c], prior.offset_sd);
        }
        sum += energy(scene.view.color.contrast - 1.0, prior.contrast_sd);
        let expected = light::frontal();
        sum += energy(level(&scene.view.light) - level(&expected), widths.level);
        for (i, (channels, expected)) in scene.view.light.iter().zip(expected).enumerate() {
            let (intensity, chroma) = self.light(i);
            let mean = mean(*channels);
            sum += energy(mean - expected[0], intensity);
            for channel in channels {
                sum += energy(channel - mean, chroma);
            }
        }
        sum
    }

    /// Adds the priors' equations.
    pub(super) fn add<E: Equations>(&self, scene: &Scene, layout: Layout, system: &mut E) {
        let Self { prior, widths, .. } = self;
        let mut at = 0;
        let mut pull = |system: &mut E, precision: f32, x: f32| {
            system.pull(at, precision, x);
            at += 1;
        };
        // The rotation is uniform; zoom and recede come below.
        for _ in 0..3 {
            pull(system, 0.0, 0.0);
        }
        for axis in 0..2 {
            let x = scene.view.pose.translation[axis];
            pull(system, precision(widths.translation), x);
        }
        pull(system, 0.0, 0.0);
        pull(system, precision(prior.distance_sd), self.ln_distance(scene));
        for &c in scene.subject.shape.iter().take(layout.shape_rank) {
            pull(system, precision(widths.shape), c);
        }
        for (i, &c) in scene.subject.albedo.iter().enumerate().take(layout.albedo_rank) {
            pull(system, precision(self.albedo(i)), c);
        }
        for _ in 0..LIGHT {
            pull(system, 0.0, 0.0);
        }
        for gain in scene.view.color.gain {
            pull(system, precision(prior.gain_sd), gain - 1.0);
        }
        pull(system, precision(prior.contrast_sd), scene.view.color.contrast - 1.0);
        for offset in scene.view.color.offset {
            pull(system, precision(prior.offset_sd), offset);
        }
        // The logarithm of the focal length is the sum of two unknowns.
        couple(system, &[(5, 1.0), (6, 1.0)], precision(widths.focal), self.ln_focal(scene));
        let expected = light::frontal();
        let mut terms = [(0, 0.0); 9];
        for (terms, (i, weight)) in terms.as_chunks_mut::<3>().0.iter_mut().zip(LEVEL) {
            for (c, term) in terms.iter_mut().enumerate() {
                *term = (layout.light() + 3 * i + c, weight * (1.0 / 3.0));
            }
        }
        let above = level(&scene.view.light) - level(&expected);
        couple(system, &terms, precision(widths.level), above);
        for (i, (channels, expected)) in scene.view.light.iter().zip(expected).enumerate() {
            let (intensity, chroma) = self.light(i);
            let first = layout.light() + 3 * i;
            let third = 1.0 / 3.0;
            let all = [(first, third), (first + 1, third), (first + 2, third)];
            let mean = mean(*channels);
            couple(system, &all, precision(intensity), mean - expected[0]);
            for (c, channel) in channels.iter().enumerate() {
                let mut apart = all.map(|(at, _)| (at, -third));
                if let Some((_, weight)) = apart.get_mut(c) {
                    *weight += 1.0;
                }
                couple(system, &apart, precision(chroma), channel - mean);
            }
        }
    }
}

/// Coefficients of the light that surfaces get which face the camera, and their basis functions on
/// average over normals of at most 60° from the axis: `1`, `z`, `3z² − 1`, scaled.
const LEVEL: [(usize, f32); 3] = [(0, SCALE[0]), (2, 0.75 * SCALE[2]), (6, 0.75 * SCALE[6])];

/// Mean radiance of white surfaces that face the camera.
fn level(light: &Light) -> f32 {
    let [band_0, _, z, _, _, _, zz, ..] = *light;
    LEVEL.iter().zip([band_0, z, zz]).map(|((_, weight), channels)| weight * mean(channels)).sum()
}

fn mean([r, g, b]: [f32; 3]) -> f32 {
    (r + g + b) * (1.0 / 3.0)
}

/// Adds `½ w (x + Σ kᵢ δᵢ)²`.
fn couple(system: &mut impl Equations, terms: &[(usize, f32)], weight: f32, x: f32) {
    let row = system.row();
    row.fill(0.0);
    for &(at, k) in terms {
        if let Some(entry) = row.get_mut(at) {
            *entry = k;
        }
    }
    system.add(weight, -x);
}
