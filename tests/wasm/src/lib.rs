//! The case of tests/case for WebAssembly: what Node and Chromium compare line by line.

use onescan_case::{
    POSTERIOR_WORDS, SEARCH, SEARCH_WORDS, STAGES, WORDS, fit, posterior, search, stages,
};
use onescan_core::engine::Engine;

/// What belongs into line `index` of fixtures/golden/device.txt: the hash of a stage, after them
/// the chain's fingerprint, what a search comes to, and the sampler's fingerprint. 0 beyond that.
#[unsafe(no_mangle)]
pub extern "C" fn line(index: usize) -> u64 {
    let mut memory = vec![0; WORDS.max(SEARCH_WORDS).max(POSTERIOR_WORDS)];
    if index < STAGES.len() {
        return stages(&mut memory, Engine::PORTABLE).map_or(0, |hashes| hashes[index]);
    }
    if index == STAGES.len() {
        return fit(&mut memory, Engine::PORTABLE, true).map_or(0, |fitted| fitted.fingerprint);
    }
    if index > STAGES.len() + SEARCH.len() {
        return posterior(&mut memory, Engine::PORTABLE).unwrap_or(0);
    }
    let hashes = search(&mut memory, Engine::PORTABLE).map(|found| found.hashes());
    hashes.and_then(|hashes| hashes.get(index - STAGES.len() - 1).copied()).unwrap_or(0)
}
