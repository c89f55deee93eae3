//! Everything a fit infers: pose, camera, light, colour transform and model coefficients.
//!
//! Conventions (all right-handed, active rotations, column vectors, radians, millimetres):
//! a model point `X` goes to the world by `X_w = Rz(roll)·Ry(yaw)·Rx(pitch)·(s·X) + t`; the
//! camera sits at the origin of the world, looks down −z, y up. The picture's y axis points
//! down, its origin is the centre of the top-left pixel's sample (pixel `(x, y)` samples the
//! window point `(x, y)`, no half-pixel shift), the same coordinates landmarks use.

use crate::color::ColorTransform;
use crate::light::{self, Light};
use crate::math;
use serde::{Deserialize, Serialize};

/// The largest number of shape or of albedo coefficients a [`Scene`] carries: room for the 199 that
/// published face models have.
pub const MAX_RANK: usize = 200;

/// Coefficients of one half of the model (shape or albedo), in standard deviations:
/// their prior is `N(0, I)`.
pub type Coefficients = heapless::Vec<f32, MAX_RANK>;

/// Pose of the object in the world (= camera) frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Uniform scale `s` of the model, applied before the rotation.
    pub scale: f32,
    /// Translation `t` in millimetres; `t[2]` is negative in front of the camera.
    pub translation: [f32; 3],
    /// Rotation about z, radians.
    pub roll: f32,
    /// Rotation about y, radians; positive yaw turns the subject's face towards +x.
    pub yaw: f32,
    /// Rotation about x, radians; positive pitch turns +y towards +z.
    pub pitch: f32,
}

impl Pose {
    /// One metre in front of the camera, upright, facing it.
    pub const AWAY_1M: Self =
        Self { scale: 1.0, translation: [0.0, 0.0, -1000.0], roll: 0.0, yaw: 0.0, pitch: 0.0 };

    /// The rotation matrix `Rz(roll)·Ry(yaw)·Rx(pitch)`, row-major.
    pub fn rotation(&self) -> [[f32; 3]; 3] {
        let (sr, cr) = math::sin_cos(self.roll);
        let (sy, cy) = math::sin_cos(self.yaw);
        let (sp, cp) = math::sin_cos(self.pitch);
        [
            [cr * cy, cr * sy * sp - sr * cp, cr * sy * cp + sr * sp],
            [sr * cy, sr * sy * sp + cr * cp, sr * sy * cp - cr * sp],
            [-sy, cy * sp, cy * cp],
        ]
    }

    /// Maps a model point to the world.
    pub fn to_world(&self, point: [f32; 3]) -> [f32; 3] {
        self.to_world_by(&self.rotation(), point)
    }

    /// [`Pose::to_world`] with the rotation already computed.
    #[inline]
    pub fn to_world_by(&self, r: &[[f32; 3]; 3], point: [f32; 3]) -> [f32; 3] {
        let p = point.map(|c| c * self.scale);
        let row = |i: usize| r[i][0] * p[0] + r[i][1] * p[1] + r[i][2] * p[2] + self.translation[i];
        [row(0), row(1), row(2)]
    }

    /// Turns the pose by a rotation vector `w` of the world, radians, about the object's origin.
    pub fn turn(&mut self, w: [f32; 3]) {
        let r = self.rotation();
        let product = rotation_by(w).map(|row| {
            core::array::from_fn(|j| row[0] * r[0][j] + row[1] * r[1][j] + row[2] * r[2][j])
        });
        (self.roll, self.yaw, self.pitch) = Self::euler(&product);
    }

    /// Euler angles `(roll, yaw, pitch)` of a row-major rotation matrix: pitch from
    /// `r21, r22`, yaw from `−r20`, roll from `r10, r00`.
    pub fn euler(r: &[[f32; 3]; 3]) -> (f32, f32, f32) {
        let pitch = math::atan2(r[2][1], r[2][2]);
        let yaw = math::atan2(-r[2][0], math::sqrt(r[2][1] * r[2][1] + r[2][2] * r[2][2]));
        let roll = math::atan2(r[1][0], r[0][0]);
        (roll, yaw, pitch)
    }
}

/// The row-major rotation of a rotation vector `w`, radians (Rodrigues):
///
/// `cos·I + a·[w]× + b·w wᵀ`, `a = sin |w|/|w|`, `b = (1 − cos |w|)/|w|²`.
pub(crate) fn rotation_by(w: [f32; 3]) -> [[f32; 3]; 3] {
    let angle2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
    let angle = math::sqrt(angle2);
    let (sin, cos) = math::sin_cos(angle);
    let (a, b) = if angle > 1e-6 { (sin / angle, (1.0 - cos) / angle2) } else { (1.0, 0.5) };
    [
        [cos + b * w[0] * w[0], b * w[0] * w[1] - a * w[2], b * w[0] * w[2] + a * w[1]],
        [b * w[0] * w[1] + a * w[2], cos + b * w[1] * w[1], b * w[1] * w[2] - a * w[0]],
        [b * w[0] * w[2] - a * w[1], b * w[1] * w[2] + a * w[0], cos + b * w[2] * w[2]],
    ]
}

/// Pinhole camera. Lengths share one unit (only ratios matter); the principal point is in
/// normalised device coordinates, `[-1, 1]` across the picture, y up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Focal length.
    pub focal_length: f32,
    /// Width and height of the sensor.
    pub sensor: [f32; 2],
    /// Where the optical axis meets the picture, NDC.
    pub principal_point: [f32; 2],
    /// Distance (mm) below which nothing is drawn.
    pub near: f32,
    /// Distance (mm) of the far plane; it only scales window depth in files.
    pub far: f32,
    /// Width and height of the picture in pixels.
    pub image_size: [u32; 2],
}

impl Camera {
    /// The reference engine's default (focal length 7.5 on a 2×2 sensor), fitted to a picture:
    /// the shorter side keeps the sensor's 2, and the other side of the sensor grows so that pixels stay
    /// square.
    pub fn for_image(width: u32, height: u32) -> Self {
        let (w, h) = (width.max(1) as f32, height.max(1) as f32);
        let side = w.min(h);
        Self {
            focal_length: 7.5,
            sensor: [2.0 * w / side, 2.0 * h / side],
            principal_point: [0.0, 0.0],
            near: 10.0,
            far: 1e6,
            image_size: [width, height],
        }
    }

    /// Projects a point of the world to `(u, v, d)`: window pixels and the distance `d = −z`.
    ///
    /// `u = W/2·(x_ndc + 1)`, `v = H/2·(1 − y_ndc)`, `x_ndc = 2(f/s_x)·x/d + c_x`. A point at or
    /// behind the camera's plane has no picture; its `d ≤ 0` says so.
    pub fn project(&self, world: [f32; 3]) -> (f32, f32, f32) {
        let p = self.pixel_scale();
        let d = -world[2];
        (p.focal[0] * world[0] / d + p.centre[0], p.centre[1] - p.focal[1] * world[1] / d, d)
    }

    /// Focal length and principal point in pixels.
    pub fn pixel_scale(&self) -> PixelCamera {
        let [w, h] = self.image_size.map(|side| side as f32);
        PixelCamera {
            focal: [w * self.focal_length / self.sensor[0], h * self.focal_length / self.sensor[1]],
            centre: [
                0.5 * w * (1.0 + self.principal_point[0]),
                0.5 * h * (1.0 - self.principal_point[1]),
            ],
        }
    }

    /// Depth in window units `[0, 1]`, as the reference engine stores it:
    /// `z_w = (A − B/d + 1)/2`, `A = (far+near)/(far−near)`, `B = 2·far·near/(far−near)`.
    pub fn window_depth(&self, distance: f32) -> f32 {
        let range = self.far - self.near;
        let a = (self.far + self.near) / range;
        let b = 2.0 * self.far * self.near / range;
        0.5 * (a - b / distance + 1.0)
    }
}

/// A camera in pixel units, see [`Camera::pixel_scale`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelCamera {
    /// Focal length in pixels, per axis.
    pub focal: [f32; 2],
    /// Principal point in window pixels.
    pub centre: [f32; 2],
}

/// Whom or what a picture shows: all that does not change from one picture to the next.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Subject {
    /// Shape coefficients.
    pub shape: Coefficients,
    /// Albedo coefficients.
    pub albedo: Coefficients,
}

impl Subject {
    /// The mean of a model, with room for so many coefficients (each at most [`MAX_RANK`]; larger
    /// counts are cut).
    pub fn mean(shape_rank: usize, albedo_rank: usize) -> Self {
        let zeros = |rank: usize| {
            let mut v = Coefficients::new();
            // Cannot fail: the length is cut to the capacity.
            let _ = v.resize(rank.min(MAX_RANK), 0.0);
            v
        };
        Self { shape: zeros(shape_rank), albedo: zeros(albedo_rank) }
    }
}

/// How a picture shows its subject.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Where the subject is.
    pub pose: Pose,
    /// What it is seen through.
    pub camera: Camera,
    /// What lights it.
    pub light: Light,
    /// What the camera did to the colours.
    pub color: ColorTransform,
}

impl View {
    /// From one metre away under frontal light, in a picture of the given size.
    pub fn initial(width: u32, height: u32) -> Self {
        Self {
            pose: Pose::AWAY_1M,
            camera: Camera::for_image(width, height),
            light: light::frontal(),
            color: ColorTransform::NEUTRAL,
        }
    }

    /// Everything a fit changes, as one list of numbers.
    pub fn parameters(&self) -> impl Iterator<Item = &f32> {
        let Self { pose, camera, light, color } = self;
        [&pose.scale, &pose.roll, &pose.yaw, &pose.pitch]
            .into_iter()
            .chain(&pose.translation)
            .chain([&camera.focal_length])
            .chain(&camera.principal_point)
            .chain(light.as_flattened())
            .chain(&color.gain)
            .chain([&color.contrast])
            .chain(&color.offset)
    }
}

/// One hypothesis about a picture: the state of the Markov chain. In files its parts stand side by
/// side: `pose`, `camera`, `light`, `color`, `shape`, `albedo`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "Flat", into = "Flat")]
pub struct Scene {
    /// Whom or what it shows.
    pub subject: Subject,
    /// How it shows it.
    pub view: View,
}

/// A scene in a file.
#[derive(Serialize, Deserialize)]
#[serde(rename = "Scene")]
struct Flat {
    pose: Pose,
    camera: Camera,
    light: Light,
    color: ColorTransform,
    shape: Coefficients,
    albedo: Coefficients,
}

impl From<Flat> for Scene {
    fn from(Flat { pose, camera, light, color, shape, albedo }: Flat) -> Self {
        Self { subject: Subject { shape, albedo }, view: View { pose, camera, light, color } }
    }
}

impl From<Scene> for Flat {
    fn from(Scene { subject: Subject { shape, albedo }, view }: Scene) -> Self {
        let View { pose, camera, light, color } = view;
        Self { pose, camera, light, color, shape, albedo }
    }
}

impl Scene {
    /// The mean face of a model, one metre away under frontal light, in a picture of the given
    /// size, with room for `shape_rank` and `albedo_rank` coefficients (each at most
    /// [`MAX_RANK`]; larger counts are cut).
    pub fn initial(width: u32, height: u32, shape_rank: usize, albedo_rank: usize) -> Self {
        Self { subject: Subject::mean(shape_rank, albedo_rank), view: View::initial(width, height) }
    }

    /// Everything a chain changes, as one list of numbers.
    pub fn parameters(&self) -> impl Iterator<Item = &f32> {
        self.view.parameters().chain(&self.subject.shape).chain(&self.subject.albedo)
    }
}
