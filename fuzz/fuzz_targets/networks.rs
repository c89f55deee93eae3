//! Networks with damage are refused, or find faces without a panic.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::face_mesh::Detector;
use onescan::photo::picture::Picture;

const DETECTOR: &[u8] = include_bytes!("../../fixtures/face_mesh/face_detection_short_range.tflite");
const MESH: &[u8] = include_bytes!("../../fixtures/face_mesh/face_landmark.tflite");

fuzz_target!(|data: &[u8]| {
    let Some((&kind, damage)) = data.split_first() else { return };
    let detector = match kind % 2 {
        0 => Detector::new(&onescan_fuzz::damaged(DETECTOR, damage), MESH),
        _ => Detector::new(DETECTOR, &onescan_fuzz::damaged(MESH, damage)),
    };
    if let Ok(detector) = detector {
        detector.faces(&Picture::filled(8, 8, [90, 80, 70]));
    }
});
