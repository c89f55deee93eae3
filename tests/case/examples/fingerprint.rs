//! Prints what fixtures/golden/device.txt ends with: the chain's, the search's and the sampler's hashes.

use onescan_case::{POSTERIOR_WORDS, SEARCH_WORDS, WORDS, fit, posterior, search, write_search};
use onescan_core::engine::Engine;

fn main() {
    let fitted = fit(&mut vec![0; WORDS], Engine::PORTABLE, true);
    println!("fingerprint {:016x}", fitted.map_or(0, |fitted| fitted.fingerprint));
    let found = search(&mut vec![0; SEARCH_WORDS], Engine::PORTABLE);
    let mut lines = String::new();
    if let Some(found) = found
        && write_search(&mut lines, &found).is_ok()
    {
        print!("{lines}");
    }
    let sampled = posterior(&mut vec![0; POSTERIOR_WORDS], Engine::PORTABLE);
    println!("posterior {:016x}", sampled.unwrap_or(0));
}
