//! The unknowns of the mode search: where each stands in a vector, and what a step does to a scene.
//!
//! | entries | what | unit |
//! |---|---|---|
//! | 0..3 | rotation vector of the world, about the object's origin | radian |
//! | 3, 4 | translation in x and y | mm |
//! | 5 | zoom: the focal length grows by `eᶻ` | – |
//! | 6 | recede: distance and focal length grow by `eᶻ` | – |
//! | 7.. | shape coefficients | standard deviations |
//! | then | albedo coefficients | standard deviations |
//! | then 27 | light, `[coefficient][channel]` | as in [`Light`](crate::light::Light) |
//! | then 7 | gain (3), contrast, offset (3) | as in [`ColorTransform`](crate::color::ColorTransform) |

use crate::math;
use crate::scene::Scene;

/// Entries of pose and camera.
pub const POSE: usize = 7;
/// Entries of the light.
pub const LIGHT: usize = 27;
/// Entries of the colour transform.
pub const COLOR: usize = 7;

/// How many unknowns there are, and where each kind begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Shape coefficients.
    pub shape_rank: usize,
    /// Albedo coefficients.
    pub albedo_rank: usize,
}

impl Layout {
    /// Number of unknowns.
    pub const fn len(&self) -> usize {
        POSE + self.shape_rank + self.albedo_rank + LIGHT + COLOR
    }

    /// Never: pose, light and colour are always sought.
    pub const fn is_empty(&self) -> bool {
        false
    }

    /// Where the light begins.
    pub const fn light(&self) -> usize {
        POSE + self.shape_rank + self.albedo_rank
    }

    /// Where the colour transform begins.
    pub const fn color(&self) -> usize {
        self.light() + LIGHT
    }

    /// A vector of all unknowns in its parts.
    pub fn split<'v>(&self, vector: &'v mut [f32]) -> Option<Parts<'v>> {
        let (pose, rest) = vector.split_first_chunk_mut()?;
        let (shape, rest) = rest.split_at_mut_checked(self.shape_rank)?;
        let (albedo, rest) = rest.split_at_mut_checked(self.albedo_rank)?;
        let (light, rest) = rest.split_first_chunk_mut::<LIGHT>()?;
        let light = light.as_chunks_mut().0;
        Some(Parts { pose, shape, albedo, light, color: rest.first_chunk_mut()? })
    }
}

/// The parts of a vector of unknowns.
pub struct Parts<'v> {
    /// Rotation vector, x, y, zoom, recede.
    pub pose: &'v mut [f32; POSE],
    /// Per component.
    pub shape: &'v mut [f32],
    /// Per component.
    pub albedo: &'v mut [f32],
    /// `[coefficient][channel]`.
    pub light: &'v mut [[f32; 3]],
    /// Gain, contrast, offset.
    pub color: &'v mut [f32; COLOR],
}

/// Goes a step from a scene.
pub fn advance(scene: &mut Scene, step: &Parts<'_>) {
    let [wx, wy, wz, tx, ty, zoom, recede] = *step.pose;
    scene.view.pose.turn([wx, wy, wz]);
    scene.view.pose.translation[0] += tx;
    scene.view.pose.translation[1] += ty;
    scene.view.pose.translation[2] *= math::exp_f32(recede);
    scene.view.camera.focal_length *= math::exp_f32(zoom + recede);
    let add = |to: &mut [f32], step: &[f32]| {
        for (x, d) in to.iter_mut().zip(step) {
            *x += d;
        }
    };
    add(&mut scene.subject.shape, step.shape);
    add(&mut scene.subject.albedo, step.albedo);
    add(scene.view.light.as_flattened_mut(), step.light.as_flattened());
    let [r, g, b, contrast, offset @ ..] = &*step.color;
    add(&mut scene.view.color.gain, &[*r, *g, *b]);
    scene.view.color.contrast += *contrast;
    add(&mut scene.view.color.offset, offset);
}
