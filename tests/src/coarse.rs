//! A small mesh with the shape, colours and landmarks of a large one.

use onescan::mesh::Mesh;
use onescan::mesh::landmarks::Landmark;
use std::collections::HashSet;

/// Clusters the vertices: the landmarks, then every vertex in order that is at least `spacing`
/// away from those chosen before, are kept as they are; the others are merged into the nearest
/// kept one, and triangles that collapse or repeat go.
pub fn coarse(mesh: &Mesh, landmarks: &[Landmark], spacing: f32) -> (Mesh, Vec<Landmark>) {
    let squared = |a: u32, b: u32| -> f32 {
        let (a, b) = (mesh.points[a as usize], mesh.points[b as usize]);
        (0..3).map(|i| (a[i] - b[i]) * (a[i] - b[i])).sum()
    };
    let mut kept: Vec<u32> = landmarks.iter().map(|landmark| landmark.vertex).collect();
    kept.sort_unstable();
    kept.dedup();
    for vertex in 0..mesh.points.len() as u32 {
        if kept.iter().all(|&other| squared(vertex, other) >= spacing * spacing) {
            kept.push(vertex);
        }
    }
    let nearest = |vertex: u32| {
        let mut best = 0;
        for place in 1..kept.len() {
            if squared(vertex, kept[place]) < squared(vertex, kept[best]) {
                best = place;
            }
        }
        best as u32
    };
    let merged: Vec<u32> = (0..mesh.points.len() as u32).map(nearest).collect();
    let mut seen = HashSet::new();
    let triangles = mesh
        .triangles
        .iter()
        .map(|triangle| triangle.map(|vertex| merged[vertex as usize]))
        .filter(|&[a, b, c]| {
            let mut corners = [a, b, c];
            corners.sort_unstable();
            a != b && b != c && c != a && seen.insert(corners)
        })
        .collect();
    let small = Mesh {
        points: kept.iter().map(|&vertex| mesh.points[vertex as usize]).collect(),
        colors: kept.iter().map(|&vertex| mesh.colors[vertex as usize]).collect(),
        triangles,
    };
    let landmarks = landmarks
        .iter()
        .map(|landmark| Landmark {
            name: landmark.name.clone(),
            vertex: merged[landmark.vertex as usize],
        })
        .collect();
    (small, landmarks)
}
