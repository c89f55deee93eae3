//! Builds a model of a scan, draws a random face from it, fits it to a photo and writes both faces as GLB; of
//! the built-in scan and photo, or of yours:
//!
//!     cargo run --release -p onescan --example face -- out
//!     cargo run --release -p onescan --example face -- out SCAN.ply SCAN.json PHOTO.jpg

use onescan::demo;
use onescan::error::{Error, Result};
use onescan::face_mesh::Marked;
use onescan::files::write_atomically;
use onescan::fit::{Control, Job, find_mode};
use onescan::mesh::{Axis, Mesh, glb, landmarks};
use onescan::model::build::{BuildOptions, Method, build};
use onescan::model::decompose::Truncation;
use onescan::model::kernel::Kernels;
use onescan::render;
use onescan::scan::mesh_file;
use onescan_core::rng::Rng;
use std::path::PathBuf;

fn main() -> Result<()> {
    let given: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let (folder, (mesh, marks, millimetres), photo) = match &given[..] {
        [folder] => {
            let (mesh, marks) = demo::template()?;
            (folder, (mesh, marks, 1.0), None)
        }
        [folder, scan, marks, photo] => {
            // Its colours are those of vertices or of a texture; the default options take it as it stands.
            let scan = mesh_file::read(scan, &mesh_file::Options::default())?;
            let marks = landmarks::read(marks, &scan.mesh.points, scan.millimetres)?;
            (folder, (scan.mesh, marks, scan.millimetres), Some(photo))
        }
        _ => return Err(Error::new("give a folder to write to, or FOLDER SCAN LANDMARKS PHOTO")),
    };
    std::fs::create_dir_all(folder).map_err(|e| Error::file(folder, e))?;
    let write = |name: &str, mesh: &Mesh| {
        let bytes = glb::encode(mesh, name)?;
        write_atomically(&folder.join(name), |out| std::io::Write::write_all(out, &bytes))
    };

    let options = BuildOptions {
        scan_name: "the scan",
        kernels: Kernels::named("symmetric-full", Some(Axis::X))?,
        method: Method::Exact(Truncation::Rank(60)),
        millimetres,
    };
    let built = build(&mesh, &marks, &options, &mut |_, _| ())?;
    println!("{}", built.report);
    let model = built.model.view();

    let mut rng = Rng::new(1, 0);
    let mut random = |rank| render::random_coefficients(rank, &mut rng);
    let (shape, albedo) = (random(model.shape.rank()), random(model.albedo.rank()));
    write("random.glb", &render::instance(&model, &shape, &albedo))?;

    // Landmarks that are found have the names of the built-in scan's.
    let (photo, landmarks) = if let Some(path) = photo {
        let names: Vec<_> = model.landmarks().map(|(name, _)| name).collect();
        let (photo, marked) = Marked::with_photo(path, None)?;
        (photo, marked.known(&names)?)
    } else {
        let subject = demo::subjects(7)?.swap_remove(0);
        (subject.photo, subject.landmarks)
    };
    let job = Job::new(&model, &photo, &landmarks)?;
    for fit in find_mode(&[job], &Control::default())?.into_iter().flatten() {
        let face = fit.best.scene.subject;
        write("fitted.glb", &render::instance(&model, &face.shape, &face.albedo))?;
        println!("fitted in {} steps, fingerprint {:016x}", fit.steps, fit.fingerprint);
    }
    Ok(())
}
