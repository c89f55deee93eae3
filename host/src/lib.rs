//! 3D morphable models from a single 3D scan: build, sample, render, fit.
//!
//! The inference itself lives in [`onescan_core`], which knows neither heap nor files. This crate
//! is what surrounds it on a computer:
//!
//! | step | room |
//! |---|---|
//! | scan → mesh | [`ply`], [`mesh`], [`landmarks`] |
//! | kernels → eigenbasis → `.3dmm` | [`kernel`], [`decompose`], [`build`], [`model_file`] |
//! | model → smaller model | [`export`], [`decimate`] |
//! | photo → picture a fit looks at | [`photo`], [`picture`], [`tlms`] |
//! | model + picture → fitted scene | [`fit`] |
//! | scene → pictures, meshes, reports | [`render`], [`glb`], [`rps`], [`summary`], [`report`] |
//! | the demo, the benchmark | [`demo`], [`mod@bench`] |
//! | the core's stages for wide vectors | [`simd`] |
//! | files, errors, progress | [`files`], [`error`], [`progress`] |

pub mod bench;
pub mod build;
pub mod decimate;
pub mod decompose;
pub mod demo;
pub mod error;
pub mod export;
pub mod files;
pub mod fit;
pub mod glb;
pub mod kernel;
pub mod landmarks;
pub mod mesh;
pub mod model_file;
pub mod photo;
pub mod picture;
pub mod ply;
pub mod progress;
pub mod render;
pub mod report;
pub mod rps;
pub mod simd;
pub mod summary;
pub mod tlms;
