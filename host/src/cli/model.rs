//! `onescan model`.

use super::{
    file_name, meshes, model_file, output_file, positive, read_model, write_mesh, write_model,
};
use clap::{Args, Subcommand};
use onescan::error::{Error, Result};
use onescan::files::{has_extension, read_text, write_atomically};
use onescan::interchange::Format;
use onescan::interchange::mixture::Mixture;
use onescan::mesh::landmarks::{self, Point};
use onescan::mesh::ply;
use onescan::model::morphable::Morphable;
use onescan::model::operate::posterior::Observation;
use onescan::model::operate::with_line;
use onescan::model::process::Process;
use onescan::progress::Console;
use serde_json::json;
use std::io::Write;
use std::path::{Path, PathBuf};

#[derive(Subcommand)]
pub(super) enum Model {
    /// Find the mesh of a model that explains a mesh of its topology best.
    ///
    /// The posterior mean of the coefficients, `c = (QᵀQ + σ²I)⁻¹ Qᵀ(s − m)`, and its mesh.
    Project(Project),
    /// Condition a model on known landmarks, or on a mesh of which a part is known.
    ///
    /// Gaussian-process regression: the mean moves to what is known, and what is near it varies
    /// less. Positions are a JSON array of {"id", "coordinates": [x, y, z], "uncertainty"?:
    /// {"stddevs": [3], "pcvectors": [[3], [3], [3]]}}, millimetres, ids as in `onescan info`.
    Posterior(Posterior),
    /// Cut out a region.
    ///
    /// The marginal: instances of the region's model are the region of the model's instances.
    Region(Region),
    /// Give a model another mean, a mesh of its topology.
    ///
    /// Deviations stay as they are.
    Recentre(Recentre),
    /// Add the deviations of a second model on the same mesh.
    ///
    /// Covariances add, mean and landmarks are the first model's. So a model learnt from few scans
    /// gets the flexibility of one scan's kernels: build the second model on the first one's mean.
    Augment(Augment),
    /// Say where the surface is likely to be hidden in photos: by hair, glasses, a beard.
    ///
    /// `fit` then starts from that instead of its rule for faces (hair above the brows and at the
    /// sides). Paint the model's mean (mean.ply of `onescan modes`) black where the surface is
    /// always seen, white where it is always hidden, grey in between (grey 128 is a chance of one
    /// half), and give the PLY; or a text file with a number from 0 to 1 for each vertex. Only
    /// .3dmm carries the map; `region` and `export` keep it in step.
    Occlusion(Occlusion),
    /// Learn a model from registered meshes: mean and principal components.
    ///
    /// Sample covariance, 1/(n − 1), of shape and of albedo; at most one component fewer than
    /// meshes.
    Pca(Pca),
    /// Mix models: name several, and how likely each is, in one file.
    ///
    /// Each may be made of another scan; nothing need be in correspondence (the paper's kernel density
    /// estimate). `fit` and `recognise` take the mixture, a .toml, where they take a model: they fit
    /// every component, and say which is the likeliest.
    ///
    /// Example: onescan model mix anna.3dmm ben.3dmm -o people.toml
    Mix(Mix),
}

#[derive(Args)]
pub(super) struct Project {
    /// The model: .3dmm, .h5, .h5.json or .mat.
    model: PathBuf,
    /// The mesh, PLY, of the model's topology and in its place.
    mesh: PathBuf,
    /// The mesh to write, .ply or .glb.
    #[arg(short, long)]
    output: PathBuf,
    /// Write the coefficients as well, .json.
    #[arg(long)]
    coefficients: Option<PathBuf>,
    /// Standard deviation of the mesh's numbers, mm and RGB [default: 0.003].
    #[arg(long, value_parser = positive)]
    noise: Option<f64>,
}

#[derive(Args)]
#[command(group = clap::ArgGroup::new("known").required(true).multiple(true).args(["landmarks", "mesh"]))]
pub(super) struct Posterior {
    /// The model: .3dmm, .h5, .h5.json or .mat.
    model: PathBuf,
    /// The model to write: .3dmm, .h5 or .h5.json.
    #[arg(short, long)]
    output: PathBuf,
    /// Where landmarks are, JSON.
    #[arg(long)]
    landmarks: Option<PathBuf>,
    /// A mesh of the model's topology, PLY; with --around or --mask only that part of it is known.
    #[arg(long)]
    mesh: Option<PathBuf>,
    #[command(flatten)]
    selection: Selection,
    /// Standard deviation of a position, mm, where its file does not say.
    #[arg(long, default_value_t = 1.0, value_parser = positive)]
    noise: f64,
    /// Standard deviation of a mesh's colour.
    #[arg(long, default_value_t = 0.05, value_parser = positive)]
    color_noise: f64,
}

/// Some of the vertices.
#[derive(Args)]
struct Selection {
    /// Vertices near this landmark; may be repeated.
    #[arg(long, value_name = "LANDMARK", conflicts_with = "mask")]
    around: Vec<String>,
    /// How near, mm.
    #[arg(long, default_value_t = 30.0, value_parser = positive)]
    radius: f64,
    /// A text file with a line for each vertex, 1 if it belongs to the part, 0 if not.
    #[arg(long)]
    mask: Option<PathBuf>,
}

#[derive(Args)]
pub(super) struct Region {
    /// The model: .3dmm, .h5, .h5.json or .mat.
    model: PathBuf,
    /// The model to write: .3dmm, .h5 or .h5.json.
    #[arg(short, long)]
    output: PathBuf,
    #[command(flatten)]
    selection: Selection,
}

#[derive(Args)]
pub(super) struct Recentre {
    /// The model: .3dmm, .h5, .h5.json or .mat.
    model: PathBuf,
    /// The mesh, PLY.
    mesh: PathBuf,
    /// The model to write: .3dmm, .h5 or .h5.json.
    #[arg(short, long)]
    output: PathBuf,
}

#[derive(Args)]
pub(super) struct Augment {
    /// The model whose mean stays: .3dmm, .h5, .h5.json or .mat.
    model: PathBuf,
    /// The model that lends its deviations.
    by: PathBuf,
    /// The model to write: .3dmm, .h5 or .h5.json.
    #[arg(short, long)]
    output: PathBuf,
}

#[derive(Args)]
pub(super) struct Occlusion {
    /// The model: .3dmm, .h5, .h5.json or .mat.
    model: PathBuf,
    /// How likely each vertex is hidden: a mesh of the model's topology, .ply, by its colours; or
    /// numbers from 0 to 1, a vertex each.
    #[arg(long)]
    map: PathBuf,
    /// The model to write: .3dmm.
    #[arg(short, long)]
    output: PathBuf,
}

#[derive(Args)]
pub(super) struct Pca {
    /// Meshes, PLY, or directories of them: same vertices in the same order, aligned.
    #[arg(required = true)]
    meshes: Vec<PathBuf>,
    /// The model to write: .3dmm, .h5 or .h5.json.
    #[arg(short, long)]
    output: PathBuf,
    /// Landmarks of the first mesh, JSON.
    #[arg(long)]
    landmarks: Option<PathBuf>,
}

#[derive(Args)]
pub(super) struct Mix {
    /// The models: .3dmm, .h5, .h5.json or .mat.
    #[arg(required = true)]
    models: Vec<PathBuf>,
    /// The mixture to write, .toml.
    #[arg(short, long)]
    output: PathBuf,
    /// How likely each model is before a photo is seen, in proportion [default: all alike].
    #[arg(long, num_args = 1.., value_parser = positive)]
    weights: Vec<f64>,
}

impl Model {
    pub(super) fn run(self, console: Console) -> Result<()> {
        match self {
            Self::Project(command) => command.run(console),
            Self::Posterior(command) => command.run(console),
            Self::Region(command) => command.run(console),
            Self::Recentre(command) => command.run(console),
            Self::Augment(command) => command.run(console),
            Self::Occlusion(command) => command.run(console),
            Self::Pca(command) => command.run(console),
            Self::Mix(command) => command.run(console),
        }
    }
}

/// Writes a model that was made of a file, and says what it holds.
fn write(console: Console, from: &Path, path: &Path, model: &Morphable) -> Result<()> {
    let variance = |process: &Process| process.held() / process.vertices() as f64;
    console.say(format_args!(
        "{} vertices; shape: {} components, {:.3} mm² per vertex; albedo: {} components, {:.5}",
        model.shape.vertices(),
        model.shape.rank(),
        variance(&model.shape),
        model.albedo.rank(),
        variance(&model.albedo)
    ));
    write_model(console, from, path, model)
}

impl Project {
    fn run(self, console: Console) -> Result<()> {
        output_file(&self.output, &["ply", "glb"])?;
        self.coefficients.as_deref().map_or(Ok(()), |path| output_file(path, &["json"]))?;
        let (model, mesh) = (read_model(console, &self.model)?, ply::read(&self.mesh)?);
        let variance = self.noise.map(|deviation| deviation * deviation);
        let [shape, albedo] =
            model.project(&mesh, variance).map_err(|e| Error::file(&self.mesh, e))?;
        let found = model.instance(&shape, &albedo);
        write_mesh(&self.output, &found)?;
        if let Some(path) = &self.coefficients {
            let text = format!("{:#}\n", json!({ "shape": shape, "albedo": albedo }));
            write_atomically(path, |out| out.write_all(text.as_bytes()))?;
        }
        let rms = |a: &[[f32; 3]], b: &[[f32; 3]]| {
            let pairs = a.as_flattened().iter().zip(b.as_flattened());
            let sum: f64 = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum();
            (sum / a.len().max(1) as f64).sqrt()
        };
        console.say(format_args!(
            "off by {:.3} mm and {:.4} of RGB per vertex (root mean square)",
            rms(&found.points, &mesh.points),
            rms(&found.colors, &mesh.colors)
        ));
        console.say(format_args!("wrote {}", self.output.display()));
        Ok(())
    }
}

impl Selection {
    fn is_whole(&self) -> bool {
        self.around.is_empty() && self.mask.is_none()
    }

    /// Which vertices belong to it.
    fn of(&self, model: &Morphable) -> Result<Vec<bool>> {
        let vertices = model.shape.vertices();
        let Some(path) = &self.mask else {
            return if self.around.is_empty() {
                Ok(vec![true; vertices])
            } else {
                model.around(&self.around, self.radius)
            };
        };
        per_vertex(path, vertices, "0 or 1", |word| match word {
            "0" => Some(false),
            "1" => Some(true),
            _ => None,
        })
    }
}

/// The words of a text file, one for each vertex.
fn per_vertex<T>(
    path: &Path,
    vertices: usize,
    expected: &str,
    parse: impl Fn(&str) -> Option<T>,
) -> Result<Vec<T>> {
    let text = read_text(path)?;
    let values = text
        .split_whitespace()
        .enumerate()
        .map(|(i, word)| {
            parse(word).ok_or_else(|| {
                let shown: String = word.chars().take(20).collect();
                let what = format_args!("line {}: {shown:?}, expected {expected}", i + 1);
                Error::file(path, what)
            })
        })
        .collect::<Result<Vec<T>>>()?;
    if values.len() == vertices {
        return Ok(values);
    }
    Err(Error::file(
        path,
        format_args!("has {} lines, the model {vertices} vertices; give one each", values.len()),
    ))
}

impl Posterior {
    fn run(self, console: Console) -> Result<()> {
        model_file(&self.output)?;
        let model = read_model(console, &self.model)?;
        let (mut shape, mut albedo) = (Vec::new(), Vec::new());
        let mut sources = Vec::new();
        if let Some(path) = &self.landmarks {
            let positions = landmarks::read_points(path)?;
            for position in &positions {
                shape.push(self.observation(&model, position).map_err(|e| Error::file(path, e))?);
            }
            sources.push(format!("{} landmarks", positions.len()));
        }
        if let Some(path) = &self.mesh {
            let mesh = ply::read(path)?;
            // Says if the topology differs.
            model.about(&mesh).map_err(|e| Error::file(path, e))?;
            let selected = self.selection.of(&model)?;
            let known: Vec<usize> = (0..selected.len()).filter(|&v| selected[v]).collect();
            let observe = |field: &[[f32; 3]], deviation: f64| {
                let at = |&v: &usize| {
                    Observation::isotropic(v as u32, field[v].map(f64::from), deviation)
                };
                known.iter().map(at).collect::<Vec<_>>()
            };
            shape.extend(observe(&mesh.points, self.noise));
            albedo.extend(observe(&mesh.colors, self.color_noise));
            sources.push(format!("{} vertices of {}", known.len(), file_name(path)));
        } else if !self.selection.is_whole() {
            return Err(Error::new("--around and --mask choose a part of --mesh; give that too"));
        }
        let mut posterior = model.posterior(&shape, &albedo)?;
        posterior.provenance =
            with_line(&posterior.provenance, "posterior_of", &sources.join(", "));
        write(console, &self.model, &self.output, &posterior)
    }

    fn observation(&self, model: &Morphable, position: &Point) -> Result<Observation> {
        let landmark = model.landmarks.iter().find(|l| l.name == position.id);
        let vertex = landmark.ok_or_else(|| model.no_landmark(&position.id))?.vertex;
        let usual = Observation::isotropic(vertex, position.coordinates, self.noise);
        let covariance = position.uncertainty.map_or(usual.covariance, |u| u.covariance());
        Ok(Observation { covariance, ..usual })
    }
}

impl Region {
    fn run(self, console: Console) -> Result<()> {
        model_file(&self.output)?;
        if self.selection.is_whole() {
            return Err(Error::new("which region? give --around LANDMARK or --mask FILE"));
        }
        let model = read_model(console, &self.model)?;
        let selected = self.selection.of(&model)?;
        let mut region = model.region(|v| selected[v as usize])?.orthonormal()?;
        let from = format!("{} of {} vertices", region.shape.vertices(), selected.len());
        region.provenance = with_line(&region.provenance, "region_of", &from);
        write(console, &self.model, &self.output, &region)
    }
}

impl Recentre {
    fn run(self, console: Console) -> Result<()> {
        model_file(&self.output)?;
        let (model, mesh) = (read_model(console, &self.model)?, ply::read(&self.mesh)?);
        let mut moved = model.about(&mesh).map_err(|e| Error::file(&self.mesh, e))?;
        moved.provenance = with_line(&moved.provenance, "mean", &file_name(&self.mesh));
        write(console, &self.model, &self.output, &moved)
    }
}

impl Augment {
    fn run(self, console: Console) -> Result<()> {
        model_file(&self.output)?;
        let (model, other) = (read_model(console, &self.model)?, read_model(console, &self.by)?);
        let mut both = model.augmented(&other).map_err(|e| Error::file(&self.by, e))?;
        both.provenance = with_line(&both.provenance, "augmented_by", &file_name(&self.by));
        console.say(format_args!(
            "the means are {:.2} mm apart (root mean square)",
            model.mean_distance(&other)
        ));
        write(console, &self.model, &self.output, &both)
    }
}

impl Occlusion {
    fn run(self, console: Console) -> Result<()> {
        model_file(&self.output)?;
        if Format::of(&self.output) != Format::ThreeDmm {
            return Err(Error::file(
                &self.output,
                "only .3dmm carries an occlusion map; give .3dmm",
            ));
        }
        let mut model = read_model(console, &self.model)?;
        let byte = |share: f32| (255.0 * share).round() as u8;
        let is_mesh = has_extension(&self.map, &["ply"]);
        let map: Vec<u8> = if is_mesh {
            let mesh = ply::read(&self.map)?;
            // Says if the topology differs.
            model.about(&mesh).map_err(|e| Error::file(&self.map, e))?;
            mesh.colors.iter().map(|[r, g, b]| byte((r + g + b) / 3.0)).collect()
        } else {
            let share = |word: &str| {
                let value: f32 = word.parse().ok()?;
                (0.0..=1.0).contains(&value).then(|| byte(value))
            };
            per_vertex(&self.map, model.shape.vertices(), "a number from 0 to 1", share)?
        };
        let mean = map.iter().map(|&v| f64::from(v)).sum::<f64>() / 255.0 / map.len().max(1) as f64;
        console.say(format_args!("hidden with probability {mean:.2}, vertices' average"));
        model.occlusion = Some(map);
        model.provenance = with_line(&model.provenance, "occlusion_map", &file_name(&self.map));
        write(console, &self.model, &self.output, &model)
    }
}

impl Mix {
    fn run(self, console: Console) -> Result<()> {
        output_file(&self.output, &["toml"])?;
        let weights = match &self.weights[..] {
            [] => vec![1.0; self.models.len()],
            given if given.len() == self.models.len() => given.to_vec(),
            given => {
                return Err(Error::new(format_args!(
                    "{} models and {} --weights; give one each, in their order",
                    self.models.len(),
                    given.len()
                )));
            }
        };
        for path in &self.models {
            if read_model(console, path)?.landmarks.is_empty() {
                console.say(Error::file(path, "has no landmarks, so it cannot be fitted"));
            }
        }
        let text = Mixture::text(&self.models, &weights, &self.output)?;
        write_atomically(&self.output, |out| out.write_all(text.as_bytes()))?;
        console.say(format_args!("wrote {}", self.output.display()));
        Ok(())
    }
}

impl Pca {
    fn run(self, console: Console) -> Result<()> {
        model_file(&self.output)?;
        let (paths, meshes): (Vec<_>, Vec<_>) = meshes(&self.meshes)?.into_iter().unzip();
        if let Some(odd) = meshes.iter().position(|mesh| mesh.triangles != meshes[0].triangles) {
            return Err(Error::file(
                &paths[odd],
                format_args!(
                    "has other triangles than {}; give registered meshes",
                    paths[0].display()
                ),
            ));
        }
        let landmarks = match &self.landmarks {
            Some(path) => landmarks::read(path, &meshes[0].points, 1.0)?,
            None => Vec::new(),
        };
        let unnamed = landmarks.is_empty();
        let model = Morphable::of_meshes(&meshes, landmarks)?;
        write(console, &paths[0], &self.output, &model)?;
        if unnamed {
            console.say("no --landmarks: the model can be sampled and rendered, but not fitted");
        }
        Ok(())
    }
}
