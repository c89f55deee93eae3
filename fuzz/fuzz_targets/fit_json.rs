//! A fit that is read can be written again, and drawn.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::fit::summary::Summary;

fuzz_target!(|data: &str| {
    let Ok(summary) = Summary::parse(data) else { return };
    let text = summary.to_json().expect("what was read can be written");
    assert_eq!(Summary::parse(&text).expect("what is written can be read"), summary);
    onescan_fuzz::draw(summary.parameters);
});
