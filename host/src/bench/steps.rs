//! Steps of the chain, and the bytes that they move.

use super::workload::{SEED, Workload};
use crate::error::{Error, Result};
use onescan_core::basis::{field_len, padded};
use onescan_core::chain::{Chain, Config, PhaseName};
use onescan_core::engine::Engine;
use onescan_core::model::Triangles;
use onescan_core::proposal::Touched;
use serde::Serialize;
use std::mem::size_of;
use std::time::{Duration, Instant};

/// Steps of the image phase in one run.
const STEPS: u32 = 1500;
/// Runs of the same chain.
const REPETITIONS: usize = 2;

/// Steps until one has compared the picture. Returns whether there was one.
pub fn step_to_image(chain: &mut Chain<'_, '_>) -> bool {
    let before = chain.checkpoint().image_evaluated;
    while chain.step().is_some() {
        if chain.checkpoint().image_evaluated != before {
            return true;
        }
    }
    false
}

/// Speed of the image phase of a chain on one core.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Speed {
    /// Steps per second that compared the picture. The time of the others, turned down by an
    /// earlier test, is theirs too.
    pub steps_per_second: f64,
    /// Steps per second, whatever became of them.
    pub all_steps_per_second: f64,
}

/// The image phase of a chain, timed.
pub(super) struct Run {
    /// Seconds of the whole phase.
    pub(super) seconds: f64,
    /// Steps that compared the picture; of these, how many computed positions, what is visible,
    /// and albedo anew.
    pub(super) evaluated: f64,
    shape: f64,
    geometry: f64,
    albedo: f64,
}

impl Run {
    pub(super) fn new(
        workload: &Workload,
        engine: &Engine,
        solve_light: bool,
        progress: &mut dyn FnMut(f64),
    ) -> Result<Self> {
        let config = Config::default().with(|config| {
            config.image_steps = STEPS;
            config.solve_light = solve_light;
        });
        let (model, landmarks) = (workload.model.view(), workload.observed());
        let problem = workload.problem(&model, &landmarks, &config).with_engine(engine);
        let mut memory = vec![0_u32; problem.dimensions().words()];
        let mut times = vec![Duration::MAX; STEPS as usize];
        let mut evaluated = Vec::new();
        for repetition in 0..REPETITIONS {
            let mut chain = Chain::new(problem, SEED, 0, &mut memory).map_err(Error::new)?;
            while chain.phase() == PhaseName::Landmarks && chain.step().is_some() {}
            let touches: Vec<Touched> =
                chain.tallies(PhaseName::Image).map(|(branch, _)| branch.kind.touches()).collect();
            evaluated.clear();
            for time in &mut times {
                let before = chain.checkpoint().image_evaluated;
                let start = Instant::now();
                let step = chain.step();
                *time = start.elapsed().min(*time);
                if chain.checkpoint().image_evaluated != before {
                    evaluated.extend(step.map(|step| touches[step.branch]));
                }
            }
            progress((repetition + 1) as f64 / REPETITIONS as f64);
        }
        let count = |of: fn(&Touched) -> bool| {
            evaluated.iter().filter(|touched| of(touched)).count() as f64
        };
        Ok(Self {
            seconds: times.iter().sum::<Duration>().as_secs_f64(),
            evaluated: count(|_| true),
            shape: count(|touched| touched.shape),
            geometry: count(|touched| touched.geometry),
            albedo: count(|touched| touched.albedo),
        })
    }

    pub(super) fn speed(&self) -> Speed {
        Speed {
            steps_per_second: self.evaluated / self.seconds,
            all_steps_per_second: f64::from(STEPS) / self.seconds,
        }
    }
}

/// Bytes the stages read and write, each buffer once.
pub(super) struct Traffic {
    /// The components in use of one half's basis, and its mean.
    basis: f64,
    /// Four numbers per vertex.
    quads: f64,
    /// Corner indices.
    triangles: f64,
    /// Covered pixels.
    covered: f64,
}

impl Traffic {
    pub(super) fn new(workload: &Workload) -> Self {
        let model = workload.model.view();
        let number = size_of::<f32>();
        let triangles = match model.triangles {
            Triangles::U16(t) => size_of_val(t),
            Triangles::U32(t) => size_of_val(t),
        };
        let entry = size_of::<i16>() * Config::default().shape_rank + number;
        Self {
            basis: (entry * field_len(model.vertices())) as f64,
            quads: (4 * number * padded(model.vertices())) as f64,
            triangles: triangles as f64,
            covered: workload.covered * workload.picture.rgb.len() as f64,
        }
    }

    /// An average image-evaluated step of a run. Per covered pixel, the frame holds 16 bytes,
    /// normal, albedo and target 12 each, the background 4.
    pub(super) fn per_step(&self, run: &Run) -> f64 {
        let instance = self.basis + self.quads;
        let normals = 2.0 * self.quads + self.triangles;
        let project = 2.0 * self.quads;
        let rasterize = self.triangles + self.quads + (2.0 * 16.0 + 4.0) * self.covered;
        let normal = (16.0 + 12.0) * self.covered + self.quads + self.triangles;
        let albedo = 12.0 * self.covered + self.quads;
        let compare = 3.0 * 12.0 * self.covered;
        let total = run.shape * (instance + normals)
            + run.albedo * (instance + albedo + 16.0 * self.covered + self.triangles)
            + run.geometry * (project + rasterize + normal + albedo)
            + run.evaluated * compare;
        total / run.evaluated
    }
}
