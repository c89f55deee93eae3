//! Morphable models in the HDF5 layout of statismo and the reference engine: version 0.9 in and
//! out, versions 0.8 and 1 in; as `.h5` and as `.h5.json`.
//!
//! Files of the Basel face models 2017 and 2019 have this layout. Three parts, `shape`, `color`
//! and perhaps `expression`, each hold a Gaussian process over the vertices of one reference mesh:
//!
//! | dataset | holds |
//! |---|---|
//! | `model/mean` (3V) | x, y, z of a vertex after the other; absolute points, RGB, or offsets |
//! | `model/pcaBasis` (3V, r) | `U`; in version 0.8 `U diag(√λ)` |
//! | `model/pcaVariance` (r) | `λ` |
//! | `model/noiseVariance` | variance of the noise |
//! | `representer/points` (3, V) | the reference, the same in all parts |
//! | `representer/cells` (3, T) | its triangles |
//! | `/metadata/landmarks/json` or `text` | named points of the reference |

use crate::error::{Error, Result};
use crate::interchange::hdf5::{Group, Store, Values};
use crate::mesh::landmarks::{self, Landmark, Point, Uncertainty};
use crate::model::morphable::{Import, Morphable};
use crate::model::process::Process;
use crate::vector::distance;
use faer::Mat;
use std::collections::{BTreeMap, HashMap};

/// How far a landmark may lie from a vertex of the reference, as a share of the reference's
/// diagonal: rounding to 32 bits and printing move it less.
pub const LANDMARK_TOLERANCE: f64 = 1e-4;

/// What reading a number's digits may take from it, likewise.
const ROUNDING: f64 = 1e-13;

/// Millimetres in a metre, the unit `length-unit` is given in.
const MILLIMETRES: f64 = 1000.0;

/// Metres that a unit of the coordinates is long; only files written in C++ say so.
const LENGTH_UNIT: &str = "shape/representer/length-unit";

/// Of models that lack colours.
const SHAPE_ALONE: &str = "this is a model of shape alone, which is not taken: what is drawn and fitted \
                           needs colours as well; take a model that has them, or build one of a scan";

/// What the format cannot say about when a model was built; nothing reads it.
const BUILD_TIME: &str = "not recorded";

/// Reads a model.
///
/// # Errors
/// Naming the dataset: what is missing, of another shape, not finite, or out of range; parts over
/// different references.
pub fn read(file: &dyn Store) -> Result<Import> {
    let reader = Reader { file };
    if !reader.has("shape")? && file.shape("model/mean")?.is_some() {
        return Err(Error::new(format_args!("model/mean: {SHAPE_ALONE}")));
    }
    let (reference, triangles) = reader.reference("shape")?;
    for part in ["color", "expression"] {
        if reader.has(part)? && reader.reference(part)?.0 != reference {
            return Err(Error::new(format_args!(
                "{part}/representer/points: another reference than the shape's; parts of \
                 different models cannot be combined"
            )));
        }
    }
    if !reader.has("color")? {
        return Err(Error::new(format_args!(
            "color/model/mean: there is no such dataset; {SHAPE_ALONE}"
        )));
    }
    reader.is_rgb()?;

    let unit = reader.length_unit()?;
    let mut notes = Vec::new();
    let mut uncertainties = BTreeMap::new();
    let landmarks = reader.landmarks(&reference, &mut uncertainties, &mut notes)?;
    let vertices = reference.len();
    let shape = reader.process("shape", vertices)?.in_unit(unit);
    let reference: Vec<[f32; 3]> =
        reference.iter().map(|p| p.map(|x| (f64::from(x) * unit) as f32)).collect();
    if !shape.mean.as_flattened().iter().all(|x| x.is_finite()) {
        return Err(Error::new(format_args!(
            "{LENGTH_UNIT}: {unit} mm make coordinates overflow; get the file again"
        )));
    }
    let expression = if reader.has("expression")? {
        Some(reader.process("expression", vertices)?.in_unit(unit))
    } else {
        None
    };
    let model = Morphable {
        reference: (reference != shape.mean).then_some(reference),
        shape,
        albedo: reader.colors(vertices)?,
        expression,
        triangles,
        landmarks,
        uncertainties,
        occlusion: None,
        provenance: "format = \"statismo\"\n".into(),
    };
    Ok(Import { model, notes })
}

/// Points and triangles.
type ReferenceMesh = (Vec<[f32; 3]>, Vec<[u32; 3]>);

struct Reader<'a> {
    file: &'a dyn Store,
}

impl Reader<'_> {
    fn has(&self, part: &str) -> Result<bool> {
        Ok(self.file.shape(&format!("{part}/model/mean"))?.is_some())
    }

    /// Numbers of a dataset of that shape, all finite.
    fn numbers(&self, path: &str, shape: &[usize]) -> Result<Vec<f64>> {
        let found = self.file.shape(path)?;
        if found.as_ref().is_some_and(|found| !same(found, shape)) {
            return Err(Error::new(format_args!(
                "{path}: shape {:?}, expected {shape:?}; the file is damaged, get it again",
                found.unwrap_or_default()
            )));
        }
        let numbers = self.file.numbers(path)?;
        // A dataset that was made and never filled has none.
        if numbers.len() != shape.iter().product::<usize>() {
            return Err(Error::new(format_args!(
                "{path}: {} numbers, expected {shape:?}; the file is incomplete, get it again",
                numbers.len()
            )));
        }
        if let Some(i) = numbers.iter().position(|x| !(*x as f32).is_finite()) {
            return Err(Error::new(format_args!(
                "{path}: entry {i} is {}; the file is damaged, get it again",
                numbers[i]
            )));
        }
        Ok(numbers)
    }

    /// Lengths of the axes of a dataset that has two.
    fn matrix(&self, path: &str) -> Result<Option<[usize; 2]>> {
        let Some(shape) = self.file.shape(path)? else { return Ok(None) };
        let lengths: Vec<usize> = shape.iter().filter_map(|&n| usize::try_from(n).ok()).collect();
        let lengths = <[usize; 2]>::try_from(lengths);
        lengths.map(Some).map_err(|_| {
            Error::new(format_args!("{path}: shape {shape:?}, expected two axes; get it again"))
        })
    }

    /// A single number, written with or without an axis.
    fn single(&self, path: &str) -> Result<Option<f64>> {
        match self.file.shape(path)? {
            None => Ok(None),
            Some(shape) if shape.is_empty() => Ok(self.numbers(path, &[])?.first().copied()),
            Some(_) => Ok(self.numbers(path, &[1])?.first().copied()),
        }
    }

    /// Points and triangles of a part's reference, in the file's unit.
    fn reference(&self, part: &str) -> Result<ReferenceMesh> {
        // Names and layouts of old files differ.
        let old = format!("{part}/representer/reference-mesh");
        let points_at = format!("{part}/representer/points");
        let cells_at = format!("{part}/representer/cells");
        let old_points_at = format!("{old}/vertex-coordinates");
        let old_cells_at = format!("{old}/triangle-list");
        let points = match self.matrix(&points_at)? {
            Some([3, n]) => planes(&self.numbers(&points_at, &[3, n])?),
            Some(shape) => return Err(wrong_axes(&points_at, shape, "[3, vertices]")),
            None => match self.matrix(&old_points_at)? {
                Some([n, 3]) => rows(&self.numbers(&old_points_at, &[n, 3])?),
                Some(shape) => return Err(wrong_axes(&old_points_at, shape, "[vertices, 3]")),
                None => return Err(missing(&points_at)),
            },
        };
        let (cells_at, cells) = match self.matrix(&cells_at)? {
            Some([3, t]) => {
                let cells = planes(&self.numbers(&cells_at, &[3, t])?);
                (cells_at, cells)
            }
            Some(shape) => return Err(wrong_axes(&cells_at, shape, "[3, triangles]")),
            None => match self.matrix(&old_cells_at)? {
                Some([t, 3]) => {
                    let cells = rows(&self.numbers(&old_cells_at, &[t, 3])?);
                    (old_cells_at, cells)
                }
                Some(shape) => return Err(wrong_axes(&old_cells_at, shape, "[triangles, 3]")),
                None => return Err(missing(&cells_at)),
            },
        };
        if points.is_empty() || cells.is_empty() {
            return Err(Error::new(format_args!("{part}/representer: the mesh is empty")));
        }
        let count = points.len();
        let valid = |v: f64| v >= 0.0 && v < count as f64 && v.fract() == 0.0;
        if let Some(i) = cells.iter().position(|cell| !cell.iter().all(|&v| valid(v))) {
            return Err(Error::new(format_args!(
                "{cells_at}: triangle {i} is {:?}, there are {count} vertices; the file is \
                 damaged, get it again",
                cells[i]
            )));
        }
        let points = points.iter().map(|p| p.map(|x| x as f32)).collect();
        Ok((points, cells.iter().map(|cell| cell.map(|v| v as u32)).collect()))
    }

    fn is_rgb(&self) -> Result<()> {
        const PATH: &str = "color/representer/colorspace";
        if self.file.shape(PATH)?.is_none() {
            return Ok(());
        }
        let space = self.file.text(PATH)?;
        if space.trim() == "RGB" {
            Ok(())
        } else {
            Err(Error::new(format_args!("{PATH}: {space:?}, only RGB is read; convert the model")))
        }
    }

    /// Millimetres per unit of the file: one unless it says otherwise.
    fn length_unit(&self) -> Result<f64> {
        match self.single(LENGTH_UNIT)? {
            // 0.001 in 32 bits is not a thousandth.
            Some(unit) if (unit * MILLIMETRES - 1.0).abs() < 1e-6 => Ok(1.0),
            Some(unit) if unit > 0.0 => Ok(unit * MILLIMETRES),
            Some(unit) => Err(Error::new(format_args!("{LENGTH_UNIT}: {unit} m is no length"))),
            None => Ok(1.0),
        }
    }

    /// Whether a part's columns are `U√λ` rather than `U`: versions before 0.9.
    fn is_scaled(&self, part: &str) -> Result<bool> {
        let version = |name: &str| self.single(&format!("{part}/version/{name}"));
        Ok(match (version("majorVersion")?, version("minorVersion")?) {
            (Some(0.0), Some(minor)) => minor < 9.0,
            (Some(_), _) => false,
            (None, _) => true,
        })
    }

    fn process(&self, part: &str, vertices: usize) -> Result<Process> {
        let path = |name: &str| format!("{part}/model/{name}");
        let length = 3 * vertices;
        let mean = rows(&self.numbers(&path("mean"), &[length])?);
        let basis_at = path("pcaBasis");
        let Some([_, rank]) = self.matrix(&basis_at)? else { return Err(missing(&basis_at)) };
        let mut variances = self.numbers(&path("pcaVariance"), &[rank])?;
        if let Some(k) = variances.iter().position(|v| *v < 0.0) {
            return Err(Error::new(format_args!(
                "{}: entry {k} is {}, a variance is not negative; get the file again",
                path("pcaVariance"),
                variances[k]
            )));
        }
        let entries = self.numbers(&basis_at, &[length, rank])?;
        let scale: Vec<f64> = if self.is_scaled(part)? {
            // What a component without variance adds cannot be told from nothing.
            variances.iter().map(|v| if *v > 1e-16 { 1.0 / v.sqrt() } else { 0.0 }).collect()
        } else {
            vec![1.0; rank]
        };
        let basis = Mat::from_fn(length, rank, |row, k| {
            scale[k] * entries[(row % vertices * 3 + row / vertices) * rank + k]
        });
        drop(entries);
        let noise = self.single(&path("noiseVariance"))?.unwrap_or(0.0);
        if noise < 0.0 {
            return Err(Error::new(format_args!(
                "{}: {noise}, a variance is not negative; get the file again",
                path("noiseVariance")
            )));
        }
        variances.shrink_to_fit();
        let mean = mean.iter().map(|p| p.map(|x| x as f32)).collect();
        Ok(Process::new(mean, basis, variances, noise))
    }

    /// The process of colours, which lie between 0 and 1.
    fn colors(&self, vertices: usize) -> Result<Process> {
        let process = self.process("color", vertices)?;
        let sum: f64 = process.mean.as_flattened().iter().copied().map(f64::from).sum();
        if sum > 3.0 * vertices as f64 {
            return Err(Error::new(
                "color/model/mean: most colours are above 1, as if of 0 to 255; divide it by 255 (and \
                 pcaVariance by its square, if that is so, too)",
            ));
        }
        Ok(process)
    }

    /// Landmarks as vertices of the reference, in the file's unit.
    fn landmarks(
        &self,
        reference: &[[f32; 3]],
        uncertainties: &mut BTreeMap<String, Uncertainty>,
        notes: &mut Vec<String>,
    ) -> Result<Vec<Landmark>> {
        const JSON: &str = "metadata/landmarks/json";
        const TEXT: &str = "metadata/landmarks/text";
        let (path, points) = if self.file.shape(JSON)?.is_some() {
            (JSON, landmarks::parse_points(&self.file.text(JSON)?))
        } else if self.file.shape(TEXT)?.is_some() {
            (TEXT, landmarks::parse_lines(&self.file.text(TEXT)?))
        } else {
            return Ok(Vec::new());
        };
        let points = points.map_err(|e| Error::new(format_args!("{path}: {e}")))?;
        let index = Index::new(reference);
        let mut found = Vec::new();
        let (mut moved, mut left_out) = (Vec::new(), Vec::new());
        for point in points {
            let (vertex, distance) = index.nearest(point.coordinates);
            if !(distance <= LANDMARK_TOLERANCE * index.diagonal) {
                left_out.push(point.id);
                continue;
            }
            if distance > ROUNDING * index.diagonal {
                moved.push(distance);
            }
            if let Some(uncertainty) = point.uncertainty {
                uncertainties.insert(point.id.clone(), uncertainty);
            }
            found.push(Landmark { name: point.id, vertex });
        }
        if !moved.is_empty() {
            let most = moved.iter().fold(0.0_f64, |most, d| most.max(*d));
            notes.push(format!(
                "{} of {} landmarks are not exactly at a vertex of the reference (up to {most:.1e} \
                 away); the nearest was taken",
                moved.len(),
                found.len()
            ));
        }
        if !left_out.is_empty() {
            notes.push(format!("left out, as they are at no vertex: {}", left_out.join(", ")));
        }
        Ok(found)
    }
}

fn missing(path: &str) -> Error {
    Error::new(format_args!("{path}: there is no such dataset; is this a morphable model?"))
}

fn wrong_axes(path: &str, found: [usize; 2], expected: &str) -> Error {
    Error::new(format_args!("{path}: shape {found:?}, expected {expected}; get the file again"))
}

fn same(found: &[u64], expected: &[usize]) -> bool {
    found.len() == expected.len() && found.iter().zip(expected).all(|(a, b)| *a == *b as u64)
}

/// Triples that lie one after the other.
fn rows(numbers: &[f64]) -> Vec<[f64; 3]> {
    numbers.as_chunks().0.to_vec()
}

/// Triples whose first numbers lie one after the other, then their second, then their third.
fn planes(numbers: &[f64]) -> Vec<[f64; 3]> {
    let n = numbers.len() / 3;
    (0..n).map(|i| [numbers[i], numbers[n + i], numbers[2 * n + i]]).collect()
}

/// Finds vertices by their coordinates.
struct Index<'a> {
    points: &'a [[f32; 3]],
    exact: HashMap<[u64; 3], u32>,
    diagonal: f64,
}

impl<'a> Index<'a> {
    fn new(points: &'a [[f32; 3]]) -> Self {
        let mut exact = HashMap::new();
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for (i, p) in points.iter().enumerate() {
            let p = p.map(f64::from);
            exact.entry(key(p)).or_insert(i as u32);
            for axis in 0..3 {
                low[axis] = low[axis].min(p[axis]);
                high[axis] = high[axis].max(p[axis]);
            }
        }
        Self { points, exact, diagonal: distance(low, high) }
    }

    /// The vertex at or nearest to `at`, and how far it is.
    fn nearest(&self, at: [f64; 3]) -> (u32, f64) {
        if let Some(&vertex) = self.exact.get(&key(at)) {
            return (vertex, 0.0);
        }
        let far = |p: &[f32; 3]| distance(p.map(f64::from), at);
        (0..)
            .zip(self.points.iter().map(far))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap_or((0, f64::INFINITY))
    }
}

/// Bits of coordinates; adding zero makes both zeros one.
fn key(p: [f64; 3]) -> [u64; 3] {
    p.map(|x| (x + 0.0).to_bits())
}

/// The groups and datasets of a model, as the reference engine writes them.
///
/// `U` is rounded to 32 bits. Landmarks get the coordinates of their vertices in the reference,
/// exactly, as its reader wants them.
pub fn write(model: &Morphable) -> Group {
    let mut root = Group::default();
    let parts = [
        ("shape", "gravis::MeshShapeRepresenter", Some(&model.shape)),
        ("color", "gravis::MeshColorRepresenter", Some(&model.albedo)),
        ("expression", "gravis::MeshExpressionRepresenter", model.expression.as_ref()),
    ];
    put_version(&mut root, "");
    put_entry(&mut root, "MorphableModel", "/", "CUSTOM_MODEL");
    for (part, representer, process) in parts {
        let Some(process) = process else { continue };
        let (path, kind) = match part {
            // Two slashes: so does the engine.
            "shape" => ("//shape".to_string(), "POLYGON_MESH_MODEL"),
            _ => (format!("/{part}"), "POLYGON_MESH_DATA_MODEL"),
        };
        put_entry(&mut root, &format!("MorphableModel.{part}"), &path, kind);
        put_version(&mut root, &format!("{part}/"));
        put_process(&mut root, part, process);
        put_reference(&mut root, part, model);
        root.group(&format!("{part}/representer")).attributes =
            vec![("name", representer), ("datasetType", "POLYGON_MESH")];
    }
    root.put("color/representer/colorspace", &[1], Values::Text("RGB\0".into()));
    let points: Vec<Point> = model
        .landmarks
        .iter()
        .map(|landmark| Point {
            id: landmark.name.clone(),
            coordinates: model.reference()[landmark.vertex as usize].map(f64::from),
            description: None,
            uncertainty: model.uncertainties.get(&landmark.name).copied(),
        })
        .collect();
    // Without an axis: so scalismo-faces wants it.
    root.put("metadata/landmarks/json", &[], Values::Text(landmarks::to_json(&points)));
    root
}

fn put_version(root: &mut Group, part: &str) {
    root.put(&format!("{part}version/majorVersion"), &[], Values::I32(vec![0]));
    root.put(&format!("{part}version/minorVersion"), &[], Values::I32(vec![9]));
}

fn put_entry(root: &mut Group, name: &str, path: &str, kind: &str) {
    for (field, text) in [("modelPath", path), ("modelType", kind)] {
        root.put(&format!("catalog/{name}/{field}"), &[1], Values::Text(text.into()));
    }
}

fn put_process(root: &mut Group, part: &str, process: &Process) {
    let (vertices, rank) = (process.vertices(), process.rank());
    let mut put = |name: &str, shape: &[usize], values: Vec<f32>| {
        root.put(&format!("{part}/model/{name}"), shape, Values::F32(values));
    };
    put("mean", &[3 * vertices], process.mean.as_flattened().to_vec());
    put("noiseVariance", &[1], vec![process.noise as f32]);
    let mut entries = Vec::with_capacity(3 * vertices * rank);
    for vertex in 0..vertices {
        for channel in 0..3 {
            let row = process.basis.row(channel * vertices + vertex);
            entries.extend(row.iter().map(|x| *x as f32));
        }
    }
    put("pcaBasis", &[3 * vertices, rank], entries);
    put("pcaVariance", &[rank], process.variances.iter().map(|v| *v as f32).collect());
    root.put(&format!("{part}/modelinfo/build-time"), &[1], Values::Text(BUILD_TIME.into()));
    root.put(&format!("{part}/modelinfo/scores"), &[1, 1], Values::F32(vec![0.0]));
}

fn put_reference(root: &mut Group, part: &str, model: &Morphable) {
    let (points, cells) = (model.reference(), &model.triangles);
    let planes = |k: usize| points.iter().map(move |p| p[k]);
    let corners = |k: usize| cells.iter().map(move |t| t[k].cast_signed());
    let values = Values::F32((0..3).flat_map(planes).collect());
    root.put(&format!("{part}/representer/points"), &[3, points.len()], values);
    let values = Values::I32((0..3).flat_map(corners).collect());
    root.put(&format!("{part}/representer/cells"), &[3, cells.len()], values);
}

#[cfg(test)]
mod tests;
