//! What the fuzz targets share: a tiny model, damage to bytes that carry a checksum, and what holds of
//! every mesh.

use onescan::mesh::landmarks::Landmark;
use onescan::mesh::{Axis, Mesh};
use onescan::model::build::{BuildOptions, Method, build};
use onescan::model::decompose::Truncation;
use onescan::model::kernel::Kernels;
use onescan::model_file::OwnedModel;
use onescan::render;
use onescan::scan::doctor::{Findings, mend};
use onescan::scan::mesh_file::{self, Format, Options};
use onescan_core::scene::Scene;
use std::path::Path;
use std::sync::OnceLock;

/// A model of a bent square: four vertices, two triangles, rank 3, landmarks `a` to `d`.
pub fn model() -> &'static OwnedModel {
    static MODEL: OnceLock<OwnedModel> = OnceLock::new();
    MODEL.get_or_init(|| {
        let scan = Mesh {
            points: vec![[-50., -50., 0.], [50., -50., 0.], [50., 50., 9.], [-50., 50., 9.]],
            colors: vec![[0.8, 0.6, 0.5]; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let landmarks: Vec<_> = ["a", "b", "c", "d"]
            .into_iter()
            .zip(0..)
            .map(|(name, vertex)| Landmark { name: name.into(), vertex })
            .collect();
        let options = BuildOptions {
            scan_name: "square",
            kernels: Kernels::named("standard-full", Some(Axis::X)).expect("a preset"),
            method: Method::Exact(Truncation::Rank(3)),
            millimetres: 1.0,
        };
        build(&scan, &landmarks, &options, &mut |_, _| ()).expect("a good scan").model
    })
}

/// Damages bytes: `damage` is a list of (offset, offset, value), the offset from the beginning
/// where it is below 0x8000 and from the end otherwise.
pub fn damaged(bytes: &[u8], damage: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for &[low, high, value] in damage.as_chunks().0 {
        let offset = usize::from(u16::from_le_bytes([low, high]));
        let length = bytes.len();
        let place = if offset < 0x8000 { offset } else { length.wrapping_sub(offset - 0x7fff) };
        if let Some(byte) = bytes.get_mut(place) {
            *byte = value;
        }
    }
    bytes
}

/// What `render --fit` does with a scene from a file, in a small picture.
pub fn draw(mut scene: Scene) {
    scene.view.camera = render::resize_camera(&scene.view.camera, [48, 32]);
    render::draw_on(&model().view(), &scene, [0; 3]);
}

/// What holds of every mesh that is read, whatever its format.
pub fn mesh(data: &[u8], format: Format) {
    let options = Options { color: Some([0.5; 3]), ..Options::default() };
    // Where no file lies that the bytes could name.
    let path = Path::new("/nonexistent/mesh");
    let Ok(scan) = mesh_file::parse(path, data, format, &options) else { return };
    let mesh = scan.mesh;
    let vertices = mesh.points.len();
    assert!(vertices > 0 && mesh.colors.len() == vertices && !mesh.triangles.is_empty());
    assert!(mesh.triangles.as_flattened().iter().all(|&v| (v as usize) < vertices));
    assert!(mesh.points.as_flattened().iter().all(|x| x.is_finite()));
    Findings::of(&mesh, 1.0);
    let (mended, _) = mend(&mesh, true);
    assert!(mended.triangles.as_flattened().iter().all(|&v| (v as usize) < mended.points.len()));
}
