//! Numbers that say how a fit is done.

use crate::likelihood::prior::Prior;
use serde::{Deserialize, Serialize};

/// How a fit is done.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Config {
    /// Shape coefficients to infer.
    pub shape_rank: usize,
    /// Albedo coefficients to infer.
    pub albedo_rank: usize,
    /// Steps of the landmark phase.
    pub landmark_steps: u32,
    /// Steps of the shape phase; 0 for faces.
    pub shape_steps: u32,
    /// Steps of the image phase.
    pub image_steps: u32,
    /// Standard deviation of a landmark, pixels.
    pub landmark_sd: f32,
    /// Standard deviation of a pixel's colour channel.
    pub pixel_sd: f32,
    /// Pixels that share one independent error: the image likelihood is raised to the power
    /// `1/pixel_patch`. What a model cannot explain (a wrinkle, a highlight) is wrong in a whole
    /// patch of the picture; counted pixel by pixel (1, as the paper does) it would
    /// overrule the prior and be explained by a wrong shape. The default is for pictures with a longer
    /// side of 256 pixels; a patch of a larger picture has more pixels, as the whole picture has.
    pub pixel_patch: f32,
    /// Priors on pose, camera and colour.
    pub prior: Prior,
    /// Whether the light is also solved for in closed form, as the paper's chain does. Without that
    /// move the image phase is a sampler of its target.
    pub solve_light: bool,
}

impl Config {
    /// The same but for what `set` changes:
    ///
    /// ```
    /// # use onescan_core::chain::Config;
    /// let config = Config::default().with(|config| config.image_steps = 10_000);
    /// ```
    #[must_use]
    pub fn with(mut self, set: impl FnOnce(&mut Self)) -> Self {
        set(&mut self);
        self
    }

    /// Steps of all phases.
    pub fn steps(&self) -> u64 {
        let phases = [self.landmark_steps, self.shape_steps, self.image_steps];
        phases.into_iter().map(u64::from).sum()
    }
}

impl Default for Config {
    /// The paper's face fit: 50 + 50 coefficients, 5000 + 5000 steps, its standard deviations. The patch is
    /// ours (docs/accuracy.md).
    fn default() -> Self {
        Self {
            shape_rank: 50,
            albedo_rank: 50,
            landmark_steps: 5000,
            shape_steps: 0,
            image_steps: 5000,
            landmark_sd: 4.0,
            pixel_sd: 0.043,
            pixel_patch: 80.0,
            prior: Prior::default(),
            solve_light: true,
        }
    }
}
