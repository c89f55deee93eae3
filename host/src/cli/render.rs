//! `onescan render`.

use super::{degrees, output_file, size};
use clap::Args;
use onescan::error::{Error, Result};
use onescan::files::has_extension;
use onescan::fit::rps::Rps;
use onescan::fit::summary::{Summary, hex};
use onescan::interchange;
use onescan::photo::picture::Picture;
use onescan::progress::Console;
use onescan::render;
use onescan::scan::mesh_file;
use std::path::PathBuf;

/// Render the mean of a model, a fit, or a mesh from any side.
///
/// Without --fit or --rps: the mean, upright, under frontal light. With them: the fitted scene as
/// the photo's camera sees it; --yaw and --pitch then turn the fitted object further.
#[derive(Args)]
pub(super) struct Render {
    /// The model: .3dmm, .h5, .h5.json or .mat; or a mesh, which `onescan inspect --picture` shows
    /// with what options it needs.
    model: PathBuf,
    /// The picture to write, PNG.
    #[arg(short, long)]
    output: PathBuf,
    /// Parameters of a fit, fit.json, or the directory that `onescan fit` wrote it to.
    #[arg(long, conflicts_with = "rps")]
    fit: Option<PathBuf>,
    /// Parameters of the reference engine, .rps.
    #[arg(long)]
    rps: Option<PathBuf>,
    /// Size of the picture, one side or width and height, 640x480 [default: 512, or the fit's photo].
    #[arg(long, value_name = "N|WxH", value_parser = size)]
    size: Option<[u32; 2]>,
    /// Turn to the subject's left, degrees.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, value_parser = degrees)]
    yaw: f32,
    /// Nod down, degrees.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, value_parser = degrees)]
    pitch: f32,
}

impl Render {
    pub(super) fn run(self, console: Console) -> Result<()> {
        output_file(&self.output, &["png"])?;
        if has_extension(&self.model, &mesh_file::EXTENSIONS) {
            return self.mesh(console);
        }
        let file = interchange::open(&self.model)?;
        let model = file.view();
        let (yaw, pitch) = (self.yaw.to_radians(), self.pitch.to_radians());
        let fitted = if let Some(path) = &self.fit {
            if has_extension(path, &["rps"]) {
                return Err(Error::file(path, "not fit.json; give an .rps to --rps"));
            }
            let own = if path.is_dir() { &path.join("fit.json") } else { path };
            let summary = Summary::read(own)?;
            if summary.model.checksum != hex(model.checksum()) {
                return Err(Error::file(
                    path,
                    format_args!(
                        "model.checksum: this fit was made with another model ({}); give that one",
                        summary.model.file
                    ),
                ));
            }
            Some(summary.parameters)
        } else if let Some(path) = &self.rps {
            Some(Rps::read(path)?.scene)
        } else {
            None
        };
        let scene = match fitted {
            Some(mut scene) => {
                scene.view.pose.yaw += yaw;
                scene.view.pose.pitch += pitch;
                if let Some(size) = self.size {
                    scene.view.camera = render::resize_camera(&scene.view.camera, size);
                }
                scene
            }
            None => render::portrait(&model, self.size.unwrap_or([512, 512]), yaw, pitch),
        };
        self.write(&render::smooth_on(&model, &scene, render::GROUND), console)
    }

    fn write(&self, picture: &Picture, console: Console) -> Result<()> {
        picture.write_png(&self.output)?;
        console.say(format_args!("wrote {}", self.output.display()));
        Ok(())
    }

    /// A mesh instead of a model.
    fn mesh(&self, console: Console) -> Result<()> {
        if let Some(fit) = self.fit.as_ref().or(self.rps.as_ref()) {
            return Err(Error::file(
                fit,
                "is a model's parameters, and a mesh has none; leave it out",
            ));
        }
        // What has no colour is grey.
        let options = mesh_file::Options { color: Some([0.7; 3]), ..Default::default() };
        let mesh = mesh_file::read(&self.model, &options)?.mesh;
        let size = self.size.unwrap_or([512, 512]);
        let turn = [self.yaw, self.pitch].map(f32::to_radians);
        self.write(&render::mesh_portrait(&mesh, size, turn)?, console)
    }
}
