//! Whether landmarks can be a model's: before a fit, and beside what it found.

use super::summary::LandmarkFound;
use super::{Fit, Job};
use crate::error::{Error, Result};
use crate::photo::Crop;
use crate::photo::tlms::{MIN_VISIBLE, Tlms};
use crate::vector::{self, dot, turned};
use onescan_core::basis::Basis;
use onescan_core::chain::{Config, Problem};
use onescan_core::image::Image;
use onescan_core::likelihood::landmarks::ObservedLandmark;
use onescan_core::model::Model;
use onescan_core::scene::{MAX_RANK, View};
use onescan_core::search::{self, ModeSearch, Options};

/// A landmark farther from its fitted place than this many standard deviations is named. Chosen, not measured.
const FAR: f64 = 4.0;
/// One farther than this from where all landmarks put the mean has no say in what is looked at,
/// as a share of the crop's longer side: a quarter of what the landmarks of a face span in it.
const ASTRAY: f64 = 30.0 / 256.0;
/// Energy of landmarks that the mean explains: most faces' have below 1, with a wrong one among a
/// dozen below 3.
const GOOD: f64 = 4.0;
/// Yaw beyond which half of a face is guessed, degrees. Chosen, not measured.
const AWAY: f32 = 60.0;
/// Pixels of the photo that a face needs, and the share of them that nothing hides. Chosen, not measured, as
/// are the next.
const ENOUGH_PIXELS: f64 = 900.0;
const ENOUGH_SEEN: f64 = 0.3;
/// Standard deviation of the brightness that a face has at least, `[0, 1]`; a wall has less.
const ENOUGH_CONTRAST: f64 = 0.04;

/// How the mean of a model, in its best pose, explains landmarks.
#[derive(Clone, Debug)]
pub struct Explained {
    /// Pose and camera.
    pub view: View,
    /// Negative log density per landmark, up to a constant; 0 if all lie where the mean has them.
    pub energy: f64,
    /// Mean cosine between the surface's normal at a landmark and the way to the camera: negative
    /// if the surface is seen from behind.
    pub facing: f64,
}

/// Poses the mean of a model by landmarks, positions in pixels of the crop.
///
/// # Errors
/// Landmarks the model does not have.
pub fn explain(
    model: &Model<'_>,
    landmarks: &[ObservedLandmark<'_>],
    crop: &Crop,
    sd: f32,
) -> Result<Explained> {
    let [width, height] = crop.scaled_to;
    let pixels = vec![[0; 3]; width as usize * height as usize];
    let image = Image { pixels: &pixels, width, height };
    let config = Config::default().with(|config| {
        (config.shape_rank, config.albedo_rank, config.landmark_sd) = (0, 0, sd);
    });
    let problem = Problem::new(model, image, landmarks, &config);
    let mut memory = vec![0; search::words(&problem, &Options::default())];
    let search = ModeSearch::new(problem, Options::default(), &mut memory).map_err(Error::new)?;
    let view = *search.initial();
    let count = landmarks.len().max(1) as f64;
    let vertices: Vec<u32> = landmarks.iter().filter_map(|l| model.landmark(l.name)).collect();
    let rotation = view.pose.rotation();
    let cosine = |&v: &u32| {
        let normal = normal(model, v);
        let point = view.pose.to_world(model.shape.mean_at(v as usize));
        let turned = turned(&rotation, normal);
        let lengths = (dot(turned, turned) * dot(point, point)).sqrt();
        if lengths > 0.0 { f64::from(-dot(turned, point) / lengths) } else { 0.0 }
    };
    Ok(Explained {
        energy: search.energy().landmarks / count,
        facing: vertices.iter().map(cosine).sum::<f64>() / count,
        view,
    })
}

/// Normal of the mean at a vertex, as long as the triangles around it are large.
fn normal(model: &Model<'_>, vertex: u32) -> [f32; 3] {
    let triangles = (0..model.triangles.len()).filter_map(|t| model.triangles.get(t));
    let mut sum = [0.0; 3];
    for triangle in triangles.filter(|t| t.contains(&vertex)) {
        let normal = vector::normal(triangle.map(|v| model.shape.mean_at(v as usize)));
        sum.iter_mut().zip(normal).for_each(|(sum, n)| *sum += n);
    }
    sum
}

/// The name of the same point on the other side.
pub fn mirrored(name: &str) -> String {
    let other = |part| match part {
        "left" => "right",
        "right" => "left",
        part => part,
    };
    name.split('.').map(other).collect::<Vec<_>>().join(".")
}

/// The landmarks in pixels of a crop.
fn in_crop(landmarks: &Tlms, crop: &Crop) -> Vec<(String, [f32; 2])> {
    let place = |x: f32, y: f32| crop.to_crop([x.into(), y.into()]).map(|c| c as f32);
    landmarks.visible().map(|l| (l.id.clone(), place(l.x, l.y))).collect()
}

fn named(landmarks: &[(String, [f32; 2])]) -> Vec<ObservedLandmark<'_>> {
    landmarks
        .iter()
        .map(|(name, position)| ObservedLandmark { name, position: *position })
        .collect()
}

/// Looks whether landmarks in a photo of a size can be a model's.
///
/// # Errors
/// When the model explains them as if seen from behind, and their mirror image from before: left
/// and right are exchanged, or y points up. (A turned photo is no mirror image.)
pub fn check_sides(
    model: &Model<'_>,
    landmarks: &Tlms,
    photo: [u32; 2],
    side: u32,
    sd: f32,
) -> Result<()> {
    let crop = Crop::around(&landmarks.visible_points(), photo, Crop::ENLARGE, side)?;
    let given = in_crop(landmarks, &crop);
    let other: Vec<_> = given.iter().map(|(name, at)| (mirrored(name), *at)).collect();
    let known = |(name, _): &(String, _)| model.landmark(name).is_some();
    if !other.iter().all(known) || other == given {
        return Ok(());
    }
    if explain(model, &named(&given), &crop, sd)?.facing > 0.0 {
        return Ok(());
    }
    let other = explain(model, &named(&other), &crop, sd)?;
    if other.facing <= 0.0 || other.energy > GOOD {
        return Ok(());
    }
    // Names exchanged, a face whose y points up stands on its head.
    let roll = other.view.pose.roll;
    Err(Error::new(if roll.cos() > 0.7 {
        "left and right are exchanged: the points fit the model with their names the other way \
         round (left is the subject's left, on the right of a photo that is no selfie)"
    } else if roll.cos() < -0.7 {
        "y seems to point up: the points fit the model turned over; count y from the top of the \
         photo, downwards"
    } else {
        "the points are the mirror image of a face that lies on its side: are x and y exchanged, or \
         left and right?"
    }))
}

/// The part of a photo to look at: [`Crop::around`] the landmarks, without those that are far from where
/// the others put the model.
///
/// # Errors
/// Those of [`Crop::around`]; landmarks the model does not have.
pub fn crop_around(
    model: &Model<'_>,
    landmarks: &Tlms,
    photo: [u32; 2],
    side: u32,
    sd: f32,
) -> Result<Crop> {
    let around =
        |landmarks: &Tlms| Crop::around(&landmarks.visible_points(), photo, Crop::ENLARGE, side);
    let crop = around(landmarks)?;
    let observed = in_crop(landmarks, &crop);
    let found = explain(model, &named(&observed), &crop, sd)?.view;
    let astray = ASTRAY * f64::from(side);
    let near: Vec<&str> = observed
        .iter()
        .filter(|(name, at)| {
            let place = model.landmark(name).map(|v| model.shape.mean_at(v as usize));
            place.is_some_and(|place| distance(&found, place, *at) < astray)
        })
        .map(|(name, _)| &**name)
        .collect();
    if near.len() == observed.len() || near.len() < MIN_VISIBLE {
        return Ok(crop);
    }
    let mut rest = landmarks.clone();
    rest.keep(&near);
    around(&rest)
}

/// Pixels from where a scene shows a point of the model to a point of the picture.
fn distance(view: &View, point: [f32; 3], at: [f32; 2]) -> f64 {
    let (u, v, _) = view.camera.project(view.pose.to_world(point));
    let [x, y] = [u - at[0], v - at[1]].map(f64::from);
    // Not `hypot`, whose last bit is the platform's.
    (x * x + y * y).sqrt()
}

/// The landmarks beside what the fit found; `points` are the fitted model's vertices.
pub(super) fn compare(job: &Job<'_>, fit: &Fit, points: &[[f32; 3]]) -> Vec<LandmarkFound> {
    let view = &fit.best.scene.view;
    let found = job.landmarks.visible().filter_map(|l| {
        let point = *points.get(job.model.landmark(&l.id)? as usize)?;
        let marked = [f64::from(l.x), f64::from(l.y)];
        let (u, v, _) = view.camera.project(view.pose.to_world(point));
        let distance = distance(view, point, fit.crop.to_crop(marked).map(|c| c as f32));
        Some(LandmarkFound {
            name: l.id.clone(),
            marked,
            fitted: fit.crop.to_photo([u.into(), v.into()]),
            distance_px: distance,
            far: distance > FAR * f64::from(job.config.landmark_sd),
        })
    });
    found.collect()
}

/// What speaks against a fit, as sentences.
pub(super) fn warnings(job: &Job<'_>, fit: &Fit, landmarks: &[LandmarkFound]) -> Vec<String> {
    let far = landmarks.iter().filter(|l| l.far).map(|l| {
        let [x, y] = l.fitted;
        format!(
            "landmark {} is {:.0} px (of the crop) from where the fit has it, ({x:.0}, {y:.0}) in \
             the photo; look whether it is right",
            l.name, l.distance_px
        )
    });
    let mut all: Vec<String> = far.collect();
    let yaw = fit.best.scene.view.pose.yaw.to_degrees();
    if yaw.abs() > AWAY {
        all.push(format!(
            "the face looks away (yaw {yaw:.0}°); its other side is guessed, not seen"
        ));
    }
    let covered = fit.best_quality.covered;
    let [sx, sy] = fit.crop.scale();
    let pixels = covered as f64 / (sx * sy);
    if pixels < ENOUGH_PIXELS {
        all.push(format!(
            "the face covers only {pixels:.0} pixels of the photo; take a larger picture of it"
        ));
    }
    let ranks = [&job.model.shape, &job.model.albedo].map(Basis::rank);
    let wanted = [job.config.shape_rank, job.config.albedo_rank];
    if ranks.iter().zip(wanted).any(|(rank, wanted)| *rank > MAX_RANK && wanted == MAX_RANK) {
        all.push(format!(
            "the model has {} + {} components; a fit infers the {MAX_RANK} leading ones of each",
            ranks[0], ranks[1]
        ));
    }
    if let Some(mode) = &fit.mode {
        if !mode.found.converged {
            all.push(format!(
                "the search did not come to rest in its {} steps; what it found may not be the best",
                mode.found.iterations
            ));
        }
        if contrast(job, fit, &mode.mask).is_some_and(|contrast| contrast < ENOUGH_CONTRAST) {
            all.push(
                "the photo is nearly plain where the landmarks put the face; are they of this \
                 photo, in its pixels?"
                    .into(),
            );
        }
        let seen: f32 = mode.mask.iter().sum();
        let share = f64::from(seen) / covered.max(1) as f64;
        if share < ENOUGH_SEEN {
            all.push(format!(
                "only {:.0} % of the face is seen, the rest is taken for something before it \
                 (mask.png)",
                100.0 * share
            ));
        }
    }
    all
}

/// Standard deviation of the photo's brightness where the face is seen; `None` if nowhere.
fn contrast(job: &Job<'_>, fit: &Fit, mask: &[f32]) -> Option<f64> {
    let picture = fit.crop.cut(job.photo).ok()?;
    let (mut sum, mut squares, mut seen) = (0.0, 0.0, 0.0);
    for (pixel, &m) in picture.rgb.iter().zip(mask) {
        let grey = pixel.iter().map(|&c| f64::from(c)).sum::<f64>() / (3.0 * 255.0);
        let m = f64::from(m);
        (sum, squares, seen) = (sum + m * grey, squares + m * grey * grey, seen + m);
    }
    (seen > 0.0).then(|| (squares / seen - (sum / seen) * (sum / seen)).max(0.0).sqrt())
}
