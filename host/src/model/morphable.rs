//! Morphable models in double precision: what other programs' files hold, and what new models are
//! computed from.
//!
//! A `.3dmm` file keeps 16-bit entries for a fast fit; here a model is a mean and a matrix.

use crate::error::Result;
use crate::mesh::Mesh;
use crate::mesh::landmarks::{Landmark, Uncertainty};
use crate::model::layout::ModelParts;
use crate::model::process::{Half, Process};
use crate::model_file::OwnedModel;
use onescan_core::model::Model;
use std::borrow::Cow;
use std::collections::BTreeMap;

/// How far the square of a unit column's length may be from one: rounding of a file's entries
/// takes less.
const UNIT_TOLERANCE: f64 = 1e-2;

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
    /// Per vertex, 255 times the prior probability that it is hidden, if that is known.
    pub occlusion: Option<Vec<u8>>,
    /// Where the model comes from: TOML.
    pub provenance: String,
}

impl Morphable {
    /// A model without expressions, occlusion map or uncertainties of landmarks, made around its mean.
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
            occlusion: None,
            provenance,
        }
    }

    /// The model of a `.3dmm` file.
    pub fn of(model: &Model<'_>) -> Self {
        let half = |basis| Process::of(basis, model.vertices());
        Self::with_halves(model, half(&model.shape), half(&model.albedo))
    }

    /// A `.3dmm` model whose halves are known in better precision than its file's.
    pub fn with_halves(model: &Model<'_>, shape: Process, albedo: Process) -> Self {
        let landmark = |(name, vertex): (&str, u32)| Landmark { name: name.to_string(), vertex };
        let known = Self::new(
            shape,
            albedo,
            (0..model.triangles.len()).filter_map(|t| model.triangles.get(t)).collect(),
            model.landmarks().map(landmark).collect(),
            model.provenance().to_string(),
        );
        Self { occlusion: model.occlusion().map(<[u8]>::to_vec), ..known }
    }

    /// Positions the model was made around.
    pub fn reference(&self) -> &[[f32; 3]] {
        self.reference.as_deref().unwrap_or(&self.shape.mean)
    }

    /// The model as a `.3dmm`; for `levels` see [`ModelParts`]. Noise and expressions are left out, and columns
    /// that are far from unit length are brought to it.
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
            occlusion: self.occlusion.as_deref(),
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

    /// The mesh that coefficients give, its colours limited to `[0, 1]`.
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
    use crate::mesh::Axis;
    use crate::model::build::{BuildOptions, Method, build};
    use crate::model::decompose::Truncation;
    use crate::model::kernel::Kernels;

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
