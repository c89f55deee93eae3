//! The same deviations from another mean.

use crate::error::Result;
use crate::mesh::Mesh;
use crate::model::morphable::Morphable;
use crate::model::process::Process;

impl Process {
    /// This covariance about another mean of as many vertices.
    ///
    /// # Errors
    /// A mean over another number of vertices.
    pub fn about(&self, mean: &[[f32; 3]]) -> Result<Self> {
        self.check_length(mean.len())?;
        Ok(Self { mean: mean.to_vec(), ..self.clone() })
    }
}

impl Morphable {
    /// This model with a mesh of its topology for its mean, shape and albedo.
    ///
    /// # Errors
    /// A mesh of another number of vertices.
    pub fn about(&self, mesh: &Mesh) -> Result<Self> {
        Ok(Self {
            shape: self.shape.about(&mesh.points)?,
            albedo: self.albedo.about(&mesh.colors)?,
            ..self.clone()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::morphable;

    #[test]
    fn instances_move_with_the_mean() {
        let model = morphable(6, 3, 2);
        let mut mesh = model.mean();
        for point in &mut mesh.points {
            point[1] += 100.0;
        }
        let moved = model.about(&mesh).unwrap();
        let (a, b) = (model.shape.instance(&[1.0, 2.0]), moved.shape.instance(&[1.0, 2.0]));
        for (a, b) in a.iter().zip(&b) {
            assert!((b[1] - a[1] - 100.0).abs() < 1e-4 && a[0] == b[0]);
        }
        mesh.points.pop();
        assert!(model.about(&mesh).is_err());
    }
}
