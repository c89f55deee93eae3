//! What a mesh looks like.

use crate::error::Result;
use crate::photo::picture::Picture;

/// The colours of a mesh, in place of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct Skin {
    /// The colours, sRGB.
    pub colors: Colors,
    /// Whether a viewer is to light them: no, if light is in them.
    pub lit: bool,
}

impl Skin {
    /// Whether there is a picture.
    pub fn textured(&self) -> bool {
        matches!(self.colors, Colors::Texture(_))
    }
}

/// Where colours are kept.
#[derive(Clone, Debug, PartialEq)]
pub enum Colors {
    /// At the vertices, in `[0, 1]`.
    Vertices(Vec<[f32; 3]>),
    /// In a picture.
    Texture(Texture),
}

/// A picture laid on a mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// Where the vertices are in it: in `[0, 1]`, v down.
    pub uvs: Vec<[f32; 2]>,
    /// The picture.
    pub picture: Picture,
    /// The same as a PNG file.
    pub png: Vec<u8>,
}

impl Texture {
    /// Lays a picture on a mesh.
    ///
    /// # Errors
    /// A picture without pixels.
    pub fn new(uvs: Vec<[f32; 2]>, picture: Picture) -> Result<Self> {
        Ok(Self { uvs, png: picture.to_png()?, picture })
    }
}
