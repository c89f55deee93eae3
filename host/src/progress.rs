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
                "{msg:24} [{bar:40}] {percent:>3} %  {elapsed}, {eta} left",
            )
            .unwrap_or_else(|_| ProgressStyle::default_bar())
            .progress_chars("=> ");
            let bar = ProgressBar::new(total).with_style(style);
            bar.set_message(plain(name).into_owned());
            bar
        };
        let plain = !self.quiet && !stderr().is_terminal();
        let now = Instant::now();
        Task { bar, plain, name: name.to_string(), started: now, stage: now, last: now }
    }
}

/// A running task.
pub struct Task {
    bar: ProgressBar,
    plain: bool,
    name: String,
    started: Instant,
    /// When what is being done was begun.
    stage: Instant,
    /// The last plain line.
    last: Instant,
}

/// How long what is left will take, if it goes on as before.
fn left(elapsed: Duration, done: u64, total: u64) -> Duration {
    elapsed.mul_f64(total.saturating_sub(done) as f64 / done.max(1) as f64)
}

impl Task {
    /// Time between plain lines.
    const PLAIN_INTERVAL: Duration = Duration::from_secs(5);
    /// What took as long, or longer, is told.
    const WORTH_TELLING: Duration = Duration::from_secs(1);

    /// The task has come to `done` units.
    pub fn set(&mut self, done: u64) {
        self.bar.set_position(done);
        if self.plain && self.last.elapsed() > Self::PLAIN_INTERVAL {
            self.last = Instant::now();
            let total = self.bar.length().unwrap_or(1).max(1);
            let elapsed = self.started.elapsed();
            let left = left(elapsed, done, total).as_secs();
            let (name, percent) = (&self.name, 100 * done / total);
            let so_far = elapsed.as_secs();
            complain(format_args!("{name}: {percent} %, {so_far} s, about {left} s left"));
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
            self.say_stage();
            self.name = name.to_string();
            self.bar.set_message(plain(name).into_owned());
        }
    }

    /// Says how long took what is done, unless that was no time.
    fn say_stage(&mut self) {
        let took = self.stage.elapsed();
        self.stage = Instant::now();
        if took < Self::WORTH_TELLING {
            return;
        }
        let line = format!("{}: {:.1} s", self.name, took.as_secs_f64());
        if self.plain {
            complain(line);
        } else {
            self.bar.println(plain(&line));
        }
    }

    /// The task is done; its bar disappears.
    pub fn finish(mut self) {
        self.say_stage();
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_takes_as_long_as_what_was_done() {
        let elapsed = Duration::from_secs(10);
        assert_eq!(left(elapsed, 25, 100), Duration::from_secs(30));
        assert_eq!(left(elapsed, 100, 100), Duration::ZERO);
        assert_eq!(left(Duration::ZERO, 0, 1000), Duration::ZERO);
        assert_eq!(left(elapsed, 120, 100), Duration::ZERO);
    }
}
