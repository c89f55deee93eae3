//! The paper's experiments, on this project's own faces.
//!
//! | room | experiment |
//! |---|---|
//! | [`kernels`] | samples of the ten kernels |
//! | [`decomposition`] | exact components beside sampled ones, and what they cost |
//! | [`compactness`] | one-scan models beside a model of 60 people: how compact, general, specific |
//! | [`recognition`] | people told by fits at other angles: the paper's table |
//! | [`registration`] | ten scans registered by shape only, and by shape and albedo |
//! | [`photos`] | photos, and what each of recognition's models makes of them |
//! | [`objects`] | a fish and a bird, and fits to others of their kind |
//! | [`faces`] | the faces they are made on |
//! | [`stages`] | what of them is done, until all is |

pub mod compactness;
pub mod decomposition;
pub mod faces;
pub mod kernels;
pub mod objects;
pub mod photos;
pub mod recognition;
pub mod registration;
pub mod stages;
