//! A surface by its triangles: areas, edges, pieces, and which way it looks.

use crate::vector::{self, dot, length, minus};
use std::collections::{BTreeMap, HashMap, HashSet};

/// Least `|6 V| / A^{3/2}` at which a surface is bent enough to have an inside; a hemisphere has
/// about 0.2, a tenth of a sphere's cap 0.04.
pub(in crate::scan) const BENT: f64 = 0.01;

pub(in crate::scan) type Points<'a> = &'a [[f64; 3]];

pub(in crate::scan) fn normal(points: Points<'_>, triangle: [u32; 3]) -> [f64; 3] {
    vector::normal(triangle.map(|v| points[v as usize]))
}

pub(in crate::scan) fn area(points: Points<'_>, triangle: [u32; 3]) -> f64 {
    0.5 * length(normal(points, triangle))
}

pub(in crate::scan) fn distance(points: Points<'_>, a: u32, b: u32) -> f64 {
    vector::distance(points[a as usize], points[b as usize])
}

pub(in crate::scan) fn bounds(points: Points<'_>) -> ([f64; 3], [f64; 3]) {
    points.iter().fold(([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]), |(low, high), p| {
        (std::array::from_fn(|i| low[i].min(p[i])), std::array::from_fn(|i| high[i].max(p[i])))
    })
}

/// Triangles with area, the first of each three corners; and how many were without area and how
/// many repeated.
pub(in crate::scan) fn distinct(
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
pub(in crate::scan) type Edges = BTreeMap<[u32; 2], Vec<(u32, bool)>>;

fn sides([a, b, c]: [u32; 3]) -> [([u32; 2], bool); 3] {
    [[a, b], [b, c], [c, a]].map(|[from, to]| ([from.min(to), from.max(to)], from < to))
}

pub(in crate::scan) fn edges(triangles: &[[u32; 3]]) -> Edges {
    let mut edges = Edges::new();
    for (t, triangle) in triangles.iter().enumerate() {
        for (edge, forward) in sides(*triangle) {
            edges.entry(edge).or_default().push((t as u32, forward));
        }
    }
    edges
}

/// Triangles without those for which one of their edges has no room: the larger come first.
pub(in crate::scan) fn thinned(points: Points<'_>, triangles: &[[u32; 3]]) -> Vec<[u32; 3]> {
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
pub(in crate::scan) struct Groups {
    parents: Vec<u32>,
}

impl Groups {
    pub(in crate::scan) fn new(count: usize) -> Self {
        Self { parents: (0..count as u32).collect() }
    }

    pub(in crate::scan) fn find(&mut self, mut a: u32) -> u32 {
        while self.parents[a as usize] != a {
            let above = self.parents[self.parents[a as usize] as usize];
            self.parents[a as usize] = above;
            a = above;
        }
        a
    }

    pub(in crate::scan) fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.parents[a.max(b) as usize] = a.min(b);
    }
}

/// The triangles of each component, connected by vertices; the largest first.
pub(in crate::scan) fn components(vertices: usize, triangles: &[[u32; 3]]) -> Vec<Vec<u32>> {
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
pub(in crate::scan) fn centre(points: Points<'_>, triangles: &[[u32; 3]]) -> [f64; 3] {
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
pub(in crate::scan) fn flux(
    points: Points<'_>,
    triangles: impl Iterator<Item = [u32; 3]>,
    o: [f64; 3],
) -> f64 {
    triangles.map(|t| dot(minus(points[t[0] as usize], o), normal(points, t))).sum()
}

/// Turns triangles so that neighbours agree; returns how many were turned.
///
/// Within a patch, connected by edges of two triangles, the majority by area decides; a closed
/// patch is turned outwards, and if the surface as a whole looks inwards the open ones are turned.
pub(in crate::scan) fn orient(points: Points<'_>, triangles: &mut [[u32; 3]]) -> usize {
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
