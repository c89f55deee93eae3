//! The model of a part of the surface.

use crate::error::{Error, Result};
use crate::mesh::landmarks::Landmark;
use crate::model::morphable::Morphable;

impl Morphable {
    /// The model of the vertices that `keep` accepts: their marginal covariance, the triangles all
    /// of whose corners stay, the landmarks that stay. Coefficients mean the same as before, so
    /// components are no longer orthogonal.
    ///
    /// # Errors
    /// When no triangle is left.
    pub fn region(&self, keep: impl Fn(u32) -> bool) -> Result<Self> {
        let vertices: Vec<u32> = (0..self.shape.vertices() as u32).filter(|&v| keep(v)).collect();
        let at = |v: &u32| vertices.binary_search(v).ok().map(|i| i as u32);
        let triangles: Vec<[u32; 3]> =
            self.triangles.iter().filter_map(|[a, b, c]| Some([at(a)?, at(b)?, at(c)?])).collect();
        if triangles.is_empty() {
            return Err(Error::new(format_args!(
                "the region has {} vertices and no triangle; make it larger",
                vertices.len()
            )));
        }
        let landmarks: Vec<Landmark> = self
            .landmarks
            .iter()
            .filter_map(|l| Some(Landmark { name: l.name.clone(), vertex: at(&l.vertex)? }))
            .collect();
        let mut uncertainties = self.uncertainties.clone();
        uncertainties.retain(|name, _| landmarks.iter().any(|l| l.name == *name));
        let of = |points: &Vec<[f32; 3]>| vertices.iter().map(|&v| points[v as usize]).collect();
        Ok(Self {
            shape: self.shape.marginal(&vertices),
            albedo: self.albedo.marginal(&vertices),
            expression: self.expression.as_ref().map(|process| process.marginal(&vertices)),
            reference: self.reference.as_ref().map(of),
            occlusion: self
                .occlusion
                .as_ref()
                .map(|map| vertices.iter().map(|&v| map[v as usize]).collect()),
            uncertainties,
            triangles,
            landmarks,
            provenance: self.provenance.clone(),
        })
    }

    /// Whether each vertex of the mean is within `radius` millimetres of one of some landmarks.
    ///
    /// # Errors
    /// A name that is no landmark of the model.
    pub fn around(&self, names: &[String], radius: f64) -> Result<Vec<bool>> {
        let centres = names
            .iter()
            .map(|name| {
                let found = self.landmarks.iter().find(|l| l.name == *name);
                let vertex = found.map(|l| l.vertex).ok_or_else(|| self.no_landmark(name))?;
                Ok(self.shape.mean[vertex as usize])
            })
            .collect::<Result<Vec<_>>>()?;
        let near = |p: &[f32; 3], centre: &[f32; 3]| {
            let squared: f64 = (0..3).map(|k| f64::from(p[k] - centre[k]).powi(2)).sum();
            squared <= radius * radius
        };
        Ok(self.shape.mean.iter().map(|p| centres.iter().any(|c| near(p, c))).collect())
    }

    /// The error of a name that is no landmark of the model: it lists those that are.
    pub fn no_landmark(&self, name: &str) -> Error {
        let names: Vec<_> = self.landmarks.iter().map(|l| l.name.as_str()).collect();
        Error::new(format_args!(
            "the model has no landmark {name:?}; it has {}",
            if names.is_empty() { "none".into() } else { names.join(", ") }
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::morphable;

    #[test]
    fn the_region_of_an_instance_is_the_instance_of_the_region() {
        let whole = morphable(9, 4, 1);
        let keep = |v: u32| (2..7).contains(&v);
        let part = whole.region(keep).unwrap();
        let (shape, albedo) = ([1.0, -2.0, 0.5], [0.3, 0.0, 0.0, 1.0]);
        let (all, some) = (whole.instance(&shape, &albedo), part.instance(&shape, &albedo));
        assert_eq!(some.points, all.points[2..7]);
        assert_eq!(some.colors, all.colors[2..7]);
        assert_eq!(some.triangles, [[0, 1, 2], [1, 2, 3], [2, 3, 4]]);
        let names: Vec<_> = part.landmarks.iter().map(|l| (l.name.as_str(), l.vertex)).collect();
        assert_eq!(names, [("third", 0)]);
    }

    #[test]
    fn a_radius_reaches_from_its_landmark() {
        let whole = morphable(9, 4, 1);
        let nobody_else = whole.around(&["third".into()], 0.0).unwrap();
        assert_eq!(nobody_else.iter().position(|&near| near), Some(2));
        assert_eq!(nobody_else.iter().filter(|near| **near).count(), 1);
        assert!(whole.around(&["third".into()], 1e6).unwrap().iter().all(|near| *near));
        let error = whole.around(&["ear".into()], 1.0).unwrap_err().to_string();
        assert!(error.contains("no landmark \"ear\"; it has first, third"), "{error}");
        assert!(whole.region(|v| v != 2 && v != 5).is_ok());
        assert!(whole.region(|v| v % 2 == 0).unwrap_err().to_string().contains("no triangle"));
    }
}
