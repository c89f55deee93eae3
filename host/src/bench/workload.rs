//! What is measured: a model, and a rendered face of known truth.

use crate::demo;
use crate::error::{Error, Result};
use crate::model::layout;
use crate::model_file::OwnedModel;
use crate::photo::picture::Picture;
use crate::photo::tlms::Tlms;
use crate::render::{self, random_coefficients};
use crate::simd;
use onescan_core::chain::{Config, Problem};
use onescan_core::draw::{draw, draw_words};
use onescan_core::image::Image;
use onescan_core::likelihood::landmarks::ObservedLandmark;
use onescan_core::model::Model;
use onescan_core::rng::Rng;
use onescan_core::scene::{Coefficients, Scene, Subject, View};

/// Components of each half of the model. Fits infer 50 of them.
const RANK: usize = 60;
/// Sides of the picture.
pub(super) const SIZE: [u32; 2] = [256, 256];
/// Share of the picture the face covers.
const COVERED: f64 = 0.4;
/// Of the face, its light, the noise, and the chain.
pub(super) const SEED: u64 = 7;

/// What is measured: the built-in face model and a rendered face of known truth.
pub struct Workload {
    /// The symmetric-full model of the template, rank 60 each.
    pub model: OwnedModel,
    /// The truth: a random instance (50 + 50 coefficients) under random light, turned by 15°, in
    /// a picture of 256 × 256 of which it covers [`Workload::covered`].
    pub scene: Scene,
    /// The picture of [`Workload::scene`], with noise, before a soft background.
    pub picture: Picture,
    /// Its landmarks, with errors of two pixels.
    pub landmarks: Tlms,
    /// Share of the picture that the face covers, some 0.4.
    pub covered: f64,
}

impl Workload {
    /// Builds the model and draws the picture; a few seconds, told to `progress` in `[0, 1]`.
    ///
    /// # Errors
    /// Never: everything it needs is built in.
    pub fn new(progress: &mut dyn FnMut(f64)) -> Result<Self> {
        let owned = demo::template_model(RANK, &mut |done, _| progress(done))?.model;
        let model = owned.view();
        let config = Config::default();
        let mut rng = Rng::new(SEED, 0);
        let mut coefficients = |rank| Coefficients::from_iter(random_coefficients(rank, &mut rng));
        let (shape, albedo) = (coefficients(config.shape_rank), coefficients(config.albedo_rank));
        let subject = Subject { shape, albedo };
        let mut scene = Scene { subject, view: View::initial(SIZE[0], SIZE[1]) };
        scene.view.pose.yaw = 15_f32.to_radians();
        demo::random_light(&mut scene, &mut rng);
        let covered = frame(&model, &mut scene)?;

        let mesh = render::instance(&model, &scene.subject.shape, &scene.subject.albedo);
        let rigid = layout::rigid(&mesh, &demo::template()?.1)?;
        let seen = Scene { subject: Subject::default(), view: scene.view };
        let (picture, landmarks) =
            demo::synthetic_photo(&rigid.view(), &seen, 0.02, &demo::FIT_LANDMARKS, &mut rng)?;
        Ok(Self { model: owned, scene, picture, landmarks, covered })
    }

    /// The landmarks in the form a chain takes.
    pub fn observed(&self) -> Vec<ObservedLandmark<'_>> {
        let visible = self.landmarks.visible();
        visible.map(|l| ObservedLandmark { name: &l.id, position: [l.x, l.y] }).collect()
    }

    /// The fit of `model` (a view of [`Workload::model`]) to the picture.
    pub fn problem<'a>(
        &'a self,
        model: &'a Model<'a>,
        landmarks: &'a [ObservedLandmark<'a>],
        config: &'a Config,
    ) -> Problem<'a> {
        let Picture { width, height, ref rgb } = self.picture;
        let image = Image { pixels: rgb, width, height };
        Problem::new(model, image, landmarks, config).with_engine(simd::best())
    }
}

/// Zooms until the model covers [`COVERED`] of the picture; returns how much it then covers.
fn frame(model: &Model<'_>, scene: &mut Scene) -> Result<f64> {
    let [width, height] = scene.view.camera.image_size.map(|side| side as usize);
    let mut memory = vec![0; draw_words(model.vertices(), width, height)];
    let mut pixels = vec![[0.0; 3]; width * height];
    let mut covered = |scene: &Scene| {
        let count = draw(model, scene, &mut memory, &mut pixels).unwrap_or(0);
        if count == 0 {
            return Err(Error::new("the face is out of the picture"));
        }
        Ok(count as f64 / (width * height) as f64)
    };
    for _ in 0..3 {
        scene.view.camera.focal_length *= (COVERED / covered(scene)?).sqrt() as f32;
    }
    covered(scene)
}
