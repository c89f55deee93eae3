//! Named landmarks on a scan, from the JSON that landmark editors of 3D meshes write.

use crate::error::{Error, Result};
use serde::Deserialize;
use std::collections::HashSet;
use std::path::Path;

/// How far a landmark given by coordinates may lie from the nearest vertex, millimetres.
pub const MAX_DISTANCE: f32 = 5.0;

/// A named vertex.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Landmark {
    /// Name, unique in its list and not empty.
    pub name: String,
    /// Vertex index, in range of the scan it was read for.
    pub vertex: u32,
}

/// An entry of the file; further keys (`description`, `uncertainty`) are ignored.
#[derive(Deserialize)]
struct Entry {
    id: String,
    vertex: Option<u64>,
    coordinates: Option<[f32; 3]>,
}

/// Reads a landmark file for a scan.
///
/// # Errors
/// When the file cannot be read, and those of [`parse`]; they name the file.
pub fn read(path: &Path, points: &[[f32; 3]], millimetres: f32) -> Result<Vec<Landmark>> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::file(path, e))?;
    parse(&text, points, millimetres).map_err(|e| Error::file(path, e))
}

/// Parses landmarks: a JSON array of `{"id", "vertex"?, "coordinates": [x, y, z]?, …}`.
///
/// A `vertex` indexes `points`, the vertices of the scan. Without one the vertex nearest to
/// `coordinates` is taken, which are in the unit of `points`, `millimetres` long.
///
/// # Errors
/// Malformed JSON (with line and column), empty or repeated names, a vertex out of range,
/// coordinates that are not finite or farther than [`MAX_DISTANCE`] from every vertex.
pub fn parse(text: &str, points: &[[f32; 3]], millimetres: f32) -> Result<Vec<Landmark>> {
    let entries: Vec<Entry> = serde_json::from_str(text).map_err(|e| {
        Error::new(format_args!("{e}; landmarks are a JSON array of {{\"id\", \"vertex\"}}"))
    })?;
    let mut names = HashSet::new();
    let mut landmarks = Vec::new();
    for (i, entry) in entries.iter().enumerate() {
        let fault = |what: &dyn std::fmt::Display| {
            Error::new(format_args!("landmark {i} ({:?}): {what}", entry.id))
        };
        if entry.id.is_empty() || !names.insert(&entry.id) {
            return Err(fault(&"the name is empty or taken; names must be unique"));
        }
        let vertex = match (entry.vertex, entry.coordinates) {
            (Some(vertex), _) => usize::try_from(vertex).unwrap_or(usize::MAX),
            (None, Some(at)) => {
                let (vertex, distance) = nearest(points, at);
                let distance = distance * millimetres;
                // Not `>`: a distance that is not a number is too far as well.
                if !(distance <= MAX_DISTANCE) {
                    return Err(fault(&format_args!(
                        "the nearest vertex is {distance:.1} mm away, more than {MAX_DISTANCE} mm; \
                         are these the landmarks of this scan, in its unit?"
                    )));
                }
                vertex
            }
            (None, None) => return Err(fault(&"give a vertex or coordinates")),
        };
        if vertex >= points.len() {
            return Err(fault(&format_args!(
                "vertex {vertex} is out of range, the scan has {}",
                points.len()
            )));
        }
        landmarks.push(Landmark { name: entry.id.clone(), vertex: vertex as u32 });
    }
    Ok(landmarks)
}

/// Where a landmark is.
#[derive(Clone, Debug, PartialEq)]
pub struct Position {
    /// Name, unique in its list and not empty.
    pub name: String,
    /// Millimetres, finite.
    pub at: [f64; 3],
    /// Covariance of its error, mm²; none if the file does not say.
    pub covariance: Option<[[f64; 3]; 3]>,
}

/// An entry of a file of positions.
#[derive(Deserialize)]
struct PositionEntry {
    id: String,
    coordinates: [f64; 3],
    uncertainty: Option<Uncertainty>,
}

/// Standard deviations along orthonormal directions.
#[derive(Deserialize)]
struct Uncertainty {
    stddevs: [f64; 3],
    pcvectors: [[f64; 3]; 3],
}

/// Reads where landmarks are.
///
/// # Errors
/// When the file cannot be read, and those of [`parse_positions`]; they name the file.
pub fn read_positions(path: &Path) -> Result<Vec<Position>> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::file(path, e))?;
    parse_positions(&text).map_err(|e| Error::file(path, e))
}

/// Parses positions, millimetres: a JSON array of `{"id", "coordinates": [x, y, z], "uncertainty"?}`.
/// An uncertainty is `{"stddevs": [s₁, s₂, s₃], "pcvectors": [v₁, v₂, v₃]}`, vectors of three; it
/// stands for the covariance `Σ s² v vᵀ`.
///
/// # Errors
/// Malformed JSON (with line and column), empty or repeated names, numbers that are not finite.
pub fn parse_positions(text: &str) -> Result<Vec<Position>> {
    let entries: Vec<PositionEntry> = serde_json::from_str(text).map_err(|e| {
        Error::new(format_args!("{e}; positions are a JSON array of {{\"id\", \"coordinates\"}}"))
    })?;
    let mut names = HashSet::new();
    let mut positions = Vec::new();
    for (i, entry) in entries.iter().enumerate() {
        let fault = |what: &str| Error::new(format_args!("landmark {i} ({:?}): {what}", entry.id));
        if entry.id.is_empty() || !names.insert(&entry.id) {
            return Err(fault("the name is empty or taken; names must be unique"));
        }
        let covariance = entry.uncertainty.as_ref().map(|Uncertainty { stddevs, pcvectors }| {
            let term = |k: usize, i: usize, j: usize| {
                stddevs[k] * stddevs[k] * pcvectors[k][i] * pcvectors[k][j]
            };
            std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| term(k, i, j)).sum()))
        });
        let numbers = covariance.iter().flatten().flatten().chain(&entry.coordinates);
        if !numbers.copied().all(f64::is_finite) {
            return Err(fault("a number is too large"));
        }
        positions.push(Position { name: entry.id.clone(), at: entry.coordinates, covariance });
    }
    Ok(positions)
}

/// The point nearest to `at` and its distance; infinitely far if there is none.
fn nearest(points: &[[f32; 3]], at: [f32; 3]) -> (usize, f32) {
    let mut best = (0, f32::INFINITY);
    for (i, p) in points.iter().enumerate() {
        let squared = (0..3).map(|k| (p[k] - at[k]) * (p[k] - at[k])).sum::<f32>();
        if squared < best.1 {
            best = (i, squared);
        }
    }
    (best.0, best.1.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    const POINTS: [[f32; 3]; 3] = [[0.0; 3], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0]];

    #[test]
    fn by_vertex_or_by_the_nearest_one() {
        let text = r#"[{"id": "a", "vertex": 2, "coordinates": [9, 9, 9], "extra": null},
                       {"id": "b", "coordinates": [9.0, 1.0, 0.0]}]"#;
        let landmarks = parse(text, &POINTS, 1.0).unwrap();
        let found: Vec<_> = landmarks.iter().map(|l| (l.name.as_str(), l.vertex)).collect();
        assert_eq!(found, [("a", 2), ("b", 1)]);
    }

    #[test]
    fn faults_name_the_landmark() {
        for (text, part) in [
            ("[{\"id\": 3}]", "line 1"),
            (r#"[{"id": "a", "vertex": 3}]"#, "vertex 3 is out of range, the scan has 3"),
            (r#"[{"id": "a", "vertex": 0}, {"id": "a", "vertex": 1}]"#, "landmark 1 (\"a\")"),
            (r#"[{"id": "a"}]"#, "give a vertex or coordinates"),
            (r#"[{"id": "a", "coordinates": [10, 0, 1]}]"#, "is 10.0 mm away"),
            (r#"[{"id": "a", "coordinates": [1e30, 0, 0]}]"#, "mm away"),
        ] {
            let message = parse(text, &POINTS, 10.0).unwrap_err().to_string();
            assert!(message.contains(part), "{message:?} does not say {part:?}");
        }
    }

    #[test]
    fn positions_carry_their_uncertainty() {
        let text = r#"[{"id": "a", "coordinates": [1, 2, 3]},
                       {"id": "b", "coordinates": [0, 0, 0], "uncertainty":
                        {"stddevs": [2, 1, 3], "pcvectors": [[0, 1, 0], [1, 0, 0], [0, 0, 1]]}}]"#;
        let [a, b] = &parse_positions(text).unwrap()[..] else { panic!("two of them") };
        assert_eq!((a.at, a.covariance), ([1.0, 2.0, 3.0], None));
        assert_eq!(b.covariance, Some([[1.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 9.0]]));
        for (text, part) in [
            (r#"[{"id": "a", "vertex": 3}]"#, "missing field `coordinates`"),
            (r#"[{"id": "", "coordinates": [0, 0, 0]}]"#, "landmark 0 (\"\"): the name"),
            (r#"[{"id": "a", "coordinates": [1e999, 0, 0]}]"#, "line 1"),
        ] {
            let message = parse_positions(text).unwrap_err().to_string();
            assert!(message.contains(part), "{message:?} does not say {part:?}");
        }
    }
}
