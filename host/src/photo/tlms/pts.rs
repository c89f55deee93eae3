//! The 68 points that many face detectors give, in the `.pts` files of the iBUG annotations, and dlib's
//! five in such files.
//!
//! Only points on features of the face have a vertex: the outline of the face (points 1 to 17) is
//! wherever it ends in the picture, and points along brows, nose and lips wherever an annotator
//! divided them.

use super::{Landmark2, Tlms};
use crate::error::{Error, Result};

/// Our names of dlib's five points, numbered from one: eyes from outside to inside, then the nose.
const FIVE: [(usize, &str); 5] = [
    (1, "left.eye.corner_outer"),
    (2, "left.eye.corner_inner"),
    (3, "right.eye.corner_outer"),
    (4, "right.eye.corner_inner"),
    (5, "center.nose.attachement_to_philtrum"),
];

/// Our names of those of 68 points, numbered from one, which are ours. "right" is the subject's right,
/// on the left in the picture.
const SIXTY_EIGHT: [(usize, &str); 17] = [
    (9, "center.chin.tip"),
    (18, "right.eyebrow.outer"),
    (22, "right.eyebrow.inner_lower"),
    (23, "left.eyebrow.inner_lower"),
    (27, "left.eyebrow.outer"),
    (31, "center.nose.tip"),
    (34, "center.nose.attachement_to_philtrum"),
    (37, "right.eye.corner_outer"),
    (40, "right.eye.corner_inner"),
    (43, "left.eye.corner_inner"),
    (46, "left.eye.corner_outer"),
    (49, "right.lips.corner"),
    (52, "center.lips.upper.outer"),
    (55, "left.lips.corner"),
    (58, "center.lips.lower.outer"),
    (63, "center.lips.upper.inner"),
    (67, "center.lips.lower.inner"),
];

impl Tlms {
    /// Parses the points of a `.pts` file and names those that correspond to landmarks of face
    /// models, all visible:
    ///
    /// ```text
    /// version: 1
    /// n_points: 68
    /// {
    /// 193.0 101.5
    /// …
    /// }
    /// ```
    ///
    /// The first pixel's centre is (1, 1) there and (0, 0) here.
    ///
    /// # Errors
    /// Another number of points, and naming the line: anything else than two numbers.
    pub fn parse_pts(text: &str) -> Result<Self> {
        let mut points: Vec<[f32; 2]> = Vec::new();
        let mut inside = false;
        for (number, line) in (1..).zip(text.trim_start_matches('\u{feff}').lines()) {
            let line = line.split("//").next().unwrap_or_default().trim();
            match line {
                "{" => inside = true,
                "}" => inside = false,
                _ if inside && !line.is_empty() => {
                    let fields: Vec<f32> =
                        line.split_whitespace().filter_map(|field| field.parse().ok()).collect();
                    let all = fields.len() == line.split_whitespace().count();
                    let &[x, y] = &fields[..] else { return Err(no_point(number, line)) };
                    if !(all && x.is_finite() && y.is_finite()) {
                        return Err(no_point(number, line));
                    }
                    points.push([x - 1.0, y - 1.0]);
                }
                _ => {}
            }
        }
        let names: &[(usize, &str)] = match points.len() {
            68 => &SIXTY_EIGHT,
            5 => &FIVE,
            other => {
                return Err(Error::new(format_args!(
                    "{other} points between braces, expected 68 or dlib's 5; is this a .pts file of a \
                     face?"
                )));
            }
        };
        let landmarks = names
            .iter()
            .map(|&(number, name)| {
                let [x, y] = points[number - 1];
                Landmark2 { id: name.to_string(), visible: true, x, y }
            })
            .collect();
        Ok(Self { landmarks })
    }
}

fn no_point(number: usize, line: &str) -> Error {
    let line: String = line.chars().take(40).collect();
    Error::new(format_args!("line {number}: `{line}`, expected x and y in pixels"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(points: usize) -> String {
        let lines: Vec<String> = (1..=points).map(|i| format!("{i}.5 {}\n", 2 * i)).collect();
        format!("version: 1\nn_points:  {points}\n{{\n{}}}\n", lines.concat())
    }

    #[test]
    fn points_get_names_and_our_origin() {
        let tlms = Tlms::parse_pts(&file(68)).unwrap();
        let tip = tlms.landmarks.iter().find(|l| l.id == "center.nose.tip").unwrap();
        assert_eq!((tip.x, tip.y, tip.visible), (30.5, 61.0, true));
        assert_eq!(tlms.landmarks.len(), SIXTY_EIGHT.len());
        let five = Tlms::parse_pts(&file(5)).unwrap().landmarks;
        assert_eq!(
            (five[3].id.as_str(), five[3].x, five[3].y),
            ("right.eye.corner_inner", 3.5, 7.0)
        );
    }

    #[test]
    fn names_are_unique_and_pair_up() {
        for (i, &(number, name)) in SIXTY_EIGHT.iter().enumerate() {
            assert!((1..=68).contains(&number));
            assert!(SIXTY_EIGHT[..i].iter().all(|other| other.0 < number && other.1 != name));
            let other = match name.split_once('.') {
                Some(("left", rest)) => format!("right.{rest}"),
                Some(("right", rest)) => format!("left.{rest}"),
                _ => continue,
            };
            assert!(SIXTY_EIGHT.iter().any(|(_, name)| *name == other), "{other}");
        }
    }

    #[test]
    fn faults_name_the_line() {
        let says = |text: &str, part: &str| {
            let message = Tlms::parse_pts(text).unwrap_err().to_string();
            assert!(message.contains(part), "{message:?} does not say {part:?}");
        };
        says(&file(67), "67 points");
        says("", "0 points");
        says(&file(68).replace("9.5 18\n", "9.5\n"), "line 12: `9.5`");
        says(&file(68).replace("9.5 18\n", "nan 18\n"), "line 12");
        says(&file(68).replace("9.5 18\n", "9.5 x 18\n"), "line 12");
    }
}
