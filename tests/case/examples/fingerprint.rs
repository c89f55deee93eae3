//! Prints what fixtures/golden/device.txt ends with: the chain's and the search's hashes.

use onescan_case::{SEARCH_WORDS, WORDS, fit, search, write_search};
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
}
