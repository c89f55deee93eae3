//! The page of what decompositions cost.

use super::{Decompositions, Size};
use crate::error::{Error, Result};
use crate::report::charts::{Scale, Series, curves};
use crate::report::essay;
use crate::report::words::Escaped;
use std::fmt::{self, Write};

/// Headings, then rows, each of cells.
type Table = Vec<Vec<String>>;

/// A figure of a mesh, if it is known.
type Value = fn(&Size) -> Option<f64>;

/// What is plotted: a title and its value.
const COSTS: [(&str, Value); 2] =
    [("Seconds", |size| Some(size.seconds)), ("Megabytes", |size| size.megabytes)];

/// One self-contained page: time and memory by number of vertices, and the tables of methods and
/// of sizes: headings, then rows, each of cells.
///
/// # Errors
/// Never in practice.
pub(super) fn page(result: &Decompositions, [methods, sizes]: &[Table; 2]) -> Result<String> {
    let mut html = String::new();
    body(&mut html, result, methods, sizes).map_err(Error::new)?;
    essay(
        "What do exact components cost?",
        "The covariance decomposed over all vertices, beside Nyström’s method from a sample of \
         them; and how time and memory grow with the mesh.",
        &html,
    )
}

fn body(f: &mut String, result: &Decompositions, methods: &Table, sizes: &Table) -> fmt::Result {
    f.write_str("<section>\n<h2>199 + 199 components, by number of vertices</h2>\n<p>")?;
    f.write_str(
        "The face template, coarser and finer. None of these meshes is symmetric, which is the \
         worst case: a symmetric one takes about half. Kernel values are kept up to some 10,000 \
         vertices; beyond, products go by near pairs and grids, and memory is what the \
         components and the Krylov space take.",
    )?;
    f.write_str("</p>\n<div class=\"charts\">\n")?;
    let largest = result.sizes.iter().map(|size| size.vertices).max().unwrap_or(0);
    for (title, value) in COSTS {
        let point = |size: &Size| Some((size.vertices as f64, value(size)?, 0.0));
        let points: Vec<_> = result.sizes.iter().filter_map(point).collect();
        let series = [Series { points, color: 0 }];
        if let Some(svg) = curves(title, "vertices", &Scale::Linear(largest), &series, None) {
            writeln!(f, "<figure>{svg}<figcaption><b>{title}</b></figcaption></figure>")?;
        }
    }
    f.write_str("</div>\n")?;
    put(f, sizes, 0)?;
    f.write_str("</section>\n<section>\n<h2>Exact beside sampled</h2>\n<p>")?;
    f.write_str(
        "The face template itself. What a vertex lacks is the standard deviation that the \
         components leave out. MB is the most memory the process had meanwhile, with what rows \
         above left to it.",
    )?;
    f.write_str("</p>\n")?;
    put(f, methods, 2)?;
    f.write_str("</section>\n")
}

/// A table whose first columns are names, not numbers.
fn put(f: &mut String, table: &Table, names: usize) -> fmt::Result {
    f.write_str("<table class=\"costs\">\n")?;
    for (i, row) in table.iter().enumerate() {
        let cell = if i == 0 { "th" } else { "td" };
        f.write_str("<tr>")?;
        for (column, text) in row.iter().enumerate() {
            let class = if column < names { " class=\"name\"" } else { "" };
            write!(f, "<{cell}{class}>{}</{cell}>", Escaped(text))?;
        }
        f.write_str("</tr>\n")?;
    }
    f.write_str("</table>\n")
}
