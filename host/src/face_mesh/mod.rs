//! Landmarks of faces in photos, found by MediaPipe's two networks.
//!
//! The same bits on every machine: the networks' sums have one order, and what is around them
//! goes through the core's mathematics.

mod detect;
mod network;
#[cfg(feature = "full")]
pub mod scan;
mod tflite;

use crate::error::{Error, Result};
use crate::photo::picture::Picture;
#[cfg(feature = "full")]
use crate::photo::tlms::MIN_VISIBLE;
use crate::photo::tlms::Tlms;
use detect::{Found, Square, detect};
use network::Network;
use std::f32::consts::{FRAC_PI_2, PI};
#[cfg(feature = "full")]
use std::{path::Path, sync::LazyLock};

/// Parts of a photo of fewer pixels across are not searched: their faces are too small to fit. Chosen, not
/// measured.
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
    /// The photo's size, pixels.
    pub photo: [u32; 2],
}

impl Face {
    /// Its landmarks by our names, without those that lie beyond the photo's edge.
    pub fn landmarks(&self) -> Tlms {
        let mut landmarks = Tlms::of_mesh(&self.points);
        landmarks.keep_within(self.photo);
        landmarks
    }
}

impl Detector {
    /// Makes one of the contents of `face_detection_short_range.tflite` and `face_landmark.tflite`.
    ///
    /// # Errors
    /// A file that is damaged or holds another network; the message says which of the two.
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

    /// The one with the networks that the program carries.
    ///
    /// # Panics
    /// Never: that they are whole is tested.
    #[cfg(feature = "full")]
    pub fn embedded() -> &'static Self {
        const DETECTOR: &[u8] = include_bytes!("../../networks/face_detection_short_range.tflite");
        const MESH: &[u8] = include_bytes!("../../networks/face_landmark.tflite");
        static EMBEDDED: LazyLock<Detector> =
            LazyLock::new(|| Detector::new(DETECTOR, MESH).expect("the networks are whole"));
        &EMBEDDED
    }

    /// The faces of a photo, the largest first.
    ///
    /// The detector overlooks faces smaller than a seventh of what it sees, and takes those turned by more than 45°
    /// or so for others: of a face upside down it sees brows in the chin. So the photo is turned by quarters as
    /// well, and the surest of what is seen in one place counts. If there is no face in the whole photo,
    /// overlapping squares of half its size, then of a quarter, are searched.
    pub fn faces(&self, photo: &Picture) -> Vec<Face> {
        let [width, height] = [photo.width, photo.height].map(|side| side as f32);
        let side = width.max(height);
        let center = [0.5 * width, 0.5 * height];
        let mut faces = Vec::new();
        self.search(photo, Square { center, side, turn: 0.0 }, true, &mut faces);
        // What is seen in a turned photo alone is a face only if there is no other.
        let alone = faces.is_empty();
        for turn in [-FRAC_PI_2, FRAC_PI_2, PI] {
            self.search(photo, Square { center, side, turn }, alone, &mut faces);
        }
        for side in [0.5 * side, 0.25 * side] {
            if !faces.is_empty() || side < SMALLEST_PART {
                break;
            }
            for y in centers(height, side) {
                for x in centers(width, side) {
                    let square = Square { center: [x, y], side, turn: 0.0 };
                    self.search(photo, square, true, &mut faces);
                }
            }
        }
        faces.sort_by(|a, b| b.size.total_cmp(&a.size));
        faces
    }

    /// Puts the faces of a square among those that were found: the surer ones in their places, and, if `more`,
    /// those where nothing was.
    fn search(&self, photo: &Picture, square: Square, more: bool, faces: &mut Vec<Face>) {
        let seen = detect(&self.detector, photo, square);
        for face in seen.iter().filter_map(|found| self.face(photo, found)) {
            let same = |other: &&mut Face| {
                let apart = [0, 1].map(|axis| face.center[axis] - other.center[axis]);
                let near = 0.5 * other.size.max(face.size);
                apart[0] * apart[0] + apart[1] * apart[1] < near * near
            };
            match faces.iter_mut().find(same) {
                Some(other) if other.score < face.score => *other = face,
                None if more => faces.push(face),
                _ => (),
            }
        }
    }

    /// A face with its points, if the mesh sees one there too.
    fn face(&self, photo: &Picture, found: &Found) -> Option<Face> {
        let (points, presence) = detect::points(&self.mesh, photo, found);
        let &Found { center, size, score, .. } = found;
        let photo = [photo.width, photo.height];
        (presence >= 0.5).then_some(Face { center, size, score, points, photo })
    }
}

/// Landmarks of a photo, read from a file or found.
#[cfg(feature = "full")]
#[derive(Clone, Debug)]
pub struct Marked {
    /// The landmarks.
    pub landmarks: Tlms,
    /// Whether they were found, not read.
    pub found: bool,
    /// If there are several faces, a sentence that says which one this is.
    pub note: Option<String>,
    /// What speaks against landmarks that were read, as a sentence: they lie where there is no face, but
    /// there is one elsewhere.
    pub doubt: Option<String>,
    /// Whether a model need not know all of their names.
    some: bool,
}

#[cfg(feature = "full")]
impl Marked {
    /// Reads the landmarks of a photo, or finds those of its face of this number by size, from 1.
    ///
    /// # Errors
    /// Those of [`Tlms::read`], which name the file; no face, or no face of that number.
    pub fn read(file: Option<&Path>, photo: &Picture, number: usize) -> Result<Self> {
        if let Some(file) = file {
            let landmarks = Tlms::read(file, [photo.width, photo.height])?;
            let some = Tlms::is_numbered(file);
            let doubt = astray(&landmarks, photo);
            return Ok(Self { landmarks, found: false, note: None, doubt, some });
        }
        let faces = Detector::embedded().faces(photo);
        if faces.is_empty() {
            return Err(Error::new(
                "no face found; mark its landmarks yourself (docs/landmarks.md) and name the file by \
                 --landmarks",
            ));
        }
        let name = |(i, face): (usize, &Face)| {
            let [x, y] = face.center.map(f32::round);
            format!("{} at ({x}, {y}), {} pixels", i + 1, face.size.round())
        };
        let all = faces.iter().enumerate().map(name).collect::<Vec<_>>().join("; ");
        let index = number.wrapping_sub(1);
        let Some(face) = faces.get(index) else {
            let what = if faces.len() == 1 { "the only one is" } else { "there are only" };
            return Err(Error::new(format_args!("no face {number}; {what} {all}")));
        };
        let note = (faces.len() > 1)
            .then(|| format!("face {number} of {} (another by --face): {all}", faces.len()));
        Ok(Self { landmarks: face.landmarks(), found: true, note, doubt: None, some: true })
    }

    /// Reads a photo, and its landmarks or those of its largest face.
    ///
    /// # Errors
    /// A photo that cannot be read or shows no face, and those of [`Marked::read`]; all name the file.
    pub fn with_photo(path: &Path, landmarks: Option<&Path>) -> Result<(Picture, Self)> {
        let picture = crate::photo::read(path)?;
        let marked = match Self::read(landmarks, &picture, 1) {
            // What is wrong with a file of landmarks names it.
            Err(e) if landmarks.is_none() => return Err(Error::file(path, e)),
            marked => marked?,
        };
        Ok((picture, marked))
    }

    /// The landmarks that a model with landmarks of these names can use.
    ///
    /// # Errors
    /// Landmarks that were found, if fewer are left than a fit needs.
    pub fn known(&self, names: &[&str]) -> Result<Tlms> {
        let mut known = self.landmarks.clone();
        if self.some {
            known.keep(names);
        }
        if self.found && self.landmarks.landmarks.len() < MIN_VISIBLE {
            return Err(Error::new(
                "the photo's edge cuts off too much of the face; mark what is to be seen of it and name the \
                 file by --landmarks",
            ));
        }
        if self.found && known.landmarks.len() < MIN_VISIBLE {
            return Err(Error::new(
                "the model's landmarks are no face's, so that they cannot be found; mark them in the \
                 photo and name the file by --landmarks",
            ));
        }
        Ok(known)
    }
}

/// Landmarks in a photo that on average lie farther than this from where those of a face are found, in parts of
/// its size, are no landmarks of it. Set by hand they are off by .015 to .045 (the demo's photos and 40 rough
/// pictures up to 45°), those of one of the demo's photos on another by .66 and more.
#[cfg(feature = "full")]
const ASTRAY: f32 = 0.2;

/// Whether landmarks lie on none of the photo's faces, as a sentence; never, if no face is found.
#[cfg(feature = "full")]
fn astray(landmarks: &Tlms, photo: &Picture) -> Option<String> {
    let known = |face: &Face| {
        let found = face.landmarks();
        let apart: Vec<f32> = (landmarks.visible())
            .filter_map(|l| {
                let own = found.landmarks.iter().find(|own| own.id == l.id)?;
                Some((own.x - l.x).hypot(own.y - l.y))
            })
            .collect();
        let mean = apart.iter().sum::<f32>() / apart.len() as f32;
        (apart.len() >= MIN_VISIBLE).then_some((mean / face.size, face.center))
    };
    let names = Tlms::of_mesh(&[[0.0; 2]; 468]);
    if !landmarks.visible().any(|l| names.landmarks.iter().any(|own| own.id == l.id)) {
        return None;
    }
    let faces = Detector::embedded().faces(photo);
    let nearest = faces.iter().filter_map(known).min_by(|a, b| a.0.total_cmp(&b.0));
    let (_, [x, y]) = nearest.filter(|(apart, _)| *apart > ASTRAY)?;
    Some(format!(
        "the landmarks lie on no face; the nearest that is found is at ({x:.0}, {y:.0}): are they another \
         photo's?"
    ))
}

/// Centres of parts that cover a length and overlap by half or more.
fn centers(length: f32, side: f32) -> impl Iterator<Item = f32> {
    let steps = (2.0 * (length - side) / side).ceil().max(0.0);
    let first = if steps == 0.0 { 0.5 * length } else { 0.5 * side };
    let step = if steps == 0.0 { 0.0 } else { (length - side) / steps };
    (0..=steps as u32).map(move |i| first + step * i as f32)
}

#[cfg(all(test, feature = "full"))]
mod tests {
    use super::*;
    use crate::photo;
    use onescan_core::rng::Rng;
    use std::path::PathBuf;

    fn fixture(name: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures").join(name)
    }

    fn photo(name: &str) -> Picture {
        photo::read(&fixture("photos").join(name)).unwrap()
    }

    /// Distances of landmarks from where they are, as parts of the distance of the eyes (their outer
    /// corners), in rising order.
    fn errors(found: &Tlms, truth: &Tlms) -> Vec<f32> {
        let named = |name: &str| truth.landmarks.iter().find(|l| l.id == name);
        let apart = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let [right, left] = ["right", "left"]
            .map(|side| named(&format!("{side}.eye.corner_outer")).map(|l| [l.x, l.y]).unwrap());
        let error = |l: &crate::photo::tlms::Landmark2| {
            let truth = named(&l.id)?;
            Some(apart([l.x, l.y], [truth.x, truth.y]) / apart(right, left))
        };
        let mut errors: Vec<f32> = found.landmarks.iter().filter_map(error).collect();
        errors.sort_by(f32::total_cmp);
        errors
    }

    #[test]
    fn landmarks_are_near_those_set_by_hand() {
        for name in ["astronaut.png", "grace_hopper.jpg", "obama.jpg"] {
            let picture = photo(name);
            let file = fixture("photos").join(name).with_extension("tlms");
            let truth = Tlms::read(&file, [picture.width, picture.height]).unwrap();
            let faces = Detector::embedded().faces(&picture);
            assert_eq!(faces.len(), 1, "{name}");
            let errors = errors(&faces[0].landmarks(), &truth);
            let median = errors[errors.len() / 2];
            println!("{name}: median {median}, most {:?}", errors.last());
            assert!(median < 0.03, "{name}: {median}");
            assert!(errors.iter().all(|&error| error < 0.12), "{name}: {errors:?}");
        }
    }

    /// A picture turned by a quarter to the left, and where its points are then.
    fn turned(picture: &Picture, points: &[[f32; 2]]) -> (Picture, Vec<[f32; 2]>) {
        let Picture { width, height, .. } = *picture;
        let pixel = |x, y| picture.pixel(width - 1 - y, x).unwrap_or_default();
        let place = |[x, y]: &[f32; 2]| [*y, (width - 1) as f32 - x];
        (Picture::from_fn(height, width, pixel), points.iter().map(place).collect())
    }

    #[test]
    fn a_photo_on_its_side_or_head_has_its_face_as_well() {
        for name in ["astronaut.png", "grace_hopper.jpg", "obama.jpg"] {
            let mut photo = photo(name);
            let upright = Detector::embedded().faces(&photo).remove(0);
            let mut points = upright.points;
            for _ in 0..3 {
                (photo, points) = turned(&photo, &points);
                let faces = Detector::embedded().faces(&photo);
                assert_eq!(faces.len(), 1, "{name}");
                let apart = points.iter().zip(&faces[0].points);
                let apart: Vec<f32> =
                    apart.map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]) / upright.size).collect();
                let mean = apart.iter().sum::<f32>() / apart.len() as f32;
                assert!(mean < 0.05 && apart.iter().all(|&x| x < 0.1), "{name}: mean {mean}");
            }
        }
    }

    #[test]
    fn faces_come_by_size_and_are_chosen_by_number() {
        let (large, small) = (photo("astronaut.png"), photo("grace_hopper.jpg").resized(256, 300));
        let both = Picture::from_fn(800, 512, |x, y| {
            let of_small = || small.pixel(x.wrapping_sub(520), y);
            large.pixel(x, y).or_else(of_small).unwrap_or_default()
        });
        let faces = Detector::embedded().faces(&both);
        let [first, second] = &faces[..] else { panic!("{} faces", faces.len()) };
        assert!(first.size > second.size && first.center[0] < 512.0 && second.center[0] > 520.0);
        let marked = Marked::read(None, &both, 2).unwrap();
        assert_eq!(marked.landmarks, second.landmarks());
        assert!(marked.note.unwrap().starts_with("face 2 of 2 (another by --face): 1 at ("));
        let error = Marked::read(None, &both, 3).unwrap_err().to_string();
        assert!(error.starts_with("no face 3; there are only 1 at ("), "{error}");
    }

    #[test]
    fn landmarks_beyond_the_photos_edge_are_left_out() {
        let whole = photo("astronaut.png");
        let all = Detector::embedded().faces(&whole)[0].landmarks();
        let outer = all.landmarks.iter().find(|l| l.id == "right.eye.corner_outer").unwrap();
        let from = outer.x as u32 + 12;
        let cut = whole.cropped(from, 0, whole.width - from, whole.height);
        let found = Marked::read(None, &cut, 1).unwrap().landmarks;
        let names: Vec<&str> = found.landmarks.iter().map(|l| l.id.as_str()).collect();
        assert!(!names.contains(&"right.eye.corner_outer") && names.len() > 20, "{names:?}");
        found.check(cut.width, cut.height, &names).unwrap();
    }

    #[test]
    fn a_small_face_in_a_large_photo_is_found_by_its_parts() {
        let small = photo("astronaut.png").resized(400, 400);
        let far = Picture::from_fn(1600, 1200, |x, y| {
            small.pixel(x.wrapping_sub(1200), y.wrapping_sub(700)).unwrap_or([90, 110, 120])
        });
        let [face] = &Detector::embedded().faces(&far)[..] else { panic!("one face") };
        let [x, y] = face.center;
        assert!((1350.0..1400.0).contains(&x) && (760.0..820.0).contains(&y), "{x} {y}");
    }

    #[test]
    fn where_there_is_no_face_none_is_found() {
        let mut rng = Rng::new(3, 0);
        let noise: Vec<[u8; 3]> = (0..400 * 300)
            .map(|_| std::array::from_fn(|_| rng.normal_sd(60.0).abs() as u8))
            .collect();
        let noise = Picture { width: 400, height: 300, rgb: noise };
        assert!(Detector::embedded().faces(&noise).is_empty());
        assert!(Detector::embedded().faces(&Picture::filled(1, 1, [0; 3])).is_empty());
        let error = Marked::read(None, &noise, 1).unwrap_err().to_string();
        assert!(error.starts_with("no face found; mark its landmarks yourself"), "{error}");
    }

    #[test]
    fn damaged_networks_are_refused_or_run() {
        let [detector, mesh] = ["face_detection_short_range", "face_landmark"].map(|name| {
            std::fs::read(fixture("face_mesh").join(name).with_extension("tflite")).unwrap()
        });
        let error = Detector::new(&mesh, &detector).unwrap_err().to_string();
        assert_eq!(error, "face_detection_short_range.tflite: another network");
        assert!(Detector::new(&detector[..detector.len() / 2], &mesh).is_err());
        assert!(Detector::new(b"TFL3TFL3", &mesh).is_err());
        let tables: Vec<usize> = (0..detector.len()).filter(|i| i % 4 == 0).collect();
        let mut rng = Rng::new(4, 0);
        let mut refused = 0;
        for _ in 0..400 {
            let mut damaged = detector.clone();
            // Most of a file are weights; what says where things are stands at the end.
            for _ in 0..=rng.below(4) {
                let at = tables[tables.len() - 1 - rng.below(6000) as usize];
                damaged[at + rng.below(4) as usize] = rng.below(256) as u8;
            }
            match Detector::new(&damaged, &mesh) {
                Ok(detector) => drop(detector.faces(&Picture::filled(40, 30, [128; 3]))),
                Err(_) => refused += 1,
            }
        }
        assert!((50..390).contains(&refused), "{refused} of 400 were refused");
    }
}
