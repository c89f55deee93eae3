//! What the whole-system tests share.

pub mod coarse;
pub mod full;
pub mod photos;
pub mod program;
pub mod truth;
