//! 3D morphable models from a single 3D scan: build, sample, render, fit.
//!
//! The inference itself lives in [`onescan_core`], which knows neither heap nor files. This crate
//! is what surrounds it on a computer:
//!
//! | step | room |
//! |---|---|
//! | kernels → eigenbasis → model; models of models; how good they are | [`model`] |
//! | `.3dmm` files | [`model_file`] |
//! | meshes, landmarks, PLY and glTF out | [`mesh`] |
//! | scan → mesh; mended, simplified, compared | [`scan`] |
//! | model ↔ other programs' files | [`interchange`] |
//! | the paper's experiments | [`experiment`] |
//! | photo → picture a fit looks at | [`photo`] |
//! | model + picture → fitted scene | [`fit`] |
//! | scene → pictures, meshes, reports | [`render`], [`rps`], [`summary`], [`report`] |
//! | the demo, the benchmark | [`demo`], [`mod@bench`] |
//! | the core's stages for wide vectors | [`simd`] |
//! | files, errors, progress | [`files`], [`error`], [`progress`] |
//!
//! Without the feature `full` only that remains which a web page needs: no building of models, no
//! files, no command.

#[cfg(feature = "full")]
pub mod bench;
#[cfg(feature = "full")]
pub mod demo;
pub mod error;
#[cfg(feature = "full")]
pub mod experiment;
#[cfg(feature = "full")]
pub mod files;
pub mod fit;
#[cfg(feature = "full")]
pub mod interchange;
mod json;
pub mod mesh;
#[cfg(feature = "full")]
pub mod model;
pub mod model_file;
pub mod photo;
#[cfg(feature = "full")]
pub mod progress;
pub mod render;
pub mod report;
pub mod rps;
#[cfg(feature = "full")]
pub mod scan;
#[cfg(feature = "full")]
pub mod simd;
pub mod summary;
