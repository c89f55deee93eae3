//! Moves of pose and camera, as the reference engine has them.

use super::kinds::Axis;
use crate::math;
use crate::scene::{Camera, Pose};

/// Distance, mm, below which [`change_distance`] does not go, so that its logarithm stays finite.
const MIN_DISTANCE: f32 = 1.0;

/// Adds to one Euler angle: symmetric.
pub(super) fn rotate(pose: &mut Pose, axis: Axis, angle: f32) -> Option<f64> {
    match axis {
        Axis::Roll => pose.roll += angle,
        Axis::Yaw => pose.yaw += angle,
        Axis::Pitch => pose.pitch += angle,
    }
    Some(0.0)
}

/// Moves the object `shift` mm towards the camera and keeps its size in the picture:
/// `D' = D − shift`, `f' = f·D'/D`. With `(D, f, shift) → (D', f', −shift)` the Jacobian is
/// `D'/D`.
pub(super) fn change_distance(pose: &mut Pose, camera: &mut Camera, shift: f32) -> Option<f64> {
    let d = -pose.translation[2];
    let d1 = d - shift;
    if !(d > MIN_DISTANCE && d1 > MIN_DISTANCE) {
        return None;
    }
    let ratio = d1 / d;
    pose.translation[2] = -d1;
    camera.focal_length *= ratio;
    Some(math::ln(f64::from(ratio)))
}

/// `f' = f·eᶻ`; the Jacobian of the scaling is `eᶻ`.
pub(super) fn scale(camera: &mut Camera, z: f32) -> Option<f64> {
    camera.focal_length *= math::exp_f32(z);
    Some(f64::from(z))
}

/// Shifts in the picture plane: symmetric.
pub(super) fn translate(pose: &mut Pose, shift: [f32; 2]) -> Option<f64> {
    pose.translation[0] += shift[0];
    pose.translation[1] += shift[1];
    Some(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distance_keeps_the_size() {
        let mut pose = Pose::AWAY_1M;
        let mut camera = Camera::for_image(512, 512);
        change_distance(&mut pose, &mut camera, 30.0).unwrap();
        assert!((camera.focal_length - 7.275).abs() < 1e-6);
        assert!((pose.translation[2] - -970.0).abs() < 1e-4);
        assert!(change_distance(&mut pose, &mut camera, 970.0).is_none());
    }
}
