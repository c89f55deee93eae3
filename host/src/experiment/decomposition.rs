//! What exact components cost and gain beside sampled ones (Nyström), and how both grow with the
//! mesh.

mod page;

use super::stages::Stages;
use crate::demo;
use crate::error::Result;
use crate::json;
use crate::mesh::{Axis, Mesh};
use crate::model::decompose::{Progress, Truncation, decompose};
use crate::model::kernel::{Kernel, Preset, Vertex, block, trace};
use crate::model::nystrom::{self, nystrom};
use crate::model::process::Process;
use crate::scan::decimate::decimate;
use onescan_core::rng::Rng;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::time::Instant;

/// Kernels of both halves.
const KERNELS: &str = "symmetric-full";
/// Components compared.
const RANKS: [usize; 3] = [50, 199, 1000];
/// Vertices Nyström's method samples: as many as the released program, and more.
const SAMPLED: [usize; 2] = [nystrom::POINTS, 1000];
/// Components of the meshes that grow.
const COMPONENTS: usize = 199;
/// Vertices of these.
pub const SIZES: [usize; 7] = [500, 2000, 8000, 25_000, 50_000, 100_000, 200_000];
/// Seed of Nyström's samples: that of the released program.
const SEED: u64 = 1986;

/// The result.
#[derive(Clone, Debug, Serialize)]
pub struct Decompositions {
    /// Vertices of the template that methods are compared on.
    pub vertices: usize,
    /// Shape and albedo, by method and number of components.
    pub methods: Vec<Row>,
    /// Both halves of a model, by number of vertices.
    pub sizes: Vec<Size>,
}

/// One way of decomposing one kernel.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// Shape or albedo.
    pub half: String,
    /// Exact, or Nyström from how many vertices.
    pub method: String,
    /// Components.
    pub rank: usize,
    /// Fraction of the variance they hold.
    pub captured: f64,
    /// Largest standard deviation that a vertex lacks: mm, or RGB.
    pub worst_vertex: f64,
    /// Wall time.
    pub seconds: f64,
    /// Most memory in use, if the system tells.
    pub megabytes: Option<f64>,
}

/// A model of a mesh of some size.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Size {
    /// Its vertices.
    pub vertices: usize,
    /// Wall time for shape and albedo.
    pub seconds: f64,
    /// Most memory in use, if the system tells.
    pub megabytes: Option<f64>,
    /// Largest residual.
    pub residual: f64,
}

/// Decomposes the template's kernels in all ways, and those of meshes of at most `largest`
/// vertices.
///
/// # Errors
/// Those of decomposing.
pub fn run(largest: usize, stages: &Stages, progress: &mut Progress<'_>) -> Result<Decompositions> {
    let (template, _) = demo::template()?;
    let sizes: Vec<usize> = SIZES.into_iter().filter(|size| *size <= largest).collect();
    let runs = (2 * RANKS.len() * (1 + SAMPLED.len()) + 2 * sizes.len()) as f64;
    let mut done = 0.0;
    let mut methods = Vec::new();
    for (half, kernel) in kernels() {
        let vertices = Vertex::all(&template.points, &template.colors);
        for rank in RANKS {
            methods.push(stages.stage(&format!("{half}-{rank}-exact"), || {
                let watch = Watch::start();
                let rank_wanted = Truncation::Rank(rank);
                let found = decompose(&kernel, &vertices, rank_wanted, &mut |part, _| {
                    progress((done + part) / runs, &format!("{half}, {rank} components"));
                })?;
                let row = watch.stop(half, "exact".into());
                Ok(row.of(&found.around(&template.points), &kernel, &vertices))
            })?);
            done += 1.0;
            for points in SAMPLED {
                progress(done / runs, &format!("{half}, {rank} components by Nyström"));
                methods.push(stages.stage(&format!("{half}-{rank}-of-{points}"), || {
                    let watch = Watch::start();
                    let mut rng = Rng::new(SEED, 0);
                    let found =
                        nystrom(&kernel, &vertices, &template.points, points, rank, &mut rng)?;
                    let row = watch.stop(half, format!("Nyström, {points} vertices"));
                    Ok(row.of(&found, &kernel, &vertices))
                })?);
                done += 1.0;
            }
        }
    }
    let mut grown = Vec::new();
    for size in sizes {
        grown.push(stages.stage(&format!("vertices-{size}"), || {
            let mesh = resized(&template, size);
            let vertices = Vertex::all(&mesh.points, &mesh.colors);
            let (watch, mut residual) = (Watch::start(), 0.0_f64);
            let mut both = Vec::new();
            for (i, (half, kernel)) in kernels().into_iter().enumerate() {
                let rank = Truncation::Rank(COMPONENTS);
                both.push(decompose(&kernel, &vertices, rank, &mut |part, _| {
                    let done = done + i as f64 + part;
                    progress(done / runs, &format!("{half} of {size} vertices"));
                })?);
            }
            for found in &both {
                residual = residual.max(found.max_residual);
            }
            let (seconds, megabytes) = watch.read();
            Ok(Size { vertices: mesh.points.len(), seconds, megabytes, residual })
        })?);
        done += 2.0;
    }
    Ok(Decompositions { vertices: template.points.len(), methods, sizes: grown })
}

fn kernels() -> Vec<(&'static str, Kernel)> {
    let preset = Preset::named(KERNELS);
    let halves =
        |p: &Preset| vec![("shape", p.shape(Some(Axis::X))), ("albedo", p.albedo(Some(Axis::X)))];
    preset.map_or_else(Vec::new, halves)
}

/// Wall time and memory from a moment on.
struct Watch {
    start: Instant,
}

impl Watch {
    fn start() -> Self {
        // On Linux the high-water mark starts anew; elsewhere there is none.
        let _ = std::fs::write("/proc/self/clear_refs", "5");
        Self { start: Instant::now() }
    }

    fn read(&self) -> (f64, Option<f64>) {
        let seconds = self.start.elapsed().as_secs_f64();
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
        (seconds, kilobytes.map(|k| k / 1e3))
    }

    fn stop(self, half: &str, method: String) -> Row {
        let (seconds, megabytes) = self.read();
        let half = half.into();
        Row { half, method, rank: 0, captured: 0.0, worst_vertex: 0.0, seconds, megabytes }
    }
}

impl Row {
    fn of(self, process: &Process, kernel: &Kernel, vertices: &[Vertex]) -> Self {
        let terms = kernel.terms();
        let mut lacking: Vec<f64> = vertices.iter().map(|v| trace(&block(&terms, v, v))).collect();
        for (column, variance) in process.basis.col_iter().zip(&process.variances) {
            for (row, entry) in column.iter().enumerate() {
                lacking[row % vertices.len()] -= variance * entry * entry;
            }
        }
        let worst_vertex = lacking.into_iter().fold(0.0, f64::max).sqrt();
        Self { rank: process.rank(), captured: process.captured(), worst_vertex, ..self }
    }
}

/// The mesh with so many vertices: triangles divided in four until there are enough, then
/// decimated.
pub fn resized(mesh: &Mesh, vertices: usize) -> Mesh {
    let mut fine = mesh.clone();
    while fine.points.len() < vertices {
        fine = divided(&fine);
    }
    let triangles = decimate(&fine, &[], vertices);
    let mut kept: Vec<u32> = triangles.as_flattened().to_vec();
    kept.sort_unstable();
    kept.dedup();
    let place = |v: u32| kept.partition_point(|&other| other < v) as u32;
    Mesh {
        points: kept.iter().map(|&v| fine.points[v as usize]).collect(),
        colors: kept.iter().map(|&v| fine.colors[v as usize]).collect(),
        triangles: triangles.iter().map(|t| t.map(place)).collect(),
    }
}

/// Every triangle in four, at the middles of its edges.
fn divided(mesh: &Mesh) -> Mesh {
    let Mesh { mut points, mut colors, triangles } = mesh.clone();
    let mut middles: HashMap<[u32; 2], u32> = HashMap::new();
    let mut middle = |a: u32, b: u32| {
        *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
            for field in [&mut points, &mut colors] {
                let (p, q) = (field[a as usize], field[b as usize]);
                field.push(std::array::from_fn(|k| f32::midpoint(p[k], q[k])));
            }
            (points.len() - 1) as u32
        })
    };
    let quarters = |&[a, b, c]: &[u32; 3]| {
        let (x, y, z) = (middle(a, b), middle(b, c), middle(c, a));
        [[a, x, z], [x, b, y], [z, y, c], [x, y, z]]
    };
    let triangles = triangles.iter().flat_map(quarters).collect();
    Mesh { points, colors, triangles }
}

impl Decompositions {
    /// The contents of `decomposition.json`.
    ///
    /// # Errors
    /// A number that is not finite, naming the field.
    pub fn to_json(&self) -> Result<String> {
        json::to_text(self)
    }

    /// Both tables: headings, then rows.
    fn tables(&self) -> [Vec<Vec<String>>; 2] {
        let megabytes = |m: Option<f64>| m.map_or("–".into(), |m| format!("{m:.0}"));
        let heading = |names: &[&str]| names.iter().map(ToString::to_string).collect();
        let mut methods: Vec<Vec<String>> = vec![heading(&[
            "half",
            "method",
            "components",
            "variance, %",
            "worst vertex lacks",
            "seconds",
            "MB",
        ])];
        methods.extend(self.methods.iter().map(|row| {
            let unit = if row.half == "shape" { " mm" } else { "" };
            vec![
                row.half.clone(),
                row.method.clone(),
                row.rank.to_string(),
                format!("{:.2}", 100.0 * row.captured),
                format!("{:.3}{unit}", row.worst_vertex),
                format!("{:.1}", row.seconds),
                megabytes(row.megabytes),
            ]
        }));
        let mut sizes: Vec<Vec<String>> =
            vec![heading(&["vertices", "seconds", "MB", "largest residual"])];
        sizes.extend(self.sizes.iter().map(|size| {
            vec![
                size.vertices.to_string(),
                format!("{:.1}", size.seconds),
                megabytes(size.megabytes),
                format!("{:.0e}", size.residual),
            ]
        }));
        [methods, sizes]
    }

    /// Both tables, in Markdown.
    pub fn markdown(&self) -> String {
        let line = |row: &Vec<String>| format!("| {} |\n", row.join(" | "));
        let table = |rows: &Vec<Vec<String>>| {
            let rule = vec!["---".to_string(); rows[0].len()];
            let (heading, body) = (line(&rows[0]), rows[1..].iter().map(line));
            heading + &line(&rule) + &body.collect::<String>()
        };
        self.tables().each_ref().map(table).join("\n")
    }

    /// The page.
    ///
    /// # Errors
    /// Never in practice.
    pub fn page(&self) -> Result<String> {
        page::page(self, &self.tables())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn meshes_get_the_size_asked_for() {
        let (template, _) = demo::template().unwrap();
        for size in [900, 20_000] {
            let mesh = resized(&template, size);
            assert!(mesh.points.len().abs_diff(size) < 3, "{}", mesh.points.len());
            assert_eq!(mesh.points.len(), mesh.colors.len());
            assert!(
                mesh.triangles.as_flattened().iter().all(|v| (*v as usize) < mesh.points.len())
            );
            let extent = |m: &Mesh| m.points.iter().map(|p| p[1]).fold(0.0, f32::max);
            assert!((extent(&mesh) - extent(&template)).abs() < 3.0);
        }
    }

    #[test]
    fn the_page_and_the_tables_tell_everything() {
        let row = |half: &str, seconds| Row {
            half: half.into(),
            method: "exact".into(),
            rank: 199,
            captured: 0.9186,
            worst_vertex: 3.179,
            seconds,
            megabytes: None,
        };
        let size = |vertices: usize| Size {
            vertices,
            seconds: 5e-4 * vertices as f64,
            megabytes: Some(500.0),
            residual: 2e-4,
        };
        let sizes = vec![size(500), size(100_000)];
        let methods = vec![row("shape", 1.0), row("albedo", 2.0)];
        let result = Decompositions { vertices: 8291, methods, sizes };
        let page = result.page().unwrap();
        for part in ["3.179 mm", "<td>2e-4</td>", "Megabytes", "100\u{202f}000", "polyline"] {
            assert!(page.contains(part), "{part}");
        }
        assert!(result.markdown().contains("| albedo | exact | 199 | 91.86 | 3.179 | 2.0 | – |"));
    }
}
