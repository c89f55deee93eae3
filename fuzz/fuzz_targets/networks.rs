//! Networks with damage are read or refused.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::face_mesh::Detector;

const DETECTOR: &[u8] =
    include_bytes!("../../fixtures/face_mesh/face_detection_short_range.tflite");
const MESH: &[u8] = include_bytes!("../../fixtures/face_mesh/face_landmark.tflite");

fuzz_target!(|data: &[u8]| {
    let Some((&kind, damage)) = data.split_first() else { return };
    let _ = match kind % 2 {
        0 => Detector::new(&onescan_fuzz::damaged(DETECTOR, damage), MESH),
        _ => Detector::new(DETECTOR, &onescan_fuzz::damaged(MESH, damage)),
    };
});
