//! Morphable models in double precision: what other programs' files hold, and what new models are
//! computed from.
//!
//! A `.3dmm` file keeps 16-bit entries for a fast fit; here a model is a mean and a matrix.

use crate::decompose::Decomposition;
use crate::error::Result;
use crate::landmarks::{Landmark, Uncertainty};
use crate::mesh::Mesh;
use crate::model_file::{Deviation, Half, ModelParts, OwnedModel};
use faer::Mat;
use onescan_core::basis::{Basis, padded};
use onescan_core::model::Model;
use std::borrow::Cow;
use std::collections::BTreeMap;

/// How far the square of a unit column's length may be from one: rounding of a file's entries
/// takes less.
const UNIT_TOLERANCE: f64 = 1e-2;

/// A low-rank Gaussian process over V vertices, three numbers each:
/// `mean + U diag(√λ) c`, `c ~ N(0, I)`, and independent noise on every number.
///
/// Guarantees: `3V` rows and as many columns in `U` as there are `λ`, all of them finite, `λ` and
/// noise not negative. The columns may have any norm; those of a decomposition are orthonormal.
#[derive(Clone, Debug)]
pub struct Process {
    /// Per vertex: x, y, z in millimetres, or R, G, B in `[0, 1]`.
    pub mean: Vec<[f32; 3]>,
    /// `U`, 3V × r: first all vertices' x (or R), then their y, then their z.
    pub basis: Mat<f64>,
    /// `λ`.
    pub variances: Vec<f64>,
    /// Variance of the noise.
    pub noise: f64,
    /// Trace of the covariance that the components are the leading part of, without noise.
    pub total_variance: f64,
}

impl Process {
    /// A process that is all there is: nothing was left out.
    pub fn new(mean: Vec<[f32; 3]>, basis: Mat<f64>, variances: Vec<f64>, noise: f64) -> Self {
        let total_variance = held(&basis, &variances);
        Self { mean, basis, variances, noise, total_variance }
    }

    /// One half of a `.3dmm` model of so many vertices.
    pub fn of(basis: &Basis<'_>, vertices: usize) -> Self {
        let plane = padded(vertices);
        let variances: Vec<f64> = basis.variance().iter().map(|&v| f64::from(v)).collect();
        let entries = Mat::from_fn(3 * vertices, variances.len(), |row, k| {
            let entry = basis.term(row / vertices * plane + row % vertices, k, 1.0);
            f64::from(entry) / variances[k].sqrt().max(f64::MIN_POSITIVE)
        });
        let mean = |v: usize| [0, 1, 2].map(|channel| basis.mean()[channel * plane + v]);
        Self {
            mean: (0..vertices).map(mean).collect(),
            basis: entries,
            variances,
            noise: 0.0,
            total_variance: basis.total_variance(),
        }
    }

    /// What a kernel's decomposition says about deviations from a mean.
    pub fn around(mean: &[[f32; 3]], deviation: &Decomposition) -> Self {
        let vertices = mean.len();
        Self {
            mean: mean.to_vec(),
            basis: Mat::from_fn(3 * vertices, deviation.rank(), |row, k| {
                let (direction, values) = deviation.column(k);
                direction[row / vertices] * values[row % vertices]
            }),
            variances: deviation.variances.clone(),
            noise: 0.0,
            total_variance: deviation.total_variance,
        }
    }

    /// Trace of the covariance that the components make, `U diag(λ) Uᵀ`.
    pub fn held(&self) -> f64 {
        held(&self.basis, &self.variances)
    }

    /// Number of components.
    pub fn rank(&self) -> usize {
        self.variances.len()
    }

    /// Number of vertices.
    pub fn vertices(&self) -> usize {
        self.mean.len()
    }

    /// Fraction of the whole variance that the components hold.
    pub fn captured(&self) -> f64 {
        if self.total_variance > 0.0 { self.held() / self.total_variance } else { 1.0 }
    }

    /// `Q = U diag(√λ)`: the components with their standard deviations.
    pub fn scaled_basis(&self) -> Mat<f64> {
        let mut scaled = self.basis.clone();
        for (column, variance) in scaled.col_iter_mut().zip(&self.variances) {
            for entry in column.iter_mut() {
                *entry *= variance.sqrt();
            }
        }
        scaled
    }

    /// The field of coefficients; missing ones count as zero, those beyond the rank are ignored.
    pub fn instance(&self, coefficients: &[f64]) -> Vec<[f64; 3]> {
        let mut field: Vec<[f64; 3]> = self.mean.iter().map(|m| m.map(f64::from)).collect();
        let vertices = self.vertices();
        for ((c, variance), column) in
            coefficients.iter().zip(&self.variances).zip(self.basis.col_iter())
        {
            let c = c * variance.sqrt();
            for (row, entry) in column.iter().enumerate() {
                field[row % vertices][row / vertices] += c * entry;
            }
        }
        field
    }

    /// The same process in another unit: every length is so many times what it was.
    #[must_use]
    pub fn in_unit(mut self, factor: f64) -> Self {
        if factor == 1.0 {
            return self;
        }
        let square = factor * factor;
        self.mean.as_flattened_mut().iter_mut().for_each(|x| *x = (f64::from(*x) * factor) as f32);
        self.variances.iter_mut().for_each(|v| *v *= square);
        Self { noise: self.noise * square, total_variance: self.total_variance * square, ..self }
    }

    /// The same process with columns of norm one and variances to go with them, in descending
    /// order.
    #[must_use]
    pub fn with_unit_columns(&self) -> Self {
        let norms: Vec<f64> = self.basis.col_iter().map(|u| u.norm_l2()).collect();
        let variance = |k: usize| self.variances[k] * norms[k] * norms[k];
        let mut order: Vec<usize> = (0..self.rank()).collect();
        order.sort_by(|&a, &b| variance(b).total_cmp(&variance(a)));
        Self {
            mean: self.mean.clone(),
            basis: Mat::from_fn(self.basis.nrows(), order.len(), |row, k| {
                self.basis[(row, order[k])] / norms[order[k]].max(f64::MIN_POSITIVE)
            }),
            variances: order.iter().map(|&k| variance(k)).collect(),
            ..*self
        }
    }

    /// The first `rank` components.
    #[must_use]
    pub fn truncated(&self, rank: usize) -> Self {
        let rank = rank.min(self.rank());
        Self {
            mean: self.mean.clone(),
            basis: self.basis.subcols(0, rank).to_owned(),
            variances: self.variances[..rank].to_vec(),
            ..*self
        }
    }

    /// The same process on some of the vertices. Its columns are no longer orthogonal.
    #[must_use]
    pub fn marginal(&self, vertices: &[u32]) -> Self {
        let count = vertices.len();
        let row = |i: usize| i / count * self.vertices() + vertices[i % count] as usize;
        let basis = Mat::from_fn(3 * count, self.rank(), |i, k| self.basis[(row(i), k)]);
        let part = Self {
            mean: vertices.iter().map(|&v| self.mean[v as usize]).collect(),
            basis,
            variances: self.variances.clone(),
            ..*self
        };
        // What the components never held is assumed to be spread over the vertices like what
        // they hold.
        let (before, after) = (self.held(), part.held());
        let share = if before > 0.0 { after / before } else { 1.0 };
        Self { total_variance: self.total_variance * share, ..part }
    }
}

/// Trace of `U diag(λ) Uᵀ`.
fn held(basis: &Mat<f64>, variances: &[f64]) -> f64 {
    basis.col_iter().zip(variances).map(|(u, v)| v * u.squared_norm_l2()).sum()
}

impl Deviation for Process {
    fn variances(&self) -> &[f64] {
        &self.variances
    }

    fn total_variance(&self) -> f64 {
        self.total_variance
    }

    fn column(&self, k: usize, channel: usize) -> (f64, &[f64]) {
        let vertices = self.basis.nrows() / 3;
        let column = self.basis.col(k).try_as_col_major().map_or(&[][..], |c| c.as_slice());
        (self.variances[k].sqrt(), &column[channel * vertices..(channel + 1) * vertices])
    }
}

/// A morphable model: shape and albedo over the same vertices.
///
/// Guarantees: both processes have as many vertices, triangles and landmarks refer to these, there
/// is at least one triangle, names of landmarks are unique.
#[derive(Clone, Debug)]
pub struct Morphable {
    /// Positions.
    pub shape: Process,
    /// Colours.
    pub albedo: Process,
    /// What expressions add to positions, if the model has any; its mean is an offset.
    pub expression: Option<Process>,
    /// Positions the model was made around, if they are not the mean.
    pub reference: Option<Vec<[f32; 3]>>,
    /// Corner indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Named vertices.
    pub landmarks: Vec<Landmark>,
    /// By landmark, how sure its place is, where that is known.
    pub uncertainties: BTreeMap<String, Uncertainty>,
    /// Where the model comes from: TOML.
    pub provenance: String,
}

impl Morphable {
    /// A model without expressions, made around its mean, of landmarks as sure as they are.
    pub fn new(
        shape: Process,
        albedo: Process,
        triangles: Vec<[u32; 3]>,
        landmarks: Vec<Landmark>,
        provenance: String,
    ) -> Self {
        let (expression, reference, uncertainties) = (None, None, BTreeMap::new());
        Self {
            shape,
            albedo,
            expression,
            reference,
            triangles,
            landmarks,
            uncertainties,
            provenance,
        }
    }

    /// A `.3dmm` model.
    pub fn of(model: &Model<'_>) -> Self {
        let half = |basis| Process::of(basis, model.vertices());
        Self::with_halves(model, half(&model.shape), half(&model.albedo))
    }

    /// A `.3dmm` model whose halves are known better than its file's.
    pub fn with_halves(model: &Model<'_>, shape: Process, albedo: Process) -> Self {
        let landmark = |(name, vertex): (&str, u32)| Landmark { name: name.to_string(), vertex };
        Self::new(
            shape,
            albedo,
            (0..model.triangles.len()).filter_map(|t| model.triangles.get(t)).collect(),
            model.landmarks().map(landmark).collect(),
            model.provenance().to_string(),
        )
    }

    /// Positions the model was made around.
    pub fn reference(&self) -> &[[f32; 3]] {
        self.reference.as_deref().unwrap_or(&self.shape.mean)
    }

    /// The `.3dmm` model. `levels`: see [`ModelParts`]. Noise and expressions are left out, and
    /// columns that are far from unit length brought to it.
    ///
    /// # Errors
    /// See [`ModelParts::to_bytes`].
    pub fn to_model(&self, levels: i16) -> Result<OwnedModel> {
        let halves = [&self.shape, &self.albedo].map(|process| {
            let is_unit = |u: f64| (u - 1.0).abs() < UNIT_TOLERANCE;
            let unit = process.basis.col_iter().all(|u| is_unit(u.squared_norm_l2()));
            if unit { Cow::Borrowed(process) } else { Cow::Owned(process.with_unit_columns()) }
        });
        let [shape, albedo] = &halves;
        let parts = ModelParts {
            shape: Half { mean: &shape.mean, deviation: &**shape },
            albedo: Half { mean: &albedo.mean, deviation: &**albedo },
            triangles: &self.triangles,
            landmarks: &self.landmarks,
            provenance: &self.provenance,
            levels,
        };
        OwnedModel::from_bytes(&parts.to_bytes()?)
    }

    /// The mean as a mesh.
    pub fn mean(&self) -> Mesh {
        Mesh {
            points: self.shape.mean.clone(),
            colors: self.albedo.mean.clone(),
            triangles: self.triangles.clone(),
        }
    }

    /// The mesh of coefficients, colours limited to `[0, 1]`.
    pub fn instance(&self, shape: &[f64], albedo: &[f64]) -> Mesh {
        let color = |c: f64| c.clamp(0.0, 1.0) as f32;
        Mesh {
            points: self.shape.instance(shape).iter().map(|p| p.map(|x| x as f32)).collect(),
            colors: self.albedo.instance(albedo).iter().map(|p| p.map(color)).collect(),
            triangles: self.triangles.clone(),
        }
    }
}

/// A model from another program's file.
#[derive(Clone, Debug)]
pub struct Import {
    /// The model.
    pub model: Morphable,
    /// What in the file is not as it should be, and what was made of it: sentences for a person.
    pub notes: Vec<String>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::{BuildOptions, Method, build};
    use crate::decompose::Truncation;
    use crate::kernel::{Axis, Kernels};

    fn model() -> OwnedModel {
        let points: Vec<[f32; 3]> = (0..40)
            .map(|i| [(i % 5) as f32 * 9.0 - 18.0, (i / 5) as f32 * 7.0, ((i * i) % 7) as f32])
            .collect();
        let scan = Mesh {
            colors: points.iter().map(|p| [0.5 + p[0] / 90.0, 0.4, p[1] / 80.0]).collect(),
            points,
            triangles: (0..38).map(|i| [i, i + 1, i + 2]).collect(),
        };
        let landmarks = [Landmark { name: "tip".into(), vertex: 7 }];
        let options = BuildOptions {
            scan_name: "grid",
            kernels: Kernels::named("symmetric-full", Some(Axis::X)).unwrap(),
            method: Method::Exact(Truncation::Rank(12)),
            millimetres: 1.0,
        };
        build(&scan, &landmarks, &options, &mut |_, _| {}).unwrap().model
    }

    #[test]
    fn a_model_survives_the_way_to_numbers_and_back() {
        let file = model();
        let numbers = Morphable::of(&file.view());
        let back = numbers.to_model(i16::MAX).unwrap();
        assert_eq!(back.bytes(), file.bytes());
    }

    #[test]
    fn truncation_keeps_the_leading_components() {
        let whole = Morphable::of(&model().view()).shape;
        let part = whole.truncated(5);
        assert_eq!((part.rank(), part.total_variance), (5, whole.total_variance));
        assert_eq!(part.variances, whole.variances[..5]);
        let c = [0.5, -1.0, 2.0, 0.25, 1.0];
        assert_eq!(part.instance(&c), whole.instance(&c));
        assert_eq!(whole.truncated(99).rank(), 12);
    }

    #[test]
    fn a_marginal_is_the_instance_at_its_vertices() {
        let numbers = Morphable::of(&model().view());
        let some = [3, 17, 30];
        let coefficients = [0.5, -1.0, 2.0, 0.25];
        let whole = numbers.shape.instance(&coefficients);
        let part = numbers.shape.marginal(&some).instance(&coefficients);
        for (v, p) in some.iter().zip(part) {
            assert_eq!(whole[*v as usize], p);
        }
    }
}
