//! Which points of MediaPipe's face mesh (Kartynnik et al. 2019) our landmarks are, and the JSON that
//! programs write which use it.
//!
//! A landmark is a weighted mean of points. Eyes, nose, lips and chin: where the template's landmarks lie
//! between the points of the mesh on its own frontal picture. Eyebrows, pupils, nostrils and folds: the
//! weights that come nearest to the landmarks on pictures of known truth (docs/landmarks.md).

use super::{Landmark2, Tlms};
use crate::error::{Error, Result};
use serde_json::Value;

/// Points of the mesh; with irises there are ten more.
const POINTS: usize = 468;
/// Coordinates of which none is farther from 0 are parts of the picture's sides, not pixels.
const PARTS: f32 = 4.0;
/// A mesh lies no deeper than this in a file.
const DEPTH: usize = 5;

/// A point of the mesh and its weight.
type Weighted = (u16, f32);
/// A landmark's name without its side, and what it is the mean of.
type NamedMean = (&'static str, &'static [Weighted]);

/// Landmarks of the middle of the face.
const CENTER: [NamedMean; 7] = [
    ("chin.tip", &[(152, 0.61), (175, 0.39)]),
    ("lips.lower.inner", &[(14, 0.98), (15, 0.02)]),
    ("lips.lower.outer", &[(17, 0.99), (18, 0.01)]),
    ("lips.upper.inner", &[(13, 1.09), (12, -0.09)]),
    ("lips.upper.outer", &[(0, 0.98), (164, 0.02)]),
    ("nose.attachement_to_philtrum", &[(2, 0.8), (164, 0.2)]),
    ("nose.tip", &[(4, 1.0)]),
];

/// Landmarks of the subject's right side.
const RIGHT: [NamedMean; 17] = [
    ("eye.bottom", &[(145, 0.74), (144, 0.38), (23, -0.12)]),
    ("eye.corner_inner", &[(133, 1.0)]),
    ("eye.corner_outer", &[(33, 1.0)]),
    ("eye.pupil.center", &[(159, 0.81), (121, 0.19)]),
    ("eye.top", &[(159, 0.89), (27, 0.1), (28, 0.01)]),
    ("eyebrow.bend.lower", &[(224, 0.66), (53, 0.34)]),
    ("eyebrow.bend.upper", &[(105, 0.83), (224, 0.17)]),
    ("eyebrow.inner_lower", &[(55, 0.82), (190, 0.18)]),
    ("eyebrow.inner_upper", &[(107, 0.73), (55, 0.27)]),
    ("eyebrow.outer", &[(70, 0.85), (124, 0.15)]),
    ("lips.corner", &[(61, 1.0)]),
    ("lips.philtrum_ridge", &[(37, 0.96), (164, 0.04)]),
    ("nasolabial_fold.bottom", &[(57, 0.85), (135, 0.15)]),
    ("nasolabial_fold.center", &[(216, 0.75), (165, 0.25)]),
    ("nose.hole.center", &[(60, 0.84), (59, 0.16)]),
    ("nose.wing.outer", &[(48, 0.64), (64, 0.33), (49, 0.03)]),
    ("nose.wing.tip", &[(98, 0.88), (203, 0.11), (129, 0.01)]),
];

/// Points of the right side that these are made of, and their mirror images.
const MIRROR: [(u16, u16); 31] = [
    (23, 253),
    (27, 257),
    (28, 258),
    (33, 263),
    (37, 267),
    (48, 278),
    (49, 279),
    (53, 283),
    (55, 285),
    (57, 287),
    (59, 289),
    (60, 290),
    (61, 291),
    (64, 294),
    (70, 300),
    (98, 327),
    (105, 334),
    (107, 336),
    (121, 350),
    (124, 353),
    (129, 358),
    (133, 362),
    (135, 364),
    (144, 373),
    (145, 374),
    (159, 386),
    (165, 391),
    (190, 414),
    (203, 423),
    (216, 436),
    (224, 444),
];

/// The point on the other side; those of the middle are their own.
fn mirrored(point: u16) -> u16 {
    MIRROR.iter().find(|(right, _)| *right == point).map_or(point, |(_, left)| *left)
}

impl Tlms {
    /// The landmarks of a face whose mesh is known, all visible: pixels, whole numbers at the centres of
    /// pixels. Those whose points are missing are left out.
    pub fn of_mesh(points: &[[f32; 2]]) -> Self {
        let mean = |weighted: &[Weighted], turn: fn(u16) -> u16| {
            let mut sum = [0.0; 2];
            for &(point, weight) in weighted {
                let [x, y] = *points.get(usize::from(turn(point)))?;
                sum = [sum[0] + weight * x, sum[1] + weight * y];
            }
            Some(sum)
        };
        let named = |side: &str, part: &str, [x, y]: [f32; 2]| Landmark2 {
            id: format!("{side}.{part}"),
            visible: true,
            x,
            y,
        };
        let side = |side: &'static str, all: &'static [NamedMean], turn: fn(u16) -> u16| {
            all.iter().filter_map(move |(part, w)| Some(named(side, part, mean(w, turn)?)))
        };
        let center = side("center", &CENTER, |point| point);
        let left = side("left", &RIGHT, mirrored);
        Self { landmarks: center.chain(left).chain(side("right", &RIGHT, |p| p)).collect() }
    }

    /// Parses what programs write that use MediaPipe's face mesh: JSON with an array of 468 or 478 points
    /// somewhere in it, each `{"x", "y", …}` or `[x, y, …]`, as parts of the picture's sides or in pixels
    /// from its corner. `size` is the picture's width and height.
    ///
    /// # Errors
    /// Malformed JSON (with line and column), no such array or several.
    pub fn parse_mesh(text: &str, size: [u32; 2]) -> Result<Self> {
        let value: Value = serde_json::from_str(text).map_err(Error::new)?;
        let mut meshes = Vec::new();
        collect(&value, DEPTH, &mut meshes);
        let [mesh] = &meshes[..] else {
            return Err(Error::new(format_args!(
                "{} meshes of a face (arrays of {POINTS} or more points with x and y), expected one",
                meshes.len()
            )));
        };
        let most = mesh.as_flattened().iter().fold(0.0_f32, |most, x| most.max(x.abs()));
        let sides = if most <= PARTS { size.map(|side| side as f32) } else { [1.0; 2] };
        let place = |[x, y]: &[f32; 2]| [x * sides[0] - 0.5, y * sides[1] - 0.5];
        Ok(Self::of_mesh(&mesh.iter().map(place).collect::<Vec<_>>()))
    }
}

/// The meshes in a value of JSON.
fn collect(value: &Value, depth: usize, meshes: &mut Vec<Vec<[f32; 2]>>) {
    let point = |value: &Value| {
        let number = |value: Option<&Value>| Some(value?.as_f64()? as f32);
        match value {
            Value::Object(fields) => Some([number(fields.get("x"))?, number(fields.get("y"))?]),
            Value::Array(all) => Some([number(all.first())?, number(all.get(1))?]),
            _ => None,
        }
    };
    if let Value::Array(all) = value
        && all.len() >= POINTS
        && let Some(mesh) = all.iter().map(point).collect()
    {
        meshes.push(mesh);
        return;
    }
    let inner: Vec<&Value> = match value {
        Value::Array(all) => all.iter().collect(),
        Value::Object(fields) => fields.values().collect(),
        _ => Vec::new(),
    };
    if depth > 0 {
        for value in inner {
            collect(value, depth - 1, meshes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_add_up_to_one_and_sides_are_mirror_images() {
        let all = Tlms::of_mesh(&[[3.0, 4.0]; POINTS]).landmarks;
        assert_eq!(all.len(), 41);
        for Landmark2 { id, x, y, .. } in &all {
            assert!((x - 3.0).abs() < 1e-5 && (y - 4.0).abs() < 1e-5, "{id}: {x} {y}");
        }
        let is_left = |point: usize| MIRROR.iter().any(|(_, left)| usize::from(*left) == point);
        let only_left: Vec<_> =
            (0..POINTS).map(|point| [f32::from(u8::from(is_left(point))), 0.0]).collect();
        for Landmark2 { id, x, .. } in &Tlms::of_mesh(&only_left).landmarks {
            let expected = if id.starts_with("left") { 0.9..1.13 } else { -0.01..0.01 };
            assert!(expected.contains(x), "{id}: {x}");
        }
    }

    #[test]
    fn json_of_any_program_is_read() {
        let objects: Vec<_> = (0..478)
            .map(|i| format!("{{\"x\": {}, \"y\": 0.25, \"z\": 0}}", i as f32 / 500.0))
            .collect();
        let pairs: Vec<_> = (0..468).map(|i| format!("[{}, 50]", 0.4 * i as f32)).collect();
        let (objects, pairs) = (objects.join(","), pairs.join(","));
        for text in [
            format!("[{objects}]"),
            format!("{{\"faceLandmarks\": [[{objects}]], \"faceBlendshapes\": []}}"),
            format!("{{\"multi_face_landmarks\": [{{\"landmark\": [{pairs}]}}]}}"),
        ] {
            let all = Tlms::parse_mesh(&text, [200, 200]).unwrap().landmarks;
            let tip = all.iter().find(|l| l.id == "center.nose.tip").unwrap();
            assert!((tip.x - 1.1).abs() < 1e-4 && (tip.y - 49.5).abs() < 1e-4, "{tip:?}");
        }
        let says = |text: &str, part: &str| {
            let message = Tlms::parse_mesh(text, [200, 200]).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        };
        says("[1, 2", "line 1");
        says("{}", "0 meshes");
        says(&format!("[[{pairs}], [{pairs}]]"), "2 meshes");
    }
}
