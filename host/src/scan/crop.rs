//! A part of a scan, cut out by a ball.

use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::mesh::landmarks::Landmark;

/// Keeps the triangles whose corners are no farther from a landmark than `radius`, in the mesh's unit, and
/// their vertices, which stay in order. Landmarks elsewhere are dropped; returns their names.
///
/// # Errors
/// No landmark of this name, no triangle so near.
pub fn crop(
    mesh: &mut Mesh,
    landmarks: &mut Vec<Landmark>,
    name: &str,
    radius: f32,
) -> Result<Vec<String>> {
    let Some(landmark) = landmarks.iter().find(|landmark| landmark.name == name) else {
        let names: Vec<_> = landmarks.iter().map(|landmark| landmark.name.as_str()).collect();
        return Err(Error::new(format_args!(
            "--crop: no landmark {name:?}; there are {}",
            names.join(", ")
        )));
    };
    let center = mesh.points[landmark.vertex as usize];
    let near = |v: &u32| {
        let p = mesh.points[*v as usize];
        (0..3).map(|i| f64::from(p[i] - center[i]).powi(2)).sum::<f64>().sqrt() <= radius.into()
    };
    let mut triangles: Vec<_> =
        mesh.triangles.iter().copied().filter(|t| t.iter().all(near)).collect();
    if triangles.is_empty() {
        return Err(Error::new(format_args!(
            "--crop: no triangle lies so near to {name}; give more millimetres, or the scan's --unit"
        )));
    }
    let mut places = vec![None; mesh.points.len()];
    for &v in triangles.as_flattened() {
        places[v as usize] = Some(0);
    }
    for (place, number) in places.iter_mut().flatten().zip(0..) {
        *place = number;
    }
    let kept = |values: &[[f32; 3]]| -> Vec<[f32; 3]> {
        values.iter().zip(&places).filter(|(_, place)| place.is_some()).map(|(v, _)| *v).collect()
    };
    let (points, colors) = (kept(&mesh.points), kept(&mesh.colors));
    for corner in triangles.as_flattened_mut() {
        *corner = places[*corner as usize].unwrap_or_default();
    }
    *mesh = Mesh { points, colors, triangles };
    let mut dropped = Vec::new();
    landmarks.retain_mut(|landmark| {
        let place = places[landmark.vertex as usize];
        match place {
            Some(place) => landmark.vertex = place,
            None => dropped.push(landmark.name.clone()),
        }
        place.is_some()
    });
    Ok(dropped)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo;

    #[test]
    fn what_is_near_stays_with_its_landmarks() {
        let (whole, all) = demo::template().unwrap();
        let (mut face, mut marks) = (whole.clone(), all.clone());
        let dropped = crop(&mut face, &mut marks, "center.nose.tip", 40.0).unwrap();
        assert!((10..4000).contains(&face.points.len()));
        assert!(dropped.iter().any(|name| name.contains("chin")), "{dropped:?}");
        assert_eq!(marks.len() + dropped.len(), all.len());
        for mark in &marks {
            let before = all.iter().find(|other| other.name == mark.name).unwrap();
            assert_eq!(face.points[mark.vertex as usize], whole.points[before.vertex as usize]);
            assert_eq!(face.colors[mark.vertex as usize], whole.colors[before.vertex as usize]);
        }
        assert!(face.triangles.as_flattened().iter().all(|v| (*v as usize) < face.points.len()));
        let mut refused = |name: &str, radius, part: &str| {
            let error = crop(&mut face, &mut marks, name, radius).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        };
        refused("nose", 40.0, "there are ");
        refused("center.nose.tip", 1e-3, "give more millimetres");
    }
}
