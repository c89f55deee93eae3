//! The `onescan` command: parse, run, and turn an error into one line and an exit code.

mod cli;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    // Usage errors leave here with exit code 2.
    let arguments = cli::Arguments::parse();
    match arguments.run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("onescan: {error}");
            ExitCode::FAILURE
        }
    }
}
