//! Landmarks of a scan name vertices of it, each name once.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::mesh::landmarks;

fuzz_target!(|data: &str| {
    let _ = (landmarks::parse_lines(data), landmarks::uncertainties(data));
    if let Ok(points) = landmarks::parse_points(data) {
        landmarks::parse_points(&landmarks::to_json(&points)).expect("what is written can be read");
    }
    let points: Vec<_> = (0..50_u8).map(|i| [f32::from(i), 0.0, 1.0]).collect();
    for name in ["a.json", "a.pp", "a.mrk.json", "a.fcsv"] {
        let path = onescan_fuzz::file(name, data.as_bytes());
        let _ = landmarks::read_points(&path);
        let Ok(landmarks) = landmarks::read(&path, &points, 1.0) else { continue };
        for (i, landmark) in landmarks.iter().enumerate() {
            assert!((landmark.vertex as usize) < points.len());
            assert!(landmarks[..i].iter().all(|other| other.name != landmark.name));
        }
    }
});
