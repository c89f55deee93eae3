//! `report.html`: one self-contained page that shows a fit, or a whole demo, to a stranger.

pub(crate) mod charts;
#[cfg(feature = "full")]
mod measures;
#[cfg(feature = "full")]
mod posterior;
mod tables;
pub(crate) mod words;

#[cfg(feature = "full")]
pub use measures::{measures_report, measures_table};

use crate::error::{Error, Result};
use crate::fit::output::Finished;
use crate::fit::summary::{ModeFound, Proposal, Summary};
use crate::photo::picture::{Picture, WHITE, montage};
use onescan_core::chain::PhaseName;
use onescan_core::scene::Scene;
use onescan_core::search::LEVELS;
use std::fmt::{self, Write};
use std::path::Path;
use tables::{Rows, key_figures, provenance_facts, scene_facts};
use words::{address, base64, likelihood, number, percent};

pub(crate) use words::Escaped;

/// Longest side of the whole photo on the page, pixels.
const WHOLE_SIDE: u32 = 768;
/// Coefficients shown of each half of the model.
const SHOWN: usize = 50;

/// The page of one fit. Links point to the files beside it; `provenance` is the model's
/// (`key = value` lines).
///
/// # Errors
/// A picture without pixels.
pub fn fit_report(result: &Finished, provenance: &str) -> Result<String> {
    let file = &result.summary.image.file;
    let page = Page {
        title: format!("3D reconstruction of {file}"),
        lead: "One photo, and a model made from a single 3D scan: the shape, colour, pose and \
               light that explain the picture.",
        samples: None,
        fits: vec![Section::new(result, "", String::new())?],
        provenance,
    };
    page.html()
}

/// The page of fits to several photos of one subject. Each fit's files are linked in the folder that
/// stands beside it.
///
/// # Errors
/// A picture without pixels.
pub fn subject_report(
    results: &[Finished],
    folders: &[String],
    provenance: &str,
) -> Result<String> {
    let fits = results.iter().zip(folders);
    let fits = fits.map(|(result, folder)| Section::new(result, "", folder.clone()));
    let page = Page {
        title: format!("3D reconstruction from {} photos", results.len()),
        lead: "Several photos of one person, and a model made from a single 3D scan: the one shape \
               and colour, and each photo's own pose and light, that explain the pictures together.",
        samples: None,
        fits: fits.collect::<Result<_>>()?,
        provenance,
    };
    page.html()
}

/// The page of a demo: random `samples` of the model on one sheet, then each fit with a sentence
/// about its photo. A fit's files are linked in a directory named like its photo, extension cut.
///
/// # Errors
/// A picture without pixels.
pub fn demo_report(
    results: &[(Finished, &str)],
    samples: &Picture,
    provenance: &str,
) -> Result<String> {
    let fits = results
        .iter()
        .map(|(result, about)| {
            let file = Path::new(&result.summary.image.file);
            let folder = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            Section::new(result, about, folder)
        })
        .collect::<Result<_>>()?;
    let page = Page {
        title: "A face model from one scan".to_owned(),
        lead: "A single 3D scan became a model of many faces; the model then found the faces in \
               photos it had never seen. No data set and no training came in between.",
        samples: Some(Figure::new(
            samples,
            "Rendered faces that differ in shape and skin colour",
            "Random draws from the model. Each is the one scan it was made from, deformed and \
             recoloured by smooth random fields.",
        )?),
        fits,
        provenance,
    };
    page.html()
}

/// A picture ready for the page.
struct Figure {
    png: String,
    width: u32,
    height: u32,
    alt: String,
    caption: &'static str,
}

impl Figure {
    fn new(picture: &Picture, alt: impl Into<String>, caption: &'static str) -> Result<Self> {
        let png = base64(&picture.to_png()?);
        let (width, height) = (picture.width, picture.height);
        Ok(Self { png, width, height, alt: alt.into(), caption })
    }

    fn write(&self, f: &mut impl Write) -> fmt::Result {
        writeln!(
            f,
            "<figure><img src=\"data:image/png;base64,{}\" width=\"{}\" height=\"{}\" alt=\"{}\">\
             <figcaption>{}</figcaption></figure>",
            self.png,
            self.width,
            self.height,
            Escaped(&self.alt),
            Escaped(self.caption)
        )
    }
}

/// A page of one's own: `body` is HTML.
///
/// # Errors
/// Never.
#[cfg(feature = "full")]
pub fn essay(title: &str, lead: &str, body: &str) -> Result<String> {
    let mut html = String::new();
    head(&mut html, title, lead)
        .and_then(|()| html.write_str(body))
        .and_then(|()| foot(&mut html))
        .map_err(Error::new)?;
    Ok(html)
}

/// Bars side by side, a group for each label and in it one of every series, of the style sheet's colour
/// of that number; the y axis begins at 0. `None` without a positive value.
#[cfg(feature = "full")]
pub fn columns(
    description: &str,
    x_title: &str,
    labels: &[String],
    series: &[(usize, Vec<f64>)],
) -> Option<String> {
    charts::columns(description, x_title, labels, series)
}

/// Text that is to be shown as it is.
#[cfg(feature = "full")]
pub fn escaped(text: &str) -> String {
    Escaped(text).to_string()
}

/// A picture as HTML.
///
/// # Errors
/// A picture without pixels.
#[cfg(feature = "full")]
pub fn figure(picture: &Picture, alt: &str, caption: &'static str) -> Result<String> {
    let mut html = String::new();
    Figure::new(picture, alt, caption)?.write(&mut html).map_err(Error::new)?;
    Ok(html)
}

/// One fit on the page.
struct Section<'a> {
    summary: &'a Summary,
    about: &'a str,
    folder: String,
    figures: Vec<Figure>,
}

impl<'a> Section<'a> {
    fn new(result: &'a Finished, about: &'a str, folder: String) -> Result<Self> {
        let (summary, pictures) = (&result.summary, &result.pictures);
        let file = &summary.image.file;
        let mut figures = vec![
            Figure::new(
                &pictures.photo,
                format!("The part of the photo {file} around the landmarks"),
                "The photo, cut out around the landmarks.",
            )?,
            Figure::new(
                &pictures.on_photo,
                format!("The fitted model drawn over the photo {file}"),
                "The fitted model drawn over it. Where no seam shows, the model explains the \
                 picture.",
            )?,
            Figure::new(
                &shrunk(&pictures.whole, WHOLE_SIDE),
                format!("The whole photo {file} with the fitted model in its place"),
                "The same in the whole photo.",
            )?,
            Figure::new(
                &pictures.alone,
                format!("The fitted model alone, posed and lit as in {file}"),
                "The model alone, in the pose and light it found.",
            )?,
        ];
        figures.push(Figure::new(
            &montage(&pictures.textured.each_ref(), 8, WHITE),
            format!("The fitted face in the colours of {file}, as there and turned"),
            "The mesh that was saved, as in the photo and turned: the photo's colours where it shows the \
             face.",
        )?);
        if let Some(masked) = &pictures.masked {
            figures.push(Figure::new(
                &masked.behind,
                format!("The fitted model drawn on {file} behind what hides the face"),
                "The model behind what is no face to it: hair, glasses, teeth.",
            )?);
            figures.push(Figure::new(
                &masked.mask,
                format!("Where {file} shows the face"),
                "White where the photo shows the face, black where something hides it.",
            )?);
        }
        figures.push(Figure::new(
            &pictures.landmarks[0],
            format!("The landmarks on {file}"),
            "The landmarks. Crosses: where they were marked; dots: where the fit has them; red: too \
             far off to be believed.",
        )?);
        for (i, side) in pictures.sides.iter().enumerate() {
            figures.push(Figure::new(
                side,
                format!("The fitted model of {file}, turned, under frontal light"),
                match i {
                    0 => "Turned, under plain frontal light: shape and colour without the photo.",
                    _ => "The same from another side.",
                },
            )?);
        }
        #[cfg(feature = "full")]
        if let (Some(picture), Some(found)) = (&pictures.uncertainty, &summary.posterior) {
            figures.push(Figure::new(
                picture,
                format!(
                    "Standard deviation of the fitted shape, black 0 to white {} mm",
                    found.uncertainty_scale_mm
                ),
                "How far the shape is known: standard deviation of every point, from black (0) by \
                 violet, red and orange to white (the scale's end is among the figures below).",
            )?);
        }
        Ok(Self { summary, about, folder, figures })
    }

    fn write(&self, f: &mut impl Write) -> fmt::Result {
        let s = self.summary;
        f.write_str("<section>\n")?;
        // Alone on a page, the page's title says it.
        if !self.about.is_empty() {
            writeln!(
                f,
                "<h2>{}</h2>\n<p class=\"about\">{}</p>",
                Escaped(&s.image.file),
                Escaped(self.about)
            )?;
        }
        for warning in &s.warnings {
            writeln!(f, "<p class=\"warning\">{}.</p>", Escaped(warning))?;
        }
        f.write_str("<div class=\"pictures\">\n")?;
        self.figures.iter().try_for_each(|figure| figure.write(f))?;
        f.write_str("</div>\n")?;
        in_words(f, s)?;
        f.write_str("<div class=\"columns\"><div><h3>Key figures</h3>\n")?;
        facts(f, &key_figures(s))?;
        f.write_str("</div><div><h3>What was found</h3>\n")?;
        facts(f, &scene_facts(&s.parameters))?;
        f.write_str("</div></div>\n")?;
        #[cfg(feature = "full")]
        mixture(f, s)?;
        #[cfg(feature = "full")]
        if let Some(found) = &s.posterior {
            posterior::section(f, found)?;
        }
        if let Some(mode) = &s.mode {
            levels(f, s, mode)?;
        }
        if s.is_of_chains() {
            traces(f, s)?;
        }
        coefficients(f, &s.parameters)?;
        if s.is_of_chains() {
            moves(f, &s.proposals)?;
        }
        self.files(f)?;
        f.write_str("</section>\n")
    }

    fn files(&self, f: &mut impl Write) -> fmt::Result {
        f.write_str("<h3>Files</h3>\n<ul class=\"files\">\n")?;
        for (file, what) in [
            ("mesh.glb", "the mesh for viewers and web pages (glTF)"),
            ("mesh.ply", "the mesh with colours per vertex"),
            ("fit.json", "all numbers of this fit"),
            ("fit.rps", "the scene for scalismo-faces"),
            ("landmarks.png", "the landmarks, where they were marked and where the fit has them"),
        ] {
            let link = address(&[&self.folder, file]);
            writeln!(f, "<li><a href=\"{link}\">{file}</a>: {what}</li>")?;
        }
        #[cfg(feature = "full")]
        if self.summary.posterior.is_some() {
            posterior::files(f)?;
        }
        writeln!(
            f,
            "</ul>\n<h3>Repeat it</h3>\n<pre><code>{}</code></pre>\n<p class=\"note\">The same \
             files and seed give the fingerprint <code>{}</code> again, on any machine.</p>",
            Escaped(&self.summary.command),
            Escaped(&self.summary.fingerprint)
        )
    }
}

/// A whole page.
struct Page<'a> {
    title: String,
    lead: &'a str,
    samples: Option<Figure>,
    fits: Vec<Section<'a>>,
    provenance: &'a str,
}

impl Page<'_> {
    fn html(&self) -> Result<String> {
        let mut html = String::new();
        self.write(&mut html).map_err(Error::new)?;
        Ok(html)
    }

    fn write(&self, f: &mut impl Write) -> fmt::Result {
        head(f, &self.title, self.lead)?;
        if let Some(samples) = &self.samples {
            f.write_str("<section>\n<h2>The model</h2>\n")?;
            samples.write(f)?;
            f.write_str("</section>\n")?;
        }
        self.fits.iter().try_for_each(|section| section.write(f))?;
        f.write_str("<section>\n<h2>Where the model comes from</h2>\n")?;
        if let Some(section) = self.fits.first() {
            let model = &section.summary.model;
            writeln!(
                f,
                "<p><code>{}</code>, checksum <code>{}</code>.</p>",
                Escaped(&model.file),
                Escaped(&model.checksum)
            )?;
        }
        facts(f, &provenance_facts(self.provenance))?;
        f.write_str("</section>\n")?;
        foot(f)
    }
}

/// A page up to its first section.
fn head(f: &mut impl Write, title: &str, lead: &str) -> fmt::Result {
    write!(
        f,
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}</title>\n<style>\n{style}</style>\n</head>\n<body>\n\
         <header><p class=\"kicker\">onescan {version}</p>\n<h1>{title}</h1>\n\
         <p class=\"lead\">{lead}</p></header>\n<main>\n",
        title = Escaped(title),
        style = include_str!("style.css"),
        version = env!("CARGO_PKG_VERSION"),
        lead = Escaped(lead),
    )
}

/// A page after its last section.
fn foot(f: &mut impl Write) -> fmt::Result {
    write!(
        f,
        "</main>\n<footer><p class=\"note\">Made by onescan {}. This page \
         needs no other file and asks no server for anything.</p></footer>\n</body>\n</html>\n",
        env!("CARGO_PKG_VERSION")
    )
}

/// What happened, for somebody who has never fitted a model.
fn in_words(f: &mut impl Write, s: &Summary) -> fmt::Result {
    let steps = number(s.steps as f64, 0);
    let how = if s.is_of_chains() {
        format!(
            "It weighed {steps} hypotheses, one after the other, and kept the one whose rendered \
             picture comes closest. That picture"
        )
    } else {
        format!(
            "It placed the model by the marked points, then changed everything at once, {steps} \
             times, always towards the more probable, and judged each time which pixels show the \
             face and which something before it. What it came to"
        )
    };
    let best = percent(s.pixel_rmse.best, 1);
    let off = s.mode.as_ref().map_or_else(
        || format!("{best} of full brightness (root mean square over the pixels the model covers)"),
        |mode| {
            format!(
                "{} of full brightness where the photo shows the face (root mean square; {best} over \
                 all that the model covers)",
                percent(mode.seen_rmse, 1)
            )
        },
    );
    writeln!(
        f,
        "<p>Given {landmarks} marked points and the pixels of this photo, the program looked for \
         the pose, light, shape and colour that would produce it. {how} is off by {off}; with the \
         pose of the marked points alone it was off by {initial} over all.</p>",
        landmarks = s.image.landmarks,
        initial = percent(s.pixel_rmse.initial, 1),
    )
}

/// The course of a search, a chart for each level: their posteriors measure different things.
fn levels(f: &mut impl Write, s: &Summary, mode: &ModeFound) -> fmt::Result {
    f.write_str("<h3>The search</h3>\n<div class=\"charts\">\n")?;
    let mut rest = &s.trace[..];
    for (&steps, level) in mode.levels.iter().zip(&LEVELS) {
        let (own, after) = rest.split_at(rest.len().min(2 * steps as usize));
        rest = after;
        let points: Vec<_> = own.iter().map(|&(step, value)| (f64::from(step), value)).collect();
        let name = match level.blur {
            0.0 if level.error > 1.0 => {
                format!("The photo itself, errors {} times as large", number(level.error.into(), 1))
            }
            0.0 => "The photo itself".to_owned(),
            blur => format!("The photo blurred by {} px", number(blur.into(), 0)),
        };
        let description = format!("{name}: log posterior by step");
        if let (Some(svg), [first, .., last]) =
            (charts::line(&description, "step", &points), &points[..])
        {
            writeln!(
                f,
                "<figure>{svg}<figcaption><b>{name}.</b> Log posterior, up to a constant: from {} to \
                 {}.</figcaption></figure>",
                number(first.1, 1),
                number(last.1, 1)
            )?;
        }
    }
    writeln!(
        f,
        "</div>\n<p class=\"note\">{} Only steps that raise the curve are taken; what hides the face is \
         judged anew in each of them.</p>",
        if mode.converged {
            "The last steps changed nothing: the search has converged."
        } else {
            "The search ended at its last step and had not converged."
        }
    )
}

/// The likelihood over all phases, a chart for each: their likelihoods measure different things.
fn traces(f: &mut impl Write, s: &Summary) -> fmt::Result {
    let from = |first: u32| s.trace.partition_point(|&(step, _)| step < first);
    let [posed, shaped] = [0, s.shape_steps].map(|more| from(s.landmark_steps + more));
    let points = "Log likelihood of the marked points";
    let phases = [
        (&s.trace[..posed], "Landmarks", format!("{points}: finds the pose.")),
        (&s.trace[posed..shaped], "Shape", format!("{points}: finds pose and shape.")),
        (&s.trace[shaped..], "Picture", "Log likelihood of the pixels: finds everything.".into()),
    ];
    f.write_str("<h3>The search</h3>\n<div class=\"charts\">\n")?;
    for (trace, phase, caption) in phases {
        let points: Vec<_> = trace.iter().map(|&(step, value)| (f64::from(step), value)).collect();
        let best = points.iter().map(|p| p.1).fold(f64::NEG_INFINITY, f64::max);
        let description = format!("{phase}: log likelihood by step, best {}", likelihood(best));
        if let Some(svg) = charts::line(&description, "step", &points) {
            writeln!(
                f,
                "<figure>{svg}<figcaption><b>{phase}.</b> {caption} Starts at {}, the dot is the \
                 best: {}.</figcaption></figure>",
                likelihood(points[0].1),
                likelihood(best)
            )?;
        }
    }
    f.write_str("</div>\n")
}

fn coefficients(f: &mut impl Write, scene: &Scene) -> fmt::Result {
    f.write_str("<h3>The model’s coefficients</h3>\n<div class=\"charts\">\n")?;
    for (name, values) in [("Shape", &scene.subject.shape), ("Colour", &scene.subject.albedo)] {
        let shown = &values[..values.len().min(SHOWN)];
        let description = format!("{name} coefficients in standard deviations");
        if let Some(svg) = charts::bars(&description, "component", shown) {
            writeln!(
                f,
                "<figure>{svg}<figcaption><b>{name}.</b> The first {} of {} coefficients, in \
                 standard deviations; 0 is the scan itself.</figcaption></figure>",
                shown.len(),
                values.len()
            )?;
        }
    }
    f.write_str("</div>\n")
}

/// Acceptance by kind of proposal, a bar each.
fn moves(f: &mut impl Write, proposals: &[Proposal]) -> fmt::Result {
    if proposals.is_empty() {
        return Ok(());
    }
    f.write_str("<h3>Proposals accepted</h3>\n<div class=\"columns\">\n")?;
    for (phase, title) in [
        (PhaseName::Landmarks, "Landmarks"),
        (PhaseName::Shape, "Shape"),
        (PhaseName::Image, "Picture"),
    ] {
        if proposals.iter().all(|p| p.phase != phase || p.proposed == 0) {
            continue;
        }
        writeln!(f, "<div><p class=\"note\"><b>{title}</b></p>\n<table class=\"moves\">")?;
        for p in proposals.iter().filter(|p| p.phase == phase) {
            let share = p.accepted as f64 / p.proposed.max(1) as f64;
            let mark = if p.steers { "<span class=\"steers\">steers</span>" } else { "" };
            writeln!(
                f,
                "<tr><th scope=\"row\">{}{mark}</th>\
                 <td><span class=\"track\"><i style=\"width:{:.1}%\"></i></span></td>\
                 <td class=\"share\">{}</td><td class=\"count\">{} of {}</td></tr>",
                Escaped(&p.name),
                100.0 * share.min(1.0),
                percent(share, 0),
                number(p.accepted as f64, 0),
                number(p.proposed as f64, 0)
            )?;
        }
        f.write_str("</table></div>\n")?;
    }
    f.write_str("</div>\n")?;
    if proposals.iter().any(|p| p.steers) {
        f.write_str(
            "<p class=\"note\"><b>steers</b> marks moves that go towards what explains the picture instead of \
             wandering blindly. They find the best fit sooner, but a chain that uses them does not \
             sample the posterior.</p>\n",
        )?;
    }
    Ok(())
}

/// The components of a mixture, the likeliest of which is shown.
#[cfg(feature = "full")]
fn mixture(f: &mut impl Write, s: &Summary) -> fmt::Result {
    if s.mixture.is_empty() {
        return Ok(());
    }
    f.write_str(
        "<h3>The mixture</h3>\n<table class=\"measures\">\n<tr><th>component</th><th>before</th>\
         <th>given the photo</th><th>log evidence, against the best</th></tr>\n",
    )?;
    let most = s.mixture.iter().map(|c| c.ln_evidence).fold(f64::NEG_INFINITY, f64::max);
    for component in &s.mixture {
        writeln!(
            f,
            "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{}</td></tr>",
            Escaped(&component.model.file),
            percent(component.before, 1),
            percent(component.weight, 1),
            number(component.ln_evidence - most, 1)
        )?;
    }
    writeln!(
        f,
        "</table>\n<p class=\"note\">Every component was fitted; this page shows the likeliest. The \
         evidence is the marginal likelihood in Laplace’s approximation.</p>"
    )
}

fn facts(f: &mut impl Write, rows: &Rows) -> fmt::Result {
    f.write_str("<table class=\"facts\">\n")?;
    for (name, value) in rows {
        writeln!(
            f,
            "<tr><th scope=\"row\">{}</th><td>{}</td></tr>",
            Escaped(name),
            Escaped(value)
        )?;
    }
    f.write_str("</table>\n")
}

/// The picture with its longer side brought down to `side`, aspect kept.
fn shrunk(picture: &Picture, side: u32) -> Picture {
    let longer = picture.width.max(picture.height);
    if longer <= side {
        return picture.clone();
    }
    let scaled =
        |v: u32| (u64::from(v) * u64::from(side)).div_ceil(u64::from(longer)).max(1) as u32;
    picture.resized(scaled(picture.width), scaled(picture.height))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::output::Pictures;
    use crate::mesh::Mesh;
    use crate::mesh::skin::{Colors, Skin};
    use std::sync::Arc;

    fn finished(file: &str) -> Finished {
        let mut summary = crate::fit::summary::tests::example();
        summary.image.file = file.to_owned();
        let picture = || Picture::filled(4, 3, [90, 60, 30]);
        let pictures = Pictures {
            uncertainty: None,
            photo: picture(),
            on_photo: picture(),
            alone: picture(),
            sides: vec![picture(), picture()],
            textured: [picture(), picture()],
            whole: Picture::filled(2000, 1, [1; 3]),
            masked: None,
            landmarks: [picture(), picture()],
        };
        let mesh = Mesh { points: vec![], colors: vec![], triangles: vec![] };
        let skin = Arc::new(Skin { colors: Colors::Vertices(vec![]), lit: true });
        Finished { summary, mesh, skin, pictures, found: None }
    }

    #[test]
    fn a_page_asks_nobody_for_anything() {
        let page = fit_report(&finished("a.jpg"), "scan = \"face.ply\"\nshape_rank = 9").unwrap();
        assert_eq!(page.matches("<img src=\"data:image/png;base64,").count(), 8);
        assert_eq!(page.matches("src=").count(), 8);
        for absent in ["http", "url(", "<script", "@import"] {
            assert!(!page.contains(absent), "{absent}");
        }
        assert!(page.contains("<a href=\"mesh.glb\">"));
        assert!(page.contains(">shape rank</th><td>9</td>"));
        assert!(page.contains("<p class=\"warning\">the face looks away.</p>"));
        for tag in ["section", "figure", "table", "div", "svg", "p", "tr"] {
            let (open, close) = (format!("<{tag}"), format!("</{tag}>"));
            let opened = [" ", ">"].map(|end| page.matches(&format!("{open}{end}")).count());
            assert_eq!(opened[0] + opened[1], page.matches(&close).count(), "{tag}");
        }
    }

    #[test]
    fn names_cannot_break_out() {
        let page = fit_report(&finished("<b>\"x\"&.jpg"), "a<i> = <u>").unwrap();
        assert!(!page.contains("<b>\"x") && !page.contains("<i>") && !page.contains("<u>"));
        assert!(page.contains("&lt;b&gt;&quot;x&quot;&amp;.jpg"));
    }

    #[test]
    fn a_demo_links_into_the_directory_of_each_fit() {
        let results = [(finished("one.png"), "first"), (finished("two three.jpg"), "second")];
        let page = demo_report(&results, &Picture::filled(2, 2, [0; 3]), "").unwrap();
        assert!(page.contains("href=\"one/fit.json\"") && page.contains("two%20three/mesh.ply"));
        assert!(page.contains("<p class=\"about\">second</p>"));
    }

    #[test]
    fn a_picture_without_pixels_is_an_error() {
        let mut broken = finished("a.jpg");
        broken.pictures.alone = Picture::filled(0, 0, [0; 3]);
        assert!(fit_report(&broken, "").is_err());
    }
}
