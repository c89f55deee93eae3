//! 3D morphable models on bare metal: the inference core of onescan.
//!
//! # Where to begin
//!
//! | task | item |
//! |---|---|
//! | read a model | [`Model::new_checked`](model::Model::new_checked) |
//! | say what is fitted to what | [`Problem`](chain::Problem), [`Config`](chain::Config), [`Image`](image::Image), [`ObservedLandmark`](likelihood::landmarks::ObservedLandmark) |
//! | find the mode of the posterior | [`ModeSearch`](search::ModeSearch) |
//! | sample around that mode | [`Sampler`](posterior::Sampler) |
//! | fit by the paper's Markov chain | [`Chain`](chain::Chain) |
//! | read off what was found | [`Scene`](scene::Scene) |
//! | draw it | [`draw`](draw::draw()) |
//! | deform a model onto a scan | [`Registration`](register::Registration) |
//! | compute with wider vectors | [`Engine`](engine::Engine) |
//!
//! Crate `onescan` is the same on a computer, with files and a command; it builds the models.
//!
//! # Rooms
//! In the order the data flows:
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
//! | samples around the mode, by Hamiltonian Monte Carlo | [`posterior`] |
//! | model + scan → the model deformed onto it | [`register`] |
//! | result → picture | [`draw`](mod@draw) |
//! | memory for all of it | [`memory`], [`chain::Dimensions`] |
//! | the expensive stages, exchangeable | [`engine`] |
//!
//! # A fit
//! ```
//! use onescan_core::chain::{Config, Problem};
//! use onescan_core::image::Image;
//! use onescan_core::likelihood::landmarks::ObservedLandmark;
//! use onescan_core::model::Model;
//! use onescan_core::search::{self, ModeSearch, Options};
//! # let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../fixtures/device");
//! # let (file, picture) = (format!("{folder}/face.3dmm"), format!("{folder}/half.ppm"));
//! # let (file, picture) = (std::fs::read(file).unwrap(), std::fs::read(picture).unwrap());
//! # let mut words = vec![0_u32; file.len().div_ceil(4)];
//! # bytemuck::cast_slice_mut::<u32, u8>(&mut words)[..file.len()].copy_from_slice(&file);
//! # let bytes = &bytemuck::cast_slice(&words)[..file.len()];
//! # let pixels = picture[b"P6\n32 32\n255\n".len()..].as_chunks().0;
//! # let marks = std::fs::read_to_string(format!("{folder}/half.tlms")).unwrap();
//! # let landmarks: Vec<_> = marks.lines().map(|line| {
//! #     let [name, _, x, y] = line.split(' ').collect::<Vec<_>>()[..] else { panic!("{line}") };
//! #     ObservedLandmark { name, position: [x.parse().unwrap(), y.parse().unwrap()] }
//! # }).collect();
//! let model = Model::new_checked(bytes)?;
//! let image = Image { pixels, width: 32, height: 32 };
//! let config = Config::default().with(|config| {
//!     (config.shape_rank, config.albedo_rank) = (20, 20);
//!     config.pixel_patch = 5.0;
//! });
//! let problem = Problem::new(&model, image, &landmarks, &config);
//! let mut memory = vec![0; search::words(&problem, &Options::default())]; // or a static array
//! let mut search: ModeSearch<'_, '_> = ModeSearch::new(problem, Options::default(), &mut memory)?;
//! while search.step().is_some() { /* progress, pictures, whatever you like */ }
//! assert!(search.scene().view.pose.translation[2] < -500.0, "mm before the camera");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//! `examples/fit.rs` reads the model, the picture and the landmarks, too; with
//! [`chain::Chain`] in place of the search it is a Markov chain.
//!
//! # Features
//! None is on by default. `micromath` approximates exponentials and logarithms for processors without a
//! floating-point unit, with other bits; `naive` adds slow, obvious twins of the fast stages, with which
//! tests and benchmarks compare.
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
#[cfg(any(test, feature = "naive"))]
pub mod naive;
pub mod posterior;
pub mod proposal;
pub mod register;
pub mod render;
pub mod rng;
pub mod scene;
pub mod search;
mod vector;
