//! The demo: the built-in face model, fitted to two photos and to a rendered face of known truth.

use crate::error::{Error, Result};
use crate::mesh::landmarks::{self, Landmark};
use crate::mesh::ply;
use crate::mesh::{Axis, Mesh};
use crate::model::build::{BuildOptions, BuiltModel, Method, build};
use crate::model::decompose::{Progress, Truncation};
use crate::model::kernel::Kernels;
use crate::model::layout;
use crate::photo;
use crate::photo::picture::Picture;
use crate::photo::tlms::{Landmark2, Tlms};
use crate::render;
use onescan_core::model::Model;
use onescan_core::rng::Rng;
use onescan_core::scene::Scene;

/// The face template and its landmarks, CC0.
const TEMPLATE: &[u8] = include_bytes!("../demo/template.ply");
const LANDMARKS: &str = include_str!("../demo/landmarks.json");
/// A face the model has never seen, on the template's topology, CC0.
const IDENTITY: &[u8] = include_bytes!("../demo/identity.ply");

/// Landmarks that the face fits of the paper's released program use.
pub const FIT_LANDMARKS: [&str; 16] = [
    "right.eyebrow.bend.lower",
    "right.eyebrow.inner_lower",
    "left.eyebrow.inner_lower",
    "left.eyebrow.bend.lower",
    "right.eye.corner_outer",
    "right.eye.corner_inner",
    "left.eye.corner_inner",
    "left.eye.corner_outer",
    "right.nose.wing.tip",
    "center.nose.tip",
    "left.nose.wing.tip",
    "right.lips.corner",
    "center.lips.upper.outer",
    "left.lips.corner",
    "center.lips.lower.outer",
    "center.chin.tip",
];

/// The template as a mesh with its landmarks.
///
/// # Errors
/// Never: the bytes are built in.
pub fn template() -> Result<(Mesh, Vec<Landmark>)> {
    let mesh = ply::parse(TEMPLATE).map_err(Error::new)?;
    let landmarks = landmarks::parse(LANDMARKS, &mesh.points, 1.0)?;
    Ok((mesh, landmarks))
}

/// The symmetric-full model of the template, with `rank` components each of shape and of albedo.
///
/// # Errors
/// Never: the bytes are built in.
pub fn template_model(rank: usize, progress: &mut Progress<'_>) -> Result<BuiltModel> {
    let (mesh, landmarks) = template()?;
    let options = BuildOptions {
        scan_name: "template.ply",
        kernels: Kernels::named("symmetric-full", Some(Axis::X))?,
        method: Method::Exact(Truncation::Rank(rank)),
        millimetres: 1.0,
    };
    build(&mesh, &landmarks, &options, progress)
}

/// A photo of the demo with its landmarks.
pub struct Subject {
    /// Name of its directory and its files.
    pub name: &'static str,
    /// What the report says about it.
    pub about: &'static str,
    /// File name of the photo.
    pub file: &'static str,
    /// Bytes of the photo, to be written beside the results so that the fit can be repeated.
    pub bytes: Vec<u8>,
    /// The photo.
    pub photo: Picture,
    /// Its landmarks.
    pub landmarks: Tlms,
}

/// The demo's photos: two of people, and one of a rendered face turned by 30°.
///
/// # Errors
/// Never: the bytes are built in.
pub fn subjects(seed: u64) -> Result<Vec<Subject>> {
    let photo = |name, about, file, bytes: &[u8], tlms| {
        Ok::<_, Error>(Subject {
            name,
            about,
            file,
            bytes: bytes.to_vec(),
            photo: photo::decode(bytes)?,
            landmarks: Tlms::parse(tlms)?,
        })
    };
    let (rendered, landmarks) = rendered_identity(seed)?;
    Ok(vec![
        photo(
            "astronaut",
            "Eileen Collins, NASA (public domain): a small face in a large photo, smiling",
            "astronaut.png",
            include_bytes!("../demo/astronaut.png"),
            include_str!("../demo/astronaut.tlms"),
        )?,
        photo(
            "grace_hopper",
            "Grace Hopper, US Navy (public domain): glasses and a cap, which the model does not know",
            "grace_hopper.jpg",
            include_bytes!("../demo/grace_hopper.jpg"),
            include_str!("../demo/grace_hopper.tlms"),
        )?,
        Subject {
            name: "identity",
            about: "a rendered face the model has never seen, turned by 30°, under random light",
            file: "identity.png",
            bytes: rendered.to_png()?,
            photo: rendered,
            landmarks,
        },
    ])
}

/// The held-out identity at 30° yaw under random light, with noise and inexact landmarks.
fn rendered_identity(seed: u64) -> Result<(Picture, Tlms)> {
    let mesh = ply::parse(IDENTITY).map_err(Error::new)?;
    let (_, landmarks) = template()?;
    let model = layout::rigid(&mesh, &landmarks)?;
    let mut rng = Rng::new(seed, 0x1d);
    let mut scene = Scene::initial(256, 256, 0, 0);
    scene.view.pose.yaw = 30_f32.to_radians();
    random_light(&mut scene, &mut rng);
    synthetic_photo(&model.view(), &scene, 0.02, &FIT_LANDMARKS, &mut rng)
}

/// Changes a frontal light at random: direction and softness for all channels alike, a little
/// tint for each.
pub fn random_light(scene: &mut Scene, rng: &mut Rng) {
    for (i, coefficient) in scene.view.light.iter_mut().enumerate() {
        let [common, tint] = match i {
            0 => [0.0, 0.03],
            1..4 => [0.12, 0.02],
            _ => [0.05, 0.02],
        };
        let common = rng.normal_sd(common);
        for channel in coefficient {
            *channel += common + rng.normal_sd(tint);
        }
    }
}

/// A photo of known truth: the model's mean in a scene before a soft background, with Gaussian
/// noise, and some landmarks with errors of 2 pixels.
///
/// # Errors
/// A model that lacks one of the landmarks.
pub fn synthetic_photo(
    model: &Model<'_>,
    scene: &Scene,
    noise: f32,
    landmarks: &[&str],
    rng: &mut Rng,
) -> Result<(Picture, Tlms)> {
    // Pixels: about how far those that are set by hand are off (docs/landmarks.md).
    const LANDMARK_ERROR: f32 = 2.0;
    let [width, height] = scene.view.camera.image_size;
    let phase: [f32; 3] = std::array::from_fn(|_| rng.uniform() as f32 * 6.0);
    let background = Picture::from_fn(width, height, |x, y| {
        let (x, y) = (x as f32 / width as f32, y as f32 / height as f32);
        let wave = |p: f32, k: f32| 0.1 * (k * (x + 0.7 * y) + p).sin();
        [0.35 + wave(phase[0], 5.0), 0.42 + wave(phase[1], 7.0), 0.5 + wave(phase[2], 4.0)]
            .map(|c| (255.0 * c) as u8)
    });
    let mut picture = render::draw_over(model, scene, &background)?;
    for channel in picture.rgb.as_flattened_mut() {
        let value = f32::from(*channel) / 255.0 + rng.normal_sd(noise);
        *channel = (255.0 * value.clamp(0.0, 1.0)).round() as u8;
    }
    let points = render::instance(model, &[], &[]).points;
    let landmarks = landmarks
        .iter()
        .map(|&id| {
            let vertex = model
                .landmark(id)
                .ok_or_else(|| Error::new(format_args!("the model has no landmark {id}")))?;
            let (x, y, _) =
                scene.view.camera.project(scene.view.pose.to_world(points[vertex as usize]));
            Ok(Landmark2 {
                id: id.into(),
                visible: true,
                x: x + rng.normal_sd(LANDMARK_ERROR),
                y: y + rng.normal_sd(LANDMARK_ERROR),
            })
        })
        .collect::<Result<_>>()?;
    Ok((picture, Tlms { landmarks }))
}
