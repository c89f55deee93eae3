//! Where a face is likely to be hidden, before the picture is seen.
//!
//! A point of the face is hidden with probability ε: that of the model's map, or, if it has none,
//! hardly within the face, mostly above the brows and at the sides, where hair is.
//!
//! Eyes are of any colour, and gloss; only what is around them tells whether they are seen. Once the
//! face has been found in the blurred photo, eyes whose surroundings are seen are never hidden.

use crate::math;
use crate::model::Model;
use crate::vector::{Vec3, add, dot, scale, sub};

/// ε within the face. These numbers were chosen, not measured, up to [`ANYWHERE`].
const INSIDE: f32 = 0.02;
/// ε where hair is likely.
const HAIR: f32 = 0.8;
/// Where it begins to grow: mm above the brows' upper edge, and the mm over which it does.
const ABOVE_BROWS: [f32; 2] = [5.0, 15.0];
/// The same sideways, in units of the distance of the eyes' outer corners from the middle.
const SIDEWAYS: [f32; 2] = [1.31, 0.27];
/// Half the width and height of an eye, in units of half the distance of its corners.
const EYE: [f32; 2] = [1.1, 0.55];
/// How far its surroundings reach, in units of its own size.
const AROUND: f32 = 1.8;
/// ε of a model without these landmarks.
const ANYWHERE: f32 = 0.1;
/// ε of what is certainly hidden, see [`fill`].
pub(super) const WHOLE: f32 = 255.0;
/// That of a vertex that is never hidden.
pub(super) const NEVER: u8 = 0;

/// Fills in ε of every vertex, in units of 1 / [`WHOLE`].
pub(super) fn fill(model: &Model<'_>, hidden: &mut [u8]) {
    let face = Face::of(model);
    for (vertex, hidden) in hidden.iter_mut().enumerate() {
        *hidden = match (model.occlusion(), face) {
            (Some(map), _) => mapped(map.get(vertex).copied()),
            (None, Some(face)) => quantised(face.hidden(model.shape.mean_at(vertex))),
            (None, None) => quantised(ANYWHERE),
        };
    }
}

/// That of a map, which may always be wrong.
fn mapped(hidden: Option<u8>) -> u8 {
    hidden.map_or(128, |hidden| hidden.clamp(1, 254))
}

fn quantised(hidden: f32) -> u8 {
    (WHOLE * hidden + 0.5) as u8
}

/// Where a face has its brows and eyes.
#[derive(Clone, Copy, Debug)]
struct Face {
    /// Height of the brows' upper edge.
    brows: f32,
    /// Half the distance of the eyes' outer corners.
    eyes: f32,
}

impl Face {
    /// `None` of a model that has not the landmarks of a face.
    fn of(model: &Model<'_>) -> Option<Self> {
        let brows = model
            .landmarks()
            .filter(|(name, _)| contains(name, "eyebrow") && contains(name, "upper"))
            .map(|(_, vertex)| model.shape.mean_at(vertex as usize)[1])
            .reduce(math::more)?;
        let [left, _, _] = place(model, "left.eye.corner_outer")?;
        let [right, _, _] = place(model, "right.eye.corner_outer")?;
        let eyes = 0.5 * (left - right);
        (eyes > 0.0).then_some(Self { brows, eyes })
    }

    /// ε at a point of the mean face.
    fn hidden(self, [x, y, _]: Vec3) -> f32 {
        let ramp = |x: f32, [start, width]: [f32; 2]| ((x - start) / width).clamp(0.0, 1.0);
        let above = ramp(y - self.brows, ABOVE_BROWS);
        let side = if x < 0.0 { -x } else { x };
        let beside = ramp(side / self.eyes, SIDEWAYS);
        INSIDE + (HAIR - INSIDE) * math::more(above, beside)
    }
}

/// A landmark's place on the mean face.
fn place(model: &Model<'_>, name: &str) -> Option<Vec3> {
    Some(model.shape.mean_at(model.landmark(name)? as usize))
}

/// An eye of the mean face.
#[derive(Clone, Copy, Debug)]
pub(super) struct Eye {
    middle: Vec3,
    /// Half the distance of its corners.
    half: f32,
}

/// The eyes of a model that has their corners.
pub(super) fn eyes(model: &Model<'_>) -> [Option<Eye>; 2] {
    let corners = [
        ["left.eye.corner_inner", "left.eye.corner_outer"],
        ["right.eye.corner_inner", "right.eye.corner_outer"],
    ];
    corners.map(|[inner, outer]| {
        let [inner, outer] = [place(model, inner)?, place(model, outer)?];
        let across = sub(outer, inner);
        let half = 0.5 * math::sqrt(dot(across, across));
        Some(Eye { middle: scale(add(inner, outer), 0.5), half })
    })
}

impl Eye {
    /// Square of a point's distance from the middle: 1 on the border.
    fn distance(&self, [x, y, _]: Vec3) -> f32 {
        let [dx, dy] = [x - self.middle[0], y - self.middle[1]];
        let [x, y] = [dx / (EYE[0] * self.half), dy / (EYE[1] * self.half)];
        x * x + y * y
    }

    /// Whether a point of the mean face belongs to it.
    pub(super) fn holds(&self, point: Vec3) -> bool {
        self.distance(point) < 1.0
    }

    /// Whether a point is next to it.
    pub(super) fn is_near(&self, point: Vec3) -> bool {
        (1.0..AROUND * AROUND).contains(&self.distance(point))
    }
}

/// Like `str`'s own, which is quicker, larger, and has paths to a panic.
fn contains(name: &str, word: &str) -> bool {
    let starts = 0..=name.len().saturating_sub(word.len());
    starts.into_iter().any(|start| {
        name.as_bytes().get(start..).is_some_and(|rest| rest.starts_with(word.as_bytes()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hair_is_expected_above_the_brows_and_at_the_sides() {
        let face = Face { brows: 40.0, eyes: 44.0 };
        assert_eq!(face.hidden([0.0, 0.0, 80.0]), INSIDE);
        assert_eq!(face.hidden([10.0, 44.0, 60.0]), INSIDE);
        assert_eq!(face.hidden([0.0, 70.0, 50.0]), HAIR);
        assert_eq!(face.hidden([75.0, 0.0, 0.0]), HAIR);
        assert_eq!(face.hidden([-75.0, 0.0, 0.0]), HAIR);
        let between = face.hidden([0.0, 52.5, 50.0]);
        assert!((between - 0.5 * (INSIDE + HAIR)).abs() < 1e-6, "{between}");
    }

    #[test]
    fn a_map_is_never_quite_sure() {
        assert_eq!([Some(0), Some(102), Some(255), None].map(mapped), [1, 102, 254, 128]);
    }

    #[test]
    fn an_eye_is_wider_than_high_and_so_is_what_is_around() {
        let eye = Eye { middle: [30.0, 30.0, 0.0], half: 10.0 };
        let [inside, around, far] = [[38.0, 31.0, 0.0], [44.0, 30.0, 0.0], [30.0, 41.0, 0.0]];
        assert!(eye.holds(inside) && !eye.holds(around) && !eye.holds(far));
        assert!(!eye.is_near(inside) && eye.is_near(around) && !eye.is_near(far));
    }
}
