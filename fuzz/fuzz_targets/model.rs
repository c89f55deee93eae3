//! Bytes that pass for a model can be walked, sampled and drawn without a panic.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::model_file::OwnedModel;
use onescan::render;
use onescan_core::hash::fnv64;
use onescan_core::model::{CHECKED_FROM, HEADER_BYTES};

fuzz_target!(|data: &[u8]| {
    let Some((&kind, rest)) = data.split_first() else { return };
    // Raw bytes, or a good model with damage; the checksum, which would hide all but itself, is
    // made right.
    let mut bytes = match kind % 2 {
        0 => rest.to_vec(),
        _ => onescan_fuzz::damaged(onescan_fuzz::model().bytes(), rest),
    };
    if bytes.len() >= HEADER_BYTES {
        let checksum = fnv64(&bytes[CHECKED_FROM..]);
        bytes[16..24].copy_from_slice(&checksum.to_le_bytes());
    }
    let Ok(file) = OwnedModel::from_bytes(&bytes) else { return };
    let model = file.view();
    for (name, vertex) in model.landmarks() {
        assert!((vertex as usize) < model.vertices());
        assert!(model.landmark(name).is_some());
    }
    let shape = vec![1.0; model.shape.rank()];
    let albedo = vec![-1.0; model.albedo.rank()];
    let mesh = render::instance(&model, &shape, &albedo);
    assert_eq!(mesh.points.len(), model.vertices());
    assert!(mesh.triangles.as_flattened().iter().all(|&v| (v as usize) < model.vertices()));
    render::draw_on(&model, &render::portrait(&model, [48, 32], 0.3, 0.1), [0; 3]);
});
