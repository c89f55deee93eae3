//! The `onescan` command: parse, run, and turn an error into one line and an exit code.

mod cli;

use clap::Parser;
use onescan::error::{Error, Result};
use onescan::progress::complain;
use std::process::ExitCode;

fn main() -> ExitCode {
    // Usage errors leave here with exit code 2.
    let arguments = cli::Arguments::parse();
    match bounded_threads().and_then(|()| arguments.run()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            complain(format_args!("onescan: {error}"));
            ExitCode::FAILURE
        }
    }
}

/// Most threads, however many are asked for: more than any machine has processors to keep busy.
const MOST_THREADS: usize = 1024;

/// Sees to it that the environment does not ask for more threads than there can be.
fn bounded_threads() -> Result<()> {
    let asked = std::env::var("RAYON_NUM_THREADS").ok().and_then(|n| n.trim().parse().ok());
    if asked.is_some_and(|asked: usize| asked > MOST_THREADS) {
        complain(format_args!(
            "RAYON_NUM_THREADS: {MOST_THREADS} threads are the most; taking these"
        ));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(MOST_THREADS);
        pool.build_global()
            .map_err(|e| Error::new(format_args!("{MOST_THREADS} threads: {e}; ask for fewer")))?;
    }
    Ok(())
}
