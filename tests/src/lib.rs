//! What the whole-system tests share.

pub mod coarse;
pub mod identities;
pub mod program;
