//! The one error type of the command line: a line that names the file, the place and the mend.

use std::borrow::Cow;
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
        let line = message.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        Self(plain(&line).into_owned())
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

/// A text without what a terminal would obey instead of showing it: names and contents of files are
/// whoever's who made them. Lines and tabs stay.
pub(crate) fn plain(text: &str) -> Cow<'_, str> {
    // Beside control characters, those that turn the direction of a text.
    let obeyed = |c: char| {
        (c.is_control() && !matches!(c, '\n' | '\t'))
            || matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    };
    if text.contains(obeyed) {
        let shown = |c: char| {
            if obeyed(c) { c.escape_default().to_string() } else { c.to_string() }
        };
        Cow::Owned(text.chars().map(shown).collect())
    } else {
        Cow::Borrowed(text)
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Error {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_terminal_would_obey_is_shown() {
        let error = Error::new("\u{1b}[31mred\u{7}\n\u{9b}2J \u{202e}gpj.exe é");
        assert_eq!(error.to_string(), "\\u{1b}[31mred\\u{7} \\u{9b}2J \\u{202e}gpj.exe é");
        assert_eq!(plain("a\tb\n"), "a\tb\n");
    }
}
