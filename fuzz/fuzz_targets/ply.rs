//! A PLY file that is read is a mesh; everything else is an error.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::mesh::ply::{self, Encoding};

fuzz_target!(|data: &[u8]| {
    let Ok(mesh) = ply::parse(data) else { return };
    let vertices = mesh.points.len();
    assert!(vertices > 0 && mesh.colors.len() == vertices && !mesh.triangles.is_empty());
    assert!(mesh.triangles.as_flattened().iter().all(|&v| (v as usize) < vertices));
    assert!(mesh.points.as_flattened().iter().all(|x| x.is_finite()));
    for encoding in [Encoding::Ascii, Encoding::Binary] {
        let mut file = Vec::new();
        ply::write(&mut file, &mesh, encoding).expect("memory can be written");
        let again = ply::parse(&file).expect("what is written can be read");
        assert_eq!(again.points, mesh.points);
        assert_eq!(again.triangles, mesh.triangles);
    }
});
