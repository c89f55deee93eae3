//! The page of what decompositions cost.

use super::charts::{Series, curves, spaced};
use super::words::Escaped;
use super::{foot, head};
use crate::error::{Error, Result};
use crate::experiment::decomposition::{Decompositions, Size};
use std::fmt::{self, Write};

/// A figure of a mesh, if it is known.
type Value = fn(&Size) -> Option<f64>;

/// What is plotted: a title and its value.
const COSTS: [(&str, Value); 3] = [
    ("Seconds", |size| Some(size.seconds)),
    // Level where time is linear in vertices.
    ("Milliseconds per vertex", |size| Some(1e3 * size.seconds / size.vertices as f64)),
    ("Megabytes", |size| size.megabytes),
];

/// One self-contained page: time and memory by number of vertices, and tables: headings, then
/// rows, each of cells.
///
/// # Errors
/// None.
pub fn decomposition_report(
    result: &Decompositions,
    tables: &[Vec<Vec<String>>],
) -> Result<String> {
    let mut html = String::new();
    page(&mut html, result, tables).map_err(Error::new)?;
    Ok(html)
}

fn page(f: &mut String, result: &Decompositions, tables: &[Vec<Vec<String>>]) -> fmt::Result {
    head(
        f,
        "What do exact components cost?",
        "The covariance decomposed over all vertices, beside Nyström’s method from a sample of \
         them; and how time and memory grow with the mesh.",
    )?;
    f.write_str("<section>\n<h2>199 + 199 components, by number of vertices</h2>\n<div class=\"charts three\">\n")?;
    let numbers = spaced(result.sizes.iter().map(|size| size.vertices).collect());
    for (title, value) in COSTS {
        let point = |size: &Size| Some((size.vertices as f64, value(size)?, 0.0));
        let points: Vec<_> = result.sizes.iter().filter_map(point).collect();
        let series = [Series { points, color: 0 }];
        if let Some(svg) = curves(title, "vertices", &numbers, &series, None) {
            writeln!(f, "<figure>{svg}<figcaption><b>{title}</b></figcaption></figure>")?;
        }
    }
    f.write_str("</div>\n")?;
    for table in tables {
        f.write_str("<table class=\"measures\">\n")?;
        for (i, row) in table.iter().enumerate() {
            let cell = if i == 0 { "th" } else { "td" };
            f.write_str("<tr>")?;
            for text in row {
                write!(f, "<{cell}>{}</{cell}>", Escaped(text))?;
            }
            f.write_str("</tr>\n")?;
        }
        f.write_str("</table>\n")?;
    }
    f.write_str("</section>\n")?;
    foot(f)
}
