//! Small charts as inline SVG; colours and type come from the page's style sheet.

use super::words::{Escaped, number};
use std::fmt::Write as _;

/// Size of a chart: narrow enough that its text stays readable on a phone.
const WIDTH: f64 = 440.0;
const HEIGHT: f64 = 230.0;
/// Room around the plot for labels: left, top, right, bottom.
const MARGIN: [f64; 4] = [66.0, 10.0, 22.0, 38.0];

/// Where data lies on the page: linear on both axes.
struct Axes {
    x: (f64, f64),
    y: (f64, f64),
}

impl Axes {
    fn px(&self, x: f64) -> f64 {
        let part = (x - self.x.0) / (self.x.1 - self.x.0);
        MARGIN[0] + part * (WIDTH - MARGIN[0] - MARGIN[2])
    }

    fn py(&self, y: f64) -> f64 {
        let part = (y - self.y.0) / (self.y.1 - self.y.0);
        HEIGHT - MARGIN[3] - part * (HEIGHT - MARGIN[1] - MARGIN[3])
    }

    /// Opening tag, grid lines, tick labels and axis titles.
    fn frame(
        &self,
        description: &str,
        x_title: &str,
        x_ticks: &[(f64, String)],
        y_ticks: &[f64],
    ) -> String {
        let mut svg = format!(
            "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">",
            Escaped(description)
        );
        let (left, right) = (MARGIN[0], WIDTH - MARGIN[2]);
        let bottom = HEIGHT - MARGIN[3];
        let step = y_ticks.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::MAX, f64::min);
        let decimals = [1.0, 0.1, 0.01, 0.001].iter().filter(|&&unit| step < unit).count();
        for &tick in y_ticks {
            let y = self.py(tick);
            put(
                &mut svg,
                format_args!(
                    "<line class=\"grid\" x1=\"{left}\" x2=\"{right}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/>\
                     <text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                    left - 7.0,
                    y + 4.0,
                    number(tick, decimals)
                ),
            );
        }
        for (tick, label) in x_ticks {
            let x = self.px(*tick);
            put(
                &mut svg,
                format_args!(
                    "<line class=\"axis\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{bottom}\" y2=\"{}\"/>\
                     <text x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                    bottom + 4.0,
                    bottom + 17.0,
                    Escaped(label)
                ),
            );
        }
        put(
            &mut svg,
            format_args!(
                "<line class=\"axis\" x1=\"{left}\" x2=\"{right}\" y1=\"{bottom}\" y2=\"{bottom}\"/>\
                 <text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                f64::midpoint(left, right),
                HEIGHT - 4.0,
                Escaped(x_title)
            ),
        );
        svg
    }
}

/// A line through `(x, y)` points, x rising, with a dot at the highest.
///
/// The steep start of a search would flatten all that follows, so the y axis begins at the lowest
/// value after the first twentieth of the points; the line is cut there.
/// `None` with fewer than two points.
pub(super) fn line(description: &str, x_title: &str, points: &[(f64, f64)]) -> Option<String> {
    let (first, last) = (points.first()?.0, points.last()?.0);
    if first >= last {
        return None;
    }
    let settled = &points[points.len() / 20..];
    let low = settled.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
    let best = points.iter().fold(points[0], |a, b| if b.1 > a.1 { *b } else { a });
    let high = best.1.max(low + 1e-6 * low.abs().max(1.0));
    let pad = 0.06 * (high - low);
    let axes = Axes { x: (first, last), y: (low - pad, high + pad) };
    let mut svg = axes.frame(description, x_title, &labelled(&ticks(axes.x)), &ticks(axes.y));
    let (width, height) = (WIDTH - MARGIN[0] - MARGIN[2], HEIGHT - MARGIN[1] - MARGIN[3]);
    // A nested picture cuts off what leaves it.
    put(
        &mut svg,
        format_args!(
            "<svg x=\"{0}\" y=\"{1}\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"{0} {1} {width} {height}\"><polyline class=\"trace\" points=\"",
            MARGIN[0], MARGIN[1]
        ),
    );
    for &(x, y) in points {
        // Far below is far enough; SVG readers may stumble over huge numbers.
        put(&mut svg, format_args!("{:.1},{:.1} ", axes.px(x), axes.py(y).min(4.0 * HEIGHT)));
    }
    put(
        &mut svg,
        format_args!(
            "\"/></svg><circle class=\"best\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"3.5\"/></svg>",
            axes.px(best.0),
            axes.py(best.1)
        ),
    );
    Some(svg)
}

/// One bar per value, up or down from zero; the axis spans at least −3 to 3. `None` without
/// values.
pub(super) fn bars(description: &str, x_title: &str, values: &[f32]) -> Option<String> {
    if values.is_empty() {
        return None;
    }
    let reach = values.iter().fold(3.0, |reach, v| f64::from(v.abs()).ceil().max(reach));
    let axes = Axes { x: (0.5, values.len() as f64 + 0.5), y: (-reach, reach) };
    let numbers: Vec<f64> = ticks(axes.x).into_iter().filter(|&t| t >= 1.0).collect();
    let mut svg = axes.frame(description, x_title, &labelled(&numbers), &ticks(axes.y));
    let width = (axes.px(2.0) - axes.px(1.0)) * 0.72;
    for (i, &value) in values.iter().enumerate() {
        let (a, b) = (axes.py(0.0), axes.py(f64::from(value)));
        put(
            &mut svg,
            format_args!(
                "<rect class=\"bar\" x=\"{:.1}\" y=\"{:.1}\" width=\"{width:.1}\" height=\"{:.1}\"/>",
                axes.px(i as f64 + 1.0) - 0.5 * width,
                a.min(b),
                (a - b).abs()
            ),
        );
    }
    let zero = axes.py(0.0);
    put(
        &mut svg,
        format_args!(
            "<line class=\"axis\" x1=\"{}\" x2=\"{}\" y1=\"{zero:.1}\" y2=\"{zero:.1}\"/></svg>",
            MARGIN[0],
            WIDTH - MARGIN[2]
        ),
    );
    Some(svg)
}

/// Bars side by side, see [`columns`](super::columns).
#[cfg(feature = "full")]
pub(super) fn columns(
    description: &str,
    x_title: &str,
    labels: &[String],
    series: &[(usize, Vec<f64>)],
) -> Option<String> {
    let high = series.iter().flat_map(|(_, values)| values).copied().fold(0.0, f64::max);
    if !(high > 0.0 && high.is_finite()) {
        return None;
    }
    let axes = Axes { x: (-0.5, labels.len() as f64 - 0.5), y: (0.0, 1.05 * high) };
    let x_ticks: Vec<(f64, String)> = (0..)
        .zip(labels)
        .filter(|(_, label)| !label.is_empty())
        .map(|(i, label)| (f64::from(i), label.clone()))
        .collect();
    let mut svg = axes.frame(description, x_title, &x_ticks, &ticks(axes.y));
    let width = 0.8 / series.len() as f64;
    for (place, (color, values)) in series.iter().enumerate() {
        put(&mut svg, format_args!("<g class=\"series-{color}\">"));
        for (i, &value) in values.iter().enumerate() {
            let left = axes.px(i as f64 - 0.4 + width * place as f64);
            let right = axes.px(i as f64 - 0.4 + width * (place as f64 + 0.92));
            let top = axes.py(value);
            put(
                &mut svg,
                format_args!(
                    "<rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\"/>",
                    right - left,
                    axes.py(0.0) - top
                ),
            );
        }
        put(&mut svg, format_args!("</g>"));
    }
    put(&mut svg, format_args!("</svg>"));
    Some(svg)
}

/// One of several lines of a chart.
#[cfg(feature = "full")]
pub(crate) struct Series {
    /// `(x, y, half the height of the error bar)`, x rising, and positive.
    pub(crate) points: Vec<(f64, f64, f64)>,
    /// Its colour: of the style sheet's `.series-N`.
    pub(crate) color: usize,
}

/// The x axis of [`curves`].
#[cfg(feature = "full")]
pub(crate) enum Scale<'a> {
    /// From 0 to this.
    Linear(usize),
    /// With labels at these numbers, from the first to the last.
    Logarithmic(&'a [usize]),
}

/// Lines with dots and error bars; the y axis begins at 0. `level` is drawn as a dashed line
/// across. `None` without a range of x, or without a positive value.
#[cfg(feature = "full")]
pub(crate) fn curves(
    description: &str,
    x_title: &str,
    scale: &Scale<'_>,
    series: &[Series],
    level: Option<f64>,
) -> Option<String> {
    let place = |x: f64| if let Scale::Linear(_) = scale { x } else { x.ln() };
    let (first, last) = match *scale {
        Scale::Linear(last) => (0.0, last as f64),
        Scale::Logarithmic(numbers) => {
            (place(*numbers.first()? as f64), place(*numbers.last()? as f64))
        }
    };
    let values = series.iter().flat_map(|s| &s.points).map(|&(_, y, error)| y + error);
    let high = values.chain(level).fold(0.0, f64::max);
    if !(first < last && high > 0.0 && high.is_finite()) {
        return None;
    }
    let room = 0.03 * (last - first);
    let axes = Axes { x: (first - room, last + room), y: (0.0, 1.05 * high) };
    let x_ticks = match *scale {
        Scale::Linear(_) => labelled(&ticks((first, last))),
        Scale::Logarithmic(numbers) => {
            numbers.iter().map(|&m| (place(m as f64), m.to_string())).collect()
        }
    };
    let mut svg = axes.frame(description, x_title, &x_ticks, &ticks(axes.y));
    if let Some(level) = level {
        put(
            &mut svg,
            format_args!(
                "<line class=\"level\" x1=\"{}\" x2=\"{}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/>",
                MARGIN[0],
                WIDTH - MARGIN[2],
                y = axes.py(level)
            ),
        );
    }
    for Series { points, color } in series {
        put(&mut svg, format_args!("<g class=\"series-{color}\"><polyline points=\""));
        for (x, y, _) in points {
            put(&mut svg, format_args!("{:.1},{:.1} ", axes.px(place(*x)), axes.py(*y)));
        }
        put(&mut svg, format_args!("\"/>"));
        for (x, y, error) in points {
            let x = axes.px(place(*x));
            put(
                &mut svg,
                format_args!(
                    "<line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{:.1}\" y2=\"{:.1}\"/>\
                     <circle cx=\"{x:.1}\" cy=\"{:.1}\" r=\"2.5\"/>",
                    axes.py((y - error).max(0.0)),
                    axes.py(y + error),
                    axes.py(*y)
                ),
            );
        }
        put(&mut svg, format_args!("</g>"));
    }
    put(&mut svg, format_args!("</svg>"));
    Some(svg)
}

/// Of ascending numbers those whose labels do not touch on a logarithmic axis: the smaller stays,
/// the last always.
#[cfg(feature = "full")]
pub(super) fn spaced(numbers: Vec<usize>) -> Vec<usize> {
    let last = numbers.last().copied();
    let mut shown: Vec<usize> = Vec::new();
    for m in numbers {
        let free = |other: usize| m as f64 / other as f64 > 1.4;
        if Some(m) == last {
            shown.retain(|&other| free(other));
        }
        if shown.last().is_none_or(|&other| free(other)) {
            shown.push(m);
        }
    }
    shown
}

/// Whole numbers as labels.
fn labelled(ticks: &[f64]) -> Vec<(f64, String)> {
    ticks.iter().map(|&tick| (tick, number(tick, 0))).collect()
}

/// Three to six round numbers (1, 2 or 5 times a power of ten apart) within a range.
fn ticks((low, high): (f64, f64)) -> Vec<f64> {
    let aim = (high - low) / 5.0;
    if !(aim > 0.0 && aim.is_finite()) {
        return Vec::new();
    }
    let mut power = 1.0;
    while power * 10.0 <= aim {
        power *= 10.0;
    }
    while power > aim {
        power /= 10.0;
    }
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| *s >= aim);
    let step = step.unwrap_or(aim);
    let first = (low / step).ceil();
    // Adding zero turns −0 into 0.
    (0..7).map(|i| (first + f64::from(i)) * step + 0.0).filter(|t| *t <= high).collect()
}

fn put(out: &mut String, text: std::fmt::Arguments<'_>) {
    // Writing to a string cannot fail.
    let _ = out.write_fmt(text);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks((0.0, 5000.0)), [0.0, 1000.0, 2000.0, 3000.0, 4000.0, 5000.0]);
        assert_eq!(ticks((-3.0, 3.0)), [-2.0, 0.0, 2.0]);
        assert_eq!(ticks((-104_000.0, -98_000.0)).len(), 4);
        assert!(ticks((1.0, 1.0)).is_empty());
        assert!(ticks((0.0, f64::INFINITY)).is_empty());
    }

    #[test]
    fn a_steep_start_does_not_flatten_the_chart() {
        let mut points: Vec<_> = (0..100).map(|i| (f64::from(i), 10.0 + f64::from(i))).collect();
        points[0].1 = -1e9;
        let svg = line("trace", "step", &points).unwrap();
        assert!(svg.contains(">100</text>") && !svg.contains("000"), "{svg}");
    }

    #[cfg(feature = "full")]
    #[test]
    fn curves_are_spaced_by_factors_and_begin_at_zero() {
        let points = vec![(1.0, 2.0, 0.0), (10.0, 1.0, 0.5), (100.0, 0.5, 0.0)];
        let lines = [Series { points, color: 3 }];
        let [one, some] = [&[1][..], &[1, 10, 100]].map(Scale::Logarithmic);
        let svg = curves("error", "components", &some, &lines, Some(2.5)).unwrap();
        let at = svg.split("points=\"").nth(1).unwrap().split('"').next().unwrap();
        let x: Vec<f64> =
            at.split_whitespace().map(|p| p.split(',').next().unwrap().parse().unwrap()).collect();
        assert!((x[1] - x[0] - (x[2] - x[1])).abs() < 0.2, "{x:?}");
        assert!(svg.contains(">0</text>") && svg.contains(">100</text>"), "{svg}");
        assert!(svg.contains("class=\"series-3\"") && svg.contains("class=\"level\""));
        assert!(curves("", "", &one, &lines, None).is_none());
        assert!(curves("", "", &some, &[], None).is_none());

        let svg = curves("error", "vertices", &Scale::Linear(100), &lines, None).unwrap();
        let at = svg.split("points=\"").nth(1).unwrap().split('"').next().unwrap();
        let x: Vec<f64> =
            at.split_whitespace().map(|p| p.split(',').next().unwrap().parse().unwrap()).collect();
        assert!(((x[2] - x[1]) / (x[1] - x[0]) - 10.0).abs() < 0.1, "{x:?}");
    }

    #[test]
    fn too_little_data_gives_no_chart() {
        assert!(line("", "", &[]).is_none());
        assert!(line("", "", &[(1.0, 2.0), (1.0, 3.0)]).is_none());
        assert!(bars("", "", &[]).is_none());
        assert!(line("", "", &[(1.0, 2.0), (2.0, 2.0)]).is_some());
        assert!(bars("", "", &[0.5]).is_some());
    }
}
