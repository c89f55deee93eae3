//! Registration of the ten scans, judged by true correspondence (paper, "Registration Tasks" and its
//! supplement): shape only beside shape and albedo.
//!
//! A scan's error is the root mean square distance, over vertices, between where a registration has a
//! vertex and where it truly is, in the scan's place, nothing aligned and nothing scaled. Truths are
//! used for nothing else.

use super::faces::{identity_meshes, scan_meshes, scan_truths};
use super::stages::Stages;
use crate::demo;
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::mesh::landmarks::Landmark;
use crate::mesh::ply;
use crate::model::decompose::Progress;
use crate::model::layout;
use crate::model::morphable::Morphable;
use crate::model_file::OwnedModel;
use crate::photo::picture::{Picture, montage};
use crate::registration::{Distances, Measures, Options, Registered, register};
use crate::render;
use crate::report;
use crate::vector::{dot, length, minus};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

/// What the kernels' covariance is multiplied by beside principal components: .3², as for the
/// peers' best model in docs/registration.md.
const KERNELS: f64 = 0.09;
/// Regions that errors are told of.
pub const REGIONS: [&str; 6] = ["all", "eyes", "brows", "lips", "nose", "cheeks"];

/// A way to register.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Way {
    /// By the surface alone.
    ShapeOnly,
    /// By colours as well.
    ShapeAndAlbedo,
    /// And by 42 landmarks at their true places.
    WithLandmarks,
}

impl Way {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::ShapeOnly, Self::ShapeAndAlbedo, Self::WithLandmarks];

    fn name(self) -> &'static str {
        match self {
            Self::ShapeOnly => "shape only",
            Self::ShapeAndAlbedo => "shape + albedo",
            Self::WithLandmarks => "shape + albedo + 42 landmarks",
        }
    }
}

/// One scan registered in one way.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// Number of the scan.
    pub scan: usize,
    /// Root mean square distance to the truth, mm, by [`REGIONS`].
    pub rms_mm: [f64; REGIONS.len()],
    /// Chamfer distance of the surfaces, mm.
    pub chamfer_mm: f64,
    /// Hausdorff distance of the surfaces, mm.
    pub hausdorff_mm: f64,
    /// The same at 95 %.
    pub hausdorff_95_mm: f64,
    /// Distances between landmarks of registration and scan, mm.
    pub landmarks_mm: Distances,
    /// Seconds it took, one thread.
    pub seconds: f64,
}

/// All scans registered by one model in one way.
#[derive(Clone, Debug, Serialize)]
pub struct Series {
    /// The model.
    pub model: &'static str,
    /// How.
    pub way: Way,
    /// Scan by scan.
    pub rows: Vec<Row>,
    /// The average registration, on the model's mean.
    #[serde(skip)]
    average: Mesh,
}

impl Series {
    /// Mean over the scans of the errors in a region, mm.
    pub fn rms(&self, region: usize) -> f64 {
        self.mean(|row| row.rms_mm[region])
    }

    fn mean(&self, value: impl Fn(&Row) -> f64) -> f64 {
        self.rows.iter().map(value).sum::<f64>() / self.rows.len().max(1) as f64
    }
}

/// The result.
#[derive(Clone, Debug, Serialize)]
pub struct Registrations {
    /// Names of the regions.
    pub regions: [&'static str; REGIONS.len()],
    /// Models and ways.
    pub series: Vec<Series>,
    #[serde(skip)]
    truth: Mesh,
    #[serde(skip)]
    eye: [f32; 3],
}

/// Registers the first `scans` scans with two models in three ways. `progress` hears the fraction
/// done.
///
/// # Errors
/// Fixtures that cannot be read.
pub fn run(
    fixtures: &Path,
    scans: usize,
    stages: &Stages,
    progress: &mut Progress<'_>,
) -> Result<Registrations> {
    let (template, landmarks) = demo::template()?;
    let regions = regions(&template, &landmarks)?;
    progress(0.0, "models");
    let kernels = demo::template_model(199, &mut |_, _| {})?.model;
    let people = people(fixtures, &kernels, &landmarks)?;
    let models =
        [("kernels", &kernels, Options::default().width), ("60 people + .3 kernels", &people, 1.0)];
    let truths = scan_truths(fixtures)?;
    let marks = scan_landmarks(fixtures, &landmarks)?;
    let scans = scans.min(truths.len());
    let meshes: Vec<Mesh> = (0..scans)
        .map(|i| ply::read(&fixtures.join(format!("face/scans/scan_{i:02}.ply"))))
        .collect::<Result<_>>()?;
    let total = (models.len() * Way::ALL.len() * scans) as f64;
    let mut done = 0.0;
    let mut series = Vec::new();
    for (name, model, width) in models {
        let model = model.view();
        for way in Way::ALL {
            let (mut rows, mut aligned) = (Vec::new(), Vec::new());
            for (scan, mesh) in meshes.iter().enumerate() {
                progress(done / total, "registering");
                let albedo = way != Way::ShapeOnly;
                let options = Options { width, albedo, ..Options::default() };
                let used = if way == Way::WithLandmarks { &marks[scan][..] } else { &[] };
                let stage = format!("series-{}-scan-{scan}", series.len());
                let (row, (points, colors)) = stages.stage(&stage, || {
                    let start = Instant::now();
                    let found = register(&model, mesh, used, options, false, &mut |_| {})?;
                    let seconds = start.elapsed().as_secs_f64();
                    let row = row(scan, &found, &truths[scan], &marks[scan], &regions, seconds);
                    Ok((row, (found.aligned.points, found.aligned.colors)))
                })?;
                rows.push(row);
                aligned.push(Mesh { points, colors, triangles: template.triangles.clone() });
                done += 1.0;
            }
            series.push(Series { model: name, way, rows, average: average(&aligned) });
        }
    }
    let eye = place(&template, &landmarks, "left.eye.pupil.center")?;
    let truth = average(&scan_meshes(fixtures)?[..scans]);
    Ok(Registrations { regions: REGIONS, series, truth, eye })
}

/// Principal components of the 60 people, and a little of the kernels.
fn people(fixtures: &Path, kernels: &OwnedModel, landmarks: &[Landmark]) -> Result<OwnedModel> {
    let mut kernels = Morphable::of(&kernels.view());
    for half in [&mut kernels.shape, &mut kernels.albedo] {
        half.variances.iter_mut().for_each(|v| *v *= KERNELS);
        half.total_variance *= KERNELS;
    }
    let people = Morphable::of_meshes(&identity_meshes(fixtures)?, landmarks.to_vec())?;
    people.augmented(&kernels)?.to_model(i16::MAX)
}

/// What a chart shows of a registration.
type Value = fn(&Row) -> f64;

/// Of a scan the landmarks' vertices in the template, and their true places.
type Marks = Vec<(u32, [f32; 3])>;

fn scan_landmarks(fixtures: &Path, landmarks: &[Landmark]) -> Result<Vec<Marks>> {
    let path = fixtures.join("face/scans/scans.json");
    let text = std::fs::read_to_string(&path).map_err(|e| Error::file(&path, e))?;
    let value: serde_json::Value =
        serde_json::from_str(&text).map_err(|e| Error::file(&path, e))?;
    let scans = value.as_array().ok_or_else(|| Error::file(&path, "expected an array of scans"))?;
    let of = |scan: &serde_json::Value| {
        let place = |landmark: &Landmark| {
            let at = scan["landmarks"][&landmark.name].as_array()?;
            let [x, y, z] = &at[..] else { return None };
            Some((landmark.vertex, [x.as_f64()? as f32, y.as_f64()? as f32, z.as_f64()? as f32]))
        };
        landmarks.iter().filter_map(place).collect()
    };
    Ok(scans.iter().map(of).collect())
}

fn row(
    scan: usize,
    found: &Registered,
    truth: &[[f32; 3]],
    marks: &[(u32, [f32; 3])],
    regions: &[Vec<bool>; REGIONS.len()],
    seconds: f64,
) -> Row {
    let points = &found.mesh.points;
    let rms_mm = regions.each_ref().map(|region| {
        let pairs = points.iter().zip(truth).zip(region).filter(|(_, inside)| **inside);
        let squares: Vec<f64> = pairs.map(|((a, b), _)| apart(*a, *b).powi(2)).collect();
        (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
    });
    let measures: &Measures = &found.measures;
    Row {
        scan,
        rms_mm,
        chamfer_mm: measures.chamfer(),
        hausdorff_mm: measures.hausdorff(),
        hausdorff_95_mm: measures.hausdorff_95(),
        landmarks_mm: Distances::of(
            marks.iter().map(|(v, at)| apart(points[*v as usize], *at)).collect(),
        ),
        seconds,
    }
}

fn apart(a: [f32; 3], b: [f32; 3]) -> f64 {
    length(minus(a, b).map(f64::from))
}

/// Mean place and colour of every vertex; the triangles of the first.
fn average(meshes: &[Mesh]) -> Mesh {
    let mut sum = meshes[0].clone();
    for mesh in &meshes[1..] {
        let more = [(&mut sum.points, &mesh.points), (&mut sum.colors, &mesh.colors)];
        for (to, from) in more {
            let pairs = to.as_flattened_mut().iter_mut().zip(from.as_flattened());
            pairs.for_each(|(to, from)| *to += from);
        }
    }
    let all = sum.points.as_flattened_mut().iter_mut().chain(sum.colors.as_flattened_mut());
    all.for_each(|x| *x /= meshes.len() as f32);
    sum
}

fn place(template: &Mesh, landmarks: &[Landmark], name: &str) -> Result<[f32; 3]> {
    let landmark = landmarks.iter().find(|l| l.name == name);
    let landmark = landmark.ok_or_else(|| Error::new(format_args!("no landmark {name}")))?;
    Ok(template.points[landmark.vertex as usize])
}

/// Whether vertices belong to [`REGIONS`]: eyes within 16 mm of the middle between their corners, brows
/// within 4 mm of lines through their landmarks, lips within 5 mm of theirs, the nose within 11 mm of
/// its ridge and wings, cheeks between lower lid and lower lip, beyond 15 mm from the middle; what comes
/// first in this order is not the later.
fn regions(template: &Mesh, landmarks: &[Landmark]) -> Result<[Vec<bool>; REGIONS.len()]> {
    let at = |name: &str| place(template, landmarks, name);
    let middle = |a: [f32; 3], b: [f32; 3]| [0, 1, 2].map(|i| 0.5 * (a[i] + b[i]));
    let (mut pupils, mut brows, mut inner) = (Vec::new(), Vec::new(), Vec::new());
    for side in ["left", "right"] {
        let of = |part: &str| at(&format!("{side}.{part}"));
        let corner = of("eye.corner_inner")?;
        pupils.push(middle(of("eye.corner_outer")?, corner));
        inner.push(corner);
        for (a, b) in [
            ("inner_lower", "bend.lower"),
            ("inner_upper", "bend.upper"),
            ("bend.upper", "outer"),
            ("bend.lower", "outer"),
        ] {
            brows.push([of(&format!("eyebrow.{a}"))?, of(&format!("eyebrow.{b}"))?]);
        }
    }
    let lips = [
        "right.lips.corner",
        "right.lips.philtrum_ridge",
        "center.lips.upper.outer",
        "left.lips.philtrum_ridge",
        "left.lips.corner",
        "center.lips.lower.outer",
        "right.lips.corner",
        "left.lips.corner",
    ];
    let lips = lips.map(at).into_iter().collect::<Result<Vec<_>>>()?;
    let tip = at("center.nose.tip")?;
    let mut root = middle(inner[0], inner[1]);
    root[2] += 5.0;
    let nose =
        [[tip, at("left.nose.wing.outer")?], [tip, at("right.nose.wing.outer")?], [tip, root]];
    let (lid, chin) = (at("left.eye.bottom")?[1], at("center.lips.lower.outer")?[1]);
    let mut regions: [Vec<bool>; REGIONS.len()] = std::array::from_fn(|_| Vec::new());
    for &p in &template.points {
        let near = |lines: &[[[f32; 3]; 2]], mm: f64| lines.iter().any(|l| from_line(p, *l) < mm);
        let eyes = pupils.iter().any(|pupil| apart(p, *pupil) < 16.0);
        let lips = lips.windows(2).any(|pair| from_line(p, [pair[0], pair[1]]) < 5.0);
        let nose = near(&nose, 11.0) && !eyes && !lips;
        let beside = p[1] < lid && p[1] > chin && p[0].abs() > 15.0;
        let inside = [true, eyes, near(&brows, 4.0), lips, nose, beside && !eyes && !lips && !nose];
        for (region, inside) in regions.iter_mut().zip(inside) {
            region.push(inside);
        }
    }
    Ok(regions)
}

/// Distance of a point from a line between two others.
fn from_line(p: [f32; 3], [a, b]: [[f32; 3]; 2]) -> f64 {
    let (ab, ap) = (minus(b, a), minus(p, a));
    let t = (dot(ap, ab) / dot(ab, ab)).clamp(0.0, 1.0);
    apart(p, [0, 1, 2].map(|i| a[i] + t * ab[i]))
}

/// Pixels of the averages' pictures, and of what is cut out about the left eye.
const SIDE: u32 = 1000;
const EYE: u32 = 320;

impl Registrations {
    /// The table: a line for each model and way.
    pub fn markdown(&self) -> String {
        let mut text = String::from(
            "| model | | all | eyes | brows | lips | nose | cheeks | chamfer | Hausdorff 95 % | \
             landmarks | s |\n|---|---|---|---|---|---|---|---|---|---|---|---|\n",
        );
        for series in &self.series {
            let _ = write!(text, "| {} | {} |", series.model, series.way.name());
            for region in 0..REGIONS.len() {
                let _ = write!(text, " {:.2} |", series.rms(region));
            }
            let _ = writeln!(
                text,
                " {:.2} | {:.1} | {:.2} | {:.1} |",
                series.mean(|r| r.chamfer_mm),
                series.mean(|r| r.hausdorff_95_mm),
                series.mean(|r| r.landmarks_mm.mean),
                series.mean(|r| r.seconds)
            );
        }
        text
    }

    /// The numbers.
    ///
    /// # Errors
    /// Never in practice.
    pub fn to_json(&self) -> Result<String> {
        crate::json::to_text(self)
    }

    /// The average of the kernel model's registrations by shape only, by shape and albedo, and of the
    /// true meshes; below each its left eye and brow.
    ///
    /// # Errors
    /// None for meshes of the experiment.
    pub fn averages(&self) -> Result<Picture> {
        let averages = [&self.series[0].average, &self.series[1].average, &self.truth]
            .map(|mesh| self.pair(mesh));
        let pairs = averages.into_iter().collect::<Result<Vec<_>>>()?;
        let faces: Vec<&Picture> = pairs.iter().map(|(face, _)| face).collect();
        let eyes: Vec<&Picture> = pairs.iter().map(|(_, eye)| eye).collect();
        let [faces, eyes] = [faces, eyes].map(|row| montage(&row, 8, render::GROUND));
        let mut sheet =
            Picture::filled(faces.width, faces.height + 8 + eyes.height, render::GROUND);
        sheet.paste(&faces, 0, 0);
        sheet.paste(&eyes, 0, faces.height + 8);
        Ok(sheet)
    }

    fn pair(&self, mesh: &Mesh) -> Result<(Picture, Picture)> {
        let frame = layout::rigid(mesh, &[])?;
        let scene = render::portrait(&frame.view(), [SIDE; 2], 0.0, 0.0);
        let whole = render::smooth_on(&frame.view(), &scene, render::GROUND);
        let (x, y, _) = scene.view.camera.project(scene.view.pose.to_world(self.eye));
        let corner = |at: f32| (at as u32).saturating_sub(EYE / 2);
        // Upwards, so that the brow is in it.
        let eye = whole.cropped(corner(x), corner(y - 0.15 * EYE as f32), EYE, EYE);
        let width = SIDE / 2;
        Ok((whole.resized(width, width), eye.resized(width, width)))
    }

    /// The page.
    ///
    /// # Errors
    /// None for meshes of the experiment.
    pub fn page(&self) -> Result<String> {
        let mut body = String::from("<section>\n<h2>The average of the registrations</h2>\n");
        body += &report::figure(
            &self.averages()?,
            "Averages of registrations, with the left eye and brow",
            "Average of the scans’ registrations by the kernel model: shape only, shape and albedo, and \
             the true meshes. Below, the left eye and brow: the sharper, the better they agree.",
        )?;
        body += "</section>\n<section>\n<h2>Distances scan by scan, kernel model</h2>\n\
                 <ul class=\"legend\"><li class=\"series-0\"><i></i>shape only</li>\
                 <li class=\"series-2\"><i></i>shape and albedo</li></ul>\n<div class=\"charts\">\n";
        let values: [(&str, Value); 5] = [
            ("Hausdorff distance, all vertices, mm", |r| r.hausdorff_mm),
            ("Chamfer distance, all vertices, mm", |r| r.chamfer_mm),
            ("Hausdorff distance, landmarks, mm", |r| r.landmarks_mm.largest),
            ("Chamfer distance, landmarks, mm", |r| r.landmarks_mm.mean),
            ("True correspondence, all vertices, rms, mm", |r| r.rms_mm[0]),
        ];
        let labels: Vec<String> = self.series[0].rows.iter().map(|r| r.scan.to_string()).collect();
        for (title, value) in values {
            let of = |i: usize| self.series[i].rows.iter().map(value).collect::<Vec<f64>>();
            let chart = report::columns(title, "scan", &labels, &[(0, of(0)), (2, of(1))]);
            let _ = writeln!(
                body,
                "<figure>{}<figcaption>{title}.</figcaption></figure>",
                chart.unwrap_or_default()
            );
        }
        body += "</div>\n</section>\n<section>\n<h2>Errors by true correspondence</h2>\n\
                 <table class=\"measures\">\n<tr><th>model</th><th>by</th>";
        for region in REGIONS {
            let _ = write!(body, "<th>{region}</th>");
        }
        body += "<th>s</th></tr>\n";
        for series in &self.series {
            let _ = write!(
                body,
                "<tr><th scope=\"row\">{}</th><td>{}</td>",
                series.model,
                series.way.name()
            );
            for region in 0..REGIONS.len() {
                let _ = write!(body, "<td>{:.2}</td>", series.rms(region));
            }
            let _ = writeln!(body, "<td>{:.1}</td></tr>", series.mean(|r| r.seconds));
        }
        body += "</table>\n<p>Mean over the scans of the root mean square distance between where a \
                 vertex was registered and where it truly is, mm; nothing was aligned or scaled for \
                 that. Pose found without landmarks, but in the last line of each model.</p>\n\
                 </section>\n";
        report::essay(
            "Registration of ten scans",
            "By shape only, and by shape and albedo, judged by where vertices truly belong.",
            &body,
        )
    }
}
