//! Work that takes long: its bar, Ctrl-C, and what it goes on from.

use onescan::error::{Error, Result};
use onescan::files::write_atomically;
use onescan::fit::Control;
use onescan::progress::Task;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

pub(super) fn interrupted() -> Error {
    Error::new("interrupted; nothing was written")
}

/// Ctrl-C, what ends a program, and what a terminal sends that is closed.
const SIGNALS: &[i32] = &[
    signal_hook::consts::SIGINT,
    signal_hook::consts::SIGTERM,
    #[cfg(unix)]
    signal_hook::consts::SIGHUP,
];

/// A flag that Ctrl-C sets; the second one ends the program at once.
pub(super) fn stop_on_signals() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in SIGNALS {
        signal_hook::flag::register_conditional_shutdown(*signal, 1, Arc::clone(&stop))
            .and_then(|_| signal_hook::flag::register(*signal, Arc::clone(&stop)))
            .map_err(|e| Error::new(format_args!("cannot watch for Ctrl-C: {e}")))?;
    }
    Ok(stop)
}

/// Runs the job and moves the bar meanwhile.
pub(super) fn watch<T>(
    stop: &AtomicBool,
    mut task: Task,
    run: impl FnOnce(&Control<'_>) -> Result<T>,
) -> Result<T> {
    let steps = AtomicU64::new(0);
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let watcher = scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                task.set(steps.load(Ordering::Relaxed));
                std::thread::park_timeout(Duration::from_millis(100));
            }
            task.finish();
        });
        let ending = run(&Control { stop, steps: &steps });
        done.store(true, Ordering::Relaxed);
        watcher.thread().unpark();
        ending
    })
}

/// What an interrupted fit goes on from.
pub(super) struct Checkpoint {
    /// Where it is.
    pub(super) path: PathBuf,
    /// Whether it is this fit's: another's is left alone.
    ours: AtomicBool,
}

impl Checkpoint {
    /// One that will be written there; `ours` if this fit goes on from it.
    pub(super) fn new(path: PathBuf, ours: bool) -> Self {
        Self { path, ours: AtomicBool::new(ours) }
    }

    pub(super) fn write(&self, bytes: &[u8]) -> Result<()> {
        self.ours.store(true, Ordering::Relaxed);
        write_atomically(&self.path, |out| out.write_all(bytes))
    }

    /// Says so.
    pub(super) fn interrupted(&self) -> Error {
        if !self.ours.load(Ordering::Relaxed) {
            return interrupted();
        }
        Error::file(
            &self.path,
            "interrupted, progress saved; the same command with --resume goes on",
        )
    }

    /// A fit that is done has no more use for it.
    pub(super) fn remove(self) {
        if self.ours.into_inner() {
            let _ = std::fs::remove_file(self.path);
        }
    }
}
