//! Models: kernels, their eigenbases, building, and what is computed from models.

pub mod build;
pub mod decompose;
pub mod export;
mod kept;
pub mod kernel;
pub mod layout;
pub mod metrics;
pub mod morphable;
pub mod nystrom;
pub mod operate;
pub mod process;
