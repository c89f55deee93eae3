//! Rotation and translation between points in correspondence.

use crate::vector::{minus, turned};
use faer::{Mat, Side};

/// `x → R x + t`, right-handed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rigid {
    /// `R`, row by row.
    pub rotation: [[f64; 3]; 3],
    /// `t`.
    pub translation: [f64; 3],
}

impl Rigid {
    /// The motion that brings `moving` nearest to `fixed` in the sum of squares, without scaling
    /// (Horn 1987: the rotation is the leading eigenvector of a 4×4 matrix, as a quaternion). Only
    /// as many points as both have count; `None` without any, or with numbers that are not finite.
    pub fn between(moving: &[[f32; 3]], fixed: &[[f32; 3]]) -> Option<Self> {
        let count = moving.len().min(fixed.len());
        let (a, b) = (centre(&moving[..count])?, centre(&fixed[..count])?);
        let mut s = [[0.0; 3]; 3];
        for (p, q) in moving.iter().zip(fixed) {
            for i in 0..3 {
                for j in 0..3 {
                    s[i][j] += (f64::from(p[i]) - a[i]) * (f64::from(q[j]) - b[j]);
                }
            }
        }
        let n = [
            [s[0][0] + s[1][1] + s[2][2], s[1][2] - s[2][1], s[2][0] - s[0][2], s[0][1] - s[1][0]],
            [0.0, s[0][0] - s[1][1] - s[2][2], s[0][1] + s[1][0], s[2][0] + s[0][2]],
            [0.0, 0.0, s[1][1] - s[0][0] - s[2][2], s[1][2] + s[2][1]],
            [0.0, 0.0, 0.0, s[2][2] - s[0][0] - s[1][1]],
        ];
        let n = Mat::from_fn(4, 4, |i, j| n[i.min(j)][i.max(j)]);
        let eigen = n.self_adjoint_eigen(Side::Lower).ok()?;
        let [w, x, y, z] = [0, 1, 2, 3].map(|i| eigen.U()[(i, 3)]);
        let rotation = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ];
        Some(Self { rotation, translation: minus(b, turned(&rotation, a)) })
    }

    /// The point moved.
    pub fn apply(&self, p: [f32; 3]) -> [f32; 3] {
        let turned = turned(&self.rotation, p.map(f64::from));
        std::array::from_fn(|i| (turned[i] + self.translation[i]) as f32)
    }
}

/// `None` without points or if it is not finite.
fn centre(points: &[[f32; 3]]) -> Option<[f64; 3]> {
    let mut sum = [0.0; 3];
    for p in points {
        for (sum, x) in sum.iter_mut().zip(p) {
            *sum += f64::from(*x);
        }
    }
    let centre = sum.map(|sum| sum / points.len() as f64);
    centre.iter().all(|x| x.is_finite()).then_some(centre)
}

#[cfg(test)]
mod tests {
    use super::*;
    use onescan_core::scene::Pose;

    #[test]
    fn a_rigid_motion_is_found_and_a_bend_stays() {
        let points: Vec<[f32; 3]> =
            (0..50).map(|k| [0.3, 1.7, 2.9].map(|f| 40.0 * (f * k as f32).sin())).collect();
        let pose =
            Pose { scale: 1.0, translation: [3.0, -20.0, 7.0], roll: 0.4, yaw: -1.0, pitch: 0.2 };
        let mut moved: Vec<_> = points.iter().map(|&p| pose.to_world(p)).collect();
        let error = |moved: &[[f32; 3]]| {
            let motion = Rigid::between(&points, moved).unwrap();
            let pairs = points.iter().zip(moved);
            let far = |(p, q): (&[f32; 3], &[f32; 3])| {
                let p = motion.apply(*p);
                (0..3).map(|i| (p[i] - q[i]).abs()).fold(0.0, f32::max)
            };
            pairs.map(far).fold(0.0, f32::max)
        };
        assert!(error(&moved) < 1e-4);
        moved[7][1] += 5.0;
        assert!(error(&moved) > 0.5);
        assert_eq!(Rigid::between(&[], &points), None);
        assert_eq!(Rigid::between(&[[f32::NAN; 3]], &points), None);
    }
}
