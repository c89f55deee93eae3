//! `onescan inspect`.

use super::output_file;
use super::scan::{Placed, Scan};
use clap::Args;
use onescan::error::{Error, Result};
use onescan::files::write_atomically;
use onescan::mesh::Mesh;
use onescan::mesh::ply::{self, Encoding};
use onescan::photo::caption::captioned;
use onescan::photo::picture::{Picture, WHITE, montage};
use onescan::progress::{Console, print};
use onescan::render;
use onescan::scan::doctor::{Findings, mend};
use serde_json::json;
use std::path::PathBuf;

/// Say what a mesh holds and what is wrong with it, and mend it.
///
/// Size, borders, pieces and symmetry of a mesh, and what should be seen to before a model is
/// built of it. Also converts: --mend writes any mesh that is read as a PLY.
#[derive(Args)]
pub(super) struct Inspect {
    #[command(flatten)]
    scan: Scan,
    /// For programs.
    #[arg(long)]
    json: bool,
    /// Write the mended mesh: PLY with vertex colours, millimetres, y up. Joins equal vertices,
    /// drops triangles without area, repeated ones and those that crowd an edge, turns triangles
    /// so that they agree and look outwards, drops vertices of no triangle.
    #[arg(long, value_name = "OUT.ply")]
    mend: Option<PathBuf>,
    /// Picture of the scan to write, from the front, both sides and behind: PNG.
    #[arg(long, value_name = "FILE.png")]
    picture: Option<PathBuf>,
    /// Mend by dropping all pieces but the largest, too: eyes, say, and what else is loose.
    #[arg(long, requires = "mend")]
    largest: bool,
}

/// A mesh from four sides.
fn views(mesh: &Mesh) -> Result<Picture> {
    let view = |(name, degrees): (&str, f32)| {
        let picture = render::mesh_portrait(mesh, [384; 2], [degrees.to_radians(), 0.0])?;
        Ok(captioned(&picture, name))
    };
    let sides = [("front", 0.0), ("its left", -90.0), ("its right", 90.0), ("behind", 180.0)];
    let views = sides.into_iter().map(view).collect::<Result<Vec<_>>>()?;
    Ok(montage(&views.iter().collect::<Vec<_>>(), 4, WHITE))
}

impl Inspect {
    pub(super) fn run(self, console: Console) -> Result<()> {
        if let Some(path) = &self.mend {
            output_file(path, &["ply"])?;
        }
        if let Some(path) = &self.picture {
            output_file(path, &["png"])?;
        }
        let (Placed { mut mesh, unit, .. }, _) = self.scan.read(console)?;
        for point in &mut mesh.points {
            *point = point.map(|c| c * unit);
        }
        if let Some(path) = &self.picture {
            views(&mesh)?.write_png(path)?;
            console.say(format_args!("wrote {}", path.display()));
        }
        let findings = Findings::of(&mesh, 1.0);
        let mended = match &self.mend {
            Some(path) => {
                let (mended, what) = mend(&mesh, self.largest);
                self.write(path, &mended)?;
                Some(what)
            }
            None => None,
        };
        if self.json {
            let mut value = json!({ "findings": findings, "faults": findings.faults(true) });
            if let Some(what) = mended {
                value["mended"] = json!(what);
            }
            print(format_args!("{value:#}"))?;
            return Ok(());
        }
        print(&findings)?;
        if let (Some(what), Some(path)) = (mended, &self.mend) {
            console.say(what);
            console.say(format_args!("wrote {}", path.display()));
        }
        Ok(())
    }

    fn write(&self, path: &std::path::Path, mesh: &Mesh) -> Result<()> {
        if mesh.triangles.is_empty() {
            return Err(Error::file(
                &self.scan.path,
                "no triangle has an area; there is nothing to write",
            ));
        }
        write_atomically(path, |out| ply::write(out, mesh, Encoding::Binary))
    }
}
