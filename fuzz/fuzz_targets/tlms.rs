//! Landmarks in a picture read back as they were written, and are checked or refused.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::photo::Crop;
use onescan::photo::tlms::Tlms;

fuzz_target!(|data: &str| {
    let _ = (Tlms::parse_pts(data), Tlms::parse_mesh(data, [500, 400]));
    let Ok(tlms) = Tlms::parse(data) else { return };
    assert_eq!(Tlms::parse(&tlms.to_text()).expect("what is written can be read"), tlms);
    let names: Vec<&str> = tlms.landmarks.iter().map(|l| l.id.as_str()).collect();
    let _ = tlms.check(500, 400, &["center.nose.tip", "left.lips.corner"]);
    let good = tlms.check(500, 400, &names).is_ok();
    let crop = Crop::around(&tlms.visible_points(), [500, 400], Crop::ENLARGE, 256);
    assert!(!good || crop.is_ok(), "landmarks within the picture give a crop: {crop:?}");
});
