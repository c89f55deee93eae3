//! The time of a search for the mode.

use super::workload::Workload;
use crate::error::{Error, Result};
use crate::model_file::OwnedModel;
use onescan_core::basis::field_len;
use onescan_core::chain::Config;
use onescan_core::search::{self, ModeSearch, Options};
use serde::Serialize;
use std::mem::size_of;
use std::time::{Duration, Instant};

/// Runs of the same search.
const REPETITIONS: usize = 2;

/// How fast a search comes to the mode on one core.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ModeTime {
    /// Components of the shape, and as many of the albedo.
    pub rank: usize,
    /// Iterations until it has converged.
    pub iterations: usize,
    /// Seconds of all of it.
    pub seconds: f64,
    /// Floating-point operations of an iteration, an estimate: the sums of the normal equations,
    /// their solution, and both bases, once forth and once back.
    pub flops_per_iteration: f64,
    /// Bytes an iteration moves, an estimate: both bases forth and back and by vertex, and the
    /// matrix when it is made, copied and solved.
    pub bytes_per_iteration: f64,
    /// Seconds if its operations at the peak, or moving these bytes at the memory's bandwidth,
    /// whichever takes longer, were all there is to do.
    pub roofline_seconds: f64,
    /// Share of that speed reached.
    pub fraction_of_roofline: f64,
}

impl ModeTime {
    /// `gflops` and `bandwidth` are the machine's, 10⁹ per second.
    pub(super) fn new(
        workload: &Workload,
        model: &OwnedModel,
        rank: usize,
        gflops: f64,
        bandwidth: f64,
    ) -> Result<Self> {
        let config = mode_config(rank);
        let (model, landmarks) = (model.view(), workload.observed());
        let problem = workload.problem(&model, &landmarks, &config);
        let mut memory = vec![0; search::words(&problem, &Options::default())];
        let mut times = Vec::new();
        let mut pixels = 0;
        for _ in 0..REPETITIONS {
            pixels = 0;
            let begin = Instant::now();
            let mut search =
                ModeSearch::new(problem, Options::default(), &mut memory).map_err(Error::new)?;
            let mut again = vec![begin.elapsed()];
            let mut start = Instant::now();
            while let Some(iteration) = search.step() {
                again.push(start.elapsed());
                pixels += search::LEVELS[iteration.level].pixels;
                start = Instant::now();
            }
            let known = times.iter().copied().chain(std::iter::repeat(Duration::MAX));
            times = again.into_iter().zip(known).map(|(time, known)| time.min(known)).collect();
        }
        let (iterations, seconds) = (times.len() - 1, times.iter().sum::<Duration>().as_secs_f64());
        let n =
            (2 * rank + search::unknowns::POSE + search::unknowns::LIGHT + search::unknowns::COLOR)
                as f64;
        let entries = 2.0 * (rank * field_len(model.vertices())) as f64;
        let equations = 3.0 * pixels as f64 / iterations as f64;
        let flops = equations * n * n + n * n * n / 3.0 + 4.0 * entries;
        // Half a matrix of 4-byte numbers is read and written four times.
        let bytes = 3.0 * size_of::<i16>() as f64 * entries + 4.0 * 2.0 * 0.5 * 4.0 * n * n;
        let roofline = iterations as f64 * (flops / gflops).max(bytes / bandwidth) * 1e-9;
        Ok(Self {
            rank,
            iterations,
            seconds,
            flops_per_iteration: flops,
            bytes_per_iteration: bytes,
            roofline_seconds: roofline,
            fraction_of_roofline: roofline / seconds,
        })
    }
}

/// A search's configuration with so many components of shape and albedo each.
pub fn mode_config(rank: usize) -> Config {
    Config::default().with(|config| {
        (config.shape_rank, config.albedo_rank) = (rank, rank);
        (config.landmark_steps, config.shape_steps, config.image_steps) = (0, 0, 0);
    })
}
