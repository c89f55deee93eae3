//! HDF5 as JSON (`.h5.json`), after the `hdf5-json` schema of the HDF Group: groups and datasets
//! by identifier, links between them, values inline.

use super::{Dataset, Group, Node, Store, Values, missing};
use crate::error::{Error, Result};
use crate::json;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::io::{self, Write};

/// The version of the schema that is written.
const API_VERSION: &str = "1.1.0";

/// An `.h5.json` file in memory.
#[derive(Deserialize)]
pub struct JsonFile {
    root: String,
    groups: HashMap<String, Members>,
    #[serde(default)]
    datasets: HashMap<String, Stored>,
}

#[derive(Deserialize)]
struct Members {
    #[serde(default)]
    links: Vec<Link>,
}

#[derive(Deserialize)]
struct Link {
    title: String,
    #[serde(default)]
    collection: String,
    #[serde(default)]
    id: String,
}

#[derive(Deserialize)]
struct Stored {
    shape: Space,
    #[serde(rename = "type")]
    kind: Value,
    #[serde(default)]
    value: Value,
}

#[derive(Deserialize)]
struct Space {
    #[serde(default)]
    dims: Vec<u64>,
}

impl JsonFile {
    /// Parses the text of a file.
    ///
    /// # Errors
    /// When it is not JSON, or not of the schema.
    pub fn parse(text: &str) -> Result<Self> {
        let file: Self = json::parse(text)?;
        if file.groups.contains_key(&file.root) {
            Ok(file)
        } else {
            Err(Error::new("root: there is no group of that identifier; write the file again"))
        }
    }

    fn dataset(&self, path: &str) -> Option<&Stored> {
        let names: Vec<&str> = path.split('/').collect();
        let (name, groups) = names.split_last()?;
        let follow = |id: &str, name: &str, collection: &str| {
            let links = &self.groups.get(id)?.links;
            let is = |link: &&Link| link.title == name && link.collection == collection;
            links.iter().find(is).map(|link| link.id.clone())
        };
        let group = groups
            .iter()
            .try_fold(self.root.clone(), |group, name| follow(&group, name, "groups"))?;
        self.datasets.get(&follow(&group, name, "datasets")?)
    }
}

impl Store for JsonFile {
    fn shape(&self, path: &str) -> Result<Option<Vec<u64>>> {
        Ok(self.dataset(path).map(|dataset| dataset.shape.dims.clone()))
    }

    fn numbers(&self, path: &str) -> Result<Vec<f64>> {
        let dataset = self.dataset(path).ok_or_else(|| missing(path))?;
        // Texts of 32-bit numbers are as short as tells these apart.
        let single = dataset.kind.to_string().contains("F32");
        let mut numbers = Vec::new();
        let fault = |found: &Value| {
            let found: String = found.to_string().chars().take(40).collect();
            Error::new(format_args!("{path}: value {found}, expected numbers"))
        };
        // Rows within rows, to the depth that the shape has.
        let mut open = vec![std::slice::from_ref(&dataset.value).iter()];
        while let Some(level) = open.last_mut() {
            match level.next() {
                None => drop(open.pop()),
                Some(Value::Array(items)) if open.len() <= dataset.shape.dims.len() => {
                    open.push(items.iter());
                }
                Some(value) => {
                    let number = value.as_f64().ok_or_else(|| fault(value))?;
                    numbers.push(if single { f64::from(number as f32) } else { number });
                }
            }
        }
        let expected = dataset.shape.dims.iter().try_fold(1_u64, |p, n| p.checked_mul(*n));
        if expected == Some(numbers.len() as u64) {
            Ok(numbers)
        } else {
            Err(Error::new(format_args!(
                "{path}: {} values, its shape says {:?}; the file is incomplete",
                numbers.len(),
                dataset.shape.dims
            )))
        }
    }

    fn text(&self, path: &str) -> Result<String> {
        let value = &self.dataset(path).ok_or_else(|| missing(path))?.value;
        let text = match value {
            Value::Array(texts) if texts.len() == 1 => texts[0].as_str(),
            value => value.as_str(),
        };
        let text = text.ok_or_else(|| Error::new(format_args!("{path}: expected one text")))?;
        Ok(text.trim_end_matches('\0').to_string())
    }
}

impl Group {
    /// Writes the group as the root of an `.h5.json` file. Texts are of any length and single
    /// values have no axes: so the readers of that form expect it.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write_json(&self, out: &mut impl Write) -> io::Result<()> {
        let mut groups = Vec::new();
        let mut datasets = Vec::new();
        let root = list(self, "/", &mut groups, &mut datasets);
        write!(out, "{{\"apiVersion\":\"{API_VERSION}\",\"root\":\"{root}\",\"groups\":{{")?;
        for (i, (id, group)) in groups.iter().enumerate() {
            write!(out, "{}\n\"{id}\":{group}", if i > 0 { "," } else { "" })?;
        }
        write!(out, "}},\"datasets\":{{")?;
        for (i, (id, path, dataset)) in datasets.iter().enumerate() {
            write!(
                out,
                "{}\n\"{id}\":{{\"alias\":{},",
                if i > 0 { "," } else { "" },
                json!([path])
            )?;
            dataset.write_json(out)?;
            write!(out, "}}")?;
        }
        writeln!(out, "}}}}")
    }
}

/// Lists the group and all below it by identifier; the group's.
fn list<'a>(
    group: &'a Group,
    path: &str,
    groups: &mut Vec<(String, Value)>,
    datasets: &mut Vec<(String, String, &'a Dataset)>,
) -> String {
    let mut links = Vec::new();
    for (name, node) in &group.members {
        let below = format!("{}/{name}", path.trim_end_matches('/'));
        let (collection, id) = match node {
            Node::Group(group) => ("groups", list(group, &below, groups, datasets)),
            Node::Dataset(dataset) => {
                let id = identifier(groups.len() + datasets.len());
                datasets.push((id.clone(), below, dataset));
                ("datasets", id)
            }
        };
        links.push(json!({
            "class": "H5L_TYPE_HARD", "collection": collection, "id": id, "title": name,
        }));
    }
    let attributes: Vec<Value> = group
        .attributes
        .iter()
        .map(|(name, text)| {
            json!({
                "name": name, "shape": { "class": "H5S_SCALAR" }, "type": text_type(), "value": text,
            })
        })
        .collect();
    let id = identifier(groups.len() + datasets.len());
    groups.push((id.clone(), json!({ "alias": [path], "attributes": attributes, "links": links })));
    id
}

/// A UUID of the free form (version 8): objects are only counted, so equal models give equal files.
fn identifier(number: usize) -> String {
    format!("6f6e6573-6361-8e00-8000-{number:012x}")
}

fn text_type() -> Value {
    json!({
        "class": "H5T_STRING", "charSet": "H5T_CSET_UTF8", "strPad": "H5T_STR_NULLTERM",
        "length": "H5T_VARIABLE",
    })
}

impl Dataset {
    fn write_json(&self, out: &mut impl Write) -> io::Result<()> {
        let scalar = self.shape.is_empty() || matches!(self.values, Values::Text(_));
        let shape = if scalar {
            json!({ "class": "H5S_SCALAR" })
        } else {
            json!({ "class": "H5S_SIMPLE", "dims": self.shape })
        };
        let kind = match self.values {
            Values::F32(_) => json!({ "class": "H5T_FLOAT", "base": "H5T_IEEE_F32LE" }),
            Values::I32(_) => json!({ "class": "H5T_INTEGER", "base": "H5T_STD_I32LE" }),
            Values::Text(_) => text_type(),
        };
        write!(out, "\"shape\":{shape},\"type\":{kind},\"value\":")?;
        match &self.values {
            Values::F32(values) => rows(out, &self.shape, values),
            Values::I32(values) => rows(out, &self.shape, values),
            Values::Text(text) => write!(out, "{}", json!(text.trim_end_matches('\0'))),
        }
    }
}

/// Values as lists within lists.
fn rows<T: serde::Serialize>(
    out: &mut impl Write,
    shape: &[usize],
    values: &[T],
) -> io::Result<()> {
    let Some((&length, inner)) = shape.split_first() else {
        return values.iter().try_for_each(|v| Ok(serde_json::to_writer(&mut *out, v)?));
    };
    let size: usize = inner.iter().product();
    write!(out, "[")?;
    for i in 0..length {
        if i > 0 {
            write!(out, ",")?;
        }
        rows(out, inner, values.get(i * size..(i + 1) * size).unwrap_or_default())?;
    }
    write!(out, "]")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_reads_back() {
        let mut root = Group::default();
        let numbers = [0.1, 1e-30, -7.0, 3.4e38, 0.0, 1.0 / 3.0];
        root.put("a/numbers", &[2, 3], Values::F32(numbers.to_vec()));
        root.put("a/none", &[3, 0], Values::F32(Vec::new()));
        root.put("a/whole", &[], Values::I32(vec![-7]));
        root.put("text", &[1], Values::Text("\"œil\"".into()));
        let mut text = Vec::new();
        root.write_json(&mut text).unwrap();
        let file = JsonFile::parse(std::str::from_utf8(&text).unwrap()).unwrap();
        assert_eq!(file.shape("a/numbers").unwrap().unwrap(), [2, 3]);
        assert_eq!(file.numbers("a/numbers").unwrap(), numbers.map(f64::from));
        assert_eq!(file.numbers("a/none").unwrap(), [0.0; 0]);
        assert_eq!(file.numbers("a/whole").unwrap(), [-7.0]);
        assert_eq!(file.text("text").unwrap(), "\"œil\"");
        assert_eq!(file.shape("a").unwrap(), None);
    }

    #[test]
    fn faults_are_named() {
        let file = |dataset: &str| {
            JsonFile::parse(&format!(
                r#"{{"root": "r", "groups": {{"r": {{"links": [{{"title": "x", "collection":
                "datasets", "id": "d", "class": "H5L_TYPE_HARD"}}]}}}}, "datasets": {{"d":
                {{"type": {{"base": "H5T_IEEE_F32LE"}}, {dataset}}}}}}}"#
            ))
        };
        let says = |dataset: &str, part: &str| {
            let error = file(dataset).and_then(|f| f.numbers("x")).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        };
        says(r#""shape": {"dims": [2]}, "value": [1]"#, "1 values, its shape says [2]");
        says(r#""shape": {"dims": [1]}, "value": [[1]]"#, "expected numbers");
        says(r#""shape": {"dims": [1]}, "value": ["1"]"#, "expected numbers");
        says(r#""shape": {"dims": [99999999999, 99999999999]}, "value": []"#, "0 values");
        says(r#""value": []"#, "missing field `shape`");
        assert!(JsonFile::parse(r#"{"root": "r", "groups": {}}"#).is_err());
        assert!(JsonFile::parse("{").is_err());
    }
}
