//! 3D morphable models on bare metal: the inference core of onescan.
//!
//! The pipeline, in the order the data flows:
//!
//! | step | room |
//! |---|---|
//! | model bytes → checked view | [`model`], [`basis`] |
//! | hypothesis about the picture | [`scene`] |
//! | coefficients → positions, normals, albedo | [`basis`], [`mesh`] |
//! | positions → picture | [`render`], [`light`], [`color`] |
//! | picture, landmarks, coefficients → log density | [`image`], [`likelihood`] |
//! | hypothesis → next hypothesis | [`proposal`], [`rng`] |
//! | any target, any moves → the next state | [`metropolis`] |
//! | a fit by sampling: its target, schedule and progress | [`chain`] |
//! | the mode of the posterior, by Levenberg–Marquardt | [`search`], [`least_squares`] |
//! | memory for all of it | [`memory`], [`chain::Dimensions`] |
//! | the expensive stages, exchangeable | [`engine`] |
//! | oracles for the tests | [`naive`] |
//!
//! # Contract
//! No heap, no `unsafe`, no clock, no files: the caller owns all memory and drives the chain one
//! [`step`](chain::Chain::step) at a time. Constructors check what they are given
//! ([`model::Model::new_checked`], [`chain::Chain::new`]); after that nothing can fail or panic.
//!
//! A fit is a pure function of (model bytes, image bytes, landmarks, configuration, seed), to the
//! last bit, on every target: transcendental functions come from [`math`] alone, nothing is
//! contracted to fused multiply–adds, and every sum has the shape written in the source.

#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

#[cfg(target_endian = "big")]
compile_error!(
    "onescan-core reads models in place, and their numbers are little-endian: big-endian targets are \
     not supported"
);

pub mod basis;
pub mod chain;
pub mod color;
pub mod draw;
pub mod engine;
pub mod hash;
pub mod image;
pub mod lanes;
pub mod least_squares;
pub mod light;
pub mod likelihood;
pub mod math;
pub mod memory;
pub mod mesh;
pub mod metropolis;
pub mod model;
pub mod naive;
pub mod posterior;
pub mod proposal;
pub mod register;
pub mod render;
pub mod rng;
pub mod scene;
pub mod search;
mod vector;
