//! What samples of a posterior leave behind: the states, the mean face, and how far its vertices are
//! known.

use super::{Draw, Samples, rotation};
use crate::error::{Error, Result};
use crate::interchange::hdf5::{Group, Values};
use crate::mesh::ply::{self, Encoding};
use crate::mesh::{Mesh, glb};
use crate::photo::picture::{Picture, heat_color};
use crate::render;
use crate::scan::rigid::Rigid;
use onescan_core::model::Model;
use onescan_core::scene::{Subject, View};

/// Longer side of the picture, pixels.
const SIDE: u32 = 512;
/// States at most that the spread of vertices is made of. Chosen, not measured.
const STATES: usize = 400;

/// The mean face, and how far its vertices are known.
pub struct Spread {
    /// The face of the mean coefficients.
    pub mean: Mesh,
    /// Standard deviation of every vertex's place, mm: the root of the mean squared distance, each
    /// state's face being aligned to the mean face by rotation and translation.
    pub sd: Vec<f32>,
}

impl Spread {
    /// The spread of samples of a model's faces.
    ///
    /// # Errors
    /// No states; places that are not finite.
    pub fn new(model: &Model<'_>, samples: &Samples) -> Result<Self> {
        let draws: Vec<&Draw> = samples.draws().collect();
        let Some(first) = draws.first() else { return Err(Error::new("no states were drawn")) };
        let mut mean = Subject::mean(first.subject.shape.len(), first.subject.albedo.len());
        let share = 1.0 / draws.len() as f32;
        for draw in &draws {
            let pairs = |to: &mut [f32], from: &[f32]| {
                for (to, from) in to.iter_mut().zip(from) {
                    *to += share * from;
                }
            };
            pairs(&mut mean.shape, &draw.subject.shape);
            pairs(&mut mean.albedo, &draw.subject.albedo);
        }
        let mean = render::instance(model, &mean.shape, &mean.albedo);
        let mut squares = vec![0.0_f64; mean.points.len()];
        let stride = draws.len().div_ceil(STATES);
        let mut count = 0.0;
        for draw in draws.iter().step_by(stride) {
            let points = render::points(model, &draw.subject.shape);
            let aligned = Rigid::between(&points, &mean.points)
                .ok_or_else(|| Error::new("a state whose places are not finite"))?;
            for ((square, point), mean) in squares.iter_mut().zip(points).zip(&mean.points) {
                let point = aligned.apply(point);
                *square += (0..3).map(|i| f64::from(point[i] - mean[i]).powi(2)).sum::<f64>();
            }
            count += 1.0;
        }
        let sd = squares.into_iter().map(|square| (square / count).sqrt() as f32).collect();
        Ok(Self { mean, sd })
    }

    /// Root mean square over the vertices, mm.
    pub fn rms(&self) -> f64 {
        let sum: f64 = self.sd.iter().map(|sd| f64::from(*sd).powi(2)).sum();
        (sum / self.sd.len().max(1) as f64).sqrt()
    }

    /// The end of the scale of colours, mm: a whole number that nearly all vertices are below.
    pub fn most(&self) -> f32 {
        let mut sorted = self.sd.clone();
        sorted.sort_by(f32::total_cmp);
        let most = sorted.get(sorted.len() * 98 / 100).copied().unwrap_or(1.0);
        most.ceil().max(1.0)
    }

    /// The mean face, coloured by the standard deviations: black is none, then violet, red, orange
    /// and yellow to white at [`Spread::most`].
    pub fn mesh(&self) -> Mesh {
        let most = self.most();
        let color = |sd: &f32| {
            let level = (1024.0 * sd / most).clamp(0.0, 1024.0) as u32;
            heat_color(level).map(|c| f32::from(c) / 255.0)
        };
        Mesh { colors: self.sd.iter().map(color).collect(), ..self.mean.clone() }
    }

    /// A picture of [`Spread::mesh`], from the front and both sides, under even light.
    ///
    /// # Errors
    /// Never for a model's mesh.
    pub fn picture(&self, model: &Model<'_>) -> Result<Picture> {
        let mesh = self.mesh();
        let views = [-0.8, 0.0, 0.8].map(|yaw| {
            let mut scene = render::portrait(model, [SIDE; 2], yaw, 0.0);
            scene.view.light = onescan_core::light::ambient_white();
            render::draw_mesh(&mesh, &scene, render::GROUND)
        });
        let views = views.into_iter().collect::<Result<Vec<_>>>()?;
        Ok(crate::photo::picture::montage(&views.iter().collect::<Vec<_>>(), 8, [255; 3]))
    }

    /// The files it leaves behind: names and contents.
    ///
    /// # Errors
    /// Never for a model's mesh.
    pub fn files(&self, model: &Model<'_>) -> Result<Vec<(String, Vec<u8>)>> {
        let mesh = self.mesh();
        let ply = |mesh: &Mesh| -> Result<Vec<u8>> {
            let mut bytes = Vec::new();
            ply::write(&mut bytes, mesh, Encoding::default()).map_err(Error::new)?;
            Ok(bytes)
        };
        Ok(vec![
            ("mean.ply".into(), ply(&self.mean)?),
            ("mean.glb".into(), glb::encode(&self.mean, "posterior mean face")?),
            ("uncertainty.ply".into(), ply(&mesh)?),
            ("uncertainty.glb".into(), glb::encode(&mesh, "standard deviation of vertices")?),
            ("uncertainty.png".into(), self.picture(model)?.to_png()?),
        ])
    }
}

/// The states as `posterior.h5`: `posterior/` holds a dataset per kind of parameter, chain by chain,
/// state by state (of several photos, photo by photo after these), and `sample_stats/lp` the log
/// densities.
///
/// # Errors
/// Never for samples that were drawn.
pub fn states(samples: &Samples) -> Result<Vec<u8>> {
    let chains = samples.chains.len();
    let draws = samples.chains.first().map_or(0, Vec::len);
    let views = samples.draws().next().map_or(0, |draw| draw.views.len());
    let mut root = Group::default();
    let mut put = |path: &str, rest: &[usize], values: Vec<f32>| {
        let shape: Vec<usize> = [chains, draws].iter().chain(rest).copied().collect();
        root.put(path, &shape, Values::F32(values));
    };
    let subject = |of: fn(&Subject) -> &[f32]| -> Vec<f32> {
        samples.draws().flat_map(|draw| of(&draw.subject)).copied().collect()
    };
    let (shape, albedo) = (subject(|s| &s.shape), subject(|s| &s.albedo));
    let all = (chains * draws).max(1);
    let ranks = [shape.len() / all, albedo.len() / all];
    put("posterior/shape", &ranks[..1], shape);
    put("posterior/albedo", &ranks[1..], albedo);
    let mut of_views = |name: &str, rest: &[usize], of: &dyn Fn(&View) -> Vec<f32>| {
        let values = samples.draws().flat_map(|draw| draw.views.iter().flat_map(of)).collect();
        let own: Vec<usize> =
            (views > 1).then_some(views).into_iter().chain(rest.iter().copied()).collect();
        put(&format!("posterior/{name}"), &own, values);
    };
    of_views("rotation", &[3], &|v| rotation(v).to_vec());
    of_views("translation", &[3], &|v| v.pose.translation.to_vec());
    of_views("focal_length", &[], &|v| vec![v.camera.focal_length]);
    of_views("light", &[9, 3], &|v| v.light.as_flattened().to_vec());
    of_views("color", &[7], &|v| {
        let [r, g, b] = v.color.gain;
        let [x, y, z] = v.color.offset;
        vec![r, g, b, v.color.contrast, x, y, z]
    });
    let densities = samples.draws().map(|draw| draw.ln_density as f32).collect();
    put("sample_stats/lp", &[], densities);
    let mut bytes = Vec::new();
    root.write(&mut bytes).map_err(Error::new)?;
    Ok(bytes)
}
