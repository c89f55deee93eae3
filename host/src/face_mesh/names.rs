//! Which points of the face mesh our landmarks are.
//!
//! A landmark is a weighted mean of points. Eyes, nose, lips and chin: where the template's landmarks lie
//! between the points of the mesh on its own frontal picture. Eyebrows, pupils, nostrils and folds: the
//! weights that come nearest to the landmarks on pictures of known truth (docs/landmarks.md).

/// A point of the mesh and its weight.
type Weighted = (u16, f32);

/// Landmarks of the middle of the face.
const CENTER: [(&str, &[Weighted]); 7] = [
    ("chin.tip", &[(152, 0.61), (175, 0.39)]),
    ("lips.lower.inner", &[(14, 0.98), (15, 0.02)]),
    ("lips.lower.outer", &[(17, 0.99), (18, 0.01)]),
    ("lips.upper.inner", &[(13, 1.09), (12, -0.09)]),
    ("lips.upper.outer", &[(0, 0.98), (164, 0.02)]),
    ("nose.attachement_to_philtrum", &[(2, 0.8), (164, 0.2)]),
    ("nose.tip", &[(4, 1.0)]),
];

/// Landmarks of the subject's right side.
const RIGHT: [(&str, &[Weighted]); 17] = [
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

/// Every landmark's name and place, given the points of a mesh; those whose points are missing are left
/// out.
pub(super) fn places(points: &[[f32; 2]]) -> Vec<(String, [f32; 2])> {
    let mean = |weighted: &[Weighted], turn: fn(u16) -> u16| {
        let mut sum = [0.0; 2];
        for &(point, weight) in weighted {
            let [x, y] = *points.get(usize::from(turn(point)))?;
            sum = [sum[0] + weight * x, sum[1] + weight * y];
        }
        Some(sum)
    };
    let side = |name: &'static str, turn: fn(u16) -> u16| {
        RIGHT.iter().filter_map(move |(part, weighted)| {
            Some((format!("{name}.{part}"), mean(weighted, turn)?))
        })
    };
    let center =
        CENTER.iter().filter_map(|(part, w)| Some((format!("center.{part}"), mean(w, |p| p)?)));
    center.chain(side("left", mirrored)).chain(side("right", |p| p)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_add_up_to_one_and_sides_are_mirror_images() {
        let corners: Vec<[f32; 2]> = (0..468).map(|_| [3.0, 4.0]).collect();
        let all = places(&corners);
        assert_eq!(all.len(), 41);
        for (name, [x, y]) in &all {
            assert!((x - 3.0).abs() < 1e-5 && (y - 4.0).abs() < 1e-5, "{name}: {x} {y}");
        }
        let only_left: Vec<[f32; 2]> = (0..468)
            .map(|p| [f32::from(u8::from(MIRROR.iter().any(|(_, l)| *l == p))), 0.0])
            .collect();
        for (name, [x, _]) in places(&only_left) {
            let expected = if name.starts_with("left") { 0.9..1.13 } else { -0.01..0.01 };
            assert!(expected.contains(&x), "{name}: {x}");
        }
    }
}
