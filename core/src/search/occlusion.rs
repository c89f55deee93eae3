//! Where a face is likely to be hidden, before the picture is seen.
//!
//! A point of the face is hidden with probability ε: that of the model's map, or, if it has none,
//! hardly within the face, mostly above the brows and at the sides, where hair is.

use super::vector::{Vec3, dot};
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
}

impl Hiding {
    pub(super) fn of(model: &Model<'_>) -> Self {
        let place = |name: &str| Some(model.shape.mean_at(model.landmark(name)? as usize));
        let face = || {
            let brows = model
                .landmarks()
                .filter(|(name, _)| contains(name, "eyebrow") && contains(name, "upper"))
                .map(|(_, vertex)| model.shape.mean_at(vertex as usize)[1])
                .reduce(math::more)?;
            let [left, right] = [place("left.eye.corner_outer")?, place("right.eye.corner_outer")?];
            Some([brows, 0.5 * (left[0] - right[0])])
        };
        Self { face: face().filter(|[_, eyes]| *eyes > 0.0) }
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
        let face = Hiding { face: Some([40.0, 44.0]) };
        assert_eq!(face.at([0.0, 0.0, 80.0]), INSIDE);
        assert_eq!(face.at([10.0, 44.0, 60.0]), INSIDE);
        assert_eq!(face.at([0.0, 70.0, 50.0]), HAIR);
        assert_eq!(face.at([75.0, 0.0, 0.0]), HAIR);
        assert_eq!(face.at([-75.0, 0.0, 0.0]), HAIR);
        let between = face.at([0.0, 52.5, 50.0]);
        assert!((between - 0.5 * (INSIDE + HAIR)).abs() < 1e-6, "{between}");
        assert_eq!(Hiding { face: None }.at([0.0, 200.0, 0.0]), ANYWHERE);
    }

    #[test]
    fn a_map_is_interpolated_and_never_quite_sure() {
        let map = [0, 255, 102];
        assert_eq!(mapped(&map, [0, 1, 2], [0.5, 0.25, 0.25]), 0.25 + 0.25 * 0.4);
        assert_eq!(mapped(&map, [0, 0, 0], [1.0, 0.0, 0.0]), SURE);
        assert_eq!(mapped(&map, [1, 1, 1], [1.0, 0.0, 0.0]), 1.0 - SURE);
    }
}
