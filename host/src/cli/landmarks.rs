//! `onescan landmarks`.

use super::output_file;
use clap::Args;
use onescan::error::{Error, Result};
use onescan::face_mesh::{Detector, Face};
use onescan::files::write_atomically;
use onescan::photo;
use onescan::photo::picture::Picture;
use onescan::progress::Console;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Find a face's landmarks in a photo.
///
/// Writes what `onescan fit --landmarks` reads: a line of `id visible x y` for each, pixels from the
/// centre of the upper left one. Of several faces the largest is taken, or another by --face. Look at the
/// landmarks with --picture, and move what is off: the file is plain text.
///
/// The face mesh is MediaPipe's; the photo stays on this computer.
#[derive(Args)]
pub(super) struct Landmarks {
    /// The photo, PNG or JPEG.
    photo: PathBuf,
    /// File to write, `.tlms` [default: beside the photo, with its name].
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// Which face, by size: 1 is the largest.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    face: u32,
    /// PNG of the photo with the landmarks to write as well.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
}

impl Landmarks {
    pub(super) fn run(self, console: Console) -> Result<()> {
        let output = self.output.unwrap_or_else(|| self.photo.with_extension("tlms"));
        if output == self.photo {
            return Err(Error::file(&output, "is the photo; give another name by -o"));
        }
        output_file(&output)?;
        if let Some(picture) = &self.picture {
            output_file(picture)?;
        }
        let photo = photo::read(&self.photo)?;
        let face = find(&photo, &self.photo, self.face, console)?;
        let landmarks = face.landmarks();
        if let Some(picture) = &self.picture {
            marked(&photo, &face).write_png(picture)?;
            console.say(format_args!("wrote {}", picture.display()));
        }
        write_atomically(&output, |w| w.write_all(landmarks.to_text().as_bytes()))?;
        console.say(format_args!("wrote {}", output.display()));
        Ok(())
    }
}

/// The face of this number in a photo; the others are named.
fn find(photo: &Picture, path: &Path, number: u32, console: Console) -> Result<Face> {
    let mut faces = Detector::embedded().faces(photo);
    let name = |(i, face): (usize, &Face)| {
        let [x, y] = face.center.map(f32::round);
        format!("{} at ({x}, {y}), {} pixels", i + 1, face.size.round())
    };
    let all: Vec<String> = faces.iter().enumerate().map(name).collect();
    let index = number as usize - 1;
    if faces.is_empty() {
        return Err(Error::file(
            path,
            "no face found; write its landmarks by hand, a line of `id visible x y` each \
             (docs/landmarks.md), and give them to `onescan fit --landmarks`",
        ));
    }
    if index >= faces.len() {
        let faces = all.join("; ");
        return Err(Error::file(path, format_args!("--face {number}: there are only {faces}")));
    }
    if all.len() > 1 {
        console.say(format_args!("face {number} of {}: {}", all.len(), all.join("; ")));
    }
    Ok(faces.swap_remove(index))
}

/// The photo with a face's landmarks.
fn marked(photo: &Picture, face: &Face) -> Picture {
    const COLOR: [u8; 3] = [255, 220, 40];
    let mut picture = photo.clone();
    let radius = (face.size / 120.0).round().clamp(1.0, 40.0) as i32;
    for landmark in face.landmarks().landmarks {
        picture.dot([landmark.x, landmark.y], radius, COLOR);
    }
    picture
}
