//! 3D morphable models from a single 3D scan: build, sample, render, fit.
//!
//! The inference itself lives in [`onescan_core`], which knows neither heap nor files. This crate
//! is what surrounds it on a computer:
//!
//! | step | room |
//! |---|---|
//! | kernels → eigenbasis → `.3dmm` | [`kernel`], [`decompose`], [`nystrom`], [`build`], [`model_file`] |
//! | meshes, landmarks, PLY and glTF out | [`mesh`] |
//! | scan → mesh; mended, simplified, compared | [`scan`] |
//! | model → smaller model | [`export`] |
//! | model → double precision, models of models | [`morphable`], [`operate`] |
//! | model ↔ other programs' files | [`interchange`], [`statismo`], [`bfm2009`] |
//! | the formats below those | [`mod@hdf5`], [`mat`] |
//! | how good a model is | [`metrics`] |
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
pub mod bfm2009;
#[cfg(feature = "full")]
pub mod build;
#[cfg(feature = "full")]
pub mod decompose;
#[cfg(feature = "full")]
pub mod demo;
pub mod error;
#[cfg(feature = "full")]
pub mod experiment;
#[cfg(feature = "full")]
pub mod export;
#[cfg(feature = "full")]
pub mod files;
pub mod fit;
#[cfg(feature = "full")]
pub mod hdf5;
#[cfg(feature = "full")]
pub mod interchange;
mod json;
#[cfg(feature = "full")]
pub mod kernel;
#[cfg(feature = "full")]
pub mod layout;
#[cfg(feature = "full")]
pub mod mat;
pub mod mesh;
#[cfg(feature = "full")]
pub mod metrics;
pub mod model_file;
#[cfg(feature = "full")]
pub mod morphable;
#[cfg(feature = "full")]
pub mod nystrom;
#[cfg(feature = "full")]
pub mod operate;
pub mod photo;
#[cfg(feature = "full")]
pub mod process;
#[cfg(feature = "full")]
pub mod progress;
pub mod render;
pub mod report;
pub mod rps;
#[cfg(feature = "full")]
pub mod scan;
#[cfg(feature = "full")]
pub mod simd;
#[cfg(feature = "full")]
pub mod statismo;
pub mod summary;
