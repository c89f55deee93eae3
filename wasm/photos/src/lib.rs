//! The browser's door to photos in files.
//!
//! It is a module of its own, since most of a page is there before somebody has a photo.

use onescan::photo;
use onescan::photo::picture::Picture;
use wasm_bindgen::prelude::*;

/// A photo that was in a file.
#[wasm_bindgen]
pub struct Decoded(Picture);

/// Decodes a PNG or JPEG as the command does, to the last bit; EXIF orientation is applied.
///
/// # Errors
/// Other formats, damaged files, pictures that are too large.
#[wasm_bindgen]
pub fn decode(bytes: &[u8]) -> Result<Decoded, JsError> {
    Ok(Decoded(photo::decode(bytes)?))
}

#[wasm_bindgen]
impl Decoded {
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

    /// RGB bytes of all pixels, row by row; the photo is given away with them.
    #[wasm_bindgen(js_name = intoRgb)]
    pub fn into_rgb(self) -> Vec<u8> {
        self.0.rgb.into_flattened()
    }
}
