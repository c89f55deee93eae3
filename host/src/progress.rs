//! Progress on standard error: bars on a terminal, plain lines elsewhere, nothing when quiet.

use crate::error::{Error, Result, plain};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{ErrorKind, IsTerminal, Write, stderr, stdout};
use std::time::{Duration, Instant};

/// Prints a line on standard error, without what a terminal would obey. If nobody listens, so be it.
pub fn complain(message: impl std::fmt::Display) {
    let _ = writeln!(stderr(), "{}", plain(&message.to_string()));
}

/// Prints a line on standard output, likewise. If its reader has gone, as `head` does, so be it.
///
/// # Errors
/// A full disk, say.
pub fn print(text: impl std::fmt::Display) -> Result<()> {
    let mut out = stdout().lock();
    match writeln!(out, "{}", plain(&text.to_string())).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => {
            Err(Error::new(format_args!("cannot write to standard output: {e}")))
        }
        _ => Ok(()),
    }
}

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
            complain(message);
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
            bar.set_message(plain(name).into_owned());
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
            complain(format_args!("{}: {} %", self.name, 100 * done / total));
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
            self.bar.set_message(plain(name).into_owned());
        }
    }

    /// The task is done; its bar disappears.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}
