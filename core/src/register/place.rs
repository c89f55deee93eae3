//! Where a model is in the place of a scan.

use crate::math;
use crate::scene::rotation_by;
use crate::vector::{Vec3, add, apply, apply_transposed, dot, sub};

/// Unknowns of a place: the logarithm of the size, a rotation vector, a translation.
pub(super) const PLACE: usize = 7;

/// Where and how large a model is in a scan's place: `p = R x + t`, `x` the model's vertex times the
/// size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// `R`, row by row, right-handed; model to scan.
    pub rotation: [Vec3; 3],
    /// `t`, mm.
    pub translation: Vec3,
    /// `e^σ`.
    pub size: f32,
}

impl Place {
    /// The model's own.
    pub(super) const HOME: Self = Self {
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
        size: 1.0,
    };

    /// Where a point `x` is in the scan's place.
    pub fn apply(&self, x: Vec3) -> Vec3 {
        add(apply(&self.rotation, x), self.translation)
    }

    /// Back.
    pub(super) fn invert(&self, p: Vec3) -> Vec3 {
        apply_transposed(&self.rotation, sub(p, self.translation))
    }

    /// Goes a step of the model in its own frame: `x` becomes `e^σ exp(ω) x + δ`.
    pub(super) fn advance(&mut self, [size, wx, wy, wz, x, y, z]: [f32; PLACE]) {
        self.translation = self.apply([x, y, z]);
        let columns = transposed(rotation_by([wx, wy, wz]));
        self.rotation = self.rotation.map(|row| columns.map(|column| dot(row, column)));
        self.size *= math::exp_f32(size);
    }
}

fn transposed(m: [Vec3; 3]) -> [Vec3; 3] {
    let [a, b, c] = m;
    [[a[0], b[0], c[0]], [a[1], b[1], c[1]], [a[2], b[2], c[2]]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vector::{cross, scale};

    #[test]
    fn a_step_is_the_derivative_of_what_it_does() {
        let mut place = Place { size: 1.1, ..Place::HOME };
        place.advance([0.1, 0.3, -0.5, 0.2, 4.0, -2.0, 9.0]);
        let x = [10.0, -20.0, 30.0];
        let sized = |place: &Place| place.apply(scale(x, place.size));
        let start = scale(x, place.size);
        for i in 0..PLACE {
            let mut step = [0.0; PLACE];
            step[i] = 1e-2;
            let mut moved = place;
            moved.advance(step);
            let found = sub(moved.invert(sized(&moved)), moved.invert(sized(&place)));
            let [size, wx, wy, wz, dx, dy, dz] = step;
            let expected = add(add(scale(start, size), cross([wx, wy, wz], start)), [dx, dy, dz]);
            for axis in 0..3 {
                assert!((found[axis] - expected[axis]).abs() < 6e-3, "{i}: {found:?} {expected:?}");
            }
        }
    }

    #[test]
    fn turns_keep_lengths_and_go_back() {
        let mut place = Place::HOME;
        place.advance([0.0, 1.0, -2.0, 0.5, 1.0, 2.0, 3.0]);
        let p = place.apply([5.0, 6.0, 7.0]);
        let back = place.invert(p);
        assert!(sub(back, [5.0, 6.0, 7.0]).iter().all(|x| x.abs() < 1e-5), "{back:?}");
    }
}
