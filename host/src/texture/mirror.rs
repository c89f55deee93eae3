//! Which vertex of an object is which one's mirror image.

use crate::mesh::Axis;

/// Share of the vertices that must have a mirror image. Chosen, not measured.
const ENOUGH: f32 = 0.9;

/// The counterpart of each vertex: the one nearest to where the mirror at a coordinate plane has it, if
/// within half the mean length of an edge. `None` if the object is not nearly symmetric to any of the
/// three planes, of which the first that it is counts: x = 0 is the models' own.
pub(super) fn counterparts(
    points: &[[f32; 3]],
    triangles: &[[u32; 3]],
) -> Option<Vec<Option<u32>>> {
    let edge = mean_edge(points, triangles);
    if !(edge > 0.0 && edge.is_finite()) {
        return None;
    }
    // Slices across y, each as thick as an edge is long; of all beyond the last one.
    let least = points.iter().fold(f32::MAX, |least, p| least.min(p[1]));
    let slice = |y: f32| ((y - least) / edge).max(0.0) as usize;
    let last = points.len() - 1;
    let mut slices: Vec<Vec<u32>> = vec![Vec::new(); points.len()];
    for (i, p) in points.iter().enumerate() {
        slices[slice(p[1]).min(last)].push(i as u32);
    }
    let nearest = |p: [f32; 3]| {
        let mut best = (0.25 * edge * edge, None);
        let near = slice(p[1] - edge).min(last)..=slice(p[1] + edge).min(last);
        for slice in &slices[near] {
            for &i in slice {
                let q = points[i as usize];
                let [x, y, z] = [p[0] - q[0], p[1] - q[1], p[2] - q[2]];
                let squared = x * x + y * y + z * z;
                if squared < best.0 {
                    best = (squared, Some(i));
                }
            }
        }
        best.1
    };
    [Axis::X, Axis::Y, Axis::Z].into_iter().find_map(|axis| {
        let found: Vec<_> = points
            .iter()
            .map(|p| {
                let negated = axis.negates();
                nearest([0, 1, 2].map(|k| if negated[k] { -p[k] } else { p[k] }))
            })
            .collect();
        let share = found.iter().flatten().count() as f32 / points.len().max(1) as f32;
        (share >= ENOUGH).then_some(found)
    })
}

/// The mean length of the triangles' edges.
pub(super) fn mean_edge(points: &[[f32; 3]], triangles: &[[u32; 3]]) -> f32 {
    let distance = |a: u32, b: u32| {
        let [a, b] = [a, b].map(|i| points[i as usize]);
        (0..3).map(|k| (a[k] - b[k]) * (a[k] - b[k])).sum::<f32>().sqrt()
    };
    let sum: f32 =
        triangles.iter().map(|&[a, b, c]| distance(a, b) + distance(b, c) + distance(c, a)).sum();
    sum / (3 * triangles.len()).max(1) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::template;

    #[test]
    fn the_template_mirrors_at_x_and_at_another_plane_after_a_turn() {
        let mesh = template().unwrap().0;
        let found = counterparts(&mesh.points, &mesh.triangles).unwrap();
        for (p, image) in mesh.points.iter().zip(&found) {
            let q = mesh.points[image.unwrap() as usize];
            assert!((p[0] + q[0]).abs() < 0.1 && (p[1] - q[1]).abs() < 0.1, "{p:?} {q:?}");
        }
        let turned: Vec<_> = mesh.points.iter().map(|&[x, y, z]| [y, x, z]).collect();
        assert_eq!(counterparts(&turned, &mesh.triangles).unwrap(), found);
    }

    #[test]
    fn what_is_not_symmetric_has_no_image() {
        let mesh = template().unwrap().0;
        let bent: Vec<_> = mesh.points.iter().map(|&[x, y, z]| [x + 0.2 * y, y, z]).collect();
        assert_eq!(counterparts(&bent, &mesh.triangles), None);
        assert_eq!(counterparts(&[[1.0; 3]; 3], &[[0, 1, 2]]), None);
    }
}
