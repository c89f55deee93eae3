//! Prints the last line of fixtures/golden/device.txt.

use onescan_case::{WORDS, fit};
use onescan_core::engine::Engine;

fn main() {
    let fitted = fit(&mut vec![0; WORDS], &Engine::PORTABLE, true);
    println!("fingerprint {:016x}", fitted.map_or(0, |fitted| fitted.fingerprint));
}
