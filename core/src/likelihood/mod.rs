//! Log densities: what makes one hypothesis better than another.
//!
//! The target of the image chain is
//! `prior(scene) · landmarks(scene) · Π_covered pixels foreground / background`
//! (Schönborn et al. 2015, 2017).

pub mod background;
pub mod landmarks;
mod normal;
pub mod pixels;
pub mod prior;

pub use normal::{LN_2PI, ln_normal};
