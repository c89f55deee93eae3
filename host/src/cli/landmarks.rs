//! `onescan landmarks`.

use super::output_file;
use super::scan::{Placed, Reading};
use clap::Args;
use onescan::error::{Error, Result};
use onescan::face_mesh::{Marked, scan};
use onescan::files::{FileKind, write_atomically};
use onescan::photo;
use onescan::photo::picture::Picture;
use onescan::photo::tlms::Tlms;
use onescan::progress::Console;
use serde_json::json;
use std::io::Write;
use std::path::PathBuf;

/// Find a face's landmarks in a photo, or on a coloured scan.
///
/// Of a photo it writes what `onescan fit --landmarks` reads: a line of `name visible x y` for each,
/// pixels from the centre of the upper left one. Of several faces the largest is taken, or another by
/// --face. Of a scan (PLY, OBJ, GLB, glTF) it writes what `onescan build --landmarks` reads: JSON of
/// vertices and coordinates, these in the file's frame and unit. Whichever way the face looks, it is
/// found in pictures from all sides.
///
/// Look at them with --picture, and move what is off: both files are plain text.
///
/// The face mesh is MediaPipe's; nothing leaves this computer.
///
/// Examples:
///   onescan landmarks photo.jpg --picture marked.png
///   onescan landmarks scan.ply -o scan.json
#[derive(Args)]
#[command(verbatim_doc_comment)]
pub(super) struct Landmarks {
    /// The photo, PNG or JPEG, or the scan.
    input: PathBuf,
    /// File to write [default: beside the input, with its name: .tlms of a photo, .json of a scan].
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// Which face of a photo, by size: 1 is the largest [default: 1].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    face: Option<u32>,
    /// PNG of the photo, or of the scan from the front, with the landmarks to write as well.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    #[command(flatten, next_help_heading = "How the scan is read")]
    reading: Reading,
}

impl Landmarks {
    pub(super) fn run(self, console: Console) -> Result<()> {
        let is_photo = FileKind::of(&self.input) == Some(FileKind::Photo);
        let extension = if is_photo { "tlms" } else { "json" };
        let beside = self.input.with_extension(extension);
        if self.output.is_none() && beside.exists() {
            return Err(Error::file(
                &beside,
                "is there already, perhaps marked by hand; give another name, or this, by -o",
            ));
        }
        let output = self.output.clone().unwrap_or(beside);
        if output == self.input {
            return Err(Error::file(&output, "is the input; give another name by -o"));
        }
        output_file(&output, &[extension])?;
        if let Some(picture) = &self.picture {
            output_file(picture, &["png"])?;
        }
        let (text, marked) =
            if is_photo { self.of_photo(console)? } else { self.of_scan(console)? };
        if let Some(picture) = &self.picture {
            marked.write_png(picture)?;
            console.say(format_args!("wrote {}", picture.display()));
        }
        write_atomically(&output, |w| w.write_all(text.as_bytes()))?;
        console.say(format_args!("wrote {}", output.display()));
        Ok(())
    }

    fn of_photo(&self, console: Console) -> Result<(String, Picture)> {
        let options = self.reading.options();
        if !options.is_empty() {
            return Err(Error::file(
                &self.input,
                format_args!("is a photo, and{options} is about scans; leave it out"),
            ));
        }
        let photo = photo::read(&self.input)?;
        let found = Marked::read(None, &photo, self.face.unwrap_or(1) as usize);
        let Marked { landmarks, note, .. } = found.map_err(|e| Error::file(&self.input, e))?;
        if let Some(note) = note {
            console.say(Error::file(&self.input, note));
        }
        Ok((landmarks.to_text(), marked(&photo, &landmarks)))
    }

    fn of_scan(&self, console: Console) -> Result<(String, Picture)> {
        if self.face.is_some() {
            return Err(Error::file(
                &self.input,
                "is a scan, and --face is about photos; leave it out",
            ));
        }
        let Placed { mesh, origin, notes, .. } = self.reading.read(&self.input)?;
        for note in notes {
            console.say(Error::file(&self.input, note));
        }
        let frame = self.reading.frame()?;
        let found = scan::find(&mesh).map_err(|e| Error::file(&self.input, e))?;
        let entry = |mark: &scan::Mark| {
            let at = frame.undo(mark.coordinates.map(|c| c as f32));
            let coordinates: [f64; 3] = std::array::from_fn(|k| f64::from(at[k]) + origin[k]);
            json!({ "id": mark.name, "vertex": mark.vertex, "coordinates": coordinates })
        };
        let lines: Vec<String> = found.marks.iter().map(|mark| entry(mark).to_string()).collect();
        let text = format!("[\n{}\n]\n", lines.join(",\n"));
        Ok((text, marked(&found.picture, &found.in_picture)))
    }
}

/// A picture with landmarks.
fn marked(picture: &Picture, landmarks: &Tlms) -> Picture {
    const COLOR: [u8; 3] = [255, 220, 40];
    let mut picture = picture.clone();
    let xs = || landmarks.visible().map(|l| l.x);
    let width = xs().fold(f32::MIN, f32::max) - xs().fold(f32::MAX, f32::min);
    let radius = (width / 100.0).round().clamp(1.0, 40.0) as i32;
    for landmark in landmarks.visible() {
        picture.dot([landmark.x, landmark.y], radius, COLOR);
    }
    picture
}
