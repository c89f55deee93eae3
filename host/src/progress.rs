//! Progress on standard error: bars on a terminal, plain lines elsewhere, nothing when quiet.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal, stderr};
use std::time::{Duration, Instant};

/// Where messages for the person at the keyboard go.
#[derive(Clone, Copy, Debug)]
pub struct Console {
    quiet: bool,
}

impl Console {
    /// Says everything, or nothing if `quiet`.
    pub fn new(quiet: bool) -> Self {
        Self { quiet }
    }

    /// Prints a line.
    pub fn say(&self, message: impl std::fmt::Display) {
        if !self.quiet {
            eprintln!("{message}");
        }
    }

    /// Starts a task of `total` units.
    pub fn task(&self, name: &str, total: u64) -> Task {
        let bar = if self.quiet || !stderr().is_terminal() {
            ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::hidden())
        } else {
            let style = ProgressStyle::with_template(
                "{msg:24} [{bar:40}] {percent:>3} %  {elapsed} of {duration}",
            )
            .unwrap_or_else(|_| ProgressStyle::default_bar())
            .progress_chars("=> ");
            let bar = ProgressBar::new(total).with_style(style);
            bar.set_message(name.to_string());
            bar
        };
        let plain = !self.quiet && !stderr().is_terminal();
        Task { bar, plain, name: name.to_string(), last: Instant::now() }
    }
}

/// A running task.
pub struct Task {
    bar: ProgressBar,
    plain: bool,
    name: String,
    last: Instant,
}

impl Task {
    /// Between plain lines.
    const PLAIN_INTERVAL: Duration = Duration::from_secs(5);

    /// The task has come to `done` units.
    pub fn set(&mut self, done: u64) {
        self.bar.set_position(done);
        if self.plain && self.last.elapsed() > Self::PLAIN_INTERVAL {
            self.last = Instant::now();
            let total = self.bar.length().unwrap_or(1).max(1);
            eprintln!("{}: {} %", self.name, 100 * done / total);
        }
    }

    /// A fraction of the task is done, and this is being done.
    pub fn report(&mut self, done: f64, what: &str) {
        self.name(what);
        self.set((done * self.bar.length().unwrap_or(1) as f64) as u64);
    }

    /// Changes what the bar says it is doing.
    pub fn name(&mut self, name: &str) {
        if self.name != name {
            self.name = name.to_string();
            self.bar.set_message(self.name.clone());
        }
    }

    /// The task is done; its bar disappears.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}
