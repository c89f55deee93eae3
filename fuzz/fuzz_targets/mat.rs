//! The Basel face model 2009 is read or refused.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::interchange::{Format, parse};

fuzz_target!(|data: &[u8]| {
    // The first bytes say little; they are made right.
    let mut bytes = data.to_vec();
    if let Some(end) = bytes.get_mut(124..128) {
        end.copy_from_slice(&[0, 1, b'I', b'M']);
    }
    let Ok(import) = parse(Format::Mat, bytes) else { return };
    let vertices = import.model.shape.vertices();
    assert!(import.model.triangles.as_flattened().iter().all(|&v| (v as usize) < vertices));
});
