//! `onescan bench`.

use clap::Args;
use onescan::bench;
use onescan::error::Result;
use onescan::progress::{Console, print};

/// Measure steps per second on this machine, stage by stage, and the time to the mode, beside its
/// memory bandwidth and arithmetic.
///
/// On the built-in face model and a rendered face, one core; takes half a minute. Times are
/// the fastest of many runs, so a busy machine disturbs them little.
#[derive(Args)]
pub(super) struct Bench {
    /// For programs.
    #[arg(long)]
    json: bool,
}

impl Bench {
    pub(super) fn run(self, console: Console) -> Result<()> {
        let mut task = console.task("measuring", 1000);
        let report = bench::measure(&mut |done| task.set((1000.0 * done) as u64))?;
        task.finish();
        if self.json {
            print(report.to_json()?)?;
        } else {
            print(report)?;
        }
        Ok(())
    }
}
