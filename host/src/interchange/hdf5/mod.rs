//! HDF5 as far as models need it: groups of numbers and texts, read from `.h5` and `.h5.json`
//! and written to both.
//!
//! The binary format is read by the crate `hdf5-pure`; it is written here (`write`), because the
//! readers that matter are old: they want the first version of everything.

mod json;
mod read;
mod write;

use crate::error::{Error, Result};

pub use json::JsonFile;
pub use read::BinaryFile;

/// Where datasets are found by path, say `shape/model/mean`.
pub trait Store {
    /// Lengths of a dataset's axes, none for a single value; `None` if there is no such dataset.
    ///
    /// # Errors
    /// When something of that name cannot be read.
    fn shape(&self, path: &str) -> Result<Option<Vec<u64>>>;

    /// The numbers of a dataset, row by row.
    ///
    /// # Errors
    /// When it is missing, damaged, no numbers, or says that it is far larger than its file.
    fn numbers(&self, path: &str) -> Result<Vec<f64>>;

    /// The text of a dataset with one, without closing zeros.
    ///
    /// # Errors
    /// As [`Store::numbers`].
    fn text(&self, path: &str) -> Result<String>;
}

/// What a dataset to be written holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// IEEE 32-bit numbers.
    F32(Vec<f32>),
    /// Signed 32-bit integers.
    I32(Vec<i32>),
    /// One text.
    Text(String),
}

/// A dataset to be written.
#[derive(Clone, Debug, PartialEq)]
pub struct Dataset {
    /// Lengths of its axes, none for a single value; their product is the number of values.
    pub shape: Vec<usize>,
    /// The values, row by row.
    pub values: Values,
}

/// A group to be written.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Group {
    /// Names and texts.
    pub attributes: Vec<(&'static str, &'static str)>,
    /// What is in it: at most [`Group::MOST`], names unique.
    pub members: Vec<(String, Node)>,
}

/// A member of a group.
#[derive(Clone, Debug, PartialEq)]
pub enum Node {
    /// A group.
    Group(Group),
    /// A dataset.
    Dataset(Dataset),
}

impl Group {
    /// Most members a group can have here: what fits into one node of the old format.
    pub const MOST: usize = 8;

    /// Adds a dataset at a path, making groups on the way.
    pub fn put(&mut self, path: &str, shape: &[usize], values: Values) {
        let (group, name) = path.rsplit_once('/').unwrap_or(("", path));
        let dataset = Dataset { shape: shape.to_vec(), values };
        self.group(group).members.push((name.to_string(), Node::Dataset(dataset)));
    }

    /// The group at a path, made if it is not there.
    pub fn group(&mut self, path: &str) -> &mut Self {
        path.split('/').filter(|name| !name.is_empty()).fold(self, |group, name| {
            let is = |(n, node): &(String, Node)| n == name && matches!(node, Node::Group(_));
            let at = group.members.iter().position(is).unwrap_or_else(|| {
                group.members.push((name.to_string(), Node::Group(Self::default())));
                group.members.len() - 1
            });
            match &mut group.members[at].1 {
                Node::Group(group) => group,
                Node::Dataset(_) => unreachable!("only groups were looked for"),
            }
        })
    }
}

fn missing(path: &str) -> Error {
    Error::new(format_args!("{path}: there is no such dataset; is this a morphable model?"))
}
