//! The unknowns of the mode search: where each stands in a vector, and what a step does to them.
//!
//! First those of the subject, then those of every view of it.
//!
//! | entries | what | unit |
//! |---|---|---|
//! | 0.. | shape coefficients | standard deviations |
//! | then | albedo coefficients | standard deviations |
//!
//! | a view's | what | unit |
//! |---|---|---|
//! | 0..3 | rotation vector of the world, about the object's origin | radian |
//! | 3, 4 | translation in x and y | mm |
//! | 5 | zoom: the focal length grows by `eᶻ` | – |
//! | 6 | recede: distance and focal length both grow by `eᶻ`, so that the size stays | – |
//! | then 27 | light, `[coefficient][channel]` | as in [`Light`](crate::light::Light) |
//! | then 7 | gain (3), contrast, offset (3) | as in [`ColorTransform`](crate::color::ColorTransform) |

use crate::math;
use crate::scene::{MAX_RANK, Subject, View};
use core::ops::Range;

/// Entries of pose and camera.
pub const POSE: usize = 7;
/// Entries of the light.
pub const LIGHT: usize = 27;
/// Entries of the colour transform.
pub const COLOR: usize = 7;
/// Entries of a view.
pub const VIEW: usize = POSE + LIGHT + COLOR;

/// The most photos of one subject.
pub const MAX_PHOTOS: usize = 8;

/// How many unknowns there are, and where each kind begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Shape coefficients.
    pub shape_rank: usize,
    /// Albedo coefficients.
    pub albedo_rank: usize,
    /// Views.
    pub views: usize,
}

impl Layout {
    /// As many as there may be.
    pub const MOST: Self = Self { shape_rank: MAX_RANK, albedo_rank: MAX_RANK, views: MAX_PHOTOS };

    /// Number of unknowns.
    pub const fn len(&self) -> usize {
        self.subject() + self.views * VIEW
    }

    /// Whether nothing is sought.
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of the subject's unknowns: where the views begin.
    pub const fn subject(&self) -> usize {
        self.shape_rank + self.albedo_rank
    }

    /// A view's pose and camera.
    pub const fn pose(&self, view: usize) -> Range<usize> {
        let start = self.subject() + view * VIEW;
        start..start + POSE
    }

    /// A view's light.
    pub const fn light(&self, view: usize) -> Range<usize> {
        let start = self.pose(view).end;
        start..start + LIGHT
    }

    /// A view's colour transform.
    pub const fn color(&self, view: usize) -> Range<usize> {
        let start = self.light(view).end;
        start..start + COLOR
    }

    /// The subject's part of a vector of all unknowns, and one view's.
    pub fn split<'v>(&self, vector: &'v mut [f32], view: usize) -> Option<Parts<'v>> {
        let (shape, rest) = vector.split_at_mut_checked(self.shape_rank)?;
        let (albedo, rest) = rest.split_at_mut_checked(self.albedo_rank)?;
        let (pose, rest) = rest.get_mut(view * VIEW..)?.split_first_chunk_mut()?;
        let (light, rest) = rest.split_first_chunk_mut::<LIGHT>()?;
        let light = light.as_chunks_mut().0;
        Some(Parts { shape, albedo, pose, light, color: rest.first_chunk_mut()? })
    }
}

/// The parts of a vector of unknowns.
pub struct Parts<'v> {
    /// Per component.
    pub shape: &'v mut [f32],
    /// Per component.
    pub albedo: &'v mut [f32],
    /// Rotation vector, x, y, zoom, recede.
    pub pose: &'v mut [f32; POSE],
    /// `[coefficient][channel]`.
    pub light: &'v mut [[f32; 3]],
    /// Gain, contrast, offset.
    pub color: &'v mut [f32; COLOR],
}

fn add(to: &mut [f32], step: &[f32]) {
    for (x, d) in to.iter_mut().zip(step) {
        *x += d;
    }
}

impl Parts<'_> {
    /// Moves a subject by its part of the step.
    pub fn advance_subject(&self, subject: &mut Subject) {
        add(&mut subject.shape, self.shape);
        add(&mut subject.albedo, self.albedo);
    }

    /// Moves a view by its part of the step.
    pub fn advance_view(&self, view: &mut View) {
        let [wx, wy, wz, tx, ty, zoom, recede] = *self.pose;
        view.pose.turn([wx, wy, wz]);
        view.pose.translation[0] += tx;
        view.pose.translation[1] += ty;
        view.pose.translation[2] *= math::exp_f32(recede);
        view.camera.focal_length *= math::exp_f32(zoom + recede);
        add(view.light.as_flattened_mut(), self.light.as_flattened());
        let [r, g, b, contrast, offset @ ..] = &*self.color;
        add(&mut view.color.gain, &[*r, *g, *b]);
        view.color.contrast += *contrast;
        add(&mut view.color.offset, offset);
    }
}
