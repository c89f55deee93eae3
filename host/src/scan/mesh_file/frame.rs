//! Which way a scan stands in its file, and the rotation that stands it up.

use crate::error::{Error, Result};
use crate::vector::{cross, turned};
use std::fmt;
use std::str::FromStr;

/// An axis of the file, or its opposite.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Direction {
    axis: usize,
    negative: bool,
}

impl Direction {
    const fn new(axis: usize, negative: bool) -> Self {
        Self { axis, negative }
    }

    fn vector(self) -> [f32; 3] {
        let mut vector = [0.0; 3];
        vector[self.axis] = if self.negative { -1.0 } else { 1.0 };
        vector
    }
}

impl fmt::Display for Direction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.negative { "-" } else { "" };
        write!(f, "{sign}{}", ["x", "y", "z"][self.axis])
    }
}

impl FromStr for Direction {
    type Err = String;

    /// Parses `x`, `y`, `z`, `-x`, `-y` or `-z`.
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let name = text.strip_prefix(['-', '+']).unwrap_or(text);
        let axis = ["x", "y", "z"].iter().position(|axis| *axis == name);
        axis.map(|axis| Self::new(axis, text.starts_with('-')))
            .ok_or_else(|| "expected x, y, z, -x, -y or -z".into())
    }
}

/// The rotation from the file's axes to ours: `+x` the subject's left, `+y` up, `+z` out of the
/// face. Right-handed, so nothing is mirrored; a signed permutation, so nothing is rounded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    rows: [[f32; 3]; 3],
}

impl Default for Frame {
    /// The file's axes are ours.
    fn default() -> Self {
        Self { rows: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] }
    }
}

impl Frame {
    /// The frame whose `up` and `front` become `+y` and `+z`. Without `front` the front is the file's z; if z is
    /// up it is −y, and if z is down +y, as programs have it.
    ///
    /// # Errors
    /// `up` and `front` along the same axis.
    pub fn new(up: Direction, front: Option<Direction>) -> Result<Self> {
        let front = front.unwrap_or(match up {
            Direction { axis: 2, negative } => Direction::new(1, !negative),
            _ => Direction::new(2, false),
        });
        if up.axis == front.axis {
            return Err(Error::new("--up and --front lie along the same axis; give two axes"));
        }
        let (y, z) = (up.vector(), front.vector());
        Ok(Self { rows: [cross(y, z), y, z] })
    }

    /// A point of the file in our axes.
    pub fn turn(&self, p: [f32; 3]) -> [f32; 3] {
        // Adding 0 makes −0, which products with 0 leave behind, an ordinary zero.
        turned(&self.rows, p).map(|x| x + 0.0)
    }

    /// A point in our axes in the file's.
    pub fn undo(&self, p: [f32; 3]) -> [f32; 3] {
        let [x, y, z] = &self.rows;
        std::array::from_fn(|i| x[i] * p[0] + y[i] * p[1] + z[i] * p[2] + 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vector::dot;

    fn frame(up: &str, front: Option<&str>) -> Frame {
        Frame::new(up.parse().unwrap(), front.map(|f| f.parse().unwrap())).unwrap()
    }

    #[test]
    fn what_was_up_is_up() {
        for up in ["x", "y", "z", "-x", "-y", "-z"] {
            let direction: Direction = up.parse().unwrap();
            let frame = frame(up, None);
            assert_eq!(frame.turn(direction.vector()), [0.0, 1.0, 0.0], "{up}");
            let p = [1.5, -2.0, 3.25];
            assert_eq!(frame.undo(frame.turn(p)), p, "{up}");
            let [a, b, c] = frame.rows;
            assert_eq!(dot(a, cross(b, c)), 1.0, "{up} is a rotation");
        }
    }

    #[test]
    fn a_head_of_a_z_up_program_looks_along_minus_y() {
        assert_eq!(frame("z", None).turn([0.0, -1.0, 0.0]), [0.0, 0.0, 1.0]);
        assert_eq!(frame("z", Some("x")).turn([1.0, 0.0, 0.0]), [0.0, 0.0, 1.0]);
        assert_eq!(frame("y", None), Frame::default());
        let axis = |text: &str| text.parse::<Direction>();
        assert!(Frame::new(axis("y").unwrap(), axis("-y").ok()).is_err());
        assert!(axis("w").is_err() && axis("--x").is_err() && axis("").is_err());
    }
}
