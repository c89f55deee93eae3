//! An OFF file that is read is a mesh, which can be examined and mended; else an error.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::scan::mesh_file::Format;

fuzz_target!(|data: &[u8]| onescan_fuzz::mesh(data, Format::Off));
