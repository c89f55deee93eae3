//! Landmarks as other programs write them: MeshLab's picked points (`.pp`), 3D Slicer's markups
//! (`.mrk.json`, and older `.fcsv`).

use super::Point;
use crate::error::{Error, Result};
use crate::files::has_extension;
use serde::Deserialize;
use std::path::Path;

/// The points of a file, if its name is one of these programs'.
pub(super) fn points(path: &Path, text: &str) -> Option<Result<Vec<Point>>> {
    let markup = path.file_stem().is_some_and(|stem| has_extension(Path::new(stem), &["mrk"]));
    if has_extension(path, &["pp"]) {
        Some(picked(text))
    } else if has_extension(path, &["json"]) && markup {
        Some(markups(text))
    } else if has_extension(path, &["fcsv"]) {
        Some(fiducials(text))
    } else {
        None
    }
}

fn point(id: &str, coordinates: [f64; 3]) -> Point {
    Point { id: id.trim().to_owned(), coordinates, description: None, uncertainty: None }
}

/// `<point x="" y="" z="" name="" active="1"/>` within `<PickedPoints>`.
fn picked(text: &str) -> Result<Vec<Point>> {
    // MeshLab writes a document type, which says nothing.
    let options = roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() };
    let document = roxmltree::Document::parse_with_options(text, options).map_err(Error::new)?;
    let nodes = document.descendants().filter(|node| node.has_tag_name("point"));
    let active = nodes.filter(|node| node.attribute("active") != Some("0"));
    active
        .map(|node| {
            let at = document.text_pos_at(node.range().start).row;
            let name = node.attribute("name").unwrap_or_default();
            let mut coordinates = [0.0; 3];
            for (to, axis) in coordinates.iter_mut().zip(["x", "y", "z"]) {
                *to = node.attribute(axis).and_then(|value| value.trim().parse().ok()).ok_or_else(
                    || Error::new(format_args!("line {at}: point {name:?} has no number {axis}")),
                )?;
            }
            Ok(point(name, coordinates))
        })
        .collect()
}

/// Slicer's markups: what of them is a list of points.
#[derive(Deserialize)]
struct Markups {
    markups: Vec<Markup>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Markup {
    #[serde(default)]
    control_points: Vec<ControlPoint>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct ControlPoint {
    label: String,
    position: Option<[f64; 3]>,
    position_status: Option<String>,
}

fn markups(text: &str) -> Result<Vec<Point>> {
    let file: Markups = serde_json::from_str(text).map_err(Error::new)?;
    let all = file.markups.into_iter().flat_map(|markup| markup.control_points);
    let placed = all.filter(|p| p.position_status.as_deref().is_none_or(|s| s == "defined"));
    Ok(placed.filter_map(|p| Some(point(&p.label, p.position?))).collect())
}

/// Lines of `id,x,y,z,…`, whose columns a comment names; by default `label` is the twelfth.
fn fiducials(text: &str) -> Result<Vec<Point>> {
    let mut columns: Vec<&str> = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label".split(',').collect();
    let mut points = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        if let Some(comment) = line.strip_prefix('#') {
            if let Some((_, names)) = comment.split_once("columns =") {
                columns = names.split(',').map(str::trim).collect();
            }
            continue;
        }
        if line.trim().is_empty() {
            continue;
        }
        let fields: Vec<&str> = line.split(',').collect();
        let field = |name: &str| {
            let at = columns.iter().position(|column| *column == name)?;
            fields.get(at).copied()
        };
        let number_of = |name| field(name).and_then(|value| value.trim().parse::<f64>().ok());
        let (Some(label), [Some(x), Some(y), Some(z)]) =
            (field("label"), ["x", "y", "z"].map(number_of))
        else {
            return Err(Error::new(format_args!(
                "line {number}: expected the fields {}",
                columns.join(",")
            )));
        };
        points.push(point(label, [x, y, z]));
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PP: &str = "<!DOCTYPE PickedPoints>\n<PickedPoints>\n <DocumentData>\n  <DateTime time=\"1\" \
        date=\"2\"/>\n </DocumentData>\n <point x=\"1.5\" y=\"-2\" z=\"3e1\" name=\"tip\" active=\"1\"/>\n \
        <point x=\"1\" y=\"2\" z=\"3\" name=\"off\" active=\"0\"/>\n <point active=\"1\" z=\"6\" x=\"4\" \
        y=\"5\" name=\"a &amp; b\"/>\n</PickedPoints>\n";
    const MRK: &str = r#"{"@schema": "https://raw.githubusercontent.com/slicer/slicer/master/x.json#",
        "markups": [{"type": "Fiducial", "coordinateSystem": "LPS", "controlPoints": [
        {"id": "1", "label": "tip", "position": [1.5, -2.0, 30.0], "positionStatus": "defined"},
        {"id": "2", "label": "off", "position": [0.0, 0.0, 0.0], "positionStatus": "undefined"},
        {"id": "3", "label": "a & b", "position": [4.0, 5.0, 6.0]}]}]}"#;
    const FCSV: &str = "# Markups fiducial file version = 5.0\n# CoordinateSystem = LPS\n# columns = \
        id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n1,1.5,-2,30,0,0,0,1,1,1,0,tip,,\n\
        2,4,5,6,0,0,0,1,1,1,0,a & b,,vtk\n";

    #[test]
    fn three_programs_say_the_same() {
        for (name, text) in [("x.pp", PP), ("x.mrk.json", MRK), ("X.FCSV", FCSV)] {
            let found = points(Path::new(name), text).unwrap().unwrap();
            let expected = [point("tip", [1.5, -2.0, 30.0]), point("a & b", [4.0, 5.0, 6.0])];
            assert_eq!(found, expected, "{name}");
        }
        assert!(points(Path::new("x.json"), MRK).is_none());
    }

    #[test]
    fn faults_name_the_line() {
        let says = |name: &str, text: &str, part: &str| {
            let message = points(Path::new(name), text).unwrap().unwrap_err().to_string();
            assert!(message.contains(part), "{message:?} does not say {part:?}");
        };
        says("x.pp", &PP.replace("y=\"-2\"", "y=\"no\""), "line 6: point \"tip\" has no number y");
        says("x.pp", "<PickedPoints>\n<point", "never closed");
        says("x.mrk.json", "{\"markups\": 3}", "line 1");
        says("x.fcsv", &FCSV.replace("4,5,6", "4,five,6"), "line 5: expected the fields id,x,y,z");
    }
}
