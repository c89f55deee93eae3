//! What is wrong with a mesh, and mending it.
//!
//! A scan need not be perfect to make a model: holes are fine. But a model has a colour and a
//! normal per vertex and compares both sides of an object, so what is split, folded, inside out, off
//! centre or in another unit is told here, and what can be mended without guessing is.

mod mend;
pub(super) mod surface;

use crate::mesh::{Mesh, weld};
use crate::scan::symmetry;
use crate::vector;
pub use mend::{Mended, mend};
use serde::Serialize;
use std::collections::{HashMap, HashSet};
use std::fmt;
use surface::{
    BENT, Groups, Points, area, bounds, centre, components, distance, distinct, edges, flux,
};

/// Diagonals that the kernels' lengths suit, millimetres: half a face to a bust with its shoulders.
const DIAGONALS: std::ops::RangeInclusive<f64> = 60.0..=1500.0;
/// What mends what takes no guess.
const MEND: &str = "`onescan inspect SCAN --mend OUT.ply` mends it";
/// Least fraction of vertices with a partner across x = 0 in a mesh that lies symmetric. Chosen, not
/// measured, like the next.
const SYMMETRIC: f64 = 0.8;
/// How near a partner has to be, as a fraction of the diagonal: 4 mm in a face.
const NEAR: f64 = 0.02;

/// What there is to say about a mesh. Topology is that of the mesh whose exactly equal vertices
/// are joined: a texture's seam is no border.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Findings {
    /// Vertices in the file.
    pub vertices: usize,
    /// Triangles in the file.
    pub triangles: usize,
    /// Least coordinates of the box around it, millimetres.
    pub low: [f64; 3],
    /// Greatest coordinates.
    pub high: [f64; 3],
    /// Length of the box's diagonal, millimetres.
    pub diagonal: f64,
    /// Area of the surface, square millimetres.
    pub area: f64,
    /// Mean length of an edge, millimetres.
    pub edge: f64,
    /// Vertices at exactly the position of an earlier one.
    pub duplicate_vertices: usize,
    /// Vertices of no triangle.
    pub unused_vertices: usize,
    /// Triangles without area.
    pub degenerate_triangles: usize,
    /// Triangles with the same corners as an earlier one.
    pub duplicate_triangles: usize,
    /// Edges of more than two triangles.
    pub crowded_edges: usize,
    /// Edges whose two triangles run along it the same way: one of them is turned over.
    pub clashing_edges: usize,
    /// Edges of one triangle.
    pub border_edges: usize,
    /// Connected pieces of the border.
    pub borders: usize,
    /// Triangles of each connected component, largest first.
    pub components: Vec<usize>,
    /// Whether the surface as a whole looks inwards; none if it is flat.
    pub inside_out: Option<bool>,
    /// Whether all vertices have the same colour.
    pub one_color: bool,
    /// Fraction of vertices that have another across x = 0, within an edge's length or 2 % of the
    /// diagonal: faces are not quite symmetric.
    pub mirrored: f64,
    /// If those are few: root mean square distance from the surface, millimetres, of vertices that are mirrored
    /// at the plane at which it mirrors best; none if it is not symmetric there, either.
    pub mirrored_elsewhere: Option<f64>,
}

impl Findings {
    /// Examines a mesh whose unit is so many millimetres long.
    pub fn of(mesh: &Mesh, millimetres: f64) -> Self {
        let (map, points) = weld(&mesh.points);
        let points: Vec<[f64; 3]> =
            points.iter().map(|p| p.map(|c| f64::from(c) * millimetres)).collect();
        let joined: Vec<[u32; 3]> =
            mesh.triangles.iter().map(|t| t.map(|v| map[v as usize])).collect();
        let mut used = vec![false; mesh.points.len()];
        for &v in mesh.triangles.as_flattened() {
            used[v as usize] = true;
        }
        let (kept, degenerate, duplicate) = distinct(&points, &joined);
        let edges = edges(&kept);
        let of_size = |n: usize| edges.values().filter(move |sides| sides.len() == n);
        let border: Vec<[u32; 2]> =
            edges.iter().filter(|(_, sides)| sides.len() == 1).map(|(edge, _)| *edge).collect();
        let mut ends = Groups::new(points.len());
        for &[a, b] in &border {
            ends.join(a, b);
        }
        let (low, high) = bounds(&points);
        let diagonal = vector::distance(high, low);
        let area = kept.iter().map(|t| area(&points, *t)).sum::<f64>();
        let length: f64 = edges.keys().map(|&[a, b]| distance(&points, a, b)).sum();
        let edge = length / edges.len().max(1) as f64;
        let mirrored = mirrored(&points, edge.max(NEAR * diagonal));
        let mirrored_elsewhere = (mirrored < SYMMETRIC)
            .then(|| Some(symmetry::find(mesh).ok()?.error * millimetres))
            .flatten()
            .filter(|error| *error < 0.5 * NEAR * diagonal);
        let flux = flux(&points, kept.iter().copied(), centre(&points, &kept));
        Self {
            vertices: mesh.points.len(),
            triangles: mesh.triangles.len(),
            low,
            high,
            diagonal,
            area,
            edge,
            duplicate_vertices: mesh.points.len() - points.len(),
            unused_vertices: used.iter().filter(|used| !**used).count(),
            degenerate_triangles: degenerate,
            duplicate_triangles: duplicate,
            crowded_edges: edges.values().filter(|sides| sides.len() > 2).count(),
            clashing_edges: of_size(2).filter(|sides| sides[0].1 == sides[1].1).count(),
            border_edges: border.len(),
            borders: border.iter().map(|&[a, _]| ends.find(a)).collect::<HashSet<_>>().len(),
            components: components(points.len(), &kept).iter().map(Vec::len).collect(),
            inside_out: (flux.abs() > BENT * area.powf(1.5)).then_some(flux < 0.0),
            one_color: mesh.colors.windows(2).all(|pair| pair[0] == pair[1]),
            mirrored,
            mirrored_elsewhere,
        }
    }

    /// What should be seen to before a model is built, a line each. `mirror`: the model is to mirror
    /// at x = 0.
    pub fn faults(&self, mirror: bool) -> Vec<String> {
        let mut faults = Vec::new();
        let mut note = |there: bool, text: String| {
            if there {
                faults.push(text);
            }
        };
        let mendable = [
            (self.duplicate_vertices, "vertex", "on the very place of another (seams)"),
            (self.unused_vertices, "vertex", "of no triangle"),
            (self.degenerate_triangles, "triangle", "without area"),
            (self.duplicate_triangles, "triangle", "like another"),
            (self.crowded_edges, "edge", "of more than two triangles"),
            (self.clashing_edges, "edge", "between triangles that face opposite ways"),
        ];
        for (count, noun, what) in mendable {
            note(count > 0, format!("{} {what}: {MEND}", counted(count, noun)));
        }
        note(self.inside_out == Some(true), format!("the surface is inside out: {MEND}"));
        let others: usize = self.components.iter().skip(1).sum();
        note(
            others > 0,
            format!(
                "{} beside the largest, {others} triangles, kept as they may belong to it (eyes, a \
                 beak); `inspect --mend OUT.ply --largest` drops them",
                counted(self.components.len().saturating_sub(1), "piece")
            ),
        );
        note(
            !DIAGONALS.contains(&self.diagonal),
            format!(
                "{} mm across: kernels suit what is as large as a face or a head; {}",
                rounded(self.diagonal),
                self.unit_hint()
            ),
        );
        note(
            mirror && self.mirrored < SYMMETRIC,
            format!(
                "{:.0} % of the vertices have a partner across x = 0, {}",
                100.0 * self.mirrored,
                match self.mirrored_elsewhere {
                    Some(error) => format!(
                        "but it mirrors at another plane (off by {} mm): build with --mirror find",
                        rounded(error)
                    ),
                    None =>
                        "and there is no other plane at which it mirrors: symmetric kernels do \
                             not suit it; build with --mirror none"
                            .into(),
                }
            ),
        );
        note(self.one_color, "all vertices have the same colour: the albedo will be flat".into());
        faults
    }

    /// The unit in which a mesh, read as if in millimetres, would be as large as a face or a head, if it is
    /// too small for one.
    pub fn likely_unit(&self) -> Option<&'static str> {
        let fits = |millimetres: f64| (100.0..=700.0).contains(&(self.diagonal * millimetres));
        let units = [("cm", 10.0), ("m", 1000.0)].into_iter();
        let small = self.diagonal < *DIAGONALS.start();
        units.filter(|_| small).find(|(_, size)| fits(*size)).map(|(unit, _)| unit)
    }

    fn unit_hint(&self) -> String {
        match self.likely_unit() {
            Some(unit) => format!("if its numbers were read as mm, try --unit {unit}"),
            None => {
                "give its length by --size, or how many millimetres its unit is by --unit".into()
            }
        }
    }
}

impl fmt::Display for Findings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{} vertices, {} triangles", self.vertices, self.triangles)?;
        let side = |i: usize| format!("{}…{}", rounded(self.low[i]), rounded(self.high[i]));
        writeln!(
            f,
            "x {}, y {}, z {} mm; {} mm across, {} mm²",
            side(0),
            side(1),
            side(2),
            rounded(self.diagonal),
            rounded(self.area)
        )?;
        writeln!(f, "edges of {} mm on average", rounded(self.edge))?;
        let sizes: Vec<_> = self.components.iter().take(5).map(ToString::to_string).collect();
        let more = if self.components.len() > 5 { ", …" } else { "" };
        writeln!(
            f,
            "{} connected (triangles: {}{more}), {} ({} edges)",
            counted(self.components.len(), "piece"),
            sizes.join(", "),
            if self.borders == 0 { "closed".into() } else { counted(self.borders, "border") },
            self.border_edges
        )?;
        write!(f, "{:.0} % mirrored across x = 0", 100.0 * self.mirrored)?;
        let faults = self.faults(true);
        if faults.is_empty() {
            write!(f, "\nnothing to mend")?;
        }
        for fault in faults {
            write!(f, "\n- {fault}")?;
        }
        Ok(())
    }
}

/// The fraction of points that have another (or themselves) within `reach` of their mirror image
/// in x = 0.
fn mirrored(points: Points<'_>, reach: f64) -> f64 {
    if !(reach > 0.0) {
        return 0.0;
    }
    let cell = |p: &[f64; 3]| p.map(|c| (c / reach).floor() as i64);
    let mut cells: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
    for (v, p) in points.iter().enumerate() {
        cells.entry(cell(p)).or_default().push(v as u32);
    }
    let near = |p: [f64; 3]| {
        let at = cell(&p);
        (0..27_i64).any(|i| {
            let [x, y, z] = [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1];
            let key = [at[0].saturating_add(x), at[1].saturating_add(y), at[2].saturating_add(z)];
            cells.get(&key).into_iter().flatten().any(|&v| {
                let q = points[v as usize];
                (0..3).map(|i| (p[i] - q[i]).powi(2)).sum::<f64>() <= reach * reach
            })
        })
    };
    let found = points.iter().filter(|[x, y, z]| near([-x, *y, *z])).count();
    found as f64 / points.len().max(1) as f64
}

/// A number with four digits that count.
fn rounded(x: f64) -> String {
    let digits = if x == 0.0 { 0 } else { (3 - x.abs().log10().floor() as i64).clamp(0, 3) };
    format!("{x:.*}", digits as usize)
}

fn counted(n: usize, what: &str) -> String {
    match (n, what) {
        (1, _) => format!("{n} {what}"),
        (_, "vertex") => format!("{n} vertices"),
        _ => format!("{n} {what}s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo;

    /// A tetrahedron that looks outwards.
    fn tetrahedron() -> Mesh {
        Mesh {
            points: vec![[-40., 0., 0.], [40., 0., 0.], [0., 80., 0.], [0., 30., 80.]],
            colors: vec![[0.1; 3], [0.3; 3], [0.5; 3], [0.7; 3]],
            triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
        }
    }

    #[test]
    fn the_template_has_nothing_to_mend() {
        let (mesh, _) = demo::template().unwrap();
        let findings = Findings::of(&mesh, 1.0);
        assert_eq!(findings.faults(true), Vec::<String>::new());
        assert_eq!((findings.vertices, findings.triangles), (8291, 16374));
        assert_eq!((findings.components.as_slice(), findings.borders), (&[16374][..], 1));
        assert_eq!((findings.mirrored, findings.inside_out), (1.0, Some(false)));
        let (mended, what) = mend(&mesh, false);
        assert_eq!((mended, what.to_string().as_str()), (mesh, "nothing to mend"));
    }

    #[test]
    fn a_face_turned_inside_out_is_told_and_turned() {
        let (mesh, _) = demo::template().unwrap();
        let mut turned = mesh.clone();
        for t in &mut turned.triangles {
            t.swap(1, 2);
        }
        assert_eq!(Findings::of(&turned, 1.0).inside_out, Some(true));
        let (mended, what) = mend(&turned, false);
        assert_eq!((mended, what.turned), (mesh.clone(), 16374));
        // A minority that clashes follows the rest.
        let mut mixed = mesh.clone();
        mixed.triangles.iter_mut().step_by(3).for_each(|t| t.swap(1, 2));
        assert!(Findings::of(&mixed, 1.0).clashing_edges > 1000);
        let (mended, what) = mend(&mixed, false);
        assert_eq!((mended, what.turned), (mesh, 16374_usize.div_ceil(3)));
    }

    #[test]
    fn a_closed_mesh_is_turned_outwards_wherever_it_lies() {
        for shift in [0.0, 1e4] {
            let mut mesh = tetrahedron();
            for p in &mut mesh.points {
                p[2] += shift;
            }
            let mut turned = mesh.clone();
            for t in &mut turned.triangles {
                t.swap(1, 2);
            }
            let findings = Findings::of(&turned, 1.0);
            assert_eq!((findings.inside_out, findings.borders), (Some(true), 0));
            assert_eq!(mend(&turned, false).0, mesh);
        }
    }

    #[test]
    fn each_fault_is_counted_and_mended() {
        let good = tetrahedron();
        let mut bad = good.clone();
        // Vertex 4 repeats vertex 3, 5 is unused, 6 lies on an edge, 7 makes a fin.
        bad.points.extend([[0., 30., 80.], [9., 9., 9.], [0., 0., 0.], [1., -1., 0.]]);
        bad.colors.extend([[0.9; 3], [0.5; 3], [0.5; 3], [0.5; 3]]);
        bad.triangles[2] = [1, 2, 4];
        bad.triangles.extend([[0, 6, 1], [1, 1, 2], [3, 4, 0], [2, 1, 3], [0, 1, 7]]);
        let findings = Findings::of(&bad, 1.0);
        assert_eq!(findings.duplicate_vertices, 1);
        assert_eq!(findings.unused_vertices, 1);
        assert_eq!(findings.degenerate_triangles, 3);
        assert_eq!(findings.duplicate_triangles, 1);
        assert_eq!(findings.crowded_edges, 1);
        assert_eq!(findings.border_edges, 2, "of the fin");
        assert_eq!(findings.faults(true).len(), 5, "{:?}", findings.faults(true));
        let (mended, what) = mend(&bad, false);
        assert_eq!(mended.points, good.points);
        assert_eq!(mended.triangles, good.triangles);
        assert!((mended.colors[3][0] - 0.8).abs() < 1e-6, "the mean of both");
        assert_eq!(
            what.to_string(),
            "joined 1 equal vertex, dropped 3 triangles without area, dropped 1 repeated \
             triangle, dropped 1 triangle on a crowded edge, dropped 3 unused vertices"
        );
        assert_eq!(mend(&mended, false), (mended, Mended::default()));
    }

    #[test]
    fn smaller_pieces_go_only_if_asked() {
        let mut mesh = tetrahedron();
        mesh.points.extend([[500., 0., 0.], [510., 0., 0.], [500., 10., 0.]]);
        mesh.colors.extend([[0.5; 3]; 3]);
        mesh.triangles.insert(0, [4, 5, 6]);
        let findings = Findings::of(&mesh, 1.0);
        assert_eq!(findings.components, [4, 1]);
        assert_eq!(mend(&mesh, false).0.triangles.len(), 5);
        let (mended, what) = mend(&mesh, true);
        assert_eq!((mended, what.smaller, what.unused), (tetrahedron(), 1, 3));
    }

    #[test]
    fn size_place_and_colour_are_told() {
        let says = |mesh: &Mesh, millimetres: f64, part: &str| {
            let faults = Findings::of(mesh, millimetres).faults(true).join("\n");
            assert!(faults.contains(part), "{faults:?} does not say {part:?}");
        };
        let (face, _) = demo::template().unwrap();
        says(&face, 0.001, "--unit m");
        says(&face, 0.1, "--unit cm");
        says(&face, 40.0, "how many millimetres");
        let mut aside = face.clone();
        for p in &mut aside.points {
            p[0] += 300.0;
        }
        says(&aside, 1.0, "0 % of the vertices have a partner");
        says(&aside, 1.0, "build with --mirror find");
        let mut lopsided = aside.clone();
        for p in &mut lopsided.points {
            *p = [p[0], p[1] + 0.4 * p[0] * p[2].signum(), p[2] + (p[0] + 2.0 * p[1]).abs()];
        }
        says(&lopsided, 1.0, "build with --mirror none");
        let grey = Mesh { colors: vec![[0.5; 3]; face.points.len()], ..face };
        says(&grey, 1.0, "same colour");
    }

    #[test]
    fn a_moebius_strip_and_a_flat_square_do_no_harm() {
        let square = Mesh {
            points: vec![[-50., 0., 0.], [50., 0., 0.], [50., 90., 0.], [-50., 90., 0.]],
            colors: vec![[0.5; 3]; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        assert_eq!(Findings::of(&square, 1.0).inside_out, None);
        assert_eq!(mend(&square, true).1, Mended::default());
        let strip = Mesh {
            points: (0..5_u8).map(|i| [f32::from(i), f32::from(i * i), f32::from(i % 2)]).collect(),
            colors: vec![[0.5; 3]; 5],
            triangles: vec![[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 0], [4, 0, 1]],
        };
        assert_eq!(mend(&strip, false).0.triangles.len(), 5);
    }
}
