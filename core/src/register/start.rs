//! The pose to begin with: the mean moved rigidly onto the scan from several directions.

use super::evidence::{FACING, Look};
use super::place::Place;
use super::state::Registration;
use crate::scene::rotation_by;
use crate::vector::{Vec3, add, apply, dot, scale, sub, xyz};

/// Steps of a start, and of the nearest once more. Chosen, not measured, as are the next.
const STEPS: u32 = 10;
/// Vertices that starts look with, about.
const VERTICES: usize = 400;
/// Turns about each axis to start with, radians: with these, scans turned by up to some 70° about any axis
/// were found (docs/registration.md).
const TURNS: [f32; 3] = [0.0, 0.9, -0.9];
/// Starts: all combinations of turns.
pub(super) const STARTS: usize = TURNS.len() * TURNS.len() * TURNS.len();
/// Distances to the scan count as this, mm, if they are larger. Chosen, not measured.
const REACH: f32 = 15.0;
/// Landmarks that determine the pose.
const ENOUGH: usize = 3;

impl Registration<'_, '_> {
    /// Tries start `number`.
    pub(super) fn try_start(&mut self, number: usize) -> [f32; 2] {
        let turn = |i: usize| TURNS.get(i % TURNS.len()).copied().unwrap_or_default();
        let count = TURNS.len();
        self.place = self.centred(rotation_by([
            turn(number),
            turn(number / count),
            turn(number / count / count),
        ]));
        let by_landmarks = self.problem.landmarks.len() >= ENOUGH;
        let mut result = [0.0; 2];
        for step in 0..STEPS {
            // From far to near.
            result = self.iterate(&Look { trust: 40.0 / (1 + step) as f32, ..self.rigid() });
        }
        let energy = if by_landmarks { self.far_landmarks() } else { self.far() };
        if self.best.is_none_or(|(least, _)| energy < least) {
            self.best = Some((energy, self.place));
        }
        result
    }

    /// Goes on from the nearest start.
    pub(super) fn settle(&mut self) -> [f32; 2] {
        if let Some((_, place)) = self.best {
            self.place = place;
        }
        let mut result = [0.0; 2];
        for _ in 0..STEPS {
            result = self.iterate(&Look { trust: 10.0, ..self.rigid() });
        }
        result
    }

    fn stride(&self) -> usize {
        (self.problem.model.vertices() / VERTICES).max(1)
    }

    /// Rigid motions, by landmarks alone where they are enough.
    fn rigid(&self) -> Look {
        let by_landmarks = self.problem.landmarks.len() >= ENOUGH;
        let stride = if by_landmarks { 0 } else { self.stride() };
        Look { components: 0, size: false, trust: 0.0, stride, colors: false }
    }

    /// The mean turned, its centre on the scan's.
    fn centred(&self, rotation: [Vec3; 3]) -> Place {
        let vertices = self.problem.model.vertices();
        let points = self.problem.scan.points;
        let own = self.positions.iter().take(vertices).fold([0.0; 3], |sum, p| add(sum, xyz(*p)));
        let other = points.iter().fold([0.0; 3], |sum, p| add(sum, *p));
        let own = scale(own, 1.0 / vertices as f32);
        let other = scale(other, 1.0 / points.len() as f32);
        Place { translation: sub(other, apply(&rotation, own)), rotation, size: 1.0 }
    }

    fn far_landmarks(&self) -> f64 {
        let apart = |(v, p): &(u32, Vec3)| sub(*p, self.vertex(*v));
        self.problem.landmarks.iter().map(apart).map(|d| f64::from(dot(d, d))).sum()
    }

    /// How far some vertices are from the scan, squared and bounded; those that look elsewhere are as
    /// far as can be.
    fn far(&self) -> f64 {
        let bound = REACH * REACH;
        let vertices = (0..self.problem.model.vertices() as u32).step_by(self.stride());
        let far = |v| {
            let foot = self.foot(v, bound).filter(|foot| foot.facing > FACING);
            foot.map_or(bound, |foot| dot(foot.apart, foot.apart))
        };
        vertices.map(|v| f64::from(far(v))).sum()
    }
}
