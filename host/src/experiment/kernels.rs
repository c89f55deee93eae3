//! The paper's kernel figure: samples of its ten kernels on one scan.

use crate::error::{Error, Result};
use crate::mesh::{Axis, Mesh};
use crate::model::decompose::{Progress, Truncation, decompose};
use crate::model::kernel::{Field, Hyper, KERNELS, Vertex};
use crate::model::layout;
use crate::photo::picture::{Picture, contact_sheet};
use crate::render;
use crate::report;
use onescan_core::light::ambient_white;
use onescan_core::rng::Rng;
use std::fmt::Write as _;

/// Samples of each kernel.
pub const SAMPLES: usize = 3;
/// Side of a picture.
const SIDE: u32 = 224;

/// A kernel's samples.
pub struct Column {
    /// Index into [`KERNELS`].
    pub kernel: usize,
    /// The kernel as algebra.
    pub algebra: String,
    /// Components that were drawn from.
    pub rank: usize,
    /// Fraction of the variance they hold.
    pub captured: f64,
    /// The samples, drawn.
    pub pictures: Vec<Picture>,
}

/// Draws samples of all ten kernels on a scan, under ambient light.
///
/// # Errors
/// Those of decomposing and drawing.
pub fn run(
    scan: &Mesh,
    mirror: Option<Axis>,
    rank: usize,
    seed: u64,
    progress: &mut Progress<'_>,
) -> Result<Vec<Column>> {
    let vertices = Vertex::all(&scan.points, &scan.colors);
    let template = layout::rigid(scan, &[])?;
    let mut scene = render::portrait(&template.view(), [SIDE; 2], 0.0, 0.0);
    scene.view.light = ambient_white();
    let mut columns = Vec::new();
    for (index, named) in KERNELS.iter().enumerate() {
        let kernel = named.kernel(&Hyper::default(), mirror);
        let from = index as f64 / KERNELS.len() as f64;
        let deviation =
            decompose(&kernel, &vertices, Truncation::Rank(rank), &mut |done, what| {
                progress(
                    from + done / KERNELS.len() as f64,
                    &format!("kernel {} {what}", index + 1),
                );
            })?;
        let mean = if named.field == Field::Shape { &scan.points } else { &scan.colors };
        let process = deviation.around(mean);
        // The same coefficients for every kernel: what differs is the kernel.
        let mut rng = Rng::new(seed, 0);
        let pictures = (0..SAMPLES).map(|_| {
            let c: Vec<f64> = (0..rank).map(|_| rng.normal()).collect();
            let field = process.instance(&c);
            let mut mesh = scan.clone();
            if named.field == Field::Shape {
                mesh.points = field.iter().map(|p| p.map(|x| x as f32)).collect();
            } else {
                let color = |x: f64| x.clamp(0.0, 1.0) as f32;
                mesh.colors = field.iter().map(|c| c.map(color)).collect();
            }
            render::draw_mesh(&mesh, &scene, render::GROUND)
        });
        columns.push(Column {
            kernel: index,
            algebra: kernel.to_string(),
            rank: process.rank(),
            captured: deviation.captured(),
            pictures: pictures.collect::<Result<_>>()?,
        });
    }
    Ok(columns)
}

/// All samples: a column per kernel.
pub fn sheet(columns: &[Column]) -> Picture {
    let row = |i: usize| columns.iter().map(move |column| &column.pictures[i]);
    let pictures: Vec<&Picture> = (0..SAMPLES).flat_map(row).collect();
    contact_sheet(&pictures, columns.len(), 4, [255; 3])
}

/// The page that shows the sheet and says what one sees.
///
/// # Errors
/// Never in practice.
pub fn page(columns: &[Column], scan: &str) -> Result<String> {
    let mut body = String::from("<section>\n<h2>Three samples of each kernel</h2>\n");
    body += &report::figure(
        &sheet(columns),
        "Thirty faces: three samples in each of ten columns",
        "A column per kernel, in the order of the table. The first two move vertices and leave \
         colours alone, the other eight change colours. The light is ambient, so shapes show by \
         their outline and by what their colours do.",
    )?;
    body += "<table><thead><tr><th>Kernel</th><th>What one sees</th><th>Rank</th>\
             <th>Variance held</th></tr></thead>\n<tbody>\n";
    for Column { kernel, algebra, rank, captured, .. } in columns {
        let named = &KERNELS[*kernel];
        writeln!(
            body,
            "<tr><td class=\"name\">{}</td><td>{}<br><code>{algebra}</code></td><td>{rank}</td><td>{:.1} %</td></tr>",
            named.symbol,
            named.shows,
            100.0 * captured
        )
        .map_err(Error::new)?;
    }
    body += "</tbody></table>\n<h2>How to read it</h2>\n<p>A kernel says how the deviations of two \
             points of the scan go together. These samples are not meant to be likely faces: they \
             are what the kernel allows, at one standard deviation in every component. A fit \
             weighs that freedom against a photo. All columns of a row have the same random \
             coefficients; what differs is the kernel.</p>\n</section>\n";
    report::essay("The kernels", &format!("Samples of the paper’s ten kernels on {scan}."), &body)
}
