//! Small holes closed, by rings from the rim to its middle.

use super::doctor::surface::{self, Groups, area, bounds, distinct, edges};
use crate::mesh::{Mesh, weld};
use crate::vector::distance;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::f64::consts::PI;

/// Longest rim that is closed if nothing else is said, as a fraction of the diagonal of the box around the
/// mesh: an eye of a face. Chosen, not measured.
const LONGEST: f64 = 0.2;
/// A border is a hole if a disc with as long a rim is less than this fraction of the piece's surface;
/// else it is the outline of a piece that lies open, an eyelash's say. Chosen, not measured.
const HOLE: f64 = 0.25;

/// Closes holes whose rim is no longer than `longest`, in the mesh's unit; returns how many. New vertices
/// follow the old ones; their colours pass from the rim's to the rim's mean.
pub fn fill(mesh: &mut Mesh, longest: Option<f64>) -> usize {
    let (map, points) = weld(&mesh.points);
    let points: Vec<[f64; 3]> = points.iter().map(|p| p.map(f64::from)).collect();
    let joined: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.map(|v| map[v as usize])).collect();
    // Of equal vertices the first that is seen.
    let mut own: HashMap<u32, u32> = HashMap::new();
    for &v in mesh.triangles.as_flattened() {
        let first = own.entry(map[v as usize]).or_insert(v);
        *first = v.min(*first);
    }
    let (kept, ..) = distinct(&points, &joined);
    let mut groups = Groups::new(points.len());
    for &[a, b, c] in &kept {
        groups.join(a, b);
        groups.join(b, c);
    }
    let mut areas: HashMap<u32, f64> = HashMap::new();
    for &triangle in &kept {
        *areas.entry(groups.find(triangle[0])).or_default() += area(&points, triangle);
    }
    let (low, high) = bounds(&points);
    let longest = longest.unwrap_or(LONGEST * distance(low, high));
    let mut filled = 0;
    for rim in rims(&kept) {
        let around = rim.iter().zip(rim.iter().cycle().skip(1));
        let length: f64 = around.map(|(a, b)| surface::distance(&points, *a, *b)).sum();
        let disc = length * length / (4.0 * PI);
        let piece = areas.get(&groups.find(rim[0])).copied().unwrap_or_default();
        if length <= longest && disc < HOLE * piece {
            close(mesh, &rim.iter().map(|v| own[v]).collect::<Vec<_>>());
            filled += 1;
        }
    }
    filled
}

/// The borders that are a ring, each in the direction of the triangles that would close it.
fn rims(triangles: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let mut next = BTreeMap::new();
    let mut forked = HashSet::new();
    for ([low, high], sides) in edges(triangles) {
        if let [(_, forward)] = sides[..] {
            let (from, to) = if forward { (high, low) } else { (low, high) };
            if next.insert(from, to).is_some() {
                forked.insert(from);
            }
        }
    }
    let mut rims = Vec::new();
    while let Some((start, mut at)) = next.pop_first() {
        let mut rim = vec![start];
        while at != start {
            rim.push(at);
            let Some(to) = next.remove(&at) else { break };
            at = to;
        }
        if at == start && rim.len() > 2 && !rim.iter().any(|v| forked.contains(v)) {
            rims.push(rim);
        }
    }
    rims
}

/// Puts a membrane into a ring of vertices.
fn close(mesh: &mut Mesh, rim: &[u32]) {
    let &[a, b, ref rest @ ..] = rim else { return };
    if let &[c] = rest {
        mesh.triangles.push([a, b, c]);
        return;
    }
    let count = rim.len();
    let at = |values: &[[f32; 3]]| -> Vec<[f32; 3]> {
        rim.iter().map(|v| values[*v as usize]).collect()
    };
    let (places, colors) = (at(&mesh.points), at(&mesh.colors));
    let middle = |values: &[[f32; 3]]| -> [f32; 3] {
        std::array::from_fn(|i| values.iter().map(|v| v[i]).sum::<f32>() / count as f32)
    };
    let (center, color) = (middle(&places), middle(&colors));
    let radius = places.iter().map(|p| distance(*p, center)).sum::<f32>() / count as f32;
    let around = places.iter().zip(places.iter().cycle().skip(1));
    let edge = around.map(|(a, b)| distance(*a, *b)).sum::<f32>() / count as f32;
    // Triangles as high as they are wide; more rings than a rim's vertices can need are none.
    let rings = (radius / edge).round().clamp(1.0, count as f32) as usize;
    let mut outer = rim.to_vec();
    for ring in 1..rings {
        let t = ring as f32 / rings as f32;
        let toward = |a: [f32; 3], b: [f32; 3]| std::array::from_fn(|i| a[i] + t * (b[i] - a[i]));
        let first = mesh.points.len() as u32;
        mesh.points.extend(places.iter().map(|p| toward(*p, center)));
        mesh.colors.extend(colors.iter().map(|c| toward(*c, color)));
        let inner: Vec<u32> = (first..first + count as u32).collect();
        for k in 0..count {
            let l = (k + 1) % count;
            mesh.triangles.push([outer[k], outer[l], inner[k]]);
            mesh.triangles.push([outer[l], inner[l], inner[k]]);
        }
        outer = inner;
    }
    let hub = mesh.points.len() as u32;
    mesh.points.push(center);
    mesh.colors.push(color);
    mesh.triangles.extend((0..count).map(|k| [outer[k], outer[(k + 1) % count], hub]));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo;
    use crate::scan::doctor::Findings;

    #[test]
    fn a_hole_is_closed_and_a_rim_is_not() {
        let (mut face, _) = demo::template().unwrap();
        let whole = face.clone();
        let nose = [0.0, -10.0, 60.0];
        let near = |p: &[f32; 3]| (0..3).map(|i| (p[i] - nose[i]).powi(2)).sum::<f32>();
        let center = (0..face.points.len())
            .min_by(|a, b| near(&face.points[*a]).total_cmp(&near(&face.points[*b])))
            .map(|v| face.points[v])
            .unwrap();
        let inside = |v: &u32| {
            let p = face.points[*v as usize];
            (0..3).map(|i| (p[i] - center[i]).powi(2)).sum::<f32>() < 36.0
        };
        face.triangles = face.triangles.iter().copied().filter(|t| !t.iter().all(inside)).collect();
        let before = Findings::of(&face, 1.0);
        assert_eq!(before.borders, 2);
        assert_eq!(fill(&mut face, Some(10.0)), 0, "the rim is longer");
        assert_eq!(fill(&mut face, None), 1);
        let after = Findings::of(&face, 1.0);
        assert_eq!((after.borders, after.clashing_edges, after.crowded_edges), (1, 0, 0));
        assert_eq!(after.inside_out, Some(false));
        assert_eq!(face.points[..whole.points.len()], whole.points, "vertices keep their numbers");
        let added = &face.colors[whole.points.len()..];
        assert!(!added.is_empty() && added.iter().flatten().all(|c| (0.05..1.0).contains(c)));
        assert!((after.area / Findings::of(&whole, 1.0).area - 1.0).abs() < 0.01);
    }

    #[test]
    fn an_open_piece_is_no_hole() {
        let mut card = Mesh {
            points: vec![[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
            colors: vec![[0.5; 3]; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        assert_eq!(fill(&mut card, Some(100.0)), 0);
        // A tetrahedron without one of its sides.
        card.points[3] = [0.4, 0.3, 5.0];
        card.triangles = vec![[0, 1, 3], [1, 2, 3], [2, 0, 3]];
        assert_eq!(fill(&mut card, Some(100.0)), 1);
        assert_eq!(card.triangles[3..].len(), 1);
        assert_eq!(Findings::of(&card, 1.0).border_edges, 0);
        assert_eq!(Findings::of(&card, 1.0).inside_out, Some(false));
    }
}
