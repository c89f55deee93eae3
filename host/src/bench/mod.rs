//! How fast the fit is on this machine: stage by stage beside its naive twin, whole steps, the
//! search for the mode, and the memory bandwidth and arithmetic that bound them.
//!
//! Times are the fastest of many runs: what the machine does when nothing else runs on it. A chain
//! repeats to the last bit, so the same holds step by step: each step counts with the fastest of
//! its repetitions.

mod machine;
mod mode;
mod report;
mod stages;
mod steps;
mod workload;

pub use machine::Bandwidth;
pub use mode::{ModeTime, mode_config};
pub use report::{Report, Timing};
pub use stages::{Stage, Stages};
pub use steps::{Speed, step_to_image};
pub use workload::Workload;

use crate::demo;
use crate::error::Result;
use crate::simd;
use machine::{fastest, peak_gflops};
use onescan_core::chain::Config;
use onescan_core::engine::Engine;
use steps::{Run, Traffic};
use workload::SIZE;

/// Components of each half of the search's other model: as many as a scan's usually keeps.
const FULL_RANK: usize = 199;

/// Measures everything; half a minute or so, told to `progress` in `[0, 1]`.
///
/// # Errors
/// Never in practice: everything it needs is built in.
pub fn measure(progress: &mut dyn FnMut(f64)) -> Result<Report> {
    let workload = Workload::new(&mut |done| progress(0.3 * done))?;
    let mut memory = vec![0; Stages::words(SIZE)];
    let mut stages = Stages::new(&workload, &mut memory)?;
    let mut timings = Vec::new();
    for (done, stage) in Stage::ALL.into_iter().enumerate() {
        let fast = fastest(|| stages.run(stage));
        let twin = stages.run_naive(stage);
        let slow = twin.map(|()| fastest(|| stages.run_naive(stage)));
        timings.push((stage.name(), Timing::new(fast, slow)));
        progress(0.3 + 0.2 * (done + 1) as f64 / Stage::ALL.len() as f64);
    }

    let best = simd::best();
    let fit = Run::new(&workload, best, true, &mut |done| progress(0.5 + 0.15 * done))?;
    let sampler = Run::new(&workload, best, false, &mut |done| progress(0.65 + 0.1 * done))?;
    let portable = Engine::PORTABLE;
    let portable = Run::new(&workload, portable, true, &mut |done| progress(0.75 + 0.2 * done))?;
    let naive_step = timings
        .iter()
        .filter(|(name, _)| [Stage::Render, Stage::Likelihood].map(Stage::name).contains(name))
        .map(|(_, timing)| timing.naive_us)
        .sum::<Option<f64>>()
        .map(|us| 1e-6 * us);
    timings.push(("step", Timing::new(fit.seconds / fit.evaluated, naive_step)));

    let traffic = Traffic::new(&workload);
    let (bandwidth, peak) = (Bandwidth::measure(), peak_gflops());
    let full = demo::template_model(FULL_RANK, &mut |done, _| progress(0.95 + 0.04 * done))?.model;
    let rank = Config::default().shape_rank;
    let mode = [(&workload.model, rank), (&full, FULL_RANK)]
        .map(|(model, rank)| ModeTime::new(&workload, model, rank, peak, bandwidth.memory));
    let mode = mode.into_iter().collect::<Result<_>>()?;
    progress(1.0);
    let bytes_per_step = traffic.per_step(&fit);
    let roofline = 1e9 * bandwidth.cache / bytes_per_step;
    Ok(Report {
        fit: fit.speed(),
        sampler: sampler.speed(),
        engine: best.name,
        portable: portable.speed(),
        covered_fraction: workload.covered,
        stages: timings,
        bandwidth_gb_per_s: bandwidth,
        bytes_per_step,
        roofline_steps_per_second: roofline,
        fraction_of_roofline: fit.speed().steps_per_second / roofline,
        peak_gflops: peak,
        mode,
    })
}
