//! Landmarks of faces in photos, found by MediaPipe's two networks.
//!
//! The same bits on every machine: the networks' sums have one order ([`network`]), and what is around them
//! goes through the core's mathematics.

mod detect;
mod names;
mod network;
mod tflite;

use crate::error::{Error, Result};
use crate::photo::picture::Picture;
use crate::photo::tlms::{Landmark2, Tlms};
use detect::{Found, Square, detect};
use network::Network;
use std::f32::consts::{FRAC_PI_2, PI};

/// Parts of a photo of fewer pixels across are not searched: their faces are too small to fit.
const SMALLEST_PART: f32 = 192.0;

/// Finds faces and their landmarks.
#[derive(Debug)]
pub struct Detector {
    detector: Network,
    mesh: Network,
}

/// A face in a photo.
#[derive(Clone, Debug, PartialEq)]
pub struct Face {
    /// The centre of its box, pixels.
    pub center: [f32; 2],
    /// The longer side of its box, pixels: from the brows to the chin or so.
    pub size: f32,
    /// How sure the detector is, ½ to 1.
    pub score: f32,
    /// The 468 points of the mesh, pixels; whole numbers are centres of pixels.
    pub points: Vec<[f32; 2]>,
}

impl Face {
    /// Its landmarks by our names.
    pub fn landmarks(&self) -> Tlms {
        let landmark = |(id, [x, y]): (String, [f32; 2])| Landmark2 { id, visible: true, x, y };
        Tlms { landmarks: names::places(&self.points).into_iter().map(landmark).collect() }
    }
}

impl Detector {
    /// Of the contents of `face_detection_short_range.tflite` and `face_landmark.tflite`.
    ///
    /// # Errors
    /// Saying which of both is damaged, or is another network.
    pub fn new(detector: &[u8], mesh: &[u8]) -> Result<Self> {
        let read = |name: &str, bytes: &[u8], input: usize, outputs: &[usize]| {
            let network = tflite::read(bytes)
                .map_err(|fault| Error::new(format_args!("{name}.tflite: {fault}")))?;
            if network.input_shape() != [input, input, 3] || network.output_lengths() != outputs {
                return Err(Error::new(format_args!("{name}.tflite: another network")));
            }
            Ok(network)
        };
        Ok(Self {
            detector: read("face_detection_short_range", detector, 128, &[896 * 16, 896])?,
            mesh: read("face_landmark", mesh, 192, &[468 * 3, 1])?,
        })
    }

    /// With the networks that the program carries.
    ///
    /// # Panics
    /// Never: that they are whole is tested.
    #[cfg(feature = "full")]
    pub fn embedded() -> Self {
        const DETECTOR: &[u8] =
            include_bytes!("../../../fixtures/face_mesh/face_detection_short_range.tflite");
        const MESH: &[u8] = include_bytes!("../../../fixtures/face_mesh/face_landmark.tflite");
        Self::new(DETECTOR, MESH).expect("the networks are whole")
    }

    /// The faces of a photo, the largest first.
    ///
    /// Faces below a seventh of what the detector sees are overlooked, and so are those that are turned by more
    /// than 45° or so: if there is none in the whole photo, it is looked at from its other sides, then
    /// overlapping squares of half, then a quarter its size are searched.
    pub fn faces(&self, photo: &Picture) -> Vec<Face> {
        let [width, height] = [photo.width, photo.height].map(|side| side as f32);
        let side = width.max(height);
        let center = [0.5 * width, 0.5 * height];
        let whole =
            [0.0, -FRAC_PI_2, FRAC_PI_2, PI].map(|turn| vec![Square { center, side, turn }]);
        let parts = [0.5 * side, 0.25 * side].map(|side| {
            let squares = |y: f32| centers(width, side).map(move |x| [x, y]);
            let centers = centers(height, side).flat_map(squares);
            let squares = centers.map(|center| Square { center, side, turn: 0.0 });
            if side < SMALLEST_PART { Vec::new() } else { squares.collect() }
        });
        for squares in whole.into_iter().chain(parts) {
            let mut found: Vec<Found> = Vec::new();
            for square in squares {
                for face in detect(&self.detector, photo, square) {
                    let same = |other: &&mut Found| {
                        let apart = [0, 1].map(|axis| face.center[axis] - other.center[axis]);
                        let near = 0.5 * other.size.max(face.size);
                        apart[0] * apart[0] + apart[1] * apart[1] < near * near
                    };
                    match found.iter_mut().find(same) {
                        Some(other) if other.score < face.score => *other = face,
                        Some(_) => (),
                        None => found.push(face),
                    }
                }
            }
            let mut faces: Vec<Face> =
                found.iter().filter_map(|face| self.face(photo, face)).collect();
            if !faces.is_empty() {
                faces.sort_by(|a, b| b.size.total_cmp(&a.size));
                return faces;
            }
        }
        Vec::new()
    }

    /// A face with its points, if the mesh sees one there too.
    fn face(&self, photo: &Picture, found: &Found) -> Option<Face> {
        let (points, presence) = detect::points(&self.mesh, photo, found);
        let &Found { center, size, score, .. } = found;
        (presence >= 0.5).then_some(Face { center, size, score, points })
    }
}

/// Centres of parts that cover a length and overlap by half or more.
fn centers(length: f32, side: f32) -> impl Iterator<Item = f32> {
    let steps = (2.0 * (length - side) / side).ceil().max(0.0);
    let first = if steps == 0.0 { 0.5 * length } else { 0.5 * side };
    let step = if steps == 0.0 { 0.0 } else { (length - side) / steps };
    (0..=steps as u32).map(move |i| first + step * i as f32)
}
