//! The browser's door to onescan: models, photos, fits and a viewer as JavaScript classes.
//!
//! It converts, calls and maps errors; the fit is the core's, files and pictures are the host's.
//! What surrounds it (the worker, the page, types) is in `js/` and `page/`.

mod fit;
mod viewer;

use onescan::error::{Error, Result};
use onescan::model_file::OwnedModel;
use onescan::photo::picture::Picture;
use onescan_core::model::Model as CoreModel;
use self_cell::self_cell;
use std::rc::Rc;
use wasm_bindgen::prelude::*;

self_cell!(
    /// A model's bytes and the view of them: they are checked once.
    pub(crate) struct Opened {
        owner: OwnedModel,
        #[covariant]
        dependent: CoreModel,
    }
);

/// A morphable model.
#[wasm_bindgen]
pub struct Model(Rc<Opened>);

#[wasm_bindgen]
impl Model {
    /// Copies and checks the bytes of a `.3dmm` file.
    ///
    /// # Errors
    /// Bytes that are not a model.
    #[wasm_bindgen(constructor)]
    pub fn new(bytes: &[u8]) -> Result<Model, JsError> {
        let opened = Opened::try_new(OwnedModel::from_bytes(bytes)?, |owner| {
            CoreModel::new_checked(owner.bytes()).map_err(Error::new)
        })?;
        Ok(Self(Rc::new(opened)))
    }

    /// Number of vertices.
    #[wasm_bindgen(getter)]
    pub fn vertices(&self) -> usize {
        self.view().vertices()
    }

    /// Number of shape components.
    #[wasm_bindgen(getter, js_name = shapeRank)]
    pub fn shape_rank(&self) -> usize {
        self.view().shape.rank()
    }

    /// Number of albedo components.
    #[wasm_bindgen(getter, js_name = albedoRank)]
    pub fn albedo_rank(&self) -> usize {
        self.view().albedo.rank()
    }

    /// Names of the landmarks.
    #[wasm_bindgen(getter)]
    pub fn landmarks(&self) -> Vec<String> {
        self.view().landmarks().map(|(name, _)| name.to_owned()).collect()
    }

    /// Where the model comes from, `key = value` lines.
    #[wasm_bindgen(getter)]
    pub fn provenance(&self) -> String {
        self.view().provenance().to_owned()
    }

    fn view(&self) -> &CoreModel<'_> {
        self.0.borrow_dependent()
    }
}

/// A photo in memory.
#[wasm_bindgen]
pub struct Photo(Rc<Picture>);

#[wasm_bindgen]
impl Photo {
    /// A photo of RGBA bytes, alpha ignored.
    ///
    /// # Errors
    /// Another number of bytes than the size says.
    #[wasm_bindgen(js_name = fromRgba)]
    pub fn from_rgba(width: u32, height: u32, rgba: &[u8]) -> Result<Photo, JsError> {
        Self::of_pixels(width, height, rgba, |&[r, g, b, _]| [r, g, b])
    }

    /// A photo of RGB bytes.
    ///
    /// # Errors
    /// Another number of bytes than the size says.
    #[wasm_bindgen(js_name = fromRgb)]
    pub fn from_rgb(width: u32, height: u32, rgb: &[u8]) -> Result<Photo, JsError> {
        Self::of_pixels(width, height, rgb, |&rgb| rgb)
    }

    /// The same photo once more, for a fit to take; its pixels are not copied.
    #[must_use]
    #[expect(clippy::should_implement_trait, reason = "it is for JavaScript")]
    pub fn clone(&self) -> Photo {
        Self(Rc::clone(&self.0))
    }

    /// Columns.
    #[wasm_bindgen(getter)]
    pub fn width(&self) -> u32 {
        self.0.width
    }

    /// Rows.
    #[wasm_bindgen(getter)]
    pub fn height(&self) -> u32 {
        self.0.height
    }

    /// RGB bytes of all pixels, row by row.
    pub fn rgb(&self) -> Vec<u8> {
        self.0.rgb.as_flattened().to_vec()
    }

    /// The photo, shrunk if a side is longer than `limit`.
    pub fn shown(&self, limit: u32) -> Pixels {
        let longer = self.0.width.max(self.0.height);
        if longer <= limit {
            return Pixels(Picture::clone(&self.0));
        }
        let side = |side: u32| (u64::from(side) * u64::from(limit) / u64::from(longer)) as u32;
        Pixels(self.0.resized(side(self.0.width).max(1), side(self.0.height).max(1)))
    }

    fn of_pixels<const N: usize>(
        width: u32,
        height: u32,
        bytes: &[u8],
        rgb: impl Fn(&[u8; N]) -> [u8; 3],
    ) -> Result<Photo, JsError> {
        let (pixels, rest) = bytes.as_chunks();
        let area = u64::from(width) * u64::from(height);
        if pixels.is_empty() || !rest.is_empty() || pixels.len() as u64 != area {
            let found = bytes.len();
            return Err(JsError::new(&format!("{found} bytes are not {width}×{height} pixels")));
        }
        let rgb = pixels.iter().map(rgb).collect();
        Ok(Self(Rc::new(Picture { width, height, rgb })))
    }
}

/// A picture to show.
#[wasm_bindgen]
pub struct Pixels(Picture);

#[wasm_bindgen]
impl Pixels {
    /// Columns.
    #[wasm_bindgen(getter)]
    pub fn width(&self) -> u32 {
        self.0.width
    }

    /// Rows.
    #[wasm_bindgen(getter)]
    pub fn height(&self) -> u32 {
        self.0.height
    }

    /// RGBA bytes, as `ImageData` takes them.
    pub fn rgba(&self) -> Vec<u8> {
        self.0.rgb.iter().flat_map(|&[r, g, b]| [r, g, b, 255]).collect()
    }

    /// A PNG file.
    ///
    /// # Errors
    /// A picture without pixels.
    pub fn png(&self) -> Result<Vec<u8>, JsError> {
        Ok(self.0.to_png()?)
    }
}

/// A file to save.
#[wasm_bindgen(getter_with_clone)]
#[derive(Clone)]
pub struct File {
    /// What it is called.
    pub name: String,
    /// What is in it.
    pub bytes: Vec<u8>,
}
