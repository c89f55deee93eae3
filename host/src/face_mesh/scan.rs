//! Landmarks on a coloured scan of a face: found in pictures of it, and put on its surface.

use super::{Detector, Face};
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::model::layout;
use crate::photo::picture::Picture;
use crate::photo::tlms::{Landmark2, Tlms};
use crate::render;
use crate::scan::surface::{Nearest, Surface};
use crate::vector::{cross, distance, dot, length, minus};
use onescan_core::scene::Scene;
use std::f32::consts::FRAC_PI_2;

/// Behind the scan: faces are found as well before white, but less surely.
const GROUND: [u8; 3] = [128; 3];
/// Side of the pictures, pixels. Chosen, not measured.
const SIDE: u32 = 512;
/// Yaw and pitch of the first looks: from all six sides, as it is not known which one the face looks to.
const SIDES: [[f32; 2]; 6] = [
    [0.0, 0.0],
    [0.0, FRAC_PI_2],
    [0.0, -FRAC_PI_2],
    [FRAC_PI_2, 0.0],
    [-FRAC_PI_2, 0.0],
    [2.0 * FRAC_PI_2, 0.0],
];
/// Yaw of the second looks, of a face whose place is known. Chosen, not measured.
const TURNS: [f32; 3] = [-0.3, 0.0, 0.3];
/// What the second looks show about the face's middle, as a multiple of the distance from eyes to mouth.
/// Chosen, not measured.
const AROUND: f32 = 2.0;

/// A landmark on a scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// Its name.
    pub name: String,
    /// Where it is on the surface.
    pub coordinates: [f64; 3],
    /// The nearest vertex.
    pub vertex: u32,
}

/// A face on a scan.
#[derive(Clone, Debug)]
pub struct FaceOnScan {
    /// Its landmarks.
    pub marks: Vec<Mark>,
    /// The face from the front.
    pub picture: Picture,
    /// Where the landmarks were found in that picture.
    pub in_picture: Tlms,
}

/// Finds a face on a scan, whichever way it looks.
///
/// Pictures from all sides tell which way it looks. Then three pictures of the face alone, from the front and
/// turned a little to both sides, tell where its landmarks are: of each landmark that picture's place is taken
/// which the other two agree with best.
///
/// # Errors
/// No face in any of the pictures.
pub fn find(mesh: &Mesh) -> Result<FaceOnScan> {
    const NONE: &str = "no face found from any side; mark its landmarks in a mesh editor, and name the \
        file by --landmarks (docs/landmarks.md)";
    let detector = Detector::embedded();
    let surface = Surface::new(mesh);
    let first = SIDES.into_iter().filter_map(|[yaw, pitch]| {
        let look = Look::whole(mesh, yaw, pitch).ok()?;
        Some((look.best(detector)?, look))
    });
    let (face, look) = first
        .max_by(|(a, _), (b, _)| a.score.total_cmp(&b.score))
        .ok_or_else(|| Error::new(NONE))?;
    let place = Place::new(&look.on_surface(&face, &surface)).ok_or_else(|| Error::new(NONE))?;
    let mut seen: Vec<(String, Vec<Nearest>)> = Vec::new();
    let mut front = None;
    for yaw in TURNS {
        let look = Look::near(mesh, &place, yaw)?;
        let Some(face) = look.best(detector) else { continue };
        for (name, nearest) in look.on_surface(&face, &surface) {
            match seen.iter_mut().find(|(other, _)| *other == name) {
                Some((_, all)) => all.push(nearest),
                None => seen.push((name, vec![nearest])),
            }
        }
        if front.is_none() || yaw == 0.0 {
            front = Some((look.picture, face.landmarks()));
        }
    }
    let (picture, in_picture) = front.ok_or_else(|| Error::new(NONE))?;
    let mark = |(name, all): (String, Vec<Nearest>)| {
        let apart = |a: &Nearest| all.iter().map(|b| distance(a.point, b.point)).sum::<f64>();
        let nearest = all.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)))?;
        let corner = (0..3).max_by(|a, b| nearest.weights[*a].total_cmp(&nearest.weights[*b]));
        let vertex = nearest.triangle[corner.unwrap_or(0)];
        Some(Mark { name, coordinates: nearest.point, vertex })
    };
    Ok(FaceOnScan { marks: seen.into_iter().filter_map(mark).collect(), picture, in_picture })
}

/// Where a face is and how it is turned.
struct Place {
    center: [f32; 3],
    /// Its axes: to its left, up, forward.
    axes: [[f32; 3]; 3],
    /// From its eyes to its mouth.
    height: f32,
}

impl Place {
    /// Of landmarks on a surface; `None` if eyes and mouth are not among them, or in one place.
    fn new(marks: &[(String, Nearest)]) -> Option<Self> {
        let mean = |names: [&str; 2]| {
            let found = names.map(|name| marks.iter().find(|(id, _)| id == name));
            let [Some((_, a)), Some((_, b))] = found else { return None };
            Some(std::array::from_fn(|k| (0.5 * (a.point[k] + b.point[k])) as f32))
        };
        let left = mean(["left.eye.corner_inner", "left.eye.corner_outer"])?;
        let right = mean(["right.eye.corner_inner", "right.eye.corner_outer"])?;
        let mouth = mean(["left.lips.corner", "right.lips.corner"])?;
        let eyes: [f32; 3] = std::array::from_fn(|k| 0.5 * (left[k] + right[k]));
        let unit = |v: [f32; 3]| {
            let norm = length(v);
            (norm > 0.0).then(|| v.map(|x| x / norm))
        };
        let across = unit(minus(left, right))?;
        let upward = minus(eyes, mouth);
        let along = dot(upward, across);
        let up = unit(std::array::from_fn(|k| upward[k] - along * across[k]))?;
        Some(Self {
            center: std::array::from_fn(|k| 0.5 * (eyes[k] + mouth[k])),
            axes: [across, up, cross(across, up)],
            height: length(upward),
        })
    }
}

/// A picture of a scan, and how it is turned and moved for it.
struct Look {
    picture: Picture,
    scene: Scene,
    center: [f32; 3],
    axes: [[f32; 3]; 3],
}

impl Look {
    /// All of it from one side.
    fn whole(mesh: &Mesh, yaw: f32, pitch: f32) -> Result<Self> {
        let rigid = layout::rigid(mesh, &[])?;
        let scene = render::portrait(&rigid.view(), [SIDE; 2], yaw, pitch);
        let picture = render::draw_on(&rigid.view(), &scene, GROUND);
        let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        Ok(Self { picture, scene, center: [0.0; 3], axes })
    }

    /// A face of it, turned by a yaw from the front.
    fn near(mesh: &Mesh, place: &Place, yaw: f32) -> Result<Self> {
        let &Place { center, axes, height } = place;
        let turned = |p: &[f32; 3]| axes.map(|axis| dot(axis, minus(*p, center)));
        let mesh = Mesh { points: mesh.points.iter().map(turned).collect(), ..mesh.clone() };
        let rigid = layout::rigid(&mesh, &[])?;
        let scene = render::centered([0.0; 3], AROUND * height, [SIDE; 2], [yaw, 0.0]);
        let picture = render::draw_on(&rigid.view(), &scene, GROUND);
        Ok(Self { picture, scene, center, axes })
    }

    /// The face that is seen best.
    fn best(&self, detector: &Detector) -> Option<Face> {
        let faces = detector.faces(&self.picture);
        faces.into_iter().max_by(|a, b| a.score.total_cmp(&b.score))
    }

    /// Where a face's landmarks are on the surface: where it is seen, or over a hole the point of it that
    /// is nearest to there, as deep as the others. None if all are beside it.
    fn on_surface(&self, face: &Face, surface: &Surface) -> Vec<(String, Nearest)> {
        let rotation = self.scene.view.pose.rotation();
        let pixel = self.scene.view.camera.pixel_scale();
        // From the picture's frame into the scan's.
        let turn = |v: [f32; 3]| {
            let model: [f32; 3] =
                std::array::from_fn(|k| (0..3).map(|i| rotation[i][k] * v[i]).sum());
            std::array::from_fn::<f32, 3, _>(|k| (0..3).map(|i| self.axes[i][k] * model[i]).sum())
        };
        let eye = turn(self.scene.view.pose.translation.map(|t| -t));
        let eye: [f64; 3] = std::array::from_fn(|k| f64::from(eye[k] + self.center[k]));
        let rays = |Landmark2 { id, x, y, .. }: Landmark2| {
            let ray = turn([
                (x + 0.5 - pixel.centre[0]) / pixel.focal[0],
                (pixel.centre[1] - y - 0.5) / pixel.focal[1],
                -1.0,
            ]);
            let norm = length(ray);
            (id, ray.map(|v| f64::from(v / norm)))
        };
        let rays: Vec<_> = face.landmarks().landmarks.into_iter().map(rays).collect();
        let met: Vec<_> =
            rays.iter().map(|(_, ray)| surface.along(eye, *ray, f64::INFINITY)).collect();
        let mut depths: Vec<f64> = met.iter().flatten().map(|met| met.squared.sqrt()).collect();
        depths.sort_by(f64::total_cmp);
        let Some(depth) = depths.get(depths.len() / 2) else { return Vec::new() };
        let over =
            |ray: [f64; 3]| surface.nearest(std::array::from_fn(|k| eye[k] + depth * ray[k]));
        let all = rays.into_iter().zip(met);
        all.map(|((id, ray), met)| (id, met.unwrap_or_else(|| over(ray)))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::ply;
    use std::path::Path;

    /// The ten scans look up to 20° aside, and have topologies and holes of their own.
    #[test]
    fn landmarks_of_the_ten_scans_are_near_the_truth() {
        let place = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/face/scans");
        let text = std::fs::read_to_string(place.join("scans.json")).unwrap();
        let truths: serde_json::Value = serde_json::from_str(&text).unwrap();
        let mut all = Vec::new();
        for (i, truth) in truths.as_array().unwrap().iter().enumerate() {
            let mesh = ply::read(&place.join(format!("scan_{i:02}.ply"))).unwrap();
            let found = find(&mesh).unwrap();
            assert!(found.marks.len() >= 38, "scan {i}: {}", found.marks.len());
            let errors = found.marks.iter().map(|mark| {
                let truth = &truth["landmarks"][&mark.name];
                let squared =
                    (0..3).map(|k| (mark.coordinates[k] - truth[k].as_f64().unwrap()).powi(2));
                squared.sum::<f64>().sqrt()
            });
            let mut errors: Vec<f64> = errors.collect();
            errors.sort_by(f64::total_cmp);
            let median = errors[errors.len() / 2];
            println!("scan {i}: median {median:.2} mm, most {:.1}", errors[errors.len() - 1]);
            assert!(median < 4.0, "scan {i}: {median}");
            all.extend(errors);
        }
        all.sort_by(f64::total_cmp);
        println!("all: median {:.2} mm", all[all.len() / 2]);
        assert!(all[all.len() / 2] < 3.0);
    }
}
