//! Common eigenvectors of commuting symmetric 3×3 matrices, by joint Jacobi rotations.

use crate::model::kernel::Matrix3;

/// Relative size of off-diagonal entries that counts as zero.
const ROUNDING: f64 = 1e-12;

/// `dᵀ M d`.
pub(super) fn quadratic(m: &Matrix3, d: [f64; 3]) -> f64 {
    (0..3).map(|i| (0..3).map(|j| d[i] * m[i][j] * d[j]).sum::<f64>()).sum()
}

/// Three orthonormal vectors that are eigenvectors of all `matrices`; the coordinate axes,
/// exactly, when all are diagonal. `None` when some matrix is not symmetric or two do not
/// commute.
///
/// Each rotation in the plane (p, q) minimises the sum of squares of all off-diagonal entries
/// there (Cardoso & Souloumiac 1996, real case).
pub(super) fn joint_eigenvectors(matrices: &[Matrix3]) -> Option<[[f64; 3]; 3]> {
    let largest =
        matrices.iter().flat_map(|m| m.as_flattened()).fold(0.0, |m: f64, v| m.max(v.abs()));
    let small = |v: f64| v.abs() <= ROUNDING * largest;
    if !matrices.iter().all(|m| PLANES.iter().all(|&(p, q)| small(m[p][q] - m[q][p]))) {
        return None;
    }
    let mut vectors = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let entry = |m: &Matrix3, v: &[[f64; 3]; 3], p: usize, q: usize| -> f64 {
        (0..3).map(|i| (0..3).map(|j| v[p][i] * m[i][j] * v[q][j]).sum::<f64>()).sum()
    };
    // Jacobi converges quadratically; 3×3 matrices need four or five sweeps.
    for _ in 0..20 {
        for (p, q) in PLANES {
            let (mut gap, mut cross) = (0.0, 0.0);
            for m in matrices {
                let difference = entry(m, &vectors, p, p) - entry(m, &vectors, q, q);
                let off = 2.0 * entry(m, &vectors, p, q);
                gap += difference * difference - off * off;
                cross += 2.0 * difference * off;
            }
            let angle = 0.25 * cross.atan2(gap);
            let (sin, cos) = angle.sin_cos();
            let (a, b) = (vectors[p], vectors[q]);
            vectors[p] = std::array::from_fn(|k| cos * a[k] + sin * b[k]);
            vectors[q] = std::array::from_fn(|k| cos * b[k] - sin * a[k]);
        }
    }
    let diagonal = |m: &Matrix3| PLANES.iter().all(|&(p, q)| small(entry(m, &vectors, p, q)));
    matrices.iter().all(diagonal).then_some(vectors)
}

const PLANES: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

#[cfg(test)]
mod tests {
    use super::*;

    const GREY: Matrix3 = [[1.0, 0.9, 0.9], [0.9, 1.0, 0.9], [0.9, 0.9, 1.0]];
    const MIRROR: Matrix3 = [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    const IDENTITY: Matrix3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    #[test]
    fn diagonal_matrices_keep_the_coordinate_axes() {
        assert_eq!(joint_eigenvectors(&[IDENTITY, MIRROR]), Some(IDENTITY));
    }

    #[test]
    fn correlated_channels_part_into_grey_and_chroma() {
        let vectors = joint_eigenvectors(&[IDENTITY, GREY]).unwrap();
        let mut values = vectors.map(|v| quadratic(&GREY, v));
        values.sort_by(f64::total_cmp);
        for (got, want) in values.iter().zip([0.1, 0.1, 2.8]) {
            assert!((got - want).abs() < 1e-14, "{values:?}");
        }
    }

    #[test]
    fn matrices_that_do_not_commute_are_refused() {
        assert_eq!(joint_eigenvectors(&[GREY, MIRROR]), None);
        assert_eq!(joint_eigenvectors(&[[[1.0, 1.0, 0.0], [0.0; 3], [0.0; 3]]]), None);
    }
}
