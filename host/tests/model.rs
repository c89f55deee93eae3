//! From a scan on disk to a model on disk, and back through the core's view.

use onescan::mesh::landmarks;
use onescan::mesh::ply;
use onescan::mesh::{Axis, Mesh};
use onescan::model::build::{BuildOptions, BuiltModel, Method, build};
use onescan::model::decompose::Truncation;
use onescan::model::export::{ExportOptions, export};
use onescan::model::kernel::{Kernels, Preset, Vertex};
use onescan::model::morphable::Morphable;
use onescan::model_file::OwnedModel;
use onescan_core::hash::fnv64;
use std::path::{Path, PathBuf};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/face").join(name)
}

/// The part of the template's triangles whose corners are all among the first vertices.
fn part_of_the_template() -> Mesh {
    let mut mesh = ply::read(&fixture("template.ply")).unwrap();
    mesh.points.truncate(500);
    mesh.colors.truncate(500);
    mesh.triangles.retain(|t| t.iter().all(|&v| v < 500));
    mesh
}

fn options(truncation: Truncation) -> BuildOptions<'static> {
    BuildOptions {
        scan_name: "part.ply",
        kernels: Kernels::named("symmetric-full", Some(Axis::X)).unwrap(),
        method: Method::Exact(truncation),
        millimetres: 1.0,
    }
}

fn built(scan: &Mesh, options: &BuildOptions<'_>) -> BuiltModel {
    let text = r#"[{"id": "nose", "vertex": 7}, {"id": "œil", "vertex": 499}]"#;
    let landmarks = landmarks::parse(text, &scan.points, 1.0).unwrap();
    build(scan, &landmarks, options, &mut |_, _| {}).unwrap()
}

#[test]
fn a_written_model_is_read_as_it_was_built() {
    let scan = part_of_the_template();
    let BuiltModel { model, report, .. } = built(&scan, &options(Truncation::Rank(20)));
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("part.3dmm");
    model.write(&path).unwrap();
    let read = OwnedModel::read(&path).unwrap();
    assert_eq!(read.bytes(), model.bytes());

    let view = read.view();
    assert_eq!((view.vertices(), view.triangles.len()), (500, scan.triangles.len()));
    assert_eq!(view.triangles.get(3), Some(scan.triangles[3]));
    assert_eq!(view.landmarks().collect::<Vec<_>>(), [("nose", 7), ("œil", 499)]);
    assert_eq!((view.shape.rank(), view.albedo.rank()), (20, 20));
    for (basis, mean) in [(&view.shape, &scan.points), (&view.albedo, &scan.colors)] {
        let plane = basis.mean().len() / 3;
        for (i, value) in mean.iter().enumerate() {
            assert_eq!(
                [0, 1, 2].map(|c| basis.mean()[c * plane + i].to_bits()),
                value.map(f32::to_bits)
            );
        }
        // Columns are eigenvectors times standard deviations: their norms are the latter.
        for (k, &variance) in basis.variance().iter().enumerate() {
            let norm: f64 = (0..3 * plane).map(|i| f64::from(basis.term(i, k, 1.0)).powi(2)).sum();
            assert!((norm / f64::from(variance) - 1.0).abs() < 1e-5, "column {k}");
        }
    }
    let kernel = Preset::named("symmetric-full").unwrap().shape(Some(Axis::X));
    let variance = |p: &[f32; 3]| -> f64 {
        let vertex = Vertex { position: p.map(f64::from), color: [0.0; 3] };
        let block = kernel.evaluate(&vertex, &vertex);
        (0..3).map(|i| block[i][i]).sum()
    };
    let total: f64 = scan.points.iter().map(variance).sum();
    assert!((view.shape.total_variance() / total - 1.0).abs() < 1e-9);
    assert!(view.provenance().contains("scan = \"part.ply\"\n"));
    assert!(view.provenance().contains("kernels = \"symmetric-full\"\n"));
    assert!(report.to_string().contains("20 components hold"), "{report}");
}

#[test]
fn an_occlusion_map_goes_with_the_model_and_changes_nothing_else() {
    let BuiltModel { model, .. } = built(&part_of_the_template(), &options(Truncation::Rank(5)));
    let without = Morphable::of(&model.view());
    assert_eq!(model.view().occlusion(), None);
    assert_eq!(model.bytes()[168..192], [0; 24]);
    let map: Vec<u8> = (0..500).map(|v| (v % 256) as u8).collect();
    let with = Morphable { occlusion: Some(map.clone()), ..without.clone() };
    let file = with.to_model(i16::MAX).unwrap();
    assert_eq!(file.view().occlusion(), Some(&map[..]));
    assert_eq!(without.to_model(i16::MAX).unwrap().bytes(), model.bytes());
    // But for length, checksum and its entry in the table.
    let (a, b) = (model.bytes(), file.bytes());
    assert_eq!((&a[32..168], &a[192..]), (&b[32..168], &b[192..a.len()]));

    let region = with.region(|v| v >= 100).unwrap();
    assert_eq!(region.occlusion.as_deref(), Some(&map[100..]));
    let smaller = ExportOptions { shape_rank: 3, albedo_rank: 3, vertices: Some(200), bits: 16 };
    let exported = export(&file, &smaller).unwrap().model;
    assert_eq!(exported.view().occlusion().map(<[u8]>::len), Some(exported.view().vertices()));

    let mut damaged = file.bytes().to_vec();
    damaged[172] -= 1;
    let checksum = fnv64(&damaged[24..]).to_le_bytes();
    damaged[16..24].copy_from_slice(&checksum);
    let error = OwnedModel::from_bytes(&damaged).unwrap_err().to_string();
    assert!(error.contains("section occlusion: wrong place or length"), "{error}");
}

#[test]
fn equal_inputs_give_equal_files() {
    let scan = part_of_the_template();
    let options = options(Truncation::Variance(0.8));
    assert!(built(&scan, &options).model.bytes() == built(&scan, &options).model.bytes());
}

#[test]
fn a_scan_in_centimetres_gives_the_same_shape_in_millimetres() {
    let mut scan = part_of_the_template();
    let millimetres = built(&scan, &options(Truncation::Rank(5)));
    for c in scan.points.as_flattened_mut() {
        *c /= 10.0;
    }
    let centimetres =
        built(&scan, &BuildOptions { millimetres: 10.0, ..options(Truncation::Rank(5)) });
    let (a, b) = (millimetres.model.view(), centimetres.model.view());
    for (a, b) in a.shape.variance().iter().zip(b.shape.variance()) {
        assert!((a / b - 1.0).abs() < 1e-4);
    }
}

#[test]
fn damage_and_wrong_units_are_refused() {
    let scan = part_of_the_template();
    let BuiltModel { model, .. } = built(&scan, &options(Truncation::Rank(3)));
    let mut bytes = model.bytes().to_vec();
    bytes[1000] ^= 1;
    assert!(OwnedModel::from_bytes(&bytes).unwrap_err().to_string().contains("checksum"));
    assert!(OwnedModel::from_bytes(&bytes[..777]).unwrap_err().to_string().contains("incomplete"));
    let wrong = BuildOptions { millimetres: f32::NAN, ..options(Truncation::Rank(3)) };
    assert!(build(&scan, &[], &wrong, &mut |_, _| {}).is_err());
}
