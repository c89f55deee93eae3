//! A face to play with: any coefficients, from any side, in any light.

use crate::fit::{Ended, Fitted};
use crate::{File, Model, Opened, Pixels};
use onescan::error::{Error, Result};
use onescan::fit::summary::Summary;
use onescan::mesh::Mesh;
use onescan::mesh::glb;
use onescan::mesh::ply::{self, Encoding};
use onescan::mesh::skin::Skin;
use onescan::render;
use onescan::texture::{self, Kind};
use onescan_core::color::ColorTransform;
use onescan_core::light::{Light, ambient_diffuse, ambient_white, frontal};
use onescan_core::rng::Rng;
use onescan_core::scene::{Coefficients, MAX_RANK, Scene, Subject, View};
use std::rc::Rc;
use wasm_bindgen::prelude::*;

/// Samples along a side of a pixel that is finely drawn.
const FINER: u32 = 2;

/// A model's instance, drawn by the core's rasterizer.
#[wasm_bindgen]
pub struct Viewer {
    model: Rc<Opened>,
    shape: Vec<f32>,
    albedo: Vec<f32>,
    light: Light,
    color: ColorTransform,
    dress: Option<Dress>,
}

/// The colours of a fit's photos, for the faces of the albedo that was fitted.
struct Dress {
    fit: Rc<Ended>,
    /// Without light.
    skin: Rc<Skin>,
    albedo: Vec<f32>,
}

#[wasm_bindgen]
impl Viewer {
    /// The model's mean under frontal light.
    #[wasm_bindgen(constructor)]
    pub fn new(model: &Model) -> Viewer {
        let view = model.0.borrow_dependent();
        let zeros = |rank: usize| vec![0.0; rank.min(MAX_RANK)];
        Self {
            shape: zeros(view.shape.rank()),
            albedo: zeros(view.albedo.rank()),
            light: frontal(),
            color: ColorTransform::NEUTRAL,
            dress: None,
            model: Rc::clone(&model.0),
        }
    }

    /// Shape coefficients, standard deviations.
    #[wasm_bindgen(getter)]
    pub fn shape(&self) -> Vec<f32> {
        self.shape.clone()
    }

    /// Albedo coefficients, standard deviations.
    #[wasm_bindgen(getter)]
    pub fn albedo(&self) -> Vec<f32> {
        self.albedo.clone()
    }

    /// Sets coefficients; those not given are 0, what is not a number too.
    pub fn set(&mut self, shape: &[f32], albedo: &[f32]) {
        for (own, new) in [(&mut self.shape, shape), (&mut self.albedo, albedo)] {
            let finite = |x: &f32| if x.is_finite() { *x } else { 0.0 };
            let new = new.iter().map(finite).chain(std::iter::repeat(0.0));
            own.iter_mut().zip(new).for_each(|(own, new)| *own = new);
        }
    }

    /// A random face.
    pub fn random(&mut self, seed: u32) {
        let mut rng = Rng::new(seed.into(), 0);
        self.shape = render::random_coefficients(self.shape.len(), &mut rng);
        self.albedo = render::random_coefficients(self.albedo.len(), &mut rng);
    }

    /// The face of a fit.
    pub fn adopt(&mut self, fitted: &Fitted) {
        if let Some(Summary { parameters, .. }) = fitted.0.summaries.first() {
            self.set(&parameters.subject.shape, &parameters.subject.albedo);
        }
    }

    /// Lays the colours of a fit's photos on its face, of any shape, as long as its albedo is the fitted
    /// one. Made when first asked for, which takes some tenths of a second.
    ///
    /// # Errors
    /// None of a fit that came to its end.
    pub fn dress(&mut self, fitted: &Fitted) -> Result<(), JsError> {
        let fit = Rc::clone(&fitted.0);
        let first = fit.summaries.first();
        let albedo = first.map(|summary| summary.parameters.subject.albedo.to_vec());
        let (skin, albedo) = (fit.skin(Kind::Albedo)?, albedo.unwrap_or_default());
        self.dress = Some(Dress { fit, skin, albedo });
        Ok(())
    }

    /// Takes them off.
    pub fn undress(&mut self) {
        self.dress = None;
    }

    /// Light by name: `front`, `left`, `right`, `above`, `even`.
    ///
    /// # Errors
    /// Other names.
    pub fn illuminate(&mut self, name: &str) -> Result<(), JsError> {
        let from = |direction| ambient_diffuse([0.45; 3], [0.65; 3], direction);
        self.light = match name {
            "front" => frontal(),
            "left" => from([-0.8, 0.1, 0.6]),
            "right" => from([0.8, 0.1, 0.6]),
            "above" => from([0.0, 0.9, 0.44]),
            "even" => ambient_white(),
            _ => return Err(JsError::new(&format!("no light is called {name}"))),
        };
        self.color = ColorTransform::NEUTRAL;
        Ok(())
    }

    /// The light and the colours of a fitted photo; of the first if there is none of this number.
    #[wasm_bindgen(js_name = illuminateAs)]
    pub fn illuminate_as(&mut self, fitted: &Fitted, photo: Option<usize>) {
        let all = &fitted.0.summaries;
        if let Some(Summary { parameters, .. }) = all.get(photo.unwrap_or(0)).or(all.first()) {
            (self.light, self.color) = (parameters.view.light, parameters.view.color);
        }
    }

    /// Draws it on a ground of one colour (`0xrrggbb`), turned by radians; `fine` with smooth edges, which
    /// takes four times as long.
    pub fn draw(
        &self,
        width: u32,
        height: u32,
        yaw: f32,
        pitch: f32,
        ground: u32,
        fine: bool,
    ) -> Pixels {
        let model = self.model.borrow_dependent();
        let [_, r, g, b] = ground.to_be_bytes();
        let shown = [width, height].map(|side| side.clamp(1, 2048));
        let size = shown.map(|side| if fine { FINER * side } else { side });
        let portrait = render::portrait(model, size, yaw, pitch);
        let coefficients = |values: &[f32]| {
            // As long as the model's rank or MAX_RANK, made so.
            Coefficients::from_slice(values).unwrap_or_default()
        };
        let scene = Scene {
            subject: Subject {
                shape: coefficients(&self.shape),
                albedo: coefficients(&self.albedo),
            },
            view: View { light: self.light, color: self.color, ..portrait.view },
        };
        let ground = [r, g, b];
        let drawn = match self.worn() {
            Some(dress) => texture::show(model, &scene, &dress.skin, ground),
            None => render::draw_on(model, &scene, ground),
        };
        Pixels(if fine { drawn.resized(shown[0], shown[1]) } else { drawn })
    }

    /// Where a landmark of the model's mean is in such a picture; nothing if it has none of that
    /// name.
    pub fn locate(&self, name: &str, width: u32, height: u32, yaw: f32, pitch: f32) -> Vec<f32> {
        let model = self.model.borrow_dependent();
        let Some(vertex) = model.landmark(name) else { return Vec::new() };
        let scene = render::portrait(model, [width, height], yaw, pitch);
        let mean = render::instance(model, &[], &[]);
        let point = mean.points.get(vertex as usize).copied().unwrap_or_default();
        let (x, y, _) = scene.view.camera.project(scene.view.pose.to_world(point));
        vec![x, y]
    }

    /// The face as `face.glb`, with the photo's colours if they are laid on it, and `face.ply`.
    ///
    /// # Errors
    /// None for a model that was opened.
    pub fn files(&self) -> Result<Vec<File>, JsError> {
        let mesh = render::instance(self.model.borrow_dependent(), &self.shape, &self.albedo);
        let bytes = match self.worn() {
            Some(dress) => glb::encode_with(&mesh, &*dress.fit.skin(Kind::Photo)?, "face")?,
            None => glb::encode(&mesh, "face")?,
        };
        Ok(vec![
            File { name: "face.glb".into(), bytes },
            File { name: "face.ply".into(), bytes: ply(&mesh)? },
        ])
    }
}

impl Viewer {
    /// What the face wears: nothing if its albedo is another than the fitted.
    fn worn(&self) -> Option<&Dress> {
        let fitted = |dress: &&Dress| {
            let mut both = self.albedo.iter().zip(&dress.albedo);
            both.all(|(own, fitted)| own == fitted)
        };
        self.dress.as_ref().filter(fitted)
    }
}

fn ply(mesh: &Mesh) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    ply::write(&mut bytes, mesh, Encoding::default()).map_err(Error::new)?;
    Ok(bytes)
}
