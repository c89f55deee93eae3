//! A kernel that is read is shown as what reads back as the same, and has finite values.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::mesh::Axis;
use onescan::model::kernel::{Kernel, Kernels, PRESETS};

fuzz_target!(|data: &str| {
    if let Ok(kernel) = data.parse::<Kernel>() {
        let shown = kernel.to_string();
        let again: Kernel = shown.parse().expect("what is shown can be read");
        assert_eq!(again.to_string(), shown);
    }
    for preset in &PRESETS {
        let _ = Kernels::parse(data, preset, Some(Axis::X));
    }
});
