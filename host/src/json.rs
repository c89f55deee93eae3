//! JSON for people: errors say which field, and numbers that JSON cannot hold are refused.

use crate::error::{Error, Result};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

/// Parses JSON; errors name the field, then line and column.
pub(crate) fn parse<T: DeserializeOwned>(text: &str) -> Result<T> {
    let mut json = serde_json::Deserializer::from_str(text);
    let value = serde_path_to_error::deserialize(&mut json).map_err(|e| {
        // "." is the path of the document itself.
        match e.path().to_string().as_str() {
            "." => Error::new(e.inner()),
            path => Error::new(format_args!("{path}: {}", e.inner())),
        }
    })?;
    json.end().map_err(|e| Error::new(format_args!("after the end of the JSON: {e}")))?;
    Ok(value)
}

/// Writes JSON for people, refusing numbers JSON cannot hold.
pub(crate) fn to_text<T: Serialize>(value: &T) -> Result<String> {
    check_finite(value)?;
    let mut text = serde_json::to_string_pretty(value).map_err(Error::new)?;
    text.push('\n');
    Ok(text)
}

/// Errors with the path of the first number that is infinite or NaN.
pub(crate) fn check_finite<T: Serialize>(value: &T) -> Result<()> {
    // serde_json turns exactly these numbers into null, and nothing of ours is optional.
    fn null_in(value: &Value) -> Option<String> {
        match value {
            Value::Null => Some(String::new()),
            Value::Array(items) => items
                .iter()
                .enumerate()
                .find_map(|(i, item)| null_in(item).map(|path| format!("[{i}]{path}"))),
            Value::Object(fields) => fields
                .iter()
                .find_map(|(name, item)| null_in(item).map(|path| format!(".{name}{path}"))),
            _ => None,
        }
    }
    match null_in(&serde_json::to_value(value).map_err(Error::new)?) {
        None => Ok(()),
        Some(path) => Err(Error::new(format_args!(
            "{} is not a finite number (or too large for one)",
            path.trim_start_matches('.')
        ))),
    }
}
