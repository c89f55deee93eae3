//! The page and the table of what models achieve by number of components.

use super::charts::{Scale, Series, curves, spaced};
use super::words::{Escaped, number};
use super::{foot, head};
use crate::error::{Error, Result};
use crate::model::metrics::{Curve, Estimate, Point};
use std::fmt::{self, Write};

/// Half the width of a 95 % interval in standard errors, as in the paper's error bars.
const INTERVAL: f64 = 1.96;

/// A measure of a point: its value, and the standard error if it is an average.
type Value = fn(&Point) -> Option<Estimate>;

/// What is plotted: a title, what it says, and its value.
const MEASURES: [(&str, &str, Value); 5] = [
    ("Compactness", "variance per vertex in the first components; less is more compact", |p| {
        Some(Estimate { mean: p.compactness, standard_error: 0.0 })
    }),
    (
        "Generalization",
        "distance of a test face to its projection into the model; less is more general",
        |p| Some(p.generalization),
    ),
    (
        "Specificity",
        "distance of a random instance to the nearest test face; less is more specific",
        |p| Some(p.specificity),
    ),
    (
        "Generalization, to the surface",
        "the same from the projection’s vertices to the test face’s surface",
        |p| p.surface_generalization,
    ),
    (
        "Specificity, to the surface",
        "the same from the instance’s vertices to the surface of the nearest test face",
        |p| p.surface_specificity,
    ),
];

/// A half of a model: its name, the unit of its distances, decimals of them.
const HALVES: [(&str, &str, usize); 2] = [("Shape", "mm", 2), ("Albedo", "RGB", 4)];

fn points(curve: &Curve, half: usize) -> &[Point] {
    if half == 0 { &curve.metrics.shape } else { &curve.metrics.albedo }
}

/// One self-contained page: charts of all measures of some models (at most seven), and their table.
/// The dashed line is the first model's mean alone.
///
/// # Errors
/// Never.
pub fn measures_report(
    title: &str,
    lead: &str,
    notes: &[&str],
    models: &[Curve],
) -> Result<String> {
    let mut html = String::new();
    write_page(&mut html, title, lead, notes, models).map_err(Error::new)?;
    Ok(html)
}

fn write_page(
    f: &mut impl Write,
    title: &str,
    lead: &str,
    notes: &[&str],
    models: &[Curve],
) -> fmt::Result {
    head(f, title, lead)?;
    f.write_str("<ul class=\"legend\">\n")?;
    for (i, curve) in models.iter().enumerate() {
        let (name, about) = (Escaped(&curve.name), Escaped(&curve.about));
        writeln!(f, "<li class=\"series-{i}\"><i></i>{name}: {about}</li>")?;
    }
    f.write_str("<li><i class=\"mean\"></i>the first one’s mean alone</li></ul>\n")?;
    for (half, (name, unit, decimals)) in HALVES.into_iter().enumerate() {
        writeln!(f, "<section>\n<h2>{name}</h2>\n<div class=\"charts three\">")?;
        for (measure, about, value) in MEASURES {
            let unit = if measure == "Compactness" { format!("{unit}²") } else { unit.into() };
            let description = format!("{name}: {measure} by number of components");
            if let Some(svg) = chart(&description, models, half, value) {
                writeln!(
                    f,
                    "<figure>{svg}<figcaption><b>{measure}</b> ({unit}): {about}.</figcaption></figure>"
                )?;
            }
        }
        f.write_str("</div>\n")?;
        table(f, models, half, decimals)?;
        f.write_str("</section>\n")?;
    }
    f.write_str("<section>\n<h2>How it was measured</h2>\n")?;
    for note in notes {
        writeln!(f, "<p>{}</p>", Escaped(note))?;
    }
    f.write_str("</section>\n")?;
    foot(f)
}

fn chart(description: &str, models: &[Curve], half: usize, value: Value) -> Option<String> {
    let mut numbers: Vec<usize> = models
        .iter()
        .flat_map(|curve| points(curve, half))
        .map(|p| p.components)
        .filter(|&m| m > 0)
        .collect();
    numbers.sort_unstable();
    numbers.dedup();
    let shown = spaced(numbers);
    let series: Vec<Series> = models
        .iter()
        .enumerate()
        .map(|(color, curve)| Series {
            points: points(curve, half)
                .iter()
                .filter(|p| p.components > 0)
                .filter_map(|p| {
                    let Estimate { mean, standard_error } = value(p)?;
                    Some((p.components as f64, mean, INTERVAL * standard_error))
                })
                .collect(),
            color,
        })
        .filter(|series| !series.points.is_empty())
        .collect();
    if series.is_empty() {
        return None;
    }
    let mean = models.first().and_then(|curve| points(curve, half).first());
    let level = mean.and_then(value).map(|estimate| estimate.mean).filter(|level| *level > 0.0);
    curves(description, "components", &Scale::Logarithmic(&shown), &series, level)
}

fn table(f: &mut impl Write, models: &[Curve], half: usize, decimals: usize) -> fmt::Result {
    f.write_str("<table class=\"measures\">\n<tr><th>model</th><th>components</th>")?;
    let measures: Vec<_> = used(models, half).collect();
    for (name, _) in &measures {
        write!(f, "<th>{name}</th>")?;
    }
    f.write_str("</tr>\n")?;
    for curve in models {
        for point in points(curve, half) {
            let (name, m) = (Escaped(&curve.name), point.components);
            write!(f, "<tr><th scope=\"row\">{name}</th><td>{m}</td>")?;
            for (_, value) in &measures {
                write!(f, "<td>{}</td>", cell(value(point), decimals))?;
            }
            f.write_str("</tr>\n")?;
        }
    }
    f.write_str("</table>\n")
}

/// The measures of which there is a number.
fn used(models: &[Curve], half: usize) -> impl Iterator<Item = (&'static str, Value)> {
    let first = models.first().and_then(|curve| points(curve, half).first());
    let known = move |value: Value| first.is_some_and(|point| value(point).is_some());
    MEASURES
        .into_iter()
        .filter(move |(_, _, value)| known(*value))
        .map(|(name, _, value)| (name, value))
}

fn cell(value: Option<Estimate>, decimals: usize) -> String {
    match value {
        None => String::new(),
        // Equal numbers, up to rounding.
        Some(e) if e.standard_error < 1e-9 * e.mean.abs() + 1e-12 => number(e.mean, decimals),
        Some(e) => {
            format!("{} ± {}", number(e.mean, decimals), number(e.standard_error, decimals))
        }
    }
}

/// The measures as Markdown tables, one of shape and one of albedo.
pub fn measures_table(models: &[Curve]) -> String {
    let mut lines = Vec::new();
    for (half, (name, unit, decimals)) in HALVES.into_iter().enumerate() {
        let measures: Vec<_> = used(models, half).collect();
        let names: Vec<_> = measures.iter().map(|(name, _)| name.to_lowercase()).collect();
        if half > 0 {
            lines.push(String::new());
        }
        lines.push(format!("## {name}, {unit}\n"));
        lines.push(format!("| model | components | {} |", names.join(" | ")));
        lines.push(format!("|---|---|{}", "---|".repeat(names.len())));
        for curve in models {
            for point in points(curve, half) {
                let cells: Vec<_> =
                    measures.iter().map(|(_, value)| cell(value(point), decimals)).collect();
                let cells = cells.join(" | ");
                lines.push(format!("| {} | {} | {cells} |", curve.name, point.components));
            }
        }
    }
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::metrics::Metrics;

    fn curve(name: &str) -> Curve {
        let point = |components: usize| {
            let estimate = |x: f64| Estimate { mean: x, standard_error: 0.25 };
            Point {
                components,
                compactness: components as f64,
                generalization: estimate(3.0 / (1 + components) as f64),
                specificity: estimate(1.0 + components as f64),
                surface_generalization: None,
                surface_specificity: None,
            }
        };
        let points: Vec<Point> = [0, 1, 2, 5].into_iter().map(point).collect();
        let metrics = Metrics { shape: points.clone(), albedo: points };
        Curve { name: name.into(), about: "a <model>".into(), metrics }
    }

    #[test]
    fn a_page_charts_each_measure_of_each_half() {
        let page = measures_report("T", "L", &["a & b"], &[curve("a"), curve("b<")]).unwrap();
        assert_eq!(page.matches("<svg").count(), 6, "no chart of what was not measured");
        assert_eq!(page.matches("<polyline").count(), 12);
        assert!(page.contains("b&lt;") && page.contains("a &lt;model&gt;"));
        assert!(page.contains("a &amp; b") && !page.contains("http"));
    }

    #[test]
    fn a_table_has_a_row_for_each_number_of_components() {
        let text = measures_table(&[curve("a")]);
        assert!(text.contains("| a | 2 | 2.00 | 1.00 ± 0.25 | 3.00 ± 0.25 |\n"), "{text}");
        assert_eq!(text.lines().filter(|line| line.starts_with("| a |")).count(), 8);
    }
}
