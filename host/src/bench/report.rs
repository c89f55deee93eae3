//! What was measured: a table for a person, JSON for a program.

use super::machine::Bandwidth;
use super::mode::ModeTime;
use super::steps::Speed;
use super::workload::SIZE;
use crate::error::{Error, Result};
use serde::{Serialize, Serializer};
use std::fmt;

/// Time of something and of its naive twin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Timing {
    /// Microseconds.
    pub us: f64,
    /// Microseconds of the naive twin, if it has one.
    pub naive_us: Option<f64>,
    /// How many times faster it is than its twin.
    pub ratio: Option<f64>,
}

impl Timing {
    pub(super) fn new(seconds: f64, naive_seconds: Option<f64>) -> Self {
        Self {
            us: 1e6 * seconds,
            naive_us: naive_seconds.map(|naive| 1e6 * naive),
            ratio: naive_seconds.map(|naive| naive / seconds),
        }
    }
}

/// What was measured; displays as a table for a person, serializes as `onescan bench --json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The paper's chain, with closed-form light.
    #[serde(flatten)]
    pub fit: Speed,
    /// The same chain without it, a sampler.
    pub sampler: Speed,
    /// Vectors the stages were compiled for.
    pub engine: &'static str,
    /// The first with stages compiled for any processor of this kind.
    pub portable: Speed,
    /// Share of the picture that the face covers.
    pub covered_fraction: f64,
    /// Stages by name, and last the `step`: an image-evaluated step of the paper's chain beside
    /// the naive twins of rendering and likelihood.
    #[serde(serialize_with = "as_map")]
    pub stages: Vec<(&'static str, Timing)>,
    /// How fast this machine reads.
    pub bandwidth_gb_per_s: Bandwidth,
    /// Bytes an average image-evaluated step of that chain reads and writes, an estimate:
    /// every stage that the step's move makes necessary counts each of its buffers once. What the
    /// closed-form light looks at is not counted.
    pub bytes_per_step: f64,
    /// Image-evaluated steps per second if moving those bytes, at the cache's bandwidth, were all
    /// there is to do.
    pub roofline_steps_per_second: f64,
    /// Share of that reached.
    pub fraction_of_roofline: f64,
    /// The most single-precision operations this machine does, one core, 10⁹ per second, not fused.
    pub peak_gflops: f64,
    /// The search for the mode: with as many components as fits infer by default, and 199.
    pub mode: Vec<ModeTime>,
}

fn as_map<S: Serializer>(
    stages: &[(&'static str, Timing)],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    serializer.collect_map(stages.iter().copied())
}

impl Report {
    /// As JSON text.
    ///
    /// # Errors
    /// Never in practice: all keys are text.
    pub fn to_json(&self) -> Result<String> {
        serde_json::to_string_pretty(self).map_err(Error::new)
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [width, height] = SIZE;
        let covered = 100.0 * self.covered_fraction;
        writeln!(
            f,
            "one core, {width} × {height} pixels, {covered:.0} % of them face, {}",
            self.engine
        )?;
        writeln!(f)?;
        writeln!(f, "{:12}{:>12}{:>12}{:>9}", "stage", "µs", "naive µs", "ratio")?;
        for (name, Timing { us, naive_us, ratio }) in &self.stages {
            write!(f, "{name:12}{us:>12.1}")?;
            match naive_us.zip(*ratio) {
                Some((naive, ratio)) => writeln!(f, "{naive:>12.1}{ratio:>9.1}")?,
                None => writeln!(f, "{:>12}{:>9}", "–", "–")?,
            }
        }
        writeln!(f)?;
        writeln!(f, "{:12}{:>24}{:>12}", "steps/s", "picture compared", "all")?;
        for (name, speed) in
            [("chain", self.fit), ("sampler", self.sampler), ("portable", self.portable)]
        {
            let Speed { steps_per_second, all_steps_per_second } = speed;
            writeln!(f, "{name:12}{steps_per_second:>24.0}{all_steps_per_second:>12.0}")?;
        }
        let Bandwidth { memory, cache } = self.bandwidth_gb_per_s;
        writeln!(f)?;
        writeln!(f, "reading: memory {memory:.1} GB/s, cache {cache:.1} GB/s")?;
        writeln!(
            f,
            "a step moves {:.2} MB; bandwidth alone would allow {:.0} steps/s from cache, {:.0} from \
             memory",
            1e-6 * self.bytes_per_step,
            self.roofline_steps_per_second,
            1e9 * memory / self.bytes_per_step
        )?;
        writeln!(f, "the chain reaches {:.0} % of the former", 100.0 * self.fraction_of_roofline)?;
        writeln!(f)?;
        write!(f, "{:12}{:>12}{:>12}{:>12}", "time to mode", "s", "iterations", "ms each")?;
        write!(f, "{:>12}{:>12}{:>12}", "Mflop each", "MB each", "roofline s")?;
        for mode in &self.mode {
            let each = 1e3 * mode.seconds / mode.iterations as f64;
            writeln!(f)?;
            write!(f, "{:12}", format!("{0} + {0}", mode.rank))?;
            write!(f, "{:>12.3}{:>12}{each:>12.2}", mode.seconds, mode.iterations)?;
            write!(f, "{:>12.1}", 1e-6 * mode.flops_per_iteration)?;
            write!(f, "{:>12.1}", 1e-6 * mode.bytes_per_iteration)?;
            write!(f, "{:>12.3}", mode.roofline_seconds)?;
        }
        writeln!(f)?;
        write!(f, "arithmetic: {:.0} Gflop/s at most, none fused", self.peak_gflops)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_has_the_promised_keys() {
        let speed = Speed { steps_per_second: 2.0, all_steps_per_second: 3.0 };
        let report = Report {
            fit: speed,
            sampler: speed,
            engine: "none",
            portable: speed,
            covered_fraction: 0.4,
            stages: vec![
                ("draw", Timing::new(1.0, Some(4.0))),
                ("rasterize", Timing::new(1.0, None)),
            ],
            bandwidth_gb_per_s: Bandwidth { memory: 8.0, cache: 16.0 },
            bytes_per_step: 1e6,
            roofline_steps_per_second: 16e3,
            fraction_of_roofline: 0.1,
            peak_gflops: 90.0,
            mode: vec![ModeTime {
                rank: 50,
                iterations: 30,
                seconds: 0.3,
                flops_per_iteration: 1e8,
                bytes_per_iteration: 1e7,
                roofline_seconds: 0.1,
                fraction_of_roofline: 0.3,
            }],
        };
        let text = report.to_json().expect("JSON");
        let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(json["steps_per_second"], 2.0);
        assert_eq!(json["all_steps_per_second"], 3.0);
        assert_eq!(json["stages"]["draw"]["ratio"], 4.0);
        assert!(json["stages"]["rasterize"]["naive_us"].is_null());
        assert_eq!(json["bandwidth_gb_per_s"]["cache"], 16.0);
        for key in ["covered_fraction", "bytes_per_step", "roofline_steps_per_second"] {
            assert!(json[key].is_number(), "{key}");
        }
        assert!(json["fraction_of_roofline"].is_number());
        assert!(json["peak_gflops"].is_number());
        assert_eq!(json["mode"][0]["seconds"], 0.3);
    }
}
