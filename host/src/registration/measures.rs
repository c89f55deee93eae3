//! How far a registered mesh and its scan are from each other. Surfaces say nothing of
//! correspondence: a mesh may lie on the scan and have slid along it.

use crate::mesh::Mesh;
use crate::scan::surface::Surface;
use serde::{Deserialize, Serialize};

/// Distances of many points to a surface, mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Distances {
    /// Their mean: one side of the chamfer distance.
    pub mean: f64,
    /// 95 % are nearer.
    pub most: f64,
    /// The largest: one side of the Hausdorff distance.
    pub largest: f64,
}

impl Distances {
    /// Of some distances; zero of none.
    pub fn of(mut distances: Vec<f64>) -> Self {
        distances.sort_by(f64::total_cmp);
        let count = distances.len().max(1);
        Self {
            mean: distances.iter().sum::<f64>() / count as f64,
            most: distances.get(count * 95 / 100).copied().unwrap_or(0.0),
            largest: distances.last().copied().unwrap_or(0.0),
        }
    }
}

/// What is measured of a registration, mm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Measures {
    /// From the registered vertices to the scan's surface.
    pub to_scan: Distances,
    /// From the scan's vertices to the registered surface, beyond whose rim the scan may go.
    pub from_scan: Distances,
    /// Per registered vertex, to the scan's surface.
    #[serde(skip)]
    pub per_vertex: Vec<f64>,
}

impl Measures {
    /// Measures a registered mesh and a scan with its surface.
    pub fn of(mesh: &Mesh, scan: &Mesh, surface: &Surface) -> Self {
        let far = |surface: &Surface, points: &[[f32; 3]]| -> Vec<f64> {
            points.iter().map(|p| surface.nearest(p.map(f64::from)).squared.sqrt()).collect()
        };
        let per_vertex = far(surface, &mesh.points);
        Self {
            to_scan: Distances::of(per_vertex.clone()),
            from_scan: Distances::of(far(&Surface::new(mesh), &scan.points)),
            per_vertex,
        }
    }

    /// The larger of both Hausdorff distances.
    pub fn hausdorff(&self) -> f64 {
        self.to_scan.largest.max(self.from_scan.largest)
    }

    /// The same of 95 % of the points.
    pub fn hausdorff_95(&self) -> f64 {
        self.to_scan.most.max(self.from_scan.most)
    }

    /// The mean of both sides' means.
    pub fn chamfer(&self) -> f64 {
        f64::midpoint(self.to_scan.mean, self.from_scan.mean)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_of_a_shifted_square_are_the_shift() {
        let mesh = Mesh {
            points: vec![[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [4.0, 4.0, 0.0]],
            colors: vec![[0.5; 3]; 4],
            triangles: vec![[0, 1, 2], [2, 1, 3]],
        };
        let mut scan = mesh.clone();
        scan.points.iter_mut().for_each(|p| p[2] += 1.5);
        let measures = Measures::of(&mesh, &scan, &Surface::new(&scan));
        assert_eq!((measures.chamfer(), measures.hausdorff()), (1.5, 1.5));
        scan.points[3][2] = 9.0;
        let measures = Measures::of(&mesh, &scan, &Surface::new(&scan));
        assert!(measures.hausdorff() > 8.9 && measures.to_scan.largest < 6.0, "{measures:?}");
        assert_eq!(Distances::of((0..100).map(f64::from).collect()).most, 95.0);
    }
}
