//! The prior: standard normal coefficients, and weak proper priors on what the picture leaves open.
//!
//! The reference engine has no prior on camera and colour. A sampler needs one, or its target is
//! improper: distance and focal length are interchangeable far away, principal point and
//! translation nearly so, gain and light exactly so.

use super::normal::{LN_2PI, ln_normal};
use crate::math;
use crate::scene::Scene;
use serde::{Deserialize, Serialize};

/// Widths of the priors on pose, camera and colour.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Prior {
    /// Median of the log-normal distance of the object, mm.
    pub distance: f32,
    /// Standard deviation of the logarithm of the distance.
    pub distance_sd: f32,
    /// Standard deviation of the principal point about the picture's centre, NDC.
    pub principal_point_sd: f32,
    /// Standard deviation of each channel's gain about 1.
    pub gain_sd: f32,
    /// Standard deviation of the contrast about 1.
    pub contrast_sd: f32,
    /// Standard deviation of each channel's offset about 0.
    pub offset_sd: f32,
}

impl Default for Prior {
    /// A portrait taken from about a metre with a camera that hardly falsifies colour. Chosen, not measured.
    fn default() -> Self {
        Self {
            distance: 1000.0,
            distance_sd: 0.1,
            principal_point_sd: 1.0,
            gain_sd: 0.05,
            contrast_sd: 0.1,
            offset_sd: 0.02,
        }
    }
}

impl Prior {
    /// Log prior density of a hypothesis; −∞ if it is not in front of the camera.
    pub fn ln_density(&self, scene: &Scene) -> f64 {
        let distance = -f64::from(scene.view.pose.translation[2]);
        if !(distance > 0.0) || !(scene.view.camera.focal_length > 0.0) {
            return f64::NEG_INFINITY;
        }
        // Log-normal: the density of `ln D`, divided by `D`.
        let ln_d = math::ln(distance);
        let mut sum =
            ln_normal(ln_d, math::ln(f64::from(self.distance)), f64::from(self.distance_sd)) - ln_d;
        let mut add =
            |x: f32, mean: f64, sd: f32| sum += ln_normal(f64::from(x), mean, f64::from(sd));
        for x in scene.view.camera.principal_point {
            add(x, 0.0, self.principal_point_sd);
        }
        for c in 0..3 {
            add(scene.view.color.gain[c], 1.0, self.gain_sd);
            add(scene.view.color.offset[c], 0.0, self.offset_sd);
        }
        add(scene.view.color.contrast, 1.0, self.contrast_sd);
        sum + ln_coefficients(&scene.subject.shape) + ln_coefficients(&scene.subject.albedo)
    }
}

/// Standard normal log density of coefficients: `Σ −½log 2π − ½c²`.
pub fn ln_coefficients(coefficients: &[f32]) -> f64 {
    let squares: f64 = coefficients.iter().map(|&c| f64::from(c) * f64::from(c)).sum();
    -0.5 * LN_2PI * coefficients.len() as f64 - 0.5 * squares
}

#[cfg(test)]
mod tests {
    #[test]
    fn golden_fifty_and_fifty_zeros() {
        let two = 2.0 * super::ln_coefficients(&[0.0; 50]);
        assert!((two - -91.893_853_320_467_27).abs() < 1e-12);
    }
}
