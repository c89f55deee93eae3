//! The one error type of the command line: a line that names the file, the place and the mend.

use std::fmt;
use std::path::Path;

/// A one-line message for a person, `file: place: what was found; what to do`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error(String);

/// Result of everything here that can go wrong.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// An error that belongs to no file.
    pub fn new(message: impl fmt::Display) -> Self {
        // One line whatever a library put into its message.
        Self(message.to_string().split_whitespace().collect::<Vec<_>>().join(" "))
    }

    /// What is wrong in a text of TOML, with the line.
    #[cfg(feature = "full")]
    pub(crate) fn toml(text: &str, fault: &toml::de::Error) -> Self {
        let line = fault.span().map_or(1, |span| 1 + text[..span.start].matches('\n').count());
        Self::new(format_args!("line {line}: {}", fault.message()))
    }

    /// An error in a file: `path: message`.
    pub fn file(path: &Path, message: impl fmt::Display) -> Self {
        Self::new(format_args!("{}: {message}", path.display()))
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Error {}
