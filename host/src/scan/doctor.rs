//! What is wrong with a mesh, and mending it.
//!
//! A scan need not be perfect to make a model: holes are fine. But a model has a colour and a
//! normal per vertex and compares both sides of an object, so what is split, folded, inside out, off
//! centre or in another unit is told here, and what can be mended without guessing is.

use crate::mesh::{Mesh, weld};
use crate::scan::symmetry;
use crate::vector::{self, dot, length, minus};
use serde::Serialize;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::fmt;

/// Diagonals that the kernels' lengths suit, millimetres: half a face to a bust with its shoulders.
const DIAGONALS: std::ops::RangeInclusive<f64> = 60.0..=1500.0;
/// Least `|6 V| / A^{3/2}` at which a surface is bent enough to have an inside; a hemisphere has
/// about 0.2, a tenth of a sphere's cap 0.04.
const BENT: f64 = 0.01;
/// Least fraction of vertices with a partner across x = 0 in a mesh that lies symmetric.
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
    /// Surface, square millimetres.
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
    /// If those are few: how far mirrored vertices are from the surface at the plane at which it mirrors
    /// best, root mean square, millimetres; none if that is no symmetry.
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
            (self.duplicate_vertices, "vertices lie exactly on others (seams)"),
            (self.unused_vertices, "vertices belong to no triangle"),
            (self.degenerate_triangles, "triangles have no area"),
            (self.duplicate_triangles, "triangles repeat others"),
            (self.crowded_edges, "edges have more than two triangles"),
            (self.clashing_edges, "edges lie between triangles that face opposite ways"),
        ];
        for (count, what) in mendable {
            note(count > 0, format!("{count} {what}: --mend"));
        }
        note(self.inside_out == Some(true), "the surface is inside out: --mend".into());
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

    /// What the file's unit may be, as if this had been read in millimetres.
    fn unit_hint(&self) -> String {
        let likely = [("cm", 10.0), ("m", 1000.0)]
            .into_iter()
            .find(|(_, millimetres)| (100.0..=700.0).contains(&(self.diagonal * millimetres)));
        match likely {
            Some((unit, _)) => format!("if its numbers were read as mm, try --unit {unit}"),
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

/// What [`mend`] did; displays as a line.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Mended {
    /// Vertices joined to an equal one.
    pub joined: usize,
    /// Triangles without area dropped.
    pub degenerate: usize,
    /// Repeated triangles dropped.
    pub duplicate: usize,
    /// Triangles dropped because their edge had two already.
    pub crowded: usize,
    /// Triangles dropped with all but the largest component.
    pub smaller: usize,
    /// Triangles turned over.
    pub turned: usize,
    /// Vertices dropped that no triangle uses.
    pub unused: usize,
}

impl fmt::Display for Mended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let done: Vec<_> = [
            (self.joined, "joined", "equal vertex", "equal vertices"),
            (self.degenerate, "dropped", "triangle without area", "triangles without area"),
            (self.duplicate, "dropped", "repeated triangle", "repeated triangles"),
            (self.crowded, "dropped", "triangle on a crowded edge", "triangles on crowded edges"),
            (self.smaller, "dropped", "triangle of a smaller piece", "triangles of smaller pieces"),
            (self.turned, "turned", "triangle over", "triangles over"),
            (self.unused, "dropped", "unused vertex", "unused vertices"),
        ]
        .into_iter()
        .filter(|(count, ..)| *count > 0)
        .map(|(n, verb, one, many)| format!("{verb} {n} {}", if n == 1 { one } else { many }))
        .collect();
        f.write_str(if done.is_empty() { "nothing to mend" } else { "" })?;
        f.write_str(&done.join(", "))
    }
}

/// Joins equal vertices (their colours are averaged), drops triangles without area, repeated ones
/// and of those that crowd an edge the smallest, if asked all components but the largest, and
/// vertices no triangle uses; turns triangles so that neighbours agree, and closed pieces and the
/// surface as a whole look outwards. Order is kept. Doing it again changes nothing.
///
/// A mesh that has no triangle with area is given back without triangles.
pub fn mend(mesh: &Mesh, largest_only: bool) -> (Mesh, Mended) {
    let mut mended = Mended::default();
    let (map, points) = weld(&mesh.points);
    mended.joined = mesh.points.len() - points.len();
    let mut shown = vec![false; mesh.points.len()];
    for &v in mesh.triangles.as_flattened() {
        shown[v as usize] = true;
    }
    let mut colors = vec![[0.0_f64; 4]; points.len()];
    // No triangle shows the colours of the others.
    for ((&v, color), _) in map.iter().zip(&mesh.colors).zip(&shown).filter(|(_, shown)| **shown) {
        let sum = &mut colors[v as usize];
        for i in 0..3 {
            sum[i] += f64::from(color[i]);
        }
        sum[3] += 1.0;
    }
    let exact: Vec<[f64; 3]> = points.iter().map(|p| p.map(f64::from)).collect();
    let joined: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.map(|v| map[v as usize])).collect();
    let (kept, degenerate, duplicate) = distinct(&exact, &joined);
    (mended.degenerate, mended.duplicate) = (degenerate, duplicate);
    let roomy = thinned(&exact, &kept);
    mended.crowded = kept.len() - roomy.len();
    let mut triangles = roomy;
    if largest_only {
        let pieces = components(exact.len(), &triangles);
        let mut largest = pieces.into_iter().next().unwrap_or_default();
        largest.sort_unstable();
        mended.smaller = triangles.len() - largest.len();
        triangles = largest.into_iter().map(|t| triangles[t as usize]).collect();
    }
    mended.turned = orient(&exact, &mut triangles);

    let mut used = vec![false; points.len()];
    for &v in triangles.as_flattened() {
        used[v as usize] = true;
    }
    let mut place = vec![0_u32; points.len()];
    let mut out = Mesh { points: Vec::new(), colors: Vec::new(), triangles };
    for (v, (&point, [r, g, b, count])) in points.iter().zip(colors).enumerate() {
        if used[v] {
            place[v] = out.points.len() as u32;
            out.points.push(point);
            out.colors.push([r, g, b].map(|sum| (sum / count) as f32));
        }
    }
    mended.unused = points.len() - out.points.len();
    for triangle in &mut out.triangles {
        *triangle = triangle.map(|v| place[v as usize]);
    }
    (out, mended)
}

pub(super) type Points<'a> = &'a [[f64; 3]];

fn normal(points: Points<'_>, triangle: [u32; 3]) -> [f64; 3] {
    vector::normal(triangle.map(|v| points[v as usize]))
}

pub(super) fn area(points: Points<'_>, triangle: [u32; 3]) -> f64 {
    0.5 * length(normal(points, triangle))
}

fn distance(points: Points<'_>, a: u32, b: u32) -> f64 {
    vector::distance(points[a as usize], points[b as usize])
}

pub(super) fn bounds(points: Points<'_>) -> ([f64; 3], [f64; 3]) {
    points.iter().fold(([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]), |(low, high), p| {
        (std::array::from_fn(|i| low[i].min(p[i])), std::array::from_fn(|i| high[i].max(p[i])))
    })
}

/// Triangles with area, the first of each three corners; and how many were without area and how
/// many repeated.
pub(super) fn distinct(
    points: Points<'_>,
    triangles: &[[u32; 3]],
) -> (Vec<[u32; 3]>, usize, usize) {
    let mut seen = HashSet::new();
    let (mut degenerate, mut duplicate) = (0, 0);
    let kept = triangles.iter().copied().filter(|&t| {
        let mut key = t;
        key.sort_unstable();
        if !(area(points, t) > 0.0) {
            degenerate += 1;
            false
        } else if !seen.insert(key) {
            duplicate += 1;
            false
        } else {
            true
        }
    });
    (kept.collect(), degenerate, duplicate)
}

/// The sides of each edge: a triangle, and whether it runs from the lower to the higher vertex.
pub(super) type Edges = BTreeMap<[u32; 2], Vec<(u32, bool)>>;

fn sides([a, b, c]: [u32; 3]) -> [([u32; 2], bool); 3] {
    [[a, b], [b, c], [c, a]].map(|[from, to]| ([from.min(to), from.max(to)], from < to))
}

pub(super) fn edges(triangles: &[[u32; 3]]) -> Edges {
    let mut edges = Edges::new();
    for (t, triangle) in triangles.iter().enumerate() {
        for (edge, forward) in sides(*triangle) {
            edges.entry(edge).or_default().push((t as u32, forward));
        }
    }
    edges
}

/// Triangles without those for which one of their edges has no room: the larger come first.
fn thinned(points: Points<'_>, triangles: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let crowded: HashSet<[u32; 2]> = edges(triangles)
        .into_iter()
        .filter(|(_, sides)| sides.len() > 2)
        .map(|(edge, _)| edge)
        .collect();
    let touches = |t: &[u32; 3]| sides(*t).iter().any(|(edge, _)| crowded.contains(edge));
    let mut order: Vec<usize> = (0..triangles.len()).filter(|&t| touches(&triangles[t])).collect();
    order.sort_by(|&a, &b| {
        area(points, triangles[b]).total_cmp(&area(points, triangles[a])).then(a.cmp(&b))
    });
    let mut taken: HashMap<[u32; 2], u32> = HashMap::new();
    let mut dropped = HashSet::new();
    for t in order {
        let edges = sides(triangles[t]).map(|(edge, _)| edge);
        if edges.iter().any(|e| crowded.contains(e) && taken.get(e).is_some_and(|n| *n >= 2)) {
            dropped.insert(t);
        } else {
            for edge in edges {
                *taken.entry(edge).or_default() += 1;
            }
        }
    }
    (0..triangles.len()).filter(|t| !dropped.contains(t)).map(|t| triangles[t]).collect()
}

/// Sets of numbers that are joined one by one (union by index, paths halved).
pub(super) struct Groups {
    parents: Vec<u32>,
}

impl Groups {
    pub(super) fn new(count: usize) -> Self {
        Self { parents: (0..count as u32).collect() }
    }

    pub(super) fn find(&mut self, mut a: u32) -> u32 {
        while self.parents[a as usize] != a {
            let above = self.parents[self.parents[a as usize] as usize];
            self.parents[a as usize] = above;
            a = above;
        }
        a
    }

    pub(super) fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.parents[a.max(b) as usize] = a.min(b);
    }
}

/// The triangles of each component, connected by vertices; the largest first.
fn components(vertices: usize, triangles: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let mut groups = Groups::new(vertices);
    for &[a, b, c] in triangles {
        groups.join(a, b);
        groups.join(b, c);
    }
    let mut found: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (t, triangle) in triangles.iter().enumerate() {
        found.entry(groups.find(triangle[0])).or_default().push(t as u32);
    }
    let mut found: Vec<_> = found.into_values().collect();
    found.sort_by_key(|triangles| std::cmp::Reverse(triangles.len()));
    found
}

/// Centre of the surface.
fn centre(points: Points<'_>, triangles: &[[u32; 3]]) -> [f64; 3] {
    let mut sum = [0.0; 4];
    for &t in triangles {
        let weight = area(points, t);
        for i in 0..3 {
            sum[i] += weight * t.iter().map(|&v| points[v as usize][i]).sum::<f64>() / 3.0;
        }
        sum[3] += weight;
    }
    [0, 1, 2].map(|i| sum[i] / sum[3].max(f64::MIN_POSITIVE))
}

/// Six times the signed volume between the triangles and `o`, `Σ (a − o)·((b − a)×(c − a))`:
/// positive where they look away from it.
fn flux(points: Points<'_>, triangles: impl Iterator<Item = [u32; 3]>, o: [f64; 3]) -> f64 {
    triangles.map(|t| dot(minus(points[t[0] as usize], o), normal(points, t))).sum()
}

/// Turns triangles so that neighbours agree; returns how many were turned.
///
/// Within a patch, connected by edges of two triangles, the majority by area decides; a closed
/// patch is turned outwards, and if the surface as a whole looks inwards the open ones are turned.
fn orient(points: Points<'_>, triangles: &mut [[u32; 3]]) -> usize {
    let edges = edges(triangles);
    let mut flips: Vec<Option<bool>> = vec![None; triangles.len()];
    let mut patches: Vec<(Vec<u32>, bool)> = Vec::new();
    for start in 0..triangles.len() {
        if flips[start].is_some() {
            continue;
        }
        flips[start] = Some(false);
        let (mut patch, mut next, mut closed) = (vec![start as u32], 0, true);
        while let Some(&t) = patch.get(next) {
            next += 1;
            let turned = flips[t as usize].unwrap_or_default();
            for (edge, forward) in sides(triangles[t as usize]) {
                let [first, second] = edges[&edge][..] else {
                    closed = false;
                    continue;
                };
                let (other, runs) = if first.0 == t { second } else { first };
                if flips[other as usize].is_none() {
                    flips[other as usize] = Some((runs == forward) != turned);
                    patch.push(other);
                }
            }
        }
        patches.push((patch, closed));
    }
    let mut flips: Vec<bool> = flips.into_iter().map(Option::unwrap_or_default).collect();
    let flipped = |t: u32, flips: &[bool]| {
        let [a, b, c] = triangles[t as usize];
        if flips[t as usize] { [a, c, b] } else { [a, b, c] }
    };
    for (patch, closed) in &patches {
        let balance = |t: &u32| {
            let area = area(points, triangles[*t as usize]);
            if flips[*t as usize] { -area } else { area }
        };
        let inwards = if *closed {
            let origin = points[triangles[patch[0] as usize][0] as usize];
            flux(points, patch.iter().map(|&t| flipped(t, &flips)), origin) < 0.0
        } else {
            patch.iter().map(balance).sum::<f64>() < 0.0
        };
        if inwards {
            for &t in patch {
                flips[t as usize] = !flips[t as usize];
            }
        }
    }
    let all = 0..triangles.len() as u32;
    let total: f64 = triangles.iter().map(|&t| area(points, t)).sum();
    let whole = flux(points, all.map(|t| flipped(t, &flips)), centre(points, triangles));
    if whole < -BENT * total.powf(1.5) {
        for &t in patches.iter().filter(|(_, closed)| !closed).flat_map(|(patch, _)| patch) {
            flips[t as usize] = !flips[t as usize];
        }
    }
    for (triangle, _) in triangles.iter_mut().zip(&flips).filter(|(_, flip)| **flip) {
        triangle.swap(1, 2);
    }
    flips.iter().filter(|flip| **flip).count()
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
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
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
