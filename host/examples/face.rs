//! Builds a model of the built-in scan, draws a random face from it, fits it to a photo and writes both
//! faces as GLB:
//!
//!     cargo run --release -p onescan --example face -- out

use onescan::demo;
use onescan::error::{Error, Result};
use onescan::files::write_atomically;
use onescan::fit::{Control, Job, Schedule, find_mode};
use onescan::mesh::{Axis, Mesh, glb};
use onescan::model::build::{BuildOptions, Method, build};
use onescan::model::decompose::Truncation;
use onescan::model::kernel::Kernels;
use onescan::photo::Crop;
use onescan::render;
use onescan_core::rng::Rng;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64};

fn main() -> Result<()> {
    let folder = std::env::args().nth(1).ok_or_else(|| Error::new("which folder to write to?"))?;
    let folder = PathBuf::from(folder);
    std::fs::create_dir_all(&folder).map_err(|e| Error::file(&folder, e))?;
    let write = |name: &str, mesh: &Mesh| {
        let bytes = glb::encode(mesh, name)?;
        write_atomically(&folder.join(name), |out| std::io::Write::write_all(out, &bytes))
    };

    // `mesh::ply::read` and `mesh::landmarks` read yours.
    let (scan, landmarks) = demo::template()?;
    let options = BuildOptions {
        scan_name: "template.ply",
        kernels: Kernels::named("symmetric-full", Some(Axis::X))?,
        method: Method::Exact(Truncation::Rank(60)),
        millimetres: 1.0,
    };
    let built = build(&scan, &landmarks, &options, &mut |_, _| ())?;
    println!("{}", built.report);
    let model = built.model.view();

    let mut rng = Rng::new(1, 0);
    let mut random = |rank| render::random_coefficients(rank, &mut rng);
    let (shape, albedo) = (random(model.shape.rank()), random(model.albedo.rank()));
    write("random.glb", &render::instance(&model, &shape, &albedo))?;

    let [subject, ..] = &demo::subjects(7)?[..] else { return Err(Error::new("no photo")) };
    let (photo, landmarks) = (&subject.photo, &subject.landmarks);
    let size = [photo.width, photo.height];
    let side = Crop::LONGER_SIDE;
    let job = Job {
        model: &model,
        photo,
        landmarks,
        crop: Crop::around(&landmarks.visible_points(), size, Crop::ENLARGE, side)?,
        mask: None,
        schedule: Schedule::Mode,
        config: Schedule::Mode.config(&model, side),
        seed: 1,
        chains: 1,
    };
    let control = Control { stop: &AtomicBool::new(false), steps: &AtomicU64::new(0) };
    for fit in find_mode(&[job], &control)?.into_iter().flatten() {
        let face = fit.best.scene.subject;
        write("fitted.glb", &render::instance(&model, &face.shape, &face.albedo))?;
        println!("fitted in {} steps, fingerprint {:016x}", fit.steps, fit.fingerprint);
    }
    Ok(())
}
