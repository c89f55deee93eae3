//! Proposals: the mixture tree as data, and what each move does to a hypothesis.
//!
//! A move changes the scene in place and returns
//! `log [q(x' → x)·|J| / q(x → x')]`, the factor by which Metropolis–Hastings must correct the
//! ratio of targets; for moves that scale several parameters together it is the Jacobian of the
//! scaling. With these the chain without [moves that steer](Move::steers) leaves its target
//! invariant. (The reference engine treats every move as symmetric.)

// Every move has the same signature, also those that cannot fail.
#![allow(clippy::unnecessary_wraps)]

mod coefficients;
mod color;
mod kinds;
mod light;
mod pose;
mod tree;

use crate::rng::Rng;
use crate::scene::Scene;
pub use kinds::{Axis, Half, Move, Touched};
pub use tree::{
    Branch, CENTRES, FACE, MAX_LEAVES, OBJECT, OBJECT_POSE, OBJECT_POSE_AND_SHAPE, POSE,
    POSE_AND_SHAPE, Table, Tree,
};

/// What a move needs to know besides the scene.
pub trait Surroundings {
    /// Model-frame position of the landmark a move is centred on.
    fn centre(&self, index: usize) -> Option<[f32; 3]>;

    /// Replaces the light of `scene`, the current state, by the closed-form light from `points`
    /// visible surface points. `None` if there is none.
    fn solve_light(&mut self, scene: &mut Scene, points: u32, rng: &mut Rng) -> Option<()>;
}

/// Applies a leaf to the scene. Returns the log ratio described at the top of this module, or
/// `None` if the move fails: it leads out of the space (behind the camera, say) or has nothing to
/// work on. A failed move counts as rejected; the scene it leaves is to be discarded.
pub fn propose(
    branch: &Branch,
    scene: &mut Scene,
    rng: &mut Rng,
    surroundings: &mut impl Surroundings,
) -> Option<f64> {
    let Some(centre) = branch.centre else {
        return apply(branch.kind, scene, rng, surroundings);
    };
    // The principal point is additive in the picture, so shifting it by the difference holds the
    // landmark exactly; given everything else the shift is a translation, its Jacobian is one.
    let point = surroundings.centre(centre)?;
    let project = |scene: &Scene| scene.view.camera.project(scene.view.pose.to_world(point));
    let (u0, v0, d0) = project(scene);
    let ratio = apply(branch.kind, scene, rng, surroundings)?;
    let (u1, v1, d1) = project(scene);
    let near = scene.view.camera.near;
    if !(d0 > near && d1 > near) {
        return None;
    }
    let [width, height] = scene.view.camera.image_size.map(|side| side as f32);
    scene.view.camera.principal_point[0] += 2.0 * (u0 - u1) / width;
    scene.view.camera.principal_point[1] -= 2.0 * (v0 - v1) / height;
    Some(ratio)
}

fn apply(
    kind: Move,
    scene: &mut Scene,
    rng: &mut Rng,
    surroundings: &mut impl Surroundings,
) -> Option<f64> {
    match kind {
        Move::Rotation { axis, sd } => pose::rotate(&mut scene.view.pose, axis, rng.normal_sd(sd)),
        Move::Distance { sd } => {
            pose::change_distance(&mut scene.view.pose, &mut scene.view.camera, rng.normal_sd(sd))
        }
        Move::Scaling { sd } => pose::scale(&mut scene.view.camera, rng.normal_sd(sd)),
        Move::Translation { sd } => {
            let shift = [rng.normal_sd(sd), rng.normal_sd(sd)];
            pose::translate(&mut scene.view.pose, shift)
        }
        Move::Color { gain_sd, contrast_sd, offset_sd } => {
            color::perturb(&mut scene.view.color, gain_sd, contrast_sd, offset_sd, rng)
        }
        Move::Gaussian { half, sd } => coefficients::add(coefficients_of(scene, half), sd, rng),
        Move::Single { half, sd } => {
            coefficients::add_to_one(coefficients_of(scene, half), sd, rng)
        }
        Move::Caricature { half, sd } => {
            coefficients::caricature(coefficients_of(scene, half), rng.normal_sd(sd))
        }
        Move::LightSpatial { sd } => light::spatial(&mut scene.view.light, sd, rng),
        Move::LightBands { sd } => light::bands(&mut scene.view.light, sd, rng),
        Move::LightIntensity { sd } => {
            light::intensity(&mut scene.view.light, 0.5 * rng.normal_sd(sd))
        }
        Move::LightPerturbation { sd } => light::perturb(&mut scene.view.light, sd, rng),
        Move::LightColor { sd } => light::tint(&mut scene.view.light, sd, rng),
        Move::SolveLight { points } => {
            surroundings.solve_light(scene, points, rng)?;
            Some(0.0)
        }
    }
}

fn coefficients_of(scene: &mut Scene, half: Half) -> &mut [f32] {
    match half {
        Half::Shape => &mut scene.subject.shape,
        Half::Albedo => &mut scene.subject.albedo,
    }
}
