//! The page's tables: a fit's numbers in units people think in.

use super::words::{likelihood, number, percent, shifted, turned};
use crate::fit::summary::Summary;
use onescan_core::color::LUMINANCE;
use onescan_core::scene::Scene;
use onescan_core::{light, math};

/// Name and value of each row.
pub(super) type Rows = Vec<(String, String)>;

/// Diagonal of a 36 × 24 mm film frame.
const FILM_DIAGONAL: f32 = 43.27;

/// What the fit did and how well it explains the picture.
pub(super) fn key_figures(s: &Summary) -> Rows {
    let [x, y] = s.image.crop.origin;
    let [width, height] = s.image.crop.size;
    let [to_width, to_height] = s.image.crop.scaled_to;
    let share = s.accepted as f64 / s.steps.max(1) as f64;
    let rows = [
        (
            "Pixel error, before → after",
            format!("{} → {}", percent(s.pixel_rmse.initial, 2), percent(s.pixel_rmse.best, 2)),
        ),
        (
            "Pixel error where the face is seen",
            s.mode.as_ref().map_or_else(String::new, |mode| percent(mode.seen_rmse, 2)),
        ),
        ("Landmark error", format!("{} px of the crop", number(s.landmark_rmse_px, 2))),
        (
            "Log likelihood, before → after",
            format!(
                "{} → {}",
                likelihood(s.log_likelihood.initial),
                likelihood(s.log_likelihood.best)
            ),
        ),
        ("Steps", steps(s)),
        (
            if s.is_of_chains() { "Accepted" } else { "Steps that changed something" },
            format!("{} ({})", number(s.accepted as f64, 0), percent(share, 0)),
        ),
        (
            "Speed",
            if s.is_of_chains() {
                format!("{} steps per second and chain", number(s.steps_per_second, 0))
            } else {
                format!("{} steps per second", number(s.steps_per_second, 1))
            },
        ),
        (
            "Photo",
            format!(
                "{}×{}, looked at {width}×{height} from ({x}, {y}), scaled to {to_width}×{to_height}",
                s.image.size[0], s.image.size[1]
            ),
        ),
        ("Seed", s.seed.to_string()),
        ("Fingerprint", s.fingerprint.clone()),
    ];
    let told = rows.into_iter().filter(|(_, value)| !value.is_empty());
    told.map(|(name, value)| (name.to_owned(), value)).collect()
}

fn steps(s: &Summary) -> String {
    if !s.is_of_chains() {
        let converged = s.mode.as_ref().is_some_and(|mode| mode.converged);
        return format!("{}, {}converged", s.steps, if converged { "" } else { "not " });
    }
    let shape = match s.shape_steps {
        0 => String::new(),
        steps => format!("{} shape + ", number(steps.into(), 0)),
    };
    format!(
        "{} landmark + {shape}{} picture, {} chain{}",
        number(s.landmark_steps.into(), 0),
        number(s.image_steps.into(), 0),
        s.chains,
        if s.chains == 1 { "" } else { "s" }
    )
}

/// Pose, camera, light and colours in units people think in.
pub(super) fn scene_facts(scene: &Scene) -> Rows {
    let (pose, camera, color) = (&scene.view.pose, &scene.view.camera, &scene.view.color);
    let [x, y, z] = pose.translation.map(f64::from);
    let diagonal =
        math::sqrt(camera.sensor[0] * camera.sensor[0] + camera.sensor[1] * camera.sensor[1]);
    let triple = |v: [f32; 3], decimals| v.map(|c| number(c.into(), decimals)).join(", ");
    let rows = [
        ("Turned (yaw)", turned(pose.yaw, "to the picture’s right", "to the picture’s left")),
        ("Nodding (pitch)", turned(pose.pitch, "down", "up")),
        ("Tilted (roll)", turned(pose.roll, "counter-clockwise", "clockwise")),
        ("Distance", format!("{} m", number(-z / 1000.0, 2))),
        (
            "Off the optical axis",
            format!("{}, {}", shifted(x, "right", "left"), shifted(y, "up", "down")),
        ),
        ("Size, against the scan", percent(pose.scale.into(), 1)),
        (
            "Focal length, as on 35 mm film",
            format!("{} mm", number(f64::from(camera.focal_length / diagonal * FILM_DIAGONAL), 0)),
        ),
        ("Light", light_in_words(scene)),
        ("Colour gain (R, G, B)", triple(color.gain, 2)),
        ("Colour offset (R, G, B)", triple(color.offset, 3)),
        ("Contrast", percent(color.contrast.into(), 0)),
    ];
    let told = rows.into_iter().filter(|(_, value)| !value.is_empty());
    told.map(|(name, value)| (name.to_owned(), value)).collect()
}

/// Ambient brightness, and the direction and strength of the first-order light.
fn light_in_words(scene: &Scene) -> String {
    let brightness =
        |i: usize| -> f32 { (0..3).map(|c| LUMINANCE[c] * scene.view.light[i][c]).sum() };
    // Coefficients 1, 2, 3 are y, z, x; their basis functions at the unit axes are the factors.
    let x = brightness(3) * light::basis([1.0, 0.0, 0.0])[3];
    let y = brightness(1) * light::basis([0.0, 1.0, 0.0])[1];
    let z = brightness(2) * light::basis([0.0, 0.0, 1.0])[2];
    let ambient = f64::from(brightness(0) * light::basis([0.0, 0.0, 1.0])[0]);
    let strength = f64::from(math::sqrt(x * x + y * y + z * z));
    let around = format!("brightness {} all around", number(ambient, 2));
    if strength < 0.02 * ambient {
        return around;
    }
    format!(
        "{around}, {} more from {}, {}",
        number(strength, 2),
        turned(math::atan2(x, z), "right", "left"),
        turned(math::atan2(y, math::sqrt(x * x + z * z)), "above", "below")
    )
}

/// The model's `key = value` lines; underscores and quotes are for machines.
pub(super) fn provenance_facts(text: &str) -> Rows {
    text.lines()
        .filter_map(|line| line.split_once('='))
        .map(|(key, value)| {
            (key.trim().replace('_', " "), value.trim().trim_matches('"').to_owned())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(rows: &Rows, name: &str) -> String {
        rows.iter().find(|(n, _)| n.starts_with(name)).unwrap().1.clone()
    }

    #[test]
    fn a_scene_is_described_in_human_units() {
        let mut scene = Scene::initial(720, 480, 0, 0);
        scene.view.pose.yaw = -0.5;
        scene.view.camera.focal_length = 50.0;
        scene.view.camera.sensor = [36.0, 24.0];
        let half_left = [-0.5_f32.sqrt() * 0.3, 0.0, 0.5_f32.sqrt() * 0.3];
        scene.view.light = light::ambient_diffuse([0.7; 3], [1.0; 3], half_left);
        let rows = scene_facts(&scene);
        assert_eq!(value(&rows, "Turned"), "28.6° to the picture’s left");
        assert_eq!(value(&rows, "Distance"), "1.00 m");
        assert_eq!(value(&rows, "Focal length"), "50 mm");
        let expected = "brightness 0.70 all around, 0.30 more from 45.0° left, 0.0°";
        assert_eq!(value(&rows, "Light"), expected);
        scene.view.light = light::ambient_white();
        assert_eq!(value(&scene_facts(&scene), "Light"), "brightness 1.00 all around");
    }

    #[test]
    fn provenance_lines_become_rows() {
        let rows = provenance_facts("scan = \"a=b.ply\"\nno row\nshape_rank = 9\n");
        assert_eq!(value(&rows, "scan"), "a=b.ply");
        assert_eq!(value(&rows, "shape rank"), "9");
        assert_eq!(rows.len(), 2);
    }
}
