//! A mixture's file is read or refused.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::interchange::mixture::Mixture;

fuzz_target!(|data: &[u8]| {
    let path = onescan_fuzz::file("mixture.toml", data);
    if let Ok(mixture) = Mixture::open(&[path]) {
        let sum: f64 = mixture.components.iter().map(|component| component.weight).sum();
        assert!((sum - 1.0).abs() < 1e-9, "{sum}");
    }
});
