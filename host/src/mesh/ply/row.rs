//! Rows of a PLY file: what is kept of a vertex and of a face, and numbers as programs write them.

use super::has_all;
use ply_rs_bw::ply::{
    ElementDef, Property, PropertyAccess, PropertyAccessResult, PropertyType, ScalarType,
};
use std::borrow::Cow;

/// What programs call a colour; the first complete triple is taken.
pub(super) const COLOR_NAMES: [[&str; 3]; 3] =
    [["red", "green", "blue"], ["diffuse_red", "diffuse_green", "diffuse_blue"], ["r", "g", "b"]];
pub(super) const POSITION_NAMES: [&str; 3] = ["x", "y", "z"];
const CORNER_NAMES: [&str; 2] = ["vertex_indices", "vertex_index"];
/// What programs call the texture coordinates of a vertex; the first complete pair is taken.
pub(super) const UV_NAMES: [[&str; 2]; 3] = [["texture_u", "texture_v"], ["s", "t"], ["u", "v"]];
/// And those of a face's corners: u and v of each in turn.
pub(super) const FACE_UV_NAME: &str = "texcoord";
/// The number of a face's texture.
pub(super) const PAGE_NAME: &str = "texnumber";

/// What stands under each of [`COLOR_NAMES`], as the file has it.
type Colors = [[f32; 3]; COLOR_NAMES.len()];

/// A row that may have a colour.
pub(super) trait Colored {
    /// What stands under each of [`COLOR_NAMES`].
    fn colors(&self) -> &Colors;
}

/// Position, and what stands under each of [`COLOR_NAMES`] and [`UV_NAMES`].
#[derive(Default)]
pub(super) struct Vertex {
    pub(super) position: [f64; 3],
    pub(super) uvs: [[f32; 2]; UV_NAMES.len()],
    colors: Colors,
}

impl Colored for Vertex {
    fn colors(&self) -> &Colors {
        &self.colors
    }
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let Some(value) = number(&property) else { return PropertyAccessResult::Ignored };
        if let Some(k) = POSITION_NAMES.iter().position(|n| *n == name) {
            self.position[k] = value;
            return PropertyAccessResult::Set;
        }
        for (names, uv) in UV_NAMES.iter().zip(&mut self.uvs) {
            if let Some(k) = names.iter().position(|n| *n == name) {
                uv[k] = value as f32;
                return PropertyAccessResult::Set;
            }
        }
        set_color(&mut self.colors, name, value)
    }
}

/// Corners, and what else faces may say.
#[derive(Default)]
pub(super) struct Face {
    pub(super) corners: Vec<i64>,
    pub(super) texcoord: Vec<f32>,
    pub(super) page: i64,
    colors: Colors,
}

impl Colored for Face {
    fn colors(&self) -> &Colors {
        &self.colors
    }
}

impl PropertyAccess for Face {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        if let Some(value) = number(&property) {
            if name == PAGE_NAME {
                self.page = value as i64;
                return PropertyAccessResult::Set;
            }
            return set_color(&mut self.colors, name, value);
        }
        if name == FACE_UV_NAME {
            self.texcoord = match property {
                Property::ListFloat(v) => v,
                Property::ListDouble(v) => v.into_iter().map(|x| x as f32).collect(),
                _ => return PropertyAccessResult::UnsupportedType,
            };
            return PropertyAccessResult::Set;
        }
        if !CORNER_NAMES.contains(&name) {
            return PropertyAccessResult::Ignored;
        }
        self.corners = match property {
            Property::ListChar(v) => widened(v),
            Property::ListUChar(v) => widened(v),
            Property::ListShort(v) => widened(v),
            Property::ListUShort(v) => widened(v),
            Property::ListInt(v) => widened(v),
            Property::ListUInt(v) => widened(v),
            _ => return PropertyAccessResult::UnsupportedType,
        };
        PropertyAccessResult::Set
    }
}

fn widened<T: Into<i64>>(list: Vec<T>) -> Vec<i64> {
    list.into_iter().map(Into::into).collect()
}

/// An element of no interest; its data is read past.
pub(super) struct Skipped;

impl PropertyAccess for Skipped {
    fn new() -> Self {
        Self
    }
}

fn set_color(colors: &mut Colors, name: &str, value: f64) -> PropertyAccessResult {
    for (names, color) in COLOR_NAMES.iter().zip(colors) {
        if let Some(k) = names.iter().position(|n| *n == name) {
            color[k] = value as f32;
            return PropertyAccessResult::Set;
        }
    }
    PropertyAccessResult::Ignored
}

fn number(property: &Property) -> Option<f64> {
    Some(match *property {
        Property::Char(v) => v.into(),
        Property::UChar(v) => v.into(),
        Property::Short(v) => v.into(),
        Property::UShort(v) => v.into(),
        Property::Int(v) => v.into(),
        Property::UInt(v) => v.into(),
        Property::Float(v) => v.into(),
        Property::Double(v) => v,
        _ => return None,
    })
}

/// The colours of an element's rows as RGB whose full value is 1; none if it has none.
pub(super) fn colors<R: Colored>(element: &ElementDef, rows: &[R]) -> Option<Vec<[f32; 3]>> {
    let which = COLOR_NAMES.iter().position(|names| has_all(element, names))?;
    let is = |name: &str, kind: &ScalarType| {
        let property = element.properties.get(name);
        property.is_some_and(|p| p.data_type == PropertyType::Scalar(kind.clone()))
    };
    let short = COLOR_NAMES[which].map(|name| is(name, &ScalarType::UShort));
    let raw = || rows.iter().map(|row| row.colors()[which]);
    // Some programs store bytes in 16 bits: a picture that dark is none.
    let bytes = raw().all(|color| color.iter().zip(short).all(|(c, short)| !short || *c <= 255.0));
    let full = COLOR_NAMES[which].map(|name| {
        if is(name, &ScalarType::Float) || is(name, &ScalarType::Double) {
            1.0
        } else if is(name, &ScalarType::UShort) && !bytes {
            f64::from(u16::MAX)
        } else {
            f64::from(u8::MAX)
        }
    });
    let scaled = |c: [f32; 3]| std::array::from_fn(|i| (f64::from(c[i]) / full[i]) as f32);
    Some(raw().map(scaled).collect())
}

/// A line of numbers as the grammar wants them: `.5` and `5.` with a digit on both sides.
pub(super) fn plain(line: &str) -> Cow<'_, str> {
    let line = line.trim();
    let digit = |at: Option<usize>| {
        at.and_then(|at| line.as_bytes().get(at)).is_some_and(u8::is_ascii_digit)
    };
    let mut plain = Cow::Borrowed(line);
    // From the end, so that places stay.
    for (at, _) in line.rmatch_indices('.') {
        if !digit(Some(at + 1)) {
            plain.to_mut().insert(at + 1, '0');
        }
        if !digit(at.checked_sub(1)) {
            plain.to_mut().insert(at, '0');
        }
    }
    plain
}

/// The beginning of a text, for a message.
pub(super) fn start(text: &str) -> String {
    const MOST: usize = 60;
    let mut start: String = text.trim().chars().take(MOST).collect();
    if start.len() < text.trim().len() {
        start.push('…');
    }
    start
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_get_digits_on_both_sides() {
        for (line, expected) in [
            ("1 2.5 -3e4", "1 2.5 -3e4"),
            (" .5 5. -.5e3 +5.e-3 \r", "0.5 5.0 -0.5e3 +5.0e-3"),
            ("a.b", "a0.0b"),
            ("é.", "é0.0"),
            ("", ""),
        ] {
            assert_eq!(plain(line), expected);
        }
    }
}
