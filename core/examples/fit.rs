//! Fits a model to a picture without a heap of its own: all memory is one slice.
//!
//!     cargo run --release -p onescan-core --example fit -- fixtures/device
//!
//! The folder has a model, `face.3dmm` (of `onescan export --device`), a picture, `half.ppm`, and where the
//! landmarks are in it, `half.tlms`.

use onescan_core::chain::{Config, Problem};
use onescan_core::image::Image;
use onescan_core::likelihood::landmarks::ObservedLandmark;
use onescan_core::model::Model;
use onescan_core::search::{self, ModeSearch, Options};
use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).ok_or("which folder?")?);
    let file = std::fs::read(folder.join("face.3dmm"))?;
    let picture = std::fs::read(folder.join("half.ppm"))?;
    let marks = std::fs::read_to_string(folder.join("half.tlms"))?;

    // A model is read where it lies, at an address that is a multiple of four: on a device, in flash.
    let mut words = vec![0_u32; file.len().div_ceil(4)];
    let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut words);
    bytes[..file.len()].copy_from_slice(&file);
    let model = Model::new_checked(&bytes[..file.len()])?;

    // P6, width, height, 255, then a byte for each channel of each pixel.
    let mut lines = picture.splitn(4, |byte| *byte == b'\n');
    let (size, pixels) = (lines.nth(1), lines.nth(1));
    let size = std::str::from_utf8(size.ok_or("no picture")?)?;
    let (width, height) = size.split_once(' ').ok_or("no size")?;
    let (pixels, _) = pixels.ok_or("no pixels")?.as_chunks::<3>();
    let image = Image { pixels, width: width.parse()?, height: height.parse()? };

    let mut landmarks = Vec::new();
    for line in marks.lines() {
        if let [name, "1", x, y] = line.split(' ').collect::<Vec<_>>()[..] {
            landmarks.push(ObservedLandmark { name, position: [x.parse()?, y.parse()?] });
        }
    }

    let config = Config::default().with(|config| {
        (config.shape_rank, config.albedo_rank) = (20, 20);
        config.pixel_patch = 5.0;
    });
    let problem = Problem::new(&model, image, &landmarks, &config);
    let mut memory = vec![0; search::words(&problem, &Options::default())];
    let mut search: ModeSearch<'_, '_> = ModeSearch::new(problem, Options::default(), &mut memory)?;
    while search.step().is_some() {
        println!("energy {:.2}", search.energy().total());
    }
    let pose = search.scene().view.pose;
    println!("turned by {:.1}°, {:.0} mm away", pose.yaw.to_degrees(), -pose.translation[2]);
    Ok(())
}
