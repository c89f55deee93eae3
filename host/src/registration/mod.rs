//! Scans registered to a model's topology: the core's search on meshes, what is measured of the
//! result, and the files it leaves behind.

mod measures;
mod output;

pub use measures::{Distances, Measures};
pub use output::{Names, write};

use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::scan::doctor::mend;
use crate::scan::rigid::Rigid;
use crate::scan::surface::Surface;
use crate::simd;
use onescan_core::model::Model;
use onescan_core::register::{Iteration, Problem, Scan, words};
pub use onescan_core::register::{Options, Registration};

/// How far along its normal a vertex looks for the scan's colour, mm (docs/registration.md). Chosen.
const REACH: f64 = 10.0;

/// A registered scan.
#[derive(Clone, Debug)]
pub struct Registered {
    /// The model's topology in the scan's place, mm; colours are the scan's.
    pub mesh: Mesh,
    /// The same moved rigidly onto the model's mean, as `onescan model pca` takes it.
    pub aligned: Mesh,
    /// The scan as it was registered: mended, mm.
    pub scan: Mesh,
    /// Shape coefficients, standard deviations.
    pub shape: Vec<f32>,
    /// Size of the mesh, as a multiple of the model's instance.
    pub size: f32,
    /// Per vertex how much the scan says of its place, 0 (nothing: the prior shows) to 1.
    pub weights: Vec<f32>,
    /// Per vertex the standard deviation of its place, mm, if that was asked for.
    pub deviations: Option<Vec<f32>>,
    /// Distances of all kinds.
    pub measures: Measures,
}

impl Registered {
    /// Why the scan probably shows something else than the model, or is in another unit, as a sentence: to the
    /// model, the instance that was found is very improbable. Scans of faces have coefficients with a root mean
    /// square of .6 at most, and sizes within 8 %; a fish has 1.2 and .72.
    pub fn doubt(&self) -> Option<String> {
        let rank = self.shape.len().max(1) as f64;
        let squares = self.shape.iter().map(|a| f64::from(*a).powi(2)).sum::<f64>();
        let typical = (squares / rank).sqrt();
        let size = f64::from(self.size);
        // Of a standard normal vector: one in some forty is above. The search's prior of the size is ±4 %.
        let doubtful = typical > 1.0 + 2.0 / (2.0 * rank).sqrt() || size.ln().abs() > 0.2;
        doubtful.then(|| {
            format!(
                "the model holds what was found for improbable (coefficients of {typical:.1} standard \
                 deviations, {size:.2} times its size); is the scan of such a thing, and of such a size?"
            )
        })
    }
}

/// Registers a model to a scan in millimetres, with some vertices of the model whose places on the
/// scan are known. `watch` hears of every iteration; `uncertainty` also finds how far vertices are known.
///
/// # Errors
/// A scan without a triangle, or of which so little is matched that nothing is known.
pub fn register(
    model: &Model<'_>,
    scan: &Mesh,
    landmarks: &[(u32, [f32; 3])],
    options: Options,
    uncertainty: bool,
    watch: &mut dyn FnMut(&Iteration),
) -> Result<Registered> {
    let (scan, _) = mend(scan, false);
    let core_scan = Scan::new(&scan.points, &scan.colors, &scan.triangles).map_err(Error::new)?;
    let problem = Problem { model, scan: core_scan, landmarks, options, engine: simd::best() };
    let mut memory = vec![0; words(&problem)];
    let mut search = Registration::new(problem, &mut memory).map_err(Error::new)?;
    let mut matched = 0.0;
    while let Some(iteration) = search.step() {
        matched = iteration.matched;
        watch(&iteration);
    }
    if !(matched > LEAST) {
        return Err(Error::new(format_args!(
            "only {:.0} % of the model found a place on the scan; give --landmarks, or see to \
             --unit, --up and --front",
            100.0 * matched
        )));
    }
    let vertices = 0..model.vertices() as u32;
    let deviations = uncertainty.then(|| {
        let mut deviations = vec![0.0; model.vertices()];
        search.deviations(&mut deviations);
        deviations
    });
    let points: Vec<[f32; 3]> = vertices.clone().map(|v| search.vertex(v)).collect();
    let triangles = (0..model.triangles.len()).filter_map(|t| model.triangles.get(t)).collect();
    let surface = Surface::new(&scan);
    let mut mesh = Mesh { colors: vec![[0.0; 3]; points.len()], points, triangles };
    mesh.colors = colors(&mesh, &scan, &surface);
    let mean: Vec<[f32; 3]> = vertices.clone().map(|v| model.shape.mean_at(v as usize)).collect();
    let home = Rigid::between(&mesh.points, &mean)
        .ok_or_else(|| Error::new("the registered mesh is not finite; is the scan in its unit?"))?;
    let aligned =
        Mesh { points: mesh.points.iter().map(|&p| home.apply(p)).collect(), ..mesh.clone() };
    Ok(Registered {
        measures: Measures::of(&mesh, &scan, &surface),
        aligned,
        shape: search.shape().to_vec(),
        size: search.place().size,
        weights: vertices.map(|v| search.weight(v)).collect(),
        deviations,
        mesh,
        scan,
    })
}

/// Share of the vertices that must have found a place. Chosen, not measured.
const LEAST: f32 = 0.1;

/// Colours of the scan where vertices' normals meet it, on either side; of those that do not, at the
/// nearest point.
fn colors(mesh: &Mesh, scan: &Mesh, surface: &Surface) -> Vec<[f32; 3]> {
    let color = |(p, n): (&[f32; 3], [f32; 3])| {
        let (p, n) = (p.map(f64::from), n.map(f64::from));
        let met = surface.along(p, n, REACH).unwrap_or_else(|| surface.nearest(p));
        met.interpolate(&scan.colors).map(|c| c.clamp(0.0, 1.0))
    };
    mesh.points.iter().zip(mesh.normals()).map(color).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo;
    use onescan_core::scene::Pose;

    #[test]
    fn a_sample_of_the_model_is_found_however_it_is_turned() {
        let built = demo::template_model(30, &mut |_, _| {}).unwrap();
        let model = built.model.view();
        let shape: Vec<f32> = (0..30).map(|k| 0.4 * (1.7 * k as f32).sin()).collect();
        let mesh = crate::render::instance(&model, &shape, &[]);
        let options = Options::default();
        for (roll, yaw, pitch) in [(0.0, 0.0, 0.0), (0.5, -0.6, 0.3), (-0.8, 0.4, -0.5)] {
            let pose = Pose { scale: 1.0, translation: [40.0, -200.0, 30.0], roll, yaw, pitch };
            let mut scan = mesh.clone();
            for p in &mut scan.points {
                *p = pose.to_world(*p);
            }
            // A hole of some centimetres beside the mouth, and a topology of its own.
            let hole = |v: u32| {
                let p = mesh.points[v as usize];
                (p[0] - 35.0).hypot(p[1] + 30.0) < 12.0
            };
            scan.triangles.retain(|t| !t.iter().any(|&v| hole(v)));
            scan.triangles.reverse();
            let found = register(&model, &scan, &[], options, false, &mut |_| {}).unwrap();
            let truth: Vec<[f32; 3]> = mesh.points.iter().map(|&p| pose.to_world(p)).collect();
            let squares = found
                .mesh
                .points
                .iter()
                .zip(&truth)
                .map(|(a, b)| (0..3).map(|i| f64::from(a[i] - b[i]).powi(2)).sum::<f64>());
            let rms = (squares.sum::<f64>() / truth.len() as f64).sqrt();
            assert!(rms < 1.0, "{roll} {yaw} {pitch}: {rms} mm");
            let again = register(&model, &scan, &[], options, false, &mut |_| {}).unwrap();
            assert_eq!(again.mesh, found.mesh, "same bits");
        }
    }

    #[test]
    fn a_scan_without_a_surface_is_refused() {
        let built = demo::template_model(3, &mut |_, _| {}).unwrap();
        let flat = Mesh {
            points: vec![[0.0; 3]; 3],
            colors: vec![[0.5; 3]; 3],
            triangles: vec![[0, 1, 2]],
        };
        let error =
            register(&built.model.view(), &flat, &[], Options::default(), true, &mut |_| {});
        assert!(error.unwrap_err().to_string().contains("triangles"));
    }
}
