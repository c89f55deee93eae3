//! Named landmarks on a scan, from the files that landmark editors of 3D meshes write.

#[cfg(feature = "full")]
mod foreign;

use crate::error::{Error, Result};
#[cfg(feature = "full")]
use crate::files::{FileKind, read_text};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashSet};
#[cfg(feature = "full")]
use std::path::Path;

/// How far a landmark given by coordinates may lie from the nearest vertex, millimetres. Chosen, not measured.
pub const MAX_DISTANCE: f32 = 5.0;

/// A named vertex.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Landmark {
    /// Name, unique in its list and not empty.
    pub name: String,
    /// Vertex index, in range of the scan it was read for.
    pub vertex: u32,
}

/// A named point in space, as files of landmarks have it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Name.
    pub id: String,
    /// Where it is, in the unit of the mesh it belongs to.
    pub coordinates: [f64; 3],
    /// A description of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub description: Option<String>,
    /// How sure its place is, if that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<Uncertainty>,
}

/// How far a landmark may be from where it was marked: a normal distribution with the covariance
/// `Σ_k s_k²·v_k v_kᵀ`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Uncertainty {
    /// Standard deviations `s_k`, in the unit of the coordinates; not negative.
    pub stddevs: [f64; 3],
    /// Directions `v_k`.
    pub pcvectors: [[f64; 3]; 3],
}

impl Uncertainty {
    /// The covariance.
    pub fn covariance(&self) -> [[f64; 3]; 3] {
        let Self { stddevs: s, pcvectors: v } = self;
        let entry = |i: usize, j: usize| (0..3).map(|k| s[k] * s[k] * v[k][i] * v[k][j]).sum();
        std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)))
    }

    fn is_valid(&self) -> bool {
        self.stddevs.iter().all(|s| s.is_finite() && *s >= 0.0)
            && self.pcvectors.as_flattened().iter().all(|v| v.is_finite())
    }
}

/// An entry of the file; further keys are ignored.
#[derive(Deserialize)]
struct Entry {
    id: String,
    vertex: Option<u64>,
    coordinates: Option<[f64; 3]>,
    uncertainty: Option<Uncertainty>,
}

fn entries(text: &str) -> Result<Vec<Entry>> {
    serde_json::from_str(text).map_err(|e| {
        Error::new(format_args!("{e}; landmarks are a JSON array of {{\"id\", \"vertex\"}}"))
    })
}

/// Reads a landmark file for a scan: JSON as [`parse`] takes it, MeshLab's picked points (`.pp`), or 3D
/// Slicer's (`.mrk.json`, `.fcsv`). Slicer may have x and y of the other sign, by its settings: whichever
/// is nearer to the scan is taken.
///
/// # Errors
/// When the file cannot be read, and those of [`parse`]; they name the file.
#[cfg(feature = "full")]
pub fn read(path: &Path, points: &[[f32; 3]], millimetres: f32) -> Result<Vec<Landmark>> {
    read_moved(path, points, [0.0; 3], millimetres)
}

/// The same as [`read`] for a scan from whose coordinates `origin` was subtracted: it is subtracted from the
/// landmarks' coordinates, too.
///
/// # Errors
/// See [`read`].
#[cfg(feature = "full")]
pub fn read_moved(
    path: &Path,
    points: &[[f32; 3]],
    origin: [f64; 3],
    millimetres: f32,
) -> Result<Vec<Landmark>> {
    let text = read_text(path).map_err(|e| FileKind::ScanLandmarks.misplaced(path).unwrap_or(e))?;
    let read = || {
        let Some(foreign) = foreign::points(path, &text) else {
            return place(&entries(&text)?, points, origin, millimetres);
        };
        let foreign = checked(foreign?)?;
        let put = |sign: f64| {
            let entry = |Point { id, coordinates: [x, y, z], .. }: &Point| Entry {
                id: id.clone(),
                vertex: None,
                coordinates: Some([sign * x, sign * y, *z]),
                uncertainty: None,
            };
            place(&foreign.iter().map(entry).collect::<Vec<_>>(), points, origin, millimetres)
        };
        put(1.0).or_else(|e| put(-1.0).map_err(|_| e))
    };
    read().map_err(|e| FileKind::ScanLandmarks.or_misplaced(path, e))
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
    place(&entries(text)?, points, [0.0; 3], millimetres)
}

/// The vertices of entries, from whose coordinates `origin` is to be subtracted.
fn place(
    entries: &[Entry],
    points: &[[f32; 3]],
    origin: [f64; 3],
    millimetres: f32,
) -> Result<Vec<Landmark>> {
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
                let at = std::array::from_fn(|i| (at[i] - origin[i]) as f32);
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

/// Reads the uncertainties of a landmark file; other programs' have none.
///
/// # Errors
/// When the file cannot be read, and those of [`uncertainties`]; they name the file.
#[cfg(feature = "full")]
pub fn read_uncertainties(path: &Path) -> Result<BTreeMap<String, Uncertainty>> {
    let text = read_text(path).map_err(|e| FileKind::ScanLandmarks.misplaced(path).unwrap_or(e))?;
    if foreign::points(path, &text).is_some() {
        return Ok(BTreeMap::new());
    }
    uncertainties(&text).map_err(|e| Error::file(path, e))
}

/// The uncertainties in a text that [`parse`] takes, by landmark; landmarks without one are left out.
///
/// # Errors
/// Malformed JSON; standard deviations that are negative, numbers that are not finite.
pub fn uncertainties(text: &str) -> Result<BTreeMap<String, Uncertainty>> {
    let mut known = BTreeMap::new();
    for entry in entries(text)? {
        let Some(uncertainty) = entry.uncertainty else { continue };
        if !uncertainty.is_valid() {
            return Err(uncertain(&entry.id));
        }
        known.insert(entry.id, uncertainty);
    }
    Ok(known)
}

fn uncertain(id: &str) -> Error {
    Error::new(format_args!(
        "landmark {id:?}: its uncertainty is negative or not finite; correct or delete it"
    ))
}

/// Reads points of a landmark file, of the kinds that [`read`] takes; their coordinates are as they stand.
///
/// # Errors
/// When the file cannot be read, and those of [`parse_points`]; they name the file.
#[cfg(feature = "full")]
pub fn read_points(path: &Path) -> Result<Vec<Point>> {
    let text = read_text(path).map_err(|e| FileKind::ScanLandmarks.misplaced(path).unwrap_or(e))?;
    let points = match foreign::points(path, &text) {
        Some(points) => points.and_then(checked),
        None => parse_points(&text),
    };
    points.map_err(|e| FileKind::ScanLandmarks.or_misplaced(path, e))
}

/// Parses points: a JSON array of `{"id", "coordinates": [x, y, z], "description"?,
/// "uncertainty"?: {"stddevs": [3], "pcvectors": [[3]; 3]}}`.
///
/// # Errors
/// Malformed JSON, empty or repeated names, numbers that are not finite.
pub fn parse_points(text: &str) -> Result<Vec<Point>> {
    let points: Vec<Point> = serde_json::from_str(text).map_err(|e| {
        Error::new(format_args!("{e}; landmarks are a JSON array of {{\"id\", \"coordinates\"}}"))
    })?;
    checked(points)
}

/// Parses points as lines of `id visible x y z`; those that are not visible are left out.
///
/// # Errors
/// Naming the line: another number of fields, a number that is none; and as [`parse_points`].
pub fn parse_lines(text: &str) -> Result<Vec<Point>> {
    let mut points = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let fields: Vec<&str> = line.split_whitespace().collect();
        if fields.is_empty() {
            continue;
        }
        let fault = || {
            let found: String = line.chars().take(60).collect();
            Error::new(format_args!("line {number}: `{found}`, expected `id visible x y z`"))
        };
        let &[id, visible, x, y, z] = &fields[..] else { return Err(fault()) };
        let visible = visible.parse::<i64>().map_err(|_| fault())? > 0;
        let mut coordinates = [0.0; 3];
        for (to, from) in coordinates.iter_mut().zip([x, y, z]) {
            *to = from.parse::<f32>().map(f64::from).map_err(|_| fault())?;
        }
        if visible {
            let id = id.to_string();
            points.push(Point { id, coordinates, description: None, uncertainty: None });
        }
    }
    checked(points)
}

fn checked(points: Vec<Point>) -> Result<Vec<Point>> {
    let mut names = HashSet::new();
    for Point { id, coordinates, uncertainty, .. } in &points {
        if id.is_empty() || !names.insert(id) {
            return Err(Error::new(format_args!(
                "landmark {id:?}: the name is empty or taken; names must be unique"
            )));
        }
        if !coordinates.iter().all(|x| x.is_finite()) {
            return Err(Error::new(format_args!(
                "landmark {id:?}: coordinates {coordinates:?} are not finite"
            )));
        }
        if uncertainty.is_some_and(|u| !u.is_valid()) {
            return Err(uncertain(id));
        }
    }
    Ok(points)
}

/// The points as text for [`parse_points`], with all digits that tell their numbers from others.
pub fn to_json(points: &[Point]) -> String {
    // Names and finite numbers cannot fail.
    serde_json::to_string(points).unwrap_or_default()
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
    #[cfg(feature = "full")]
    fn other_programs_points_are_put_on_vertices() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("x.fcsv");
        for sign in [1, -1] {
            let lines = format!(
                "1,{},0,0,0,0,0,1,1,1,0,a\n2,0,{},0.5,0,0,0,1,1,1,0,b\n",
                sign * 10,
                sign * 9
            );
            std::fs::write(&path, lines).unwrap();
            let found = read(&path, &POINTS, 1.0).unwrap();
            let found: Vec<_> = found.iter().map(|l| (l.name.as_str(), l.vertex)).collect();
            assert_eq!(found, [("a", 1), ("b", 2)]);
        }
        std::fs::write(&path, "1,50,0,0,0,0,0,1,1,1,0,a\n").unwrap();
        let message = read(&path, &POINTS, 1.0).unwrap_err().to_string();
        assert!(
            message.contains("x.fcsv: landmark 0 (\"a\"): the nearest vertex is 40.0 mm away"),
            "{message}"
        );
        assert_eq!(read_points(&path).unwrap()[0].coordinates, [50.0, 0.0, 0.0]);
        assert!(read_uncertainties(&path).unwrap().is_empty());
    }

    #[test]
    fn points_keep_their_uncertainty() {
        let text = r#"[{"id": "a", "coordinates": [0.1, -2, 3e-7], "description": "tip",
            "uncertainty": {"stddevs": [1, 2, 0.5],
                            "pcvectors": [[1, 0, 0], [0, 0.6, 0.8], [0, -0.8, 0.6]]}},
            {"id": "b", "coordinates": [1, 2, 3], "other": true}]"#;
        let points = parse_points(text).unwrap();
        assert_eq!(parse_points(&to_json(&points)).unwrap(), points);
        let covariance = points[0].uncertainty.unwrap().covariance();
        let expected = [[1.0, 0.0, 0.0], [0.0, 1.6, 1.8], [0.0, 1.8, 2.65]];
        for (found, expected) in covariance.as_flattened().iter().zip(expected.as_flattened()) {
            assert!((found - expected).abs() < 1e-12, "{covariance:?}");
        }
        let known = uncertainties(text).unwrap();
        assert_eq!(
            known.into_iter().collect::<Vec<_>>(),
            [("a".into(), points[0].uncertainty.unwrap())]
        );
        let negative = text.replace("[1, 2, 0.5]", "[1, -2, 0.5]");
        assert!(parse_points(&negative).is_err() && uncertainties(&negative).is_err());
    }

    #[test]
    fn points_are_read_from_lines() {
        let points = parse_lines("a 1 0.5 -1e2 3\n\nb 0 1 2 3\r\n").unwrap();
        assert_eq!(points.len(), 1);
        assert_eq!(points[0].coordinates, [0.5, -100.0, 3.0]);
        for (text, part) in [
            ("a 1 2 3", "line 1"),
            ("a 1 2 3 4\nb 1 x 3 4", "line 2"),
            ("a yes 2 3 4", "`id visible x y z`"),
            ("a 1 2 3 nan", "not finite"),
            ("a 1 2 3 4\na 1 2 3 4", "must be unique"),
        ] {
            let message = parse_lines(text).unwrap_err().to_string();
            assert!(message.contains(part), "{message:?} does not say {part:?}");
        }
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
        let [a, b] = &parse_points(text).unwrap()[..] else { panic!("two of them") };
        assert_eq!((a.coordinates, a.uncertainty), ([1.0, 2.0, 3.0], None));
        let covariance = b.uncertainty.map(|u| u.covariance());
        assert_eq!(covariance, Some([[1.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 9.0]]));
        for (text, part) in [
            (r#"[{"id": "a", "vertex": 3}]"#, "missing field `coordinates`"),
            (r#"[{"id": "", "coordinates": [0, 0, 0]}]"#, "landmark \"\": the name"),
            (r#"[{"id": "a", "coordinates": [1e999, 0, 0]}]"#, "line 1"),
        ] {
            let message = parse_points(text).unwrap_err().to_string();
            assert!(message.contains(part), "{message:?} does not say {part:?}");
        }
    }
}
