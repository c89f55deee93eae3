//! What a registration leaves behind: meshes, numbers, and a page.

use super::{Distances, Registered};
use crate::error::{Error, Result};
use crate::files::publish;
use crate::mesh::ply::{self, Encoding};
use crate::mesh::{Mesh, glb};
use crate::model::layout;
use crate::photo::picture::{Picture, heat_color, montage};
use crate::render;
use crate::report;
use crate::scan::rigid::Rigid;
use crate::vector::{length, minus};
use onescan_core::light::ambient_white;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::Path;

/// The distance that is white in distances.ply, mm.
const FULL: f64 = 3.0;
/// The standard deviation that is white in uncertainty.ply, mm.
const FULL_DEVIATION: f64 = 6.0;
/// Width of a bar of the histogram, mm.
const BIN: f64 = 0.1;
/// Bars of the histogram; the last holds all that is farther.
const BINS: usize = 20;
/// Sides of the pictures, pixels.
const SIDE: u32 = 400;
/// Turns of the three sides, radians.
const SIDES: [f32; 3] = [-0.8, 0.0, 0.8];

/// What things are called.
#[derive(Clone, Debug)]
pub struct Names {
    /// The model's file.
    pub model: String,
    /// The scan's file.
    pub scan: String,
    /// The command that does the same.
    pub command: String,
}

/// Writes registered.ply and .glb, aligned.ply, distances.ply, report.html, uncertainty.ply if it was asked
/// for, and register.json, all or none; `landmarks` are names, places on the scan and vertices of the model.
///
/// # Errors
/// A directory that cannot be written; a file that would replace one of the `inputs`.
pub fn write(
    directory: &Path,
    result: &Registered,
    landmarks: &[(String, [f32; 3], u32)],
    names: &Names,
    inputs: &[&Path],
) -> Result<()> {
    let bytes = |mesh: &Mesh| -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        ply::write(&mut bytes, mesh, Encoding::Binary).map_err(Error::new)?;
        Ok(bytes)
    };
    let value = to_json(result, landmarks, names);
    let mut files: Vec<(&str, Vec<u8>)> = vec![
        ("registered.ply", bytes(&result.mesh)?),
        ("registered.glb", glb::encode(&result.mesh, "registered")?),
        ("aligned.ply", bytes(&result.aligned)?),
        ("distances.ply", bytes(&distances(result))?),
        ("report.html", page(result, &value, names)?.into_bytes()),
    ];
    let mut gone = Vec::new();
    match uncertainty(result) {
        Some(mesh) => files.push(("uncertainty.ply", bytes(&mesh)?)),
        None => gone.push("uncertainty.ply"),
    }
    files.push(("register.json", format!("{value:#}\n").into_bytes()));
    publish(directory, &files, &gone, inputs)
}

/// The registered mesh, coloured by the distance to the scan: black is none, then violet, red, orange
/// and yellow to white at 3 mm.
fn distances(result: &Registered) -> Mesh {
    heat(result, result.measures.per_vertex.iter().map(|d| d / FULL))
}

/// The registered mesh, coloured the same by the standard deviations of its vertices, white at 6 mm.
fn uncertainty(result: &Registered) -> Option<Mesh> {
    let deviations = result.deviations.as_ref()?;
    Some(heat(result, deviations.iter().map(|sd| f64::from(*sd) / FULL_DEVIATION)))
}

/// The registered mesh in colours from black (0) to white (1 and more).
fn heat(result: &Registered, values: impl Iterator<Item = f64>) -> Mesh {
    let color = |value: f64| {
        heat_color((1024.0 * value).clamp(0.0, 1024.0) as u32).map(|c| f32::from(c) / 255.0)
    };
    Mesh { colors: values.map(color).collect(), ..result.mesh.clone() }
}

fn to_json(result: &Registered, landmarks: &[(String, [f32; 3], u32)], names: &Names) -> Value {
    let measures = &result.measures;
    let apart: Vec<Value> = landmarks
        .iter()
        .filter_map(|(name, at, vertex)| {
            let p = result.mesh.points.get(*vertex as usize)?;
            Some(json!({ "id": name, "distance_mm": distance(*at, *p) }))
        })
        .collect();
    let counted = result.weights.iter().filter(|w| **w > 0.1).count();
    json!({
        "onescan": env!("CARGO_PKG_VERSION"),
        "model": names.model,
        "scan": names.scan,
        "command": names.command,
        "chamfer_mm": measures.chamfer(),
        "hausdorff_mm": measures.hausdorff(),
        "hausdorff_95_mm": measures.hausdorff_95(),
        "registered_to_scan_mm": measures.to_scan,
        "scan_to_registered_mm": measures.from_scan,
        "vertices": result.mesh.points.len(),
        "vertices_with_evidence": counted,
        "landmarks": apart,
        "uncertainty_mm": result.deviations.as_ref().map(|deviations| {
            Distances::of(deviations.iter().copied().map(f64::from).collect())
        }),
        "size": result.size,
        "doubt": result.doubt(),
        "shape": result.shape,
    })
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f64 {
    length(minus(a, b).map(f64::from))
}

/// Meshes in the scan's place from three sides each, in the model's pose, under frontal or even light.
fn sides(result: &Registered, meshes: &[(&Mesh, bool)]) -> Result<Vec<Picture>> {
    let home = Rigid::between(&result.mesh.points, &result.aligned.points)
        .ok_or_else(|| Error::new("the registered mesh is not finite"))?;
    let frame = layout::rigid(&result.aligned, &[])?;
    meshes
        .iter()
        .map(|&(mesh, even)| {
            let mut moved = mesh.clone();
            moved.points.iter_mut().for_each(|p| *p = home.apply(*p));
            let views = SIDES.map(|yaw| {
                let mut scene = render::portrait(&frame.view(), [SIDE; 2], yaw, 0.0);
                if even {
                    scene.view.light = ambient_white();
                }
                render::draw_mesh(&moved, &scene, render::GROUND)
            });
            let views = views.into_iter().collect::<Result<Vec<_>>>()?;
            Ok(montage(&views.iter().collect::<Vec<_>>(), 8, [255; 3]))
        })
        .collect()
}

fn page(result: &Registered, value: &Value, names: &Names) -> Result<String> {
    let (distances, uncertainty) = (distances(result), uncertainty(result));
    let mut meshes = vec![(&result.scan, false), (&result.mesh, false), (&distances, true)];
    meshes.extend(uncertainty.iter().map(|mesh| (mesh, true)));
    let shown = sides(result, &meshes)?;
    let mut body = String::from("<section>\n");
    if let Some(doubt) = result.doubt() {
        body += "<p><b>Doubtful:</b> ";
        body += &report::escaped(&doubt);
        body += "</p>\n";
    }
    body += "<div class=\"pictures\">\n";
    let captions = [
        ("The scan from three sides", "The scan."),
        (
            "The registered mesh from three sides",
            "The registered mesh: the model’s topology, the scan’s colours.",
        ),
        (
            "Distances from three sides",
            "Distance to the scan, from black (0) by violet, red and orange to white (3 mm and more). \
             It does not show whether vertices have slid along the surface.",
        ),
        (
            "Standard deviations from three sides",
            "How far each vertex is known: standard deviation, from black (0) to white (6 mm and more).",
        ),
    ];
    for (picture, (alt, caption)) in shown.iter().zip(captions) {
        body += &report::figure(picture, alt, caption)?;
    }
    body += "</div>\n";
    let mut counts = vec![0.0; BINS];
    for d in &result.measures.per_vertex {
        counts[((d / BIN) as usize).min(BINS - 1)] += 1.0;
    }
    let labels: Vec<String> = (0..BINS)
        .map(|i| if i % 5 == 0 { format!("{:.1}", i as f64 * BIN) } else { String::new() })
        .collect();
    let chart =
        report::columns("Histogram of distances", "mm to the scan", &labels, &[(0, counts)]);
    let measures = &result.measures;
    // Writing to a string cannot fail.
    let _ = write!(
        body,
        "<div class=\"charts\"><figure>{}<figcaption>Vertices by their distance to the scan’s \
         surface; the last bar holds all that are farther.</figcaption></figure></div>\n<table>\n",
        chart.unwrap_or_default()
    );
    for (what, mm) in [
        ("chamfer distance, mean of both sides", measures.chamfer()),
        ("Hausdorff distance", measures.hausdorff()),
        ("Hausdorff distance at 95 %", measures.hausdorff_95()),
        ("registered vertices to the scan, mean", measures.to_scan.mean),
        ("the scan’s vertices to the registered mesh, mean", measures.from_scan.mean),
    ] {
        let _ = writeln!(body, "<tr><th scope=\"row\">{what}</th><td>{mm:.2} mm</td></tr>");
    }
    let apart = value["landmarks"].as_array().cloned().unwrap_or_default();
    let mm: Vec<f64> = apart.iter().filter_map(|l| l["distance_mm"].as_f64()).collect();
    if !mm.is_empty() {
        let mean = mm.iter().sum::<f64>() / mm.len() as f64;
        let _ = writeln!(
            body,
            "<tr><th scope=\"row\">{} landmarks, mean</th><td>{mean:.2} mm</td></tr>",
            mm.len()
        );
    }
    let _ = write!(
        body,
        "</table>\n<h3>Repeat it</h3>\n<pre><code>{}</code></pre>\n</section>\n",
        report::escaped(&names.command)
    );
    report::essay(
        &format!("Registration of {}", names.scan),
        "A model deformed onto a scan, so that its vertices lie where they belong.",
        &body,
    )
}
