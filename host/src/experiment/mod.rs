//! The paper's experiments that need no photos: tables and pictures of models.

pub mod kernels;
