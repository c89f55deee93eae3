//! From vertices to pixels: project, rasterize, shade.
//!
//! Each stage is a function from slices to slices, so that the chain reruns only what a move has
//! touched. Rasterizing finds the visible triangle of every pixel; shading interpolates normal and
//! albedo there and lights them. What is visible is kept, so that new albedo and new light need no
//! new geometry; the chain also keeps what was interpolated, for new light.
//!
//! A picture's rows are padded to whole chunks of [`LANES`] pixels, and everything per pixel is
//! computed a chunk at a time.

pub mod project;
pub mod rasterize;
pub mod shade;

pub use crate::lanes::{LANES, chunks};
