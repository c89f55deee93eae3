//! Scans in, and what is found out about meshes: a file per format, faults, symmetry, nearest
//! points.

pub mod crop;
pub mod decimate;
pub mod doctor;
pub mod holes;
pub mod mesh_file;
pub mod rigid;
pub mod subdivide;
pub mod surface;
pub mod symmetry;
