//! The case of tests/case for WebAssembly: what Node and Chromium compare line by line.

use onescan_case::{STAGES, WORDS, fit, stages};
use onescan_core::engine::Engine;

/// What belongs into line `index` of fixtures/golden/device.txt: the hash of a stage, or after
/// them the fingerprint. 0 beyond that.
#[unsafe(no_mangle)]
pub extern "C" fn line(index: usize) -> u64 {
    let mut memory = vec![0; WORDS];
    if index < STAGES.len() {
        return stages(&mut memory, &Engine::PORTABLE).map_or(0, |hashes| hashes[index]);
    }
    if index > STAGES.len() {
        return 0;
    }
    fit(&mut memory, &Engine::PORTABLE, true).map_or(0, |fitted| fitted.fingerprint)
}
