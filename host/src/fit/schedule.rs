//! The ways to fit, and the settings that go with each.

use crate::photo::Crop;
use onescan_core::chain::Config;
use onescan_core::model::Model;
use onescan_core::scene::MAX_RANK;
use std::fmt;

/// A way to fit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "full", derive(clap::ValueEnum))]
pub enum Schedule {
    /// Search for the mode of the posterior; hair and glasses are not taken for the face.
    #[default]
    Mode,
    /// The paper's chain: random walks and closed-form light, every pixel an error of its own.
    Paper,
    /// A chain of random walks alone, which leaves the posterior invariant.
    Sampler,
}

impl Schedule {
    /// Its settings for a model and a picture whose longer side is `side`. Errors are those of a picture of
    /// [`Crop::LONGER_SIDE`], in proportion, since a larger picture of the same says no more. A search takes
    /// all components (of each half at most [`MAX_RANK`]) and makes no steps of a chain; a chain takes
    /// the paper's numbers.
    pub fn config(self, model: &Model<'_>, side: u32) -> Config {
        let scale = side as f32 / Crop::LONGER_SIDE as f32;
        let scaled = Config::default().with(|config| {
            config.landmark_sd *= scale;
            config.pixel_patch = (config.pixel_patch * scale * scale).max(1.0);
        });
        scaled.with(|config| match self {
            Self::Mode => {
                config.shape_rank = model.shape.rank().min(MAX_RANK);
                config.albedo_rank = model.albedo.rank().min(MAX_RANK);
                (config.landmark_steps, config.image_steps) = (0, 0);
            }
            Self::Paper => config.pixel_patch = 1.0,
            Self::Sampler => config.solve_light = false,
        })
    }
}

impl fmt::Display for Schedule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Mode => "mode",
            Self::Paper => "paper",
            Self::Sampler => "sampler",
        })
    }
}
