//! Landmarks in a picture: the `.tlms` text format, `id visible x y` per line, the points of `.pts`
//! files, and those of MediaPipe's face mesh.

mod mesh;
mod pts;

use crate::error::{Error, Result};
use crate::files::{FileKind, has_extension, read_text};
use std::fmt::Write as _;
use std::path::Path;

/// Fewer visible landmarks than this do not pin down a pose.
pub const MIN_VISIBLE: usize = 4;
/// Landmarks within a box of this side, pixels, are one point. Chosen, not measured.
const TOGETHER: f32 = 2.0;
/// Landmarks less wide than this part of how long they spread are on a line. Chosen, not measured.
const ON_A_LINE: f64 = 0.01;

/// A named point in a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Landmark2 {
    /// Name, the same as in the model; no white space.
    pub id: String,
    /// Whether the point can be seen; a fit ignores it otherwise.
    pub visible: bool,
    /// Pixels from the centre of the left column.
    pub x: f32,
    /// Pixels from the centre of the top row, down.
    pub y: f32,
}

impl Landmark2 {
    /// Whether it lies in a picture of this size.
    fn is_within(&self, [width, height]: [u32; 2]) -> bool {
        // A pixel reaches half a pixel beyond its centre.
        let inside = |v: f32, side: u32| v >= -0.5 && f64::from(v) <= f64::from(side) - 0.5;
        inside(self.x, width) && inside(self.y, height)
    }
}

/// The landmarks of one picture, names unique, coordinates finite, in file order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tlms {
    /// The landmarks.
    pub landmarks: Vec<Landmark2>,
}

impl Tlms {
    /// Reads a file about a picture of this width and height: `.pts` and `.json` (a face mesh) by their
    /// extensions, anything else as `.tlms`.
    ///
    /// # Errors
    /// As [`Tlms::parse`], [`Tlms::parse_pts`] and [`Tlms::parse_mesh`], naming the file; a file that
    /// cannot be read.
    pub fn read(path: &Path, size: [u32; 2]) -> Result<Self> {
        let text =
            read_text(path).map_err(|e| FileKind::PhotoLandmarks.misplaced(path).unwrap_or(e))?;
        let found = if has_extension(path, &["pts"]) {
            Self::parse_pts(&text)
        } else if has_extension(path, &["json"]) {
            Self::parse_mesh(&text, size)
        } else {
            Self::parse(&text)
        };
        found.map_err(|e| {
            if [r#""vertex""#, r#""coordinates""#].iter().any(|key| text.contains(key)) {
                return Error::file(
                    path,
                    FileKind::ScanLandmarks.in_place_of(FileKind::PhotoLandmarks),
                );
            }
            FileKind::PhotoLandmarks.or_misplaced(path, e)
        })
    }

    /// Whether the file's name says that its points are numbered, not named.
    pub fn is_numbered(path: &Path) -> bool {
        has_extension(path, &["pts", "json"])
    }

    /// Drops the landmarks whose name is not among these: a file of numbered points has all its points, whatever
    /// the model knows.
    pub fn keep(&mut self, names: &[&str]) {
        self.landmarks.retain(|landmark| names.contains(&landmark.id.as_str()));
    }

    /// Parses `id visible x y` lines: fields separated by white space, `visible` an integer above
    /// zero for yes, blank lines skipped.
    ///
    /// # Errors
    /// Naming the line: another number of fields, a number that is none or not finite, a name
    /// that was there before.
    pub fn parse(text: &str) -> Result<Self> {
        let mut landmarks: Vec<Landmark2> = Vec::new();
        if text.trim_start().starts_with(['{', '[']) {
            return Err(Error::new("JSON, expected lines of `id visible x y`, in pixels"));
        }
        for (number, line) in (1..).zip(text.trim_start_matches('\u{feff}').lines()) {
            let at = |message: String| Error::new(format_args!("line {number}: {message}"));
            let fields: Vec<&str> = line.split_whitespace().collect();
            if fields.is_empty() {
                continue;
            }
            let &[id, visible, x, y] = &fields[..] else {
                let hint = if fields.len() == 5 { " (this looks like a 3-D landmark)" } else { "" };
                return Err(at(format!(
                    "{} fields, expected `id visible x y`{hint}",
                    fields.len()
                )));
            };
            let visible = visible.parse::<i64>().map_err(|_| {
                at(format!("visible is `{visible}`, expected 1 for yes or 0 for no"))
            })? > 0;
            let coordinate = |name: &str, field: &str| match field.parse::<f32>() {
                Ok(value) if value.is_finite() => Ok(value),
                _ => Err(at(format!("{name} is `{field}`, expected a number of pixels"))),
            };
            let (x, y) = (coordinate("x", x)?, coordinate("y", y)?);
            if landmarks.iter().any(|l| l.id == id) {
                return Err(at(format!("landmark `{id}` again; delete one of the two")));
            }
            landmarks.push(Landmark2 { id: id.to_owned(), visible, x, y });
        }
        Ok(Self { landmarks })
    }

    /// The landmarks as text that [`Tlms::parse`] reads back to the last bit.
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        for Landmark2 { id, visible, x, y } in &self.landmarks {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{id} {} {x} {y}", u8::from(*visible));
        }
        text
    }

    /// The visible landmarks.
    pub fn visible(&self) -> impl Iterator<Item = &Landmark2> {
        self.landmarks.iter().filter(|l| l.visible)
    }

    /// Coordinates of the visible landmarks, as [`Crop::around`](crate::photo::Crop::around)
    /// takes them.
    pub fn visible_points(&self) -> Vec<[f64; 2]> {
        self.visible().map(|l| [f64::from(l.x), f64::from(l.y)]).collect()
    }

    /// Leaves out what lies outside a picture of this size.
    pub fn keep_within(&mut self, size: [u32; 2]) {
        self.landmarks.retain(|landmark| landmark.is_within(size));
    }

    /// Checks the visible landmarks against a picture and a model.
    ///
    /// # Errors
    /// The first of these: names the model does not know, each with the nearest it does know;
    /// points outside the picture; fewer than [`MIN_VISIBLE`]; coordinates that are parts of the
    /// picture's sides, not pixels; points that all fall together.
    pub fn check(&self, width: u32, height: u32, model_names: &[&str]) -> Result<()> {
        let unknown: Vec<String> = self
            .visible()
            .filter(|l| !model_names.contains(&l.id.as_str()))
            .map(|l| match nearest(&l.id, model_names) {
                Some(name) => format!("`{}` (did you mean `{name}`?)", l.id),
                None => format!("`{}`", l.id),
            })
            .collect();
        if !unknown.is_empty() {
            return Err(Error::new(format_args!(
                "the model has no landmark {}; it has {}; rename, or set visible to 0",
                unknown.join(", "),
                model_names.join(", ")
            )));
        }
        let outside: Vec<String> = self
            .visible()
            .filter(|l| !l.is_within([width, height]))
            .map(|l| format!("`{}` at ({}, {})", l.id, l.x, l.y))
            .collect();
        if !outside.is_empty() {
            return Err(Error::new(format_args!(
                "landmark {} outside the {width}×{height} picture; are these landmarks of another \
                 picture, or of another size of it?",
                outside.join(", ")
            )));
        }
        let visible = self.visible().count();
        if visible < MIN_VISIBLE {
            return Err(Error::new(format_args!(
                "{visible} visible landmarks; mark at least {MIN_VISIBLE} of {}",
                model_names.join(", ")
            )));
        }
        let most = |of: fn(&Landmark2) -> f32| self.visible().map(of).fold(f32::MIN, f32::max);
        let least = |of: fn(&Landmark2) -> f32| self.visible().map(of).fold(f32::MAX, f32::min);
        let [right, bottom] = [most(|l| l.x), most(|l| l.y)];
        if right <= 1.0 && bottom <= 1.0 && width.min(height) > 8 {
            return Err(Error::new(format_args!(
                "all coordinates lie between 0 and 1; landmarks are given in pixels: multiply x by \
                 {width} and y by {height}"
            )));
        }
        if right - least(|l| l.x) < TOGETHER && bottom - least(|l| l.y) < TOGETHER {
            return Err(Error::new(format_args!(
                "all {visible} landmarks fall together at ({right}, {bottom}); mark each at its \
                 own point"
            )));
        }
        if visible > MIN_VISIBLE && self.flatness() < ON_A_LINE {
            return Err(Error::new(format_args!(
                "all {visible} landmarks lie on a line; each has an x and a y of its own"
            )));
        }
        Ok(())
    }

    /// How wide the visible landmarks spread across their longest direction, as a share of how far
    /// along it.
    fn flatness(&self) -> f64 {
        let points = self.visible_points();
        let count = points.len().max(1) as f64;
        let mean: [f64; 2] =
            std::array::from_fn(|i| points.iter().map(|p| p[i]).sum::<f64>() / count);
        let moment = |i: usize, j: usize| -> f64 {
            points.iter().map(|p| (p[i] - mean[i]) * (p[j] - mean[j])).sum()
        };
        let (xx, xy, yy) = (moment(0, 0), moment(0, 1), moment(1, 1));
        let (half, lean) = (0.5 * (xx + yy), 0.5 * (xx - yy));
        let apart = (lean * lean + xy * xy).sqrt();
        ((half - apart).max(0.0) / (half + apart).max(f64::MIN_POSITIVE)).sqrt()
    }
}

/// The known name with the fewest edits from `name`, if they are no more than a third of it.
fn nearest<'a>(name: &str, known: &[&'a str]) -> Option<&'a str> {
    let (distance, best) = known.iter().map(|k| (edits(name, k), *k)).min()?;
    (distance <= 1 + name.chars().count() / 3).then_some(best)
}

/// Levenshtein distance: insertions, deletions and substitutions from `a` to `b`.
fn edits(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, &cb) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(ca != cb);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MODEL: [&str; 5] =
        ["center.nose.tip", "left.lips.corner", "right.lips.corner", "chin", "brow"];

    fn error(text: &str) -> String {
        Tlms::parse(text).unwrap_err().to_string()
    }

    fn check(text: &str) -> String {
        Tlms::parse(text).unwrap().check(100, 80, &MODEL).unwrap_err().to_string()
    }

    #[test]
    fn lines_are_read_as_other_tools_write_them() {
        let tlms = Tlms::parse("a 1 3.5  -7e1\r\n\n \tb -1 0.10000000149011612 2\n").unwrap();
        let a = Landmark2 { id: "a".into(), visible: true, x: 3.5, y: -70.0 };
        let b = Landmark2 { id: "b".into(), visible: false, x: 0.1, y: 2.0 };
        assert_eq!(tlms.landmarks, [a, b]);
    }

    #[test]
    fn errors_name_the_line() {
        assert!(error("a 1 2 3\nb 1 2").starts_with("line 2: 3 fields"));
        assert!(error("a 1 2 3 4").contains("3-D"));
        assert!(error(" {\"a\": [1, 2]}").starts_with("JSON, expected lines"));
        assert!(error("a yes 2 3").contains("visible is `yes`"));
        assert!(error("a 1 2 nan").contains("y is `nan`"));
        assert!(error("a 1 1e99 3").contains("x is `1e99`"));
        assert!(error("a 1 2 3\n\na 0 2 3").starts_with("line 3: landmark `a` again"));
    }

    #[test]
    fn a_misspelt_name_gets_a_suggestion() {
        let message = check("center.nose.tipp 1 2 3");
        assert!(message.contains("did you mean `center.nose.tip`?"), "{message}");
        assert!(!check("something.else.altogether 1 2 3").contains("did you mean"));
    }

    #[test]
    fn points_outside_and_too_few_points_are_refused() {
        assert!(check("chin 1 99.6 3").contains("`chin` at (99.6, 3) outside the 100×80"));
        assert!(check("chin 1 99.5 -0.5\nbrow 1 0 0\nx 0 1e4 0").starts_with("2 visible"));
        let four = "chin 1 2 3\nbrow 1 2 4\ncenter.nose.tip 1 3 4\nleft.lips.corner 1 1 1";
        assert!(Tlms::parse(four).unwrap().check(100, 80, &MODEL).is_ok());
    }

    #[test]
    fn parts_of_the_sides_and_one_point_for_all_are_refused() {
        let four = |points: [[f32; 2]; 4]| {
            let lines = points.iter().zip(["chin", "brow", "center.nose.tip", "left.lips.corner"]);
            check(
                &lines.map(|([x, y], id)| format!("{id} 1 {x} {y}")).collect::<Vec<_>>().join("\n"),
            )
        };
        let parts = four([[0.5, 0.8], [0.4, 0.3], [0.5, 0.6], [0.6, 1.0]]);
        assert!(parts.ends_with("multiply x by 100 and y by 80"), "{parts}");
        let together = four([[50.5, 20.8], [50.4, 20.3], [50.5, 20.6], [51.6, 21.0]]);
        assert!(together.starts_with("all 4 landmarks fall together at (51.6, 21)"), "{together}");
    }

    #[test]
    fn edits_are_counted() {
        assert_eq!(edits("kitten", "sitting"), 3);
        assert_eq!(edits("", "abc"), 3);
    }

    proptest! {
        #[test]
        fn written_landmarks_read_back_exactly(points: Vec<(bool, f32, f32)>) {
            let landmarks = points
                .iter()
                .enumerate()
                .filter(|(_, (_, x, y))| x.is_finite() && y.is_finite())
                .map(|(i, &(visible, x, y))| Landmark2 { id: format!("p{i}"), visible, x, y })
                .collect();
            let tlms = Tlms { landmarks };
            prop_assert_eq!(Tlms::parse(&tlms.to_text()).unwrap(), tlms);
        }
    }
}
