//! What is known of pose, camera, light and colours before the picture is seen.

use super::unknowns::Layout;
use crate::basis::Basis;
use crate::least_squares::Equations;
use crate::light::{self, Light, SCALE};
use crate::likelihood::prior::Prior;
use crate::math;
use crate::scene::{Camera, Subject, View};

/// Band of each spherical-harmonics coefficient.
const BAND: [usize; 9] = [0, 1, 1, 1, 2, 2, 2, 2, 2];

/// Standard deviations of the priors that only the search uses. Radiances are those of a white surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Widths {
    /// Of the radiance of surfaces that face the camera, averaged over normals up to 60° from its direction.
    pub level: f32,
    /// Of the mean of the channels' light, by band: radiance at the band's brightest normal.
    pub intensity: [f32; 3],
    /// Of a channel's light about that mean, by band.
    pub chroma: [f32; 3],
    /// Standard deviation of a shape coefficient; the model's is 1.
    pub shape: f32,
    /// Standard deviations of the albedo's coefficients that are complexion (their components are the same
    /// all over, [`Basis::evenness`]), and of the others; the model's is 1. Gaussian processes allow for
    /// more spots than people have, and shadow and gloss would become skin.
    pub albedo: [f32; 2],
    /// Of the logarithm of the focal length about the default camera's.
    pub focal: f32,
    /// Of the object's place, mm across.
    pub translation: f32,
}

impl Default for Widths {
    /// A face lit by about white light, more or less from the front. Level, shape and albedo were measured
    /// (docs/accuracy.md, "What is minimised", "Shape's prior, and albedo's again"); the rest was chosen.
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

/// Numbers of the albedo's components that are more or less the same all over, lighter and darker, redder
/// and yellower; as evennesses add up to 3, five at most can be more even than not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Complexion([usize; 5]);

impl Complexion {
    /// Among the first components of a model's albedo.
    pub(super) fn of(albedo: &Basis<'_>, rank: usize) -> Self {
        let mut numbers = [usize::MAX; 5];
        let mut left = 3.0;
        let mut free = numbers.iter_mut();
        for component in 0..rank {
            let evenness = albedo.evenness(component);
            if evenness > 0.5
                && let Some(number) = free.next()
            {
                *number = component;
            }
            left -= evenness;
            if left < 0.5 {
                break;
            }
        }
        Self(numbers)
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
    pub(super) complexion: Complexion,
}

impl Priors<'_> {
    fn ln_distance(&self, view: &View) -> f32 {
        math::ln_f32(-view.pose.translation[2] / self.prior.distance)
    }

    /// Standard deviation of an albedo coefficient.
    pub(super) fn albedo(&self, i: usize) -> f32 {
        let [complexion, other] = self.widths.albedo;
        if self.complexion.0.contains(&i) { complexion } else { other }
    }

    /// Standard deviations of a light coefficient's mean and of its channels about it.
    fn light(&self, i: usize) -> (f32, f32) {
        let band = BAND.get(i).copied().unwrap_or(0);
        let at = |widths: [f32; 3]| widths.get(band).copied().unwrap_or(1.0);
        let scale = [SCALE[0], SCALE[1], SCALE[4]];
        let scale = scale.get(band).copied().unwrap_or(1.0);
        (at(self.widths.intensity) / scale, at(self.widths.chroma) / scale)
    }

    /// Negative log density of a subject, up to a constant.
    pub(super) fn energy_of_subject(&self, subject: &Subject) -> f64 {
        let squares = sum_of_squares(&subject.shape);
        let mut sum = 0.5 * f64::from(precision(self.widths.shape)) * squares;
        for (i, &c) in subject.albedo.iter().enumerate() {
            sum += energy(c, self.albedo(i));
        }
        sum
    }

    /// Sum of the logarithms of the standard deviations of so many coefficients.
    pub(super) fn ln_widths(&self, layout: Layout) -> f64 {
        let ln = |sd: f32| math::ln(f64::from(sd));
        let shape = layout.shape_rank as f64 * ln(self.widths.shape);
        shape + (0..layout.albedo_rank).map(|i| ln(self.albedo(i))).sum::<f64>()
    }

    /// Negative log density of a view, up to a constant; infinite if the object is not before the
    /// camera.
    pub(super) fn energy_of_view(&self, view: &View) -> f64 {
        let Self { prior, widths, .. } = self;
        if !(view.pose.translation[2] < 0.0) || !(view.camera.focal_length > 0.0) {
            return f64::INFINITY;
        }
        let mut sum = energy(self.ln_distance(view), prior.distance_sd)
            + energy(ln_focal(view), widths.focal);
        for axis in 0..2 {
            sum += energy(view.pose.translation[axis], widths.translation);
        }
        for c in 0..3 {
            sum += energy(view.color.gain[c] - 1.0, prior.gain_sd)
                + energy(view.color.offset[c], prior.offset_sd);
        }
        sum += energy(view.color.contrast - 1.0, prior.contrast_sd);
        let expected = light::frontal();
        sum += energy(level(&view.light) - level(&expected), widths.level);
        for (i, (channels, expected)) in view.light.iter().zip(expected).enumerate() {
            let (intensity, chroma) = self.light(i);
            let mean = mean(*channels);
            sum += energy(mean - expected[0], intensity);
            for channel in channels {
                sum += energy(channel - mean, chroma);
            }
        }
        sum
    }

    /// Adds the equations of a subject's priors.
    pub(super) fn add_of_subject(
        &self,
        subject: &Subject,
        layout: Layout,
        system: &mut impl Equations,
    ) {
        for (i, &c) in subject.shape.iter().enumerate().take(layout.shape_rank) {
            system.pull(i, precision(self.widths.shape), c);
        }
        for (i, &c) in subject.albedo.iter().enumerate().take(layout.albedo_rank) {
            system.pull(layout.shape_rank + i, precision(self.albedo(i)), c);
        }
    }

    /// Adds those of the view of this number.
    pub(super) fn add_of_view(
        &self,
        view: &View,
        number: usize,
        layout: Layout,
        system: &mut impl Equations,
    ) {
        let Self { prior, widths, .. } = self;
        // The rotation is uniform; the logarithm of the focal length is the sum of two unknowns.
        let pose = layout.pose(number).start;
        for axis in 0..2 {
            let x = view.pose.translation[axis];
            system.pull(pose + 3 + axis, precision(widths.translation), x);
        }
        system.pull(pose + 6, precision(prior.distance_sd), self.ln_distance(view));
        couple(
            system,
            &[(pose + 5, 1.0), (pose + 6, 1.0)],
            precision(widths.focal),
            ln_focal(view),
        );
        let color = layout.color(number).start;
        for c in 0..3 {
            system.pull(color + c, precision(prior.gain_sd), view.color.gain[c] - 1.0);
            system.pull(color + 4 + c, precision(prior.offset_sd), view.color.offset[c]);
        }
        system.pull(color + 3, precision(prior.contrast_sd), view.color.contrast - 1.0);
        let first_light = layout.light(number).start;
        let expected = light::frontal();
        let mut terms = [(0, 0.0); 9];
        for (terms, (i, weight)) in terms.as_chunks_mut::<3>().0.iter_mut().zip(LEVEL) {
            for (c, term) in terms.iter_mut().enumerate() {
                *term = (first_light + 3 * i + c, weight * (1.0 / 3.0));
            }
        }
        let above = level(&view.light) - level(&expected);
        couple(system, &terms, precision(widths.level), above);
        for (i, (channels, expected)) in view.light.iter().zip(expected).enumerate() {
            let (intensity, chroma) = self.light(i);
            let first = first_light + 3 * i;
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

/// Logarithm of the focal length over the default camera's.
fn ln_focal(view: &View) -> f32 {
    let [width, height] = view.camera.image_size;
    math::ln_f32(view.camera.focal_length / Camera::for_image(width, height).focal_length)
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
