//! How window coordinates follow positions, pose and camera.

use super::unknowns::POSE;
use crate::scene::{PixelCamera, View};
use crate::vector::{Vec3, add, apply, apply_transposed, cross, scale};

/// How window coordinates follow positions, pose and camera.
pub(super) struct Window {
    /// The pose's.
    pub(super) rotation: [Vec3; 3],
    translation: Vec3,
    scale: f32,
    pixel: PixelCamera,
}

impl Window {
    pub(super) fn new(view: &View) -> Self {
        Self {
            rotation: view.pose.rotation(),
            translation: view.pose.translation,
            scale: view.pose.scale,
            pixel: view.camera.pixel_scale(),
        }
    }

    /// `(u, v)` of a model point.
    #[inline(always)]
    pub(super) fn of(&self, point: Vec3) -> [f32; 2] {
        let [x, y, z] = add(scale(apply(&self.rotation, point), self.scale), self.translation);
        let ([fx, fy], [cx, cy], k) = (self.pixel.focal, self.pixel.centre, -1.0 / z);
        [cx + fx * x * k, cy - fy * y * k]
    }

    /// Passes what `(u, v)` of a model point cost back to the point, and to the pose.
    ///
    /// `u = c + f X/d`, `v = c − f Y/d`, `d = −Z`; turning by ω about the object's origin moves
    /// `X` by `ω × (X − t)`.
    #[inline(always)]
    pub(super) fn adjoint(&self, point: Vec3, [pu, pv]: [f32; 2]) -> (Vec3, [f32; POSE]) {
        let q = scale(apply(&self.rotation, point), self.scale);
        let [x, y, z] = add(q, self.translation);
        let k = -1.0 / z;
        let [fx, fy] = self.pixel.focal;
        let (u, v) = (fx * x * k * pu, fy * y * k * pv);
        let world = [fx * k * pu, -fy * k * pv, (u - v) * k];
        let zoom = u - v;
        let turned = cross(q, world);
        let recede = world[2] * self.translation[2] + zoom;
        let moved = scale(apply_transposed(&self.rotation, world), self.scale);
        (moved, [turned[0], turned[1], turned[2], world[0], world[1], zoom, recede])
    }
}
