//! The structured decomposition against a dense one of the whole 3V × 3V covariance.

use faer::{Mat, Side};
use onescan::mesh::ply;
use onescan::mesh::{Axis, Mesh};
use onescan::model::decompose::{Decomposition, MAX_RESIDUAL, Truncation, decompose};
use onescan::model::kernel::{Kernel, PRESETS, Preset, Vertex, mean_of, rbf, rgb_rbf};
use proptest::prelude::*;
use std::path::Path;

fn template() -> Mesh {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/face/template.ply");
    ply::read(&path).unwrap()
}

fn vertices(mesh: &Mesh, keep: impl Fn(usize, &[f32; 3]) -> bool) -> Vec<Vertex> {
    let all = mesh.points.iter().zip(&mesh.colors).enumerate();
    all.filter(|(i, (point, _))| keep(*i, point))
        .map(|(_, (point, color))| Vertex {
            position: point.map(f64::from),
            color: color.map(f64::from),
        })
        .collect()
}

/// The covariance in planar order: entry `(channel·V + i, …)`.
fn covariance(kernel: &Kernel, vertices: &[Vertex]) -> Mat<f64> {
    let v = vertices.len();
    let mut matrix = Mat::zeros(3 * v, 3 * v);
    for (i, x) in vertices.iter().enumerate() {
        for (j, y) in vertices.iter().enumerate() {
            for (r, row) in kernel.evaluate(x, y).iter().enumerate() {
                for (c, value) in row.iter().enumerate() {
                    matrix[(r * v + i, c * v + j)] = *value;
                }
            }
        }
    }
    matrix
}

fn columns(found: &Decomposition, vertices: usize) -> Mat<f64> {
    Mat::from_fn(3 * vertices, found.rank(), |entry, k| {
        let (direction, vector) = found.column(k);
        direction[entry / vertices] * vector[entry % vertices]
    })
}

/// Everything the documentation promises, checked against dense matrices.
#[track_caller]
fn assert_exact(kernel: &Kernel, vertices: &[Vertex], truncation: Truncation) -> Decomposition {
    let found = decompose(kernel, vertices, truncation, &mut |_, _| {}).unwrap();
    let matrix = covariance(kernel, vertices);
    let mut expected = matrix.self_adjoint_eigenvalues(Side::Lower).unwrap();
    expected.reverse();
    let total: f64 = expected.iter().sum();
    assert!((found.total_variance / total - 1.0).abs() < 1e-10);
    for (k, (got, want)) in found.variances.iter().zip(&expected).enumerate() {
        assert!((got / want - 1.0).abs() < 1e-4, "{kernel}: eigenvalue {k} is {want}, not {got}");
    }
    let captured = expected[..found.rank()].iter().sum::<f64>() / total;
    assert!((found.captured() - captured).abs() <= 1e-4 * captured);

    let u = columns(&found, vertices.len());
    let product = &matrix * &u;
    for (k, lambda) in found.variances.iter().enumerate() {
        let residual = (product.col(k) - faer::Scale(*lambda) * u.col(k)).norm_l2() / lambda;
        assert!(residual <= MAX_RESIDUAL, "{kernel}: residual {residual} of column {k}");
        assert!(residual <= found.max_residual + 1e-6);
        let (low, high) =
            u.col(k).iter().fold((0.0_f64, 0.0_f64), |(l, h), x| (l.min(*x), h.max(*x)));
        assert!(high >= -low * (1.0 - 1e-6), "column {k} has its largest entry negative");
    }
    let gram = u.transpose() * &u - Mat::<f64>::identity(found.rank(), found.rank());
    assert!(gram.norm_max() < 1e-9, "{kernel}: off orthonormal by {}", gram.norm_max());
    found
}

fn both_kernels(name: &str) -> [Kernel; 2] {
    let preset = Preset::named(name).unwrap();
    [preset.shape(Some(Axis::X)), preset.albedo(Some(Axis::X))]
}

#[test]
fn every_sixteenth_vertex_of_the_template() {
    // No symmetry left in the vertices.
    let subset = vertices(&template(), |i, _| i % 16 == 0);
    for name in ["standard-full", "symmetric-full"] {
        for kernel in both_kernels(name) {
            assert_exact(&kernel, &subset, Truncation::Rank(199));
        }
    }
}

#[test]
fn symmetric_vertices_split_into_even_and_odd_fields() {
    let subset =
        vertices(&template(), |_, p| (p[0].abs() * 1e3) as u32 % 12 == 5 && p[1].abs() < 60.0);
    assert!((300..1200).contains(&subset.len()), "{}", subset.len());
    for kernel in both_kernels("symmetric-full") {
        assert_exact(&kernel, &subset, Truncation::Rank(199));
    }
}

#[test]
fn variance_asks_for_the_fewest_components_that_hold_it() {
    let subset = vertices(&template(), |i, _| i % 16 == 0);
    let [shape, albedo] = both_kernels("symmetric-full");
    let found = assert_exact(&shape, &subset, Truncation::Variance(0.95));
    assert!(found.captured() >= 0.95);
    let without_last = found.captured() - found.variances[found.rank() - 1] / found.total_variance;
    assert!(without_last < 0.95);
    let all = assert_exact(&albedo, &subset[..40], Truncation::Variance(1.0 - 1e-6));
    assert!(all.captured() >= 1.0 - 1e-6);
}

#[test]
fn few_colours_have_few_components() {
    let mut vertices = vertices(&template(), |i, _| i % 16 == 0);
    for (i, vertex) in vertices.iter_mut().enumerate() {
        vertex.color = [(i % 3) as f64 * 0.2; 3];
    }
    let kernel = (0.015 * rgb_rbf(0.15)).correlated(0.95);
    let found = assert_exact(&kernel, &vertices, Truncation::Rank(199));
    assert_eq!(found.rank(), 9, "three colours, three directions");
    assert!(found.captured() > 1.0 - 1e-9);

    // However many vertices there are.
    let many = vertices.repeat(60);
    let found_in_many = decompose(&kernel, &many, Truncation::Rank(199), &mut |_, _| {}).unwrap();
    assert_eq!(found_in_many.rank(), 9);
    for (few, many) in found.variances.iter().zip(&found_in_many.variances) {
        assert!((many / few / 60.0 - 1.0).abs() < 1e-9, "{few} {many}");
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let subset = vertices(&template(), |i, _| i % 8 == 0);
    let [_, albedo] = both_kernels("symmetric-full");
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let found = pool
            .install(|| decompose(&albedo, &subset, Truncation::Rank(60), &mut |_, _| {}).unwrap());
        let bits: Vec<u64> = (0..60)
            .flat_map(|k| found.column(k).1.to_vec())
            .chain(found.variances.iter().copied())
            .map(f64::to_bits)
            .collect();
        bits
    };
    assert!(with(1) == with(3));
}

#[test]
fn kernels_that_share_no_directions_are_refused() {
    let kernel = mean_of(
        rbf(10.0).correlated(0.5),
        rbf(10.0).identity().mirrored_displacement(Some(Axis::X), 0.5),
    );
    let subset = vertices(&template(), |i, _| i < 20);
    let error = decompose(&kernel, &subset, Truncation::Rank(3), &mut |_, _| {}).err().unwrap();
    assert!(error.to_string().contains("share no eigenvectors"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(24) })]

    #[test]
    fn any_small_scan_decomposes_like_its_dense_matrix(
        vertices in prop::collection::vec(
            (prop::array::uniform3(-90.0..90.0), prop::array::uniform3(0.0..1.0))
                .prop_map(|(position, color)| Vertex { position, color }), 1..40),
        mirrored: bool,
        preset in 0..PRESETS.len(),
        rank in 0..50_usize,
    ) {
        let mut vertices = vertices;
        if mirrored {
            let images = vertices.clone().into_iter().map(|mut v| {
                v.position[2] *= -1.0;
                v
            });
            vertices.extend(images);
            vertices.push(Vertex { position: [1.0, 2.0, 0.0], color: [0.5; 3] });
        }
        let preset = &PRESETS[preset];
        for kernel in [preset.shape(Some(Axis::Z)), preset.albedo(Some(Axis::Z))] {
            assert_exact(&kernel, &vertices, Truncation::Rank(rank));
        }
    }
}
