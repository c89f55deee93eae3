//! A model in HDF5, as binary or as JSON, is read or refused; one that is read is written and read
//! again.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::interchange::{Format, parse, to_bytes};
use onescan::model::morphable::Morphable;
use std::sync::OnceLock;

/// The tiny model in both forms.
fn good() -> &'static [Vec<u8>; 2] {
    static GOOD: OnceLock<[Vec<u8>; 2]> = OnceLock::new();
    GOOD.get_or_init(|| {
        let model = Morphable::of(&onescan_fuzz::model().view());
        [Format::Hdf5, Format::Hdf5Json].map(|f| to_bytes(&model, f).expect("it can be written"))
    })
}

fuzz_target!(|data: &[u8]| {
    let Some((&kind, rest)) = data.split_first() else { return };
    let (format, good) = match kind % 2 {
        0 => (Format::Hdf5, &good()[0]),
        _ => (Format::Hdf5Json, &good()[1]),
    };
    let bytes = match kind / 2 % 2 {
        0 => rest.to_vec(),
        _ => onescan_fuzz::damaged(good, rest),
    };
    let Ok(import) = parse(format, bytes) else { return };
    let model = import.model;
    assert!(model.triangles.as_flattened().iter().all(|&v| (v as usize) < model.shape.vertices()));
    assert!(model.landmarks.iter().all(|l| (l.vertex as usize) < model.shape.vertices()));
    // Variances beyond what 32 bits hold are no model here; that is an error, too.
    let _ = model.to_model(i16::MAX);
    let again = to_bytes(&model, format).expect("what was read can be written");
    let _ = parse(format, again);
});
