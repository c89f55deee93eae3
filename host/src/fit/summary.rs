//! `fit.json` and `summary.json`: what a fit did and found, for programs and for `render --fit`.

use crate::error::{Error, Result};
use crate::files::read_text;
use crate::json;
use crate::photo::{Crop, MAX_SIDE};
use onescan_core::chain::PhaseName;
use onescan_core::scene::Scene;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A number before and after the fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BeforeAfter {
    /// Of the state the image phase began with.
    pub initial: f64,
    /// Of the best state.
    pub best: f64,
}

/// The model a fit used.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModelUsed {
    /// File name, without folders.
    pub file: String,
    /// Checksum of its bytes, 16 hexadecimal digits.
    pub checksum: String,
}

/// The photo a fit explained.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PhotoUsed {
    /// File name, without folders.
    pub file: String,
    /// Width and height in pixels, EXIF orientation applied.
    pub size: [u32; 2],
    /// The part the fit looked at.
    pub crop: Crop,
    /// Number of landmarks used.
    pub landmarks: usize,
}

/// How often one kind of proposal was made and accepted, over all chains.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Proposal {
    /// The phase, which files call stage.
    #[serde(rename = "stage")]
    pub phase: PhaseName,
    /// The proposal's name.
    pub name: String,
    /// How often it was made.
    pub proposed: u64,
    /// How often it was accepted.
    pub accepted: u64,
    /// Whether it steers the chain without the balance a sampler needs, which files call search.
    #[serde(rename = "search")]
    pub steers: bool,
}

/// How a search for the mode ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModeFound {
    /// Whether the last steps changed nothing.
    pub converged: bool,
    /// Steps of all levels.
    pub iterations: u32,
    /// Steps of each level, coarse to fine.
    #[serde(default)]
    pub levels: Vec<u32>,
    /// Log posterior density, up to a constant.
    pub posterior: f64,
    /// Root mean square colour difference in `[0, 1]` where the face is seen.
    #[serde(default)]
    pub seen_rmse: f64,
}

/// Standard deviations in Laplace's approximation: the posterior as a normal distribution about the
/// mode. It knows nothing but the mode, and is too narrow where the posterior is bent: a sampler knows better
/// ([`PosteriorFound`]).
#[cfg(feature = "full")]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Laplace {
    /// Log marginal likelihood of the photos under the model, up to a constant that depends on
    /// photos and settings alone: models may be compared on the same photos. 0 in files of older versions.
    #[serde(default)]
    pub ln_evidence: f64,
    /// Rotation about the x, y and z axis (about pitch, yaw and roll), degrees.
    pub rotation_deg: [f32; 3],
    /// Translation along x and y, mm.
    pub translation_mm: [f32; 2],
    /// Focal length at a fixed distance, relative to it.
    pub zoom: f32,
    /// Distance, with the focal length in proportion, relative to it.
    pub distance: f32,
    /// Shape coefficients.
    pub shape: Vec<f32>,
    /// Albedo coefficients.
    pub albedo: Vec<f32>,
    /// Light, as in `parameters.light`.
    pub light: Vec<[f32; 3]>,
    /// Gain, contrast, offset.
    pub color: Vec<f32>,
}

/// A component of a mixture, and what the photos say of it.
#[cfg(feature = "full")]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ComponentFound {
    /// The model.
    pub model: ModelUsed,
    /// How likely it was before the photos were seen.
    pub before: f64,
    /// How likely it is now.
    pub weight: f64,
    /// Log marginal likelihood under it, as in [`Laplace`].
    pub ln_evidence: f64,
}

/// One parameter of a sampled posterior.
#[cfg(feature = "full")]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Marginal {
    /// Its name: the path in `parameters`. Angles are in degrees here.
    pub name: String,
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
    /// 5 % quantile: with the next the 90 % interval.
    pub low: f64,
    /// 95 % quantile.
    pub high: f64,
    /// Rank-normalised split R̂.
    pub r_hat: f64,
    /// Effective sample size of the bulk.
    pub ess_bulk: f64,
    /// Effective sample size of the tails.
    pub ess_tail: f64,
}

/// A sampled posterior.
#[cfg(feature = "full")]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PosteriorFound {
    /// Chains.
    pub chains: u32,
    /// Kept states of each.
    pub draws: u32,
    /// Steps of each before, thrown away.
    pub warm_up: u32,
    /// Share of the trajectories that were accepted.
    pub acceptance: f64,
    /// Hash over the bits of every accepted state of all chains.
    pub fingerprint: String,
    /// Largest R̂.
    pub r_hat: f64,
    /// Smallest effective sample size, of bulk or tail.
    pub ess: f64,
    /// How many parameters have R̂ below 1.01 and both sample sizes of at least 400.
    pub mixed: usize,
    /// Root mean square over the vertices of the standard deviation of their places, mm, each state's
    /// face being aligned to the mean face.
    pub vertex_sd_mm: f64,
    /// The end of the scale of colours of uncertainty.png and its meshes, mm.
    pub uncertainty_scale_mm: f64,
    /// Every parameter.
    pub parameters: Vec<Marginal>,
}

/// A landmark, where it was marked and where the fit has it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LandmarkFound {
    /// Its name.
    pub name: String,
    /// Where it was marked, pixels of the photo.
    pub marked: [f64; 2],
    /// Where the fitted model has it, pixels of the photo.
    pub fitted: [f64; 2],
    /// How far these are apart, pixels of the crop (`image.crop.scaled_to`).
    pub distance_px: f64,
    /// Whether that is too far to believe the mark.
    pub far: bool,
}

/// A finished fit: the contents of `fit.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Version of onescan that made the fit.
    pub onescan: String,
    /// Command that repeats the fit; file names only, no folders.
    pub command: String,
    /// The model.
    pub model: ModelUsed,
    /// The photo.
    pub image: PhotoUsed,
    /// Files of the other photos of the same subject, which it was fitted to together.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub others: Vec<String>,
    /// Seed of all randomness.
    pub seed: u64,
    /// Hash over the bits of every accepted state, see [`hex`].
    pub fingerprint: String,
    /// Number of chains; 1 of a search.
    pub chains: u32,
    /// Steps of the landmark phase, per chain; like the next two 0 of a search.
    #[serde(rename = "landmark_samples")]
    pub landmark_steps: u32,
    /// Steps of the shape phase, per chain.
    #[serde(rename = "shape_samples", default)]
    pub shape_steps: u32,
    /// Steps of the image phase, per chain.
    #[serde(rename = "samples")]
    pub image_steps: u32,
    /// Steps of all chains and phases, or of the search.
    pub steps: u64,
    /// Accepted steps of all chains and phases.
    pub accepted: u64,
    /// Steps per second of one chain.
    pub steps_per_second: f64,
    /// Log likelihood of the picture.
    pub log_likelihood: BeforeAfter,
    /// Root mean square colour difference in `[0, 1]` over the pixels the model covers, hidden ones
    /// included.
    pub pixel_rmse: BeforeAfter,
    /// Root mean square distance of the landmarks, pixels of the crop.
    pub landmark_rmse_px: f64,
    /// The landmarks one by one.
    #[serde(default)]
    pub landmarks: Vec<LandmarkFound>,
    /// What speaks against the fit: sentences for a person.
    #[serde(default)]
    pub warnings: Vec<String>,
    /// Acceptance by kind of proposal.
    #[serde(default)]
    pub proposals: Vec<Proposal>,
    /// The phase's log likelihood by step, thinned; steps count over all phases. Of a search the
    /// log posterior before and after each step, up to a constant of its level.
    #[serde(default)]
    pub trace: Vec<(u32, f64)>,
    /// How a search for the mode ended; absent from a chain's fit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mode: Option<ModeFound>,
    /// How exact a search's result is, approximately; absent from a chain's fit.
    #[cfg(feature = "full")]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub laplace: Option<Laplace>,
    /// If the model is the likeliest of a mixture: all of its components.
    #[cfg(feature = "full")]
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub mixture: Vec<ComponentFound>,
    /// What a sampler found around the mode, if it was asked for.
    #[cfg(feature = "full")]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub posterior: Option<PosteriorFound>,
    /// The best state; its camera sees the whole photo.
    pub parameters: Scene,
}

/// Several fits: of a demo or to several photos, the contents of `summary.json`; or of a mixture's components
/// to one photo, the contents of `components.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summaries {
    /// The fits, in the order they were made.
    pub fits: Vec<Summary>,
}

/// A 64-bit hash as 16 hexadecimal digits, the form of fingerprints and checksums.
pub fn hex(hash: u64) -> String {
    format!("{hash:016x}")
}

impl Summary {
    /// Reads `fit.json`.
    ///
    /// # Errors
    /// As [`Summary::parse`], naming the file; a file that cannot be read.
    pub fn read(path: &Path) -> Result<Self> {
        let text = read_text(path)?;
        Self::parse(&text).map_err(|e| Error::file(path, e))
    }

    /// Parses the contents of `fit.json`; unknown fields are ignored.
    ///
    /// # Errors
    /// Damaged JSON, a missing field or one of another type (both named), numbers out of range.
    pub fn parse(text: &str) -> Result<Self> {
        let summary: Self = json::parse(text)?;
        check_scene(&summary.parameters)?;
        Ok(summary)
    }

    /// The contents of `fit.json`.
    ///
    /// # Errors
    /// A number that is not finite, naming the field.
    pub fn to_json(&self) -> Result<String> {
        json::to_text(self)
    }

    /// Whether it is of chains and not of a search. A web page runs none, and has no code for them.
    pub(crate) fn is_of_chains(&self) -> bool {
        cfg!(feature = "full") && self.mode.is_none()
    }
}

impl Summaries {
    /// Parses the contents of `summary.json`, or of `components.json`.
    ///
    /// # Errors
    /// As [`Summary::parse`].
    pub fn parse(text: &str) -> Result<Self> {
        let summaries: Self = json::parse(text)?;
        summaries.fits.iter().try_for_each(|fit| check_scene(&fit.parameters))?;
        Ok(summaries)
    }

    /// The contents of `summary.json`.
    ///
    /// # Errors
    /// A number that is not finite, naming the field.
    pub fn to_json(&self) -> Result<String> {
        json::to_text(self)
    }
}

/// Whether a scene that came from a file can be drawn: numbers finite, sizes positive.
pub(crate) fn check_scene(scene: &Scene) -> Result<()> {
    json::check_finite(scene)?;
    let camera = &scene.view.camera;
    let wrong = |field: &str, found: String, expected: &str| {
        Err(Error::new(format_args!("{field} is {found}, expected {expected}")))
    };
    if !camera.image_size.iter().all(|side| (1..=MAX_SIDE).contains(side)) {
        let found = format!("{}×{}", camera.image_size[0], camera.image_size[1]);
        return wrong("the picture's size", found, &format!("sides of 1 to {MAX_SIDE} pixels"));
    }
    if camera.focal_length <= 0.0 || camera.sensor.iter().any(|side| *side <= 0.0) {
        let found = format!("{} on {:?}", camera.focal_length, camera.sensor);
        return wrong("the focal length on the sensor", found, "positive numbers");
    }
    if camera.near <= 0.0 || camera.far <= camera.near {
        let found = format!("{} to {}", camera.near, camera.far);
        return wrong("the range from near to far", found, "0 < near < far");
    }
    if scene.view.pose.scale <= 0.0 {
        return wrong("the pose's scale", scene.view.pose.scale.to_string(), "a positive number");
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use serde_json::Value;

    pub(crate) fn example() -> Summary {
        let crop = Crop::around(&[[300.0, 200.0], [420.0, 330.0]], [800, 600], 2.2, 256).unwrap();
        let mut parameters = Scene::initial(800, 600, 3, 2);
        parameters.subject.shape[1] = -1.25;
        let proposal = |phase, name: &str, proposed, accepted, steers| Proposal {
            phase,
            name: name.into(),
            proposed,
            accepted,
            steers,
        };
        Summary {
            onescan: "0.1.0".into(),
            command: "onescan fit face.3dmm photo.jpg --landmarks photo.tlms -o out".into(),
            model: ModelUsed { file: "face.3dmm".into(), checksum: hex(7) },
            image: PhotoUsed { file: "photo.jpg".into(), size: [800, 600], crop, landmarks: 16 },
            others: Vec::new(),
            seed: 7,
            fingerprint: hex(0x0123_4567_89ab_cdef),
            chains: 1,
            landmark_steps: 100,
            shape_steps: 0,
            image_steps: 200,
            steps: 300,
            accepted: 123,
            steps_per_second: 250.5,
            log_likelihood: BeforeAfter { initial: -1024.5, best: 2048.25 },
            pixel_rmse: BeforeAfter { initial: 0.25, best: 0.0625 },
            landmark_rmse_px: 3.5,
            landmarks: vec![LandmarkFound {
                name: "center.nose.tip".into(),
                marked: [360.0, 260.0],
                fitted: [361.5, 262.0],
                distance_px: 2.5,
                far: false,
            }],
            warnings: vec!["the face looks away".into()],
            proposals: vec![
                proposal(PhaseName::Landmarks, "yaw", 100, 40, false),
                proposal(PhaseName::Image, "shape", 150, 60, false),
                proposal(PhaseName::Image, "light", 50, 23, true),
            ],
            trace: vec![
                (0, -90.5),
                (50, -30.0),
                (100, -1024.5),
                (200, -28_147.817_395_960_334),
                (300, 2048.25),
            ],
            mode: None,
            #[cfg(feature = "full")]
            laplace: None,
            #[cfg(feature = "full")]
            mixture: Vec::new(),
            #[cfg(feature = "full")]
            posterior: None,
            parameters,
        }
    }

    #[test]
    fn a_summary_reads_back_and_keeps_the_contract() {
        let summary = example();
        let text = summary.to_json().unwrap();
        assert_eq!(Summary::parse(&text).unwrap(), summary);
        let value: Value = serde_json::from_str(&text).unwrap();
        for field in [
            "/seed",
            "/fingerprint",
            "/steps",
            "/steps_per_second",
            "/accepted",
            "/log_likelihood/initial",
            "/log_likelihood/best",
            "/pixel_rmse/initial",
            "/pixel_rmse/best",
            "/landmark_rmse_px",
            "/parameters/shape/1",
        ] {
            assert!(value.pointer(field).is_some(), "{field}");
        }
        let demo = Summaries { fits: vec![summary] }.to_json().unwrap();
        assert!(serde_json::from_str::<Value>(&demo).unwrap().pointer("/fits/0/seed").is_some());
    }

    #[test]
    fn fields_that_were_renamed_are_called_in_files_as_ever() {
        let value: Value = serde_json::from_str(&example().to_json().unwrap()).unwrap();
        for (field, expected) in [
            ("/landmark_samples", 100.into()),
            ("/shape_samples", 0.into()),
            ("/samples", 200.into()),
            ("/proposals/0/stage", "landmarks".into()),
            ("/proposals/2/stage", "image".into()),
            ("/proposals/2/search", true.into()),
        ] {
            assert_eq!(value.pointer(field), Some::<&Value>(&expected), "{field}");
        }
    }

    #[test]
    fn unknown_fields_are_ignored() {
        let text = example().to_json().unwrap().replacen('{', "{\"future\": [1, null],", 1);
        assert_eq!(Summary::parse(&text).unwrap(), example());
    }

    #[test]
    fn errors_name_the_field() {
        let text = example().to_json().unwrap();
        let error = |from: &str, to: &str| {
            assert!(text.contains(from), "{from}");
            Summary::parse(&text.replacen(from, to, 1)).unwrap_err().to_string()
        };
        assert!(error("\"seed\"", "\"sead\"").contains("missing field `seed`"));
        assert!(error("\"roll\": 0.0", "\"roll\": \"x\"").starts_with("parameters.pose.roll: "));
        let shape = error("-1.25", "1e99");
        assert!(shape.starts_with("parameters.shape[1]: number out of range"), "{shape}");
        assert!(error("\"focal_length\": 7.5", "\"focal_length\": 0").contains("focal length"));
        assert!(Summary::parse(&text[..99]).is_err());
        assert!(Summary::parse(&(text.clone() + "x")).is_err());
    }

    #[test]
    fn a_number_json_cannot_hold_is_refused_by_name() {
        let mut summary = example();
        summary.pixel_rmse.best = f64::NAN;
        let message = summary.to_json().unwrap_err().to_string();
        assert!(message.starts_with("pixel_rmse.best is not"), "{message}");
    }
}
