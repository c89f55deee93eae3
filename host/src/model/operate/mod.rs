//! What can be done to models as numbers ([`crate::model::morphable`]); each operation gives a new one.
//!
//! | room | operation |
//! |---|---|
//! | [`mod@project`] | a mesh → its coefficients → the model's mesh that explains it |
//! | [`posterior`] | the model that knows some vertices |
//! | [`region`] | the model of some of the vertices |
//! | [`recentre`] | the same deviations from another mean |
//! | [`augment`] | deviations of two models together |
//! | [`pca`] | the model of registered meshes |
//! | [`orthonormal`] | the same covariance in orthonormal components, leading ones first |
//!
//! Throughout, `m` is the mean, `U` the basis, `λ` the variances, `Q = U diag(√λ)`; a field `s`
//! over V vertices is a vector of 3V numbers, first all vertices' x, then their y, then their z.
//! Nothing assumes that the columns of `U` are orthonormal.

pub mod augment;
pub mod orthonormal;
pub mod pca;
pub mod posterior;
pub mod project;
pub mod recentre;
pub mod region;

use faer::Mat;

/// Fields as columns, 3V × as many as there are. All have V = `vertices` values.
pub(crate) fn columns<T: Copy + Into<f64>>(vertices: usize, fields: &[&[[T; 3]]]) -> Mat<f64> {
    Mat::from_fn(3 * vertices, fields.len(), |row, j| {
        fields[j][row % vertices][row / vertices].into()
    })
}

/// `key = value` lines with one more; an earlier line of the same key goes.
pub fn with_line(provenance: &str, key: &str, value: &str) -> String {
    let other = |line: &&str| line.split('=').next().is_none_or(|found| found.trim() != key);
    let mut lines: Vec<String> =
        provenance.lines().filter(other).map(|line| line.to_string() + "\n").collect();
    lines.push(format!("{key} = {value:?}\n"));
    lines.concat()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::mesh::landmarks::Landmark;
    use crate::model::morphable::Morphable;
    use crate::model::process::Process;
    use onescan_core::rng::Rng;

    /// A process with random mean, random columns and falling variances.
    pub(crate) fn process(vertices: usize, rank: usize, seed: u64) -> Process {
        let mut rng = Rng::new(seed, 3);
        let mean = (0..vertices).map(|_| [0; 3].map(|_| rng.normal_sd(20.0))).collect();
        let basis = Mat::from_fn(3 * vertices, rank, |_, _| rng.normal());
        let variances: Vec<f64> = (0..rank).map(|k| 4.0 / (1.0 + k as f64)).collect();
        Process::new(mean, basis, variances, 0.0)
    }

    /// A strip of triangles whose shape and albedo are [`process`]es.
    pub(crate) fn morphable(vertices: usize, rank: usize, seed: u64) -> Morphable {
        let mut albedo = process(vertices, rank, seed + 100);
        albedo.mean = albedo.mean.iter().map(|c| c.map(|x| 0.5 + 0.01 * x)).collect();
        let landmark = |name: &str, vertex| Landmark { name: name.into(), vertex };
        Morphable::new(
            process(vertices, rank, seed),
            albedo,
            (2..vertices as u32).map(|i| [i - 2, i - 1, i]).collect(),
            vec![landmark("first", 0), landmark("third", 2)],
            "scan = \"strip\"\n".into(),
        )
    }

    /// `Q Qᵀ`.
    pub(crate) fn covariance(process: &Process) -> Mat<f64> {
        let q = process.scaled_basis();
        &q * q.transpose()
    }

    #[track_caller]
    pub(crate) fn assert_close(a: &Mat<f64>, b: &Mat<f64>, tolerance: f64) {
        let scale = a.norm_max().max(b.norm_max()).max(1.0);
        let error = (a - b).norm_max() / scale;
        assert!(error <= tolerance, "differs by {error:e} of its size");
    }

    #[test]
    fn a_line_replaces_the_one_of_its_key() {
        let text = with_line("a = 1\nb = \"x\"\n", "a", "two");
        assert_eq!(text, "b = \"x\"\na = \"two\"\n");
    }
}
