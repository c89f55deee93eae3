//! Where a face is likely to be hidden, before the picture is seen.
//!
//! A point of the face is hidden with probability ε: that of the model's map, or, if it has none,
//! hardly within the face, mostly above the brows and at the sides, where hair is.
//!
//! Eyes are of any colour, and gloss; only what is around them tells whether they are seen. Once the
//! face has been found in the blurred photo, eyes whose surroundings are seen are never hidden.

use super::vector::{Vec3, add, dot, scale, sub};
use crate::math;
use crate::model::Model;

/// ε within the face.
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
/// The nearest to 0 and 1 that a map's ε comes: the photo may always say otherwise.
const SURE: f32 = 0.002;

/// Prior probability that a point is hidden, by its place on the mean face.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hiding {
    /// Height of the brows and half the distance of the eyes' outer corners; `None` of a model
    /// that has not the landmarks of a face.
    face: Option<[f32; 2]>,
    /// `None` of a model that has not the corners.
    eyes: [Option<Eye>; 2],
}

/// An eye of the mean face.
#[derive(Clone, Copy, Debug)]
struct Eye {
    middle: Vec3,
    /// Half the distance of its corners.
    half: f32,
    /// Whether it is known to be seen.
    seen: bool,
}

impl Eye {
    fn of(model: &Model<'_>, [inner, outer]: [&str; 2]) -> Option<Self> {
        let [inner, outer] = [place(model, inner)?, place(model, outer)?];
        let across = sub(outer, inner);
        let half = 0.5 * math::sqrt(dot(across, across));
        Some(Self { middle: scale(add(inner, outer), 0.5), half, seen: false })
    }

    /// Square of a point's distance from the middle: 1 on the border.
    fn distance(&self, [x, y, _]: Vec3) -> f32 {
        let [dx, dy] = [x - self.middle[0], y - self.middle[1]];
        let [x, y] = [dx / (EYE[0] * self.half), dy / (EYE[1] * self.half)];
        x * x + y * y
    }
}

/// A landmark's place on the mean face.
fn place(model: &Model<'_>, name: &str) -> Option<Vec3> {
    Some(model.shape.mean_at(model.landmark(name)? as usize))
}

impl Hiding {
    pub(super) fn of(model: &Model<'_>) -> Self {
        let face = || {
            let brows = model
                .landmarks()
                .filter(|(name, _)| contains(name, "eyebrow") && contains(name, "upper"))
                .map(|(_, vertex)| model.shape.mean_at(vertex as usize)[1])
                .reduce(math::more)?;
            let [left, right] =
                [place(model, "left.eye.corner_outer")?, place(model, "right.eye.corner_outer")?];
            Some([brows, 0.5 * (left[0] - right[0])])
        };
        let eyes = [
            ["left.eye.corner_inner", "left.eye.corner_outer"],
            ["right.eye.corner_inner", "right.eye.corner_outer"],
        ];
        Self {
            face: face().filter(|[_, eyes]| *eyes > 0.0),
            eyes: eyes.map(|corners| Eye::of(model, corners)),
        }
    }

    /// Decides which eyes are seen: those around which most is, of points of the mean face and the
    /// probabilities that these are seen.
    pub(super) fn look_at_eyes(&mut self, points: impl Iterator<Item = (Vec3, f32)> + Clone) {
        for eye in self.eyes.iter_mut().flatten() {
            let around = points.clone().filter(|(point, _)| {
                let distance = eye.distance(*point);
                distance >= 1.0 && distance < AROUND * AROUND
            });
            eye.seen = around.map(|(_, seen)| seen - 0.5).sum::<f32>() > 0.0;
        }
    }

    /// Whether a point belongs to an eye that is known to be seen.
    pub(super) fn in_seen_eye(&self, point: Vec3) -> bool {
        self.eyes.iter().flatten().any(|eye| eye.seen && eye.distance(point) < 1.0)
    }

    /// ε at a point of the mean face.
    pub(super) fn at(&self, [x, y, _]: Vec3) -> f32 {
        let Some([brows, eyes]) = self.face else { return ANYWHERE };
        let ramp = |x: f32, [start, width]: [f32; 2]| ((x - start) / width).clamp(0.0, 1.0);
        let above = ramp(y - brows, ABOVE_BROWS);
        let side = if x < 0.0 { -x } else { x };
        let beside = ramp(side / eyes, SIDEWAYS);
        INSIDE + (HAIR - INSIDE) * math::more(above, beside)
    }
}

/// ε of a model's map at a point of a triangle; 0.5 of one it does not have.
pub(super) fn mapped(map: &[u8], corners: [usize; 3], weights: Vec3) -> f32 {
    let at = |v: usize| map.get(v).map_or(0.5, |&e| f32::from(e) / 255.0);
    dot(corners.map(at), weights).clamp(SURE, 1.0 - SURE)
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
        let face = Hiding { face: Some([40.0, 44.0]), eyes: [None; 2] };
        assert_eq!(face.at([0.0, 0.0, 80.0]), INSIDE);
        assert_eq!(face.at([10.0, 44.0, 60.0]), INSIDE);
        assert_eq!(face.at([0.0, 70.0, 50.0]), HAIR);
        assert_eq!(face.at([75.0, 0.0, 0.0]), HAIR);
        assert_eq!(face.at([-75.0, 0.0, 0.0]), HAIR);
        let between = face.at([0.0, 52.5, 50.0]);
        assert!((between - 0.5 * (INSIDE + HAIR)).abs() < 1e-6, "{between}");
        let other = Hiding { face: None, eyes: [None; 2] };
        assert_eq!(other.at([0.0, 200.0, 0.0]), ANYWHERE);
    }

    #[test]
    fn an_eye_is_seen_if_most_around_it_is() {
        let eye = Eye { middle: [30.0, 30.0, 0.0], half: 10.0, seen: false };
        let mut hiding = Hiding { face: None, eyes: [Some(eye), None] };
        let (inside, around, far) = ([38.0, 31.0, 0.0], [44.0, 30.0, 0.0], [30.0, 50.0, 0.0]);
        for (points, seen) in [
            ([(inside, 0.0), (around, 0.9), (around, 0.3)], true),
            ([(inside, 1.0), (around, 0.9), (around, 0.0)], false),
            ([(inside, 1.0), (far, 1.0), (far, 1.0)], false),
        ] {
            hiding.look_at_eyes(points.into_iter());
            assert_eq!(hiding.in_seen_eye(inside), seen, "{points:?}");
            assert!(!hiding.in_seen_eye(around));
        }
    }

    #[test]
    fn a_map_is_interpolated_and_never_quite_sure() {
        let map = [0, 255, 102];
        assert_eq!(mapped(&map, [0, 1, 2], [0.5, 0.25, 0.25]), 0.25 + 0.25 * 0.4);
        assert_eq!(mapped(&map, [0, 0, 0], [1.0, 0.0, 0.0]), SURE);
        assert_eq!(mapped(&map, [1, 1, 1], [1.0, 0.0, 0.0]), 1.0 - SURE);
    }
}
