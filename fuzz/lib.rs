//! What the fuzz targets share: a tiny model and a fit of it, damage to bytes that carry a checksum, and
//! what holds of every mesh.

use onescan::fit::{Job, Schedule};
use onescan::mesh::landmarks::Landmark;
use onescan::mesh::{Axis, Mesh, glb};
use onescan::model::build::{BuildOptions, Method, build};
use onescan::model::decompose::Truncation;
use onescan::model::kernel::Kernels;
use onescan::model_file::OwnedModel;
use onescan::photo::Crop;
use onescan::photo::picture::Picture;
use onescan::photo::tlms::Tlms;
use onescan::render;
use onescan::scan::doctor::{Findings, mend};
use onescan::scan::mesh_file::{self, Format, Options};
use onescan_core::chain::Config;
use onescan_core::hash::fnv64;
use onescan_core::model::Model;
use onescan_core::scene::Scene;
use std::path::{Path, PathBuf};
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

/// Side of the fitted photo, pixels.
pub const SIDE: u32 = 24;

/// A fit of that model to a grey square, with a short configuration.
pub fn job(schedule: Schedule) -> Job<'static> {
    type Known = (Model<'static>, Picture, Tlms);
    static KNOWN: OnceLock<Known> = OnceLock::new();
    let (model, photo, landmarks) = KNOWN.get_or_init(|| {
        let landmarks = Tlms::parse("a 1 5 18\nb 1 18 18\nc 1 18 5\nd 1 5 5\n").expect("good");
        (model().view(), Picture::filled(SIDE, SIDE, [90, 80, 70]), landmarks)
    });
    let config = Config::default().with(|config| {
        config.landmark_steps = 20;
        config.image_steps = 20;
        config.shape_rank = 3;
        config.albedo_rank = 3;
    });
    let crop = Crop::whole([SIDE; 2]);
    Job { model, photo, landmarks, crop, mask: None, schedule, config, seed: 7, chains: 1 }
}

/// Magic and checksum of files that continue a computation.
const HEADER: usize = 16;

/// Of data the rest after the first byte, which says whether it is taken as it is or as damage to good
/// bytes; magic and checksum, which would hide all but themselves, are made right.
pub fn continued(good: &[u8], data: &[u8]) -> Option<Vec<u8>> {
    let (&kind, rest) = data.split_first()?;
    let mut bytes = match kind % 2 {
        0 => rest.to_vec(),
        _ => damaged(good, rest),
    };
    if bytes.len() >= HEADER {
        bytes[..8].copy_from_slice(&good[..8]);
        let checksum = fnv64(&bytes[HEADER..]);
        bytes[8..HEADER].copy_from_slice(&checksum.to_le_bytes());
    }
    Some(bytes)
}

/// A file of such a name that holds the bytes, for what reads by path; the next one takes its place.
pub fn file(name: &str, bytes: &[u8]) -> PathBuf {
    static PLACE: OnceLock<PathBuf> = OnceLock::new();
    let place = PLACE.get_or_init(|| {
        let place = std::env::temp_dir().join(format!("onescan-fuzz-{}", std::process::id()));
        std::fs::create_dir_all(&place).expect("a temporary directory");
        place
    });
    let path = place.join(name);
    std::fs::write(&path, bytes).expect("room for a small file");
    path
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
    let written = glb::encode(&mesh, "mesh").expect("what was read can be written");
    // What is further out than millimetres go, or nearer than metres tell, is refused.
    let _ = mesh_file::parse(path, &written, Format::Gltf, &Options::default());
    let (mended, _) = mend(&mesh, true);
    assert!(mended.triangles.as_flattened().iter().all(|&v| (v as usize) < mended.points.len()));
}
