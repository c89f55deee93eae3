//! A full-size case whose model is the same on every machine: waves on the template instead of
//! eigenfunctions, which come from a library that computes with whatever SIMD there is.

use onescan::demo::template;
use onescan::error::{Error, Result};
use onescan::fit::Observed;
use onescan::model::layout::ModelParts;
use onescan::model::process::{Deviation, Half};
use onescan::model_file::OwnedModel;
use onescan::photo::tlms::{Landmark2, Tlms};
use onescan::photo::{self, Crop};
use onescan_core::math::sin_cos;
use onescan_core::rng::Rng;
use std::fs;
use std::path::Path;

/// Components of each half: as many as a chain infers by default.
const RANK: usize = 50;

/// Component `k` moves one coordinate (or channel) by a wave over the mesh.
struct Waves {
    variances: Vec<f64>,
    fields: Vec<Vec<f64>>,
}

impl Waves {
    /// Waves of falling length and standard deviation, the first of which is `sd`.
    fn new(points: &[[f32; 3]], sd: f64, stream: u32) -> Self {
        let mut rng = Rng::new(1, stream);
        let fields = (0..RANK).map(|k| {
            // Per millimetre: from half a wave over the face to four or so.
            let number = 0.008 * (1.0 + k as f32 / 7.0);
            let direction: [f32; 3] = std::array::from_fn(|_| rng.normal_sd(number));
            let phase = rng.normal_sd(3.0);
            let at = |p: &[f32; 3]| {
                let along = direction[0] * p[0] + direction[1] * p[1] + direction[2] * p[2];
                f64::from(sin_cos(along + phase).1)
            };
            points.iter().map(at).collect()
        });
        let variances = (0..RANK).map(|k| sd * sd / (1.0 + k as f64)).collect();
        Self { fields: fields.collect(), variances }
    }
}

impl Deviation for Waves {
    fn variances(&self) -> &[f64] {
        &self.variances
    }

    fn total_variance(&self) -> f64 {
        self.variances.iter().sum()
    }

    fn column(&self, k: usize, channel: usize) -> (f64, &[f64]) {
        let own = if k % 3 == channel { self.variances[k].sqrt() } else { 0.0 };
        (own, &self.fields[k])
    }
}

/// Writes `face.3dmm`, and what a default chain's fit to `photos/astronaut.png` looks at:
/// `photo.ppm` and `photo.tlms`.
///
/// # Errors
/// Files that cannot be read or written.
pub fn write(place: &Path, photos: &Path) -> Result<()> {
    let (mesh, landmarks) = template()?;
    let parts = ModelParts {
        shape: Half { mean: &mesh.points, deviation: &Waves::new(&mesh.points, 4.0, 1) },
        albedo: Half { mean: &mesh.colors, deviation: &Waves::new(&mesh.points, 0.08, 2) },
        triangles: &mesh.triangles,
        landmarks: &landmarks,
        provenance: "kernels = waves, for tests\n",
        occlusion: None,
        levels: i16::MAX,
    };
    OwnedModel::from_bytes(&parts.to_bytes()?)?.write(&place.join("face.3dmm"))?;

    let photo = photo::read(&photos.join("astronaut.png"))?;
    let marks = Tlms::read(&photos.join("astronaut.tlms"), [512; 2])?;
    let size = [photo.width, photo.height];
    let crop = Crop::around(&marks.visible_points(), size, Crop::ENLARGE, Crop::LONGER_SIDE)?;
    let observed = Observed::new(&photo, &marks, &crop)?;
    let picture = &observed.picture;
    let mut ppm = format!("P6\n{} {}\n255\n", picture.width, picture.height).into_bytes();
    ppm.extend(picture.bytes());
    fs::write(place.join("photo.ppm"), ppm).map_err(Error::new)?;
    let moved = observed.landmarks.iter().map(|l| {
        let [x, y] = l.position;
        Landmark2 { id: l.name.into(), visible: true, x, y }
    });
    let moved = Tlms { landmarks: moved.collect() };
    fs::write(place.join("photo.tlms"), moved.to_text()).map_err(Error::new)
}
