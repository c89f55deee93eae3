//! Runs the real `onescan`, as a user would.

use serde_json::Value;
use std::ffi::OsStr;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::thread::sleep;
use std::time::Duration;

/// The fixtures' directory.
pub fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures")
}

/// Cargo's target directory, in which this test lies.
///
/// # Panics
/// If the test was not built by cargo.
pub fn target() -> PathBuf {
    // target/profile/deps/test
    let test = std::env::current_exe().expect("tests have a path");
    test.ancestors().nth(3).expect("cargo builds tests in target/profile/deps").to_path_buf()
}

/// The optimised program, built (alone, as a user's is) on first use. Cargo gives a test the
/// path of its own package's programs only.
fn program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        let target = target();
        let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let built = Command::new(cargo)
            .args(["build", "--quiet", "--release", "--package", "onescan", "--bin", "onescan"])
            .arg("--target-dir")
            .arg(&target)
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .status();
        assert!(built.is_ok_and(|status| status.success()), "onescan does not build");
        target.join("release").join(format!("onescan{}", std::env::consts::EXE_SUFFIX))
    })
}

/// What a run came to.
#[derive(Debug)]
pub struct Run {
    /// Exit code; none if a signal ended it.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

impl From<Output> for Run {
    fn from(output: Output) -> Self {
        Self {
            code: output.status.code(),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

/// A command line: words, in a directory. A word `@path` is that file of the fixtures.
pub struct Onescan(Command);

impl Onescan {
    /// The program with the words of `line`, which hold no spaces.
    pub fn new(directory: &Path, line: &str) -> Self {
        let mut command = Command::new(program());
        command.current_dir(directory).arg("--quiet").stdin(Stdio::null());
        for word in line.split_whitespace() {
            match word.strip_prefix('@') {
                Some(path) => command.arg(fixtures().join(path)),
                None => command.arg(word),
            };
        }
        Self(command)
    }

    /// Sets a variable of its environment.
    #[must_use]
    pub fn env(mut self, name: &str, value: impl AsRef<OsStr>) -> Self {
        self.0.env(name, value);
        self
    }

    /// Runs it to its end.
    ///
    /// # Panics
    /// If it does not start.
    pub fn run(mut self) -> Run {
        self.0.output().expect("onescan starts").into()
    }

    /// Runs it to its end, which must be a good one without a word; standard output.
    ///
    /// # Panics
    /// If it fails.
    #[track_caller]
    pub fn succeed(self) -> String {
        let line = format!("{:?}", self.0);
        let run = self.run();
        assert_eq!((run.code, run.stderr.as_str()), (Some(0), ""), "{line}");
        run.stdout
    }

    /// Starts it, with its standard output to be read.
    ///
    /// # Panics
    /// If it does not start.
    pub fn start(mut self) -> Child {
        self.0.stdout(Stdio::piped()).spawn().expect("onescan starts")
    }

    /// Runs it with nobody to read what it prints.
    ///
    /// # Panics
    /// If it does not start.
    pub fn unread(mut self) -> Run {
        let child = self.0.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        let mut child = child.expect("onescan starts");
        drop(child.stdout.take());
        child.wait_with_output().expect("onescan ends").into()
    }

    /// Runs it with its standard output going to a file.
    ///
    /// # Panics
    /// If it does not start.
    pub fn print_to(mut self, file: File) -> Run {
        self.0.stdout(file).output().expect("onescan starts").into()
    }

    /// Kills it, without a chance to do anything, once a file is there.
    ///
    /// # Panics
    /// If it does not start, or ends without such a file.
    pub fn kill_once(mut self, file: &Path) {
        let mut child = self.0.spawn().expect("onescan starts");
        while !file.exists() {
            let ended = child.try_wait().expect("it is ours");
            assert!(ended.is_none(), "ended without {}", file.display());
            sleep(Duration::from_millis(10));
        }
        child.kill().expect("it is ours");
        child.wait().expect("it is ours");
    }

    /// Presses Ctrl-C after a while.
    ///
    /// # Panics
    /// If it does not start.
    pub fn interrupt(mut self, after: Duration) -> Run {
        let child = self.0.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        let child = child.expect("onescan starts");
        sleep(after);
        press_ctrl_c(&child);
        child.wait_with_output().expect("onescan ends").into()
    }
}

/// By the shell's own `kill`: the program of that name is not on every machine. It may be too
/// late, which the caller sees by the exit code.
fn press_ctrl_c(child: &Child) {
    let _ = Command::new("sh")
        .args(["-c", &format!("kill -INT {}", child.id())])
        .stderr(Stdio::null())
        .status();
}

/// Reads a JSON file, `fit.json` say.
///
/// # Panics
/// If it is none.
#[track_caller]
pub fn json(path: &Path) -> Value {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// The field of that name as text.
///
/// # Panics
/// If there is none.
#[track_caller]
pub fn fingerprint(fit: &Value) -> &str {
    fit["fingerprint"].as_str().expect("fit.json has a fingerprint")
}
