//! The browser's door to landmarks: faces in pictures.
//!
//! It is a module of its own, since it is loaded only when asked for, and compiled for speed instead of
//! size.

use onescan::error::Error;
use onescan::face_mesh;
use onescan::photo::picture::Picture;
use wasm_bindgen::prelude::*;

/// Finds faces in photos, by MediaPipe's networks.
#[wasm_bindgen]
pub struct Detector(face_mesh::Detector);

#[wasm_bindgen]
impl Detector {
    /// Of the contents of `face_detection_short_range.tflite` and `face_landmark.tflite`.
    ///
    /// # Errors
    /// Saying which of both is damaged, or is another network.
    #[wasm_bindgen(constructor)]
    pub fn new(detector: &[u8], mesh: &[u8]) -> Result<Detector, JsError> {
        Ok(Self(face_mesh::Detector::new(detector, mesh)?))
    }

    /// The faces of a photo of RGB bytes, the largest first.
    ///
    /// # Errors
    /// Another number of bytes than the size says.
    pub fn faces(&self, width: u32, height: u32, rgb: &[u8]) -> Result<Vec<Face>, JsError> {
        let (pixels, rest) = rgb.as_chunks();
        let area = u64::from(width) * u64::from(height);
        if pixels.is_empty() || !rest.is_empty() || pixels.len() as u64 != area {
            let found = rgb.len();
            return Err(
                Error::new(format_args!("{found} bytes are not {width}×{height} pixels")).into()
            );
        }
        let found = |face: face_mesh::Face| Face {
            x: face.center[0],
            y: face.center[1],
            size: face.size,
            landmarks: face.landmarks().to_text(),
        };
        let photo = Picture { width, height, rgb: pixels.to_vec() };
        Ok(self.0.faces(&photo).into_iter().map(found).collect())
    }
}

/// A face in a photo.
#[wasm_bindgen(getter_with_clone)]
pub struct Face {
    /// Centre of its box, pixels from the centre of the left column.
    pub x: f32,
    /// The same from the top row, down.
    pub y: f32,
    /// The longer side of its box, pixels.
    pub size: f32,
    /// The text of a `.tlms` file.
    pub landmarks: String,
}
