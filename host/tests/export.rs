//! Smaller models are the same model over less.

use onescan::bench::Workload;
use onescan::model::export::{ExportOptions, Exported, export};
use onescan::model_file::OwnedModel;
use onescan_core::basis::Basis;
use onescan_core::model::Model;

const ALL: ExportOptions =
    ExportOptions { shape_rank: usize::MAX, albedo_rank: usize::MAX, vertices: None, bits: 16 };

fn face() -> OwnedModel {
    Workload::new(&mut |_| ()).unwrap().model
}

/// Which vertex of `whole` each vertex of `part` was: the one with the same mean shape and albedo.
fn origins(whole: &Model<'_>, part: &Model<'_>) -> Vec<usize> {
    let key = |model: &Model<'_>, v: usize| {
        [&model.shape, &model.albedo].map(|basis| {
            let plane = basis.mean().len() / 3;
            [0, 1, 2].map(|c| basis.mean()[c * plane + v].to_bits())
        })
    };
    let places: std::collections::HashMap<_, _> =
        (0..whole.vertices()).map(|v| (key(whole, v), v)).collect();
    (0..part.vertices()).map(|v| places[&key(part, v)]).collect()
}

/// Covariance of two field entries.
fn covariance(basis: &Basis<'_>, [a, b]: [(usize, usize); 2]) -> f64 {
    let plane = basis.mean().len() / 3;
    let term = |(v, c): (usize, usize), k| f64::from(basis.term(c * plane + v, k, 1.0));
    (0..basis.rank()).map(|k| term(a, k) * term(b, k)).sum()
}

#[test]
fn a_decimated_model_has_the_covariance_of_the_vertices_it_kept() {
    let model = face();
    let Exported { model: small, report } =
        export(&model, &ExportOptions { vertices: Some(500), ..ALL }).unwrap();
    let (whole, part) = (model.view(), small.view());
    assert_eq!(report.vertices, [whole.vertices(), 500]);
    assert_eq!(part.vertices(), 500);
    let origins = origins(&whole, &part);
    for (name, v) in part.landmarks() {
        assert_eq!(whole.landmark(name), Some(origins[v as usize] as u32), "{name}");
    }
    assert_eq!(part.landmarks().count(), whole.landmarks().count());
    for (before, after) in [(&whole.shape, &part.shape), (&whole.albedo, &part.albedo)] {
        for i in (0..500).step_by(37) {
            for j in (0..500).step_by(83) {
                let [a, b] = [(i, i % 3), (j, (j + 1) % 3)];
                let own = covariance(after, [a, b]);
                let [p, q] = [(origins[i], i % 3), (origins[j], (j + 1) % 3)];
                let scale = (covariance(before, [p, p]) * covariance(before, [q, q])).sqrt();
                assert!((own - covariance(before, [p, q])).abs() < 1e-3 * scale, "{i} {j}");
            }
        }
        assert!(after.variance().is_sorted_by(|a, b| a >= b));
        // Orthogonal, with the variances for squared lengths.
        let plane = after.mean().len() / 3;
        let dot = |k: usize, l: usize| -> f64 {
            let term = |i, k| f64::from(after.term(i, k, 1.0));
            (0..3 * plane).map(|i| term(i, k) * term(i, l)).sum()
        };
        for (k, &variance) in after.variance().iter().enumerate().take(10) {
            assert!((dot(k, k) / f64::from(variance) - 1.0).abs() < 1e-3, "{k}");
            assert!(dot(k, k + 1).abs() < 1e-3 * f64::from(variance), "{k}");
        }
    }
    for half in &report.halves {
        assert!((half.captured[0] - half.captured[1]).abs() < 1e-3, "{half}");
    }
}

#[test]
fn lower_ranks_and_fewer_bits_leave_the_leading_components() {
    let model = face();
    let options = ExportOptions { shape_rank: 7, albedo_rank: 0, bits: 9, ..ALL };
    let Exported { model: small, report } = export(&model, &options).unwrap();
    let (whole, part) = (model.view(), small.view());
    assert_eq!((part.shape.rank(), part.albedo.rank()), (7, 0));
    assert_eq!(part.shape.variance(), &whole.shape.variance()[..7]);
    assert_eq!(part.shape.mean(), whole.shape.mean());
    assert_eq!(part.triangles.get(77), whole.triangles.get(77));
    let (mut error, mut largest) = (0.0_f32, 0.0_f32);
    for entry in 0..whole.shape.mean().len() {
        let (a, b) = (whole.shape.term(entry, 3, 1.0), part.shape.term(entry, 3, 1.0));
        (error, largest) = (error.max((a - b).abs()), largest.max(a.abs()));
    }
    // Half a level of 255.
    assert!(error > 0.0 && error <= 0.501 * largest / 255.0, "{error} of {largest}");
    assert!(report.halves[0].rounding > 0.0 && report.halves[0].rounding < 0.01);
    assert!(report.halves[0].captured[1] < report.halves[0].captured[0]);

    // Of an export of an export, the last counts.
    let Exported { model: again, .. } = export(&small, &ExportOptions { bits: 4, ..ALL }).unwrap();
    let bits: Vec<_> =
        again.view().provenance().lines().filter(|l| l.starts_with("exported_bits")).collect();
    assert_eq!(bits, ["exported_bits = 4"]);

    let Exported { model: same, .. } = export(&model, &ALL).unwrap();
    let same = same.view();
    for k in [0, 5, 40] {
        for entry in (0..whole.shape.mean().len()).step_by(11) {
            let same = same.shape.term(entry, k, 1.0);
            assert!((same - whole.shape.term(entry, k, 1.0)).abs() <= 1e-6 * same.abs());
        }
    }
}

#[test]
fn a_mesh_is_not_decimated_to_nothing() {
    let error = export(&face(), &ExportOptions { vertices: Some(10), ..ALL }).err().unwrap();
    assert!(error.to_string().contains("cannot be brought below"), "{error}");
}
