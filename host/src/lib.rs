//! 3D morphable models from a single 3D scan: build, sample, render, fit.
//!
//! The inference itself lives in [`onescan_core`], which knows neither heap nor files. This crate
//! is what surrounds it on a computer, and the command `onescan`.
//!
//! # Where to begin
//!
//! | task | item |
//! |---|---|
//! | read a scan | [`scan::mesh_file::read`] |
//! | read its landmarks | [`mesh::landmarks::read`] |
//! | build a model of it | [`model::build::build`], with [`Kernels`](model::kernel::Kernels) |
//! | read and write models, also other programs' | [`model_file::OwnedModel`], [`interchange::read`], [`interchange::write`] |
//! | draw random faces | [`render::random_coefficients`], [`render::instance`] |
//! | read a photo, and its landmarks or those found | [`face_mesh::Marked::with_photo`] |
//! | fit a model to a photo | [`fit::Job::new`], [`fit::find_mode`] |
//! | say how well the fit is known | [`posterior::sample`] |
//! | write a fit's meshes, pictures and report | [`fit::output::finish`], [`fit::output::write`] |
//! | draw a model or a fit | [`render::portrait`], [`render::smooth_on`] |
//! | register a model to a scan | [`registration::register`] |
//! | say who is in a photo | [`recognition::fits::Fits`], [`recognition::scores::Score`] |
//!
//! # Rooms
//!
//! | step | room |
//! |---|---|
//! | scan → mesh; mending, simplifying and comparing meshes | [`scan`] |
//! | meshes, their landmarks, PLY, glTF out | [`mesh`] |
//! | kernels → eigenbasis → model; models of models; how good a model is | [`model`] |
//! | `.3dmm` files | [`model_file`] |
//! | model ↔ other programs' files | [`interchange`] |
//! | photo → picture and landmarks a fit looks at | [`photo`] |
//! | model + scene → picture, mesh | [`render`] |
//! | fit + photo → texture | [`texture`] |
//! | model + picture → fitted scene, and the files about it | [`fit`] |
//! | photo or scan → a face's landmarks | [`face_mesh`] |
//! | mode → samples of the posterior around it | [`posterior`] |
//! | fits, measures → pages | [`report`] |
//! | fits → who it is | [`recognition`] |
//! | model + scan → registered mesh | [`registration`] |
//! | the paper's experiments | [`experiment`] |
//! | the demo, the benchmark | [`demo`], [`mod@bench`] |
//! | the core's stages for wide vectors | [`simd`] |
//! | files, errors, progress | [`files`], [`error`], [`progress`] |
//!
//! # Build, draw, fit
//! ```
//! use onescan::fit::{Control, Job, find_mode};
//! use onescan::{demo, render};
//! use onescan_core::rng::Rng;
//!
//! // Of the built-in scan, with ten components; `model::build::build` takes any.
//! let built = demo::template_model(10, &mut |_, _| ())?;
//! let model = built.model.view();
//!
//! let shape = render::random_coefficients(model.shape.rank(), &mut Rng::new(1, 0));
//! let face = render::instance(&model, &shape, &[]);
//! assert_eq!(face.points.len(), model.vertices());
//!
//! let [subject, ..] = &demo::subjects(7)?[..] else { panic!("there are three") };
//! let job = Job::new(&model, &subject.photo, &subject.landmarks)?;
//! let fits = find_mode(&[job], &Control::default())?.expect("nobody stops it");
//! assert!(fits[0].best_quality.landmark_rmse < 10.0, "pixels");
//! # Ok::<(), onescan::error::Error>(())
//! ```
//! `examples/face.rs` does the same at full length, and writes meshes.
//!
//! Rooms use each other in one direction only; a test of `xtask` sees to it.
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
pub mod face_mesh;
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
pub mod posterior;
#[cfg(feature = "full")]
pub mod progress;
#[cfg(feature = "full")]
pub mod recognition;
#[cfg(feature = "full")]
pub mod registration;
pub mod render;
pub mod report;
#[cfg(feature = "full")]
pub mod scan;
#[cfg(feature = "full")]
pub mod simd;
pub mod texture;
mod vector;
