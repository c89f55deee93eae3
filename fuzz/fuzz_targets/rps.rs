//! Render parameters that are read can be written again, and drawn.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::fit::rps::Rps;

fuzz_target!(|data: &str| {
    let Ok(rps) = Rps::parse(data) else { return };
    let text = rps.to_text().expect("what was read can be written");
    Rps::parse(&text).expect("what is written can be read");
    onescan_fuzz::draw(rps.scene);
});
