//! The case of tests/case for WebAssembly: what Node and Chromium compare line by line.

use onescan_case::{SEARCH_WORDS, STAGES, WORDS, fit, search, stages};
use onescan_core::engine::Engine;

/// What belongs into line `index` of fixtures/golden/device.txt: the hash of a stage, after them
/// the chain's fingerprint, and then what a search comes to. 0 beyond that.
#[unsafe(no_mangle)]
pub extern "C" fn line(index: usize) -> u64 {
    let mut memory = vec![0; WORDS.max(SEARCH_WORDS)];
    if index < STAGES.len() {
        return stages(&mut memory, Engine::PORTABLE).map_or(0, |hashes| hashes[index]);
    }
    if index == STAGES.len() {
        return fit(&mut memory, Engine::PORTABLE, true).map_or(0, |fitted| fitted.fingerprint);
    }
    let hashes = search(&mut memory, Engine::PORTABLE).map(|found| found.hashes());
    hashes.and_then(|hashes| hashes.get(index - STAGES.len() - 1).copied()).unwrap_or(0)
}
