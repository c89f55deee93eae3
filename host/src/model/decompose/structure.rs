//! Splits a matrix-valued kernel over vertices into independent scalar problems, exactly.
//!
//! The covariance is `Σ_a M_a ⊗ G_a` with symmetric 3×3 matrices `M_a` and scalar Gaussians
//! `G_a[i, j] = exp(−‖x_i − Φ_a x_j‖²/σ_a²)`.
//! 1. If the `M_a` commute they share eigenvectors `v_c` (coordinate axes; grey and chroma),
//!    and the covariance falls apart into three scalar ones, `Σ_a (v_cᵀ M_a v_c) G_a`.
//! 2. If the vertices are symmetric under the only mirror Φ in the kernel, even and odd fields
//!    do not mix, and on them a mirrored Gaussian is the plain one times ±1. Over pairs of
//!    vertices `(i, i')` that halves each problem: with the orthonormal fields
//!    `(e_i ± e_i')/√2`, and `e_i` on the mirror, `G±[i, j] = c_i c_j (g(i, j) ± g(i, j'))`,
//!    `c = 1` for a pair and `1/√2` (even) or `0` (odd) on the mirror.
//! 3. To a kernel of colours alone, vertices of the same colour are the same: `m` of them are one
//!    point, with the orthonormal field `Σ e_i/√m` and `c = √m`.
//! 4. Problems whose weights are proportional have the same eigenvectors and are solved once
//!    (x, y and z of a symmetric shape model; both chroma directions).

use super::commuting::{joint_eigenvectors, quadratic};
use super::operator::{Operator, Weights};
use super::tiles::Metric;
use crate::error::{Error, Result};
use crate::model::kernel::{Kernel, Matrix3, Space, Term, Vertex, reflect};
use faer::ColRef;
use std::collections::HashMap;

/// Relative size of what counts as rounding when weights are compared.
const ROUNDING: f64 = 1e-12;

/// The reflection that is none.
const PLAIN: [bool; 3] = [false; 3];

/// One role of the eigenpairs `(θ, u)` of a scalar problem: they stand for the pairs
/// `(scale·θ, direction ⊗ u)` of the covariance.
#[derive(Clone, Copy, Debug)]
pub(super) struct Use {
    pub(super) direction: [f64; 3],
    pub(super) scale: f64,
}

/// The scalar problems of a kernel over vertices.
pub(super) struct Structure {
    pub(super) operator: Operator,
    /// Per problem of the operator, at least one.
    pub(super) uses: Vec<Vec<Use>>,
    sectors: Vec<Sector>,
    orbits: Orbits,
}

/// Which fields a problem lives on.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Sector {
    Whole,
    Even,
    Odd,
}

/// A scalar problem: fields of one sector, weights of the Gaussians (the largest 1).
struct Scalar {
    sector: Sector,
    weights: Vec<f64>,
    uses: Vec<Use>,
}

/// Vertices that are one point of the scalar problems: mirror images, equal colours, or each alone.
struct Orbits {
    /// Per vertex, its orbit.
    of: Vec<usize>,
    /// Per orbit, its first vertex.
    first: Vec<usize>,
    /// Per orbit, how many vertices it has.
    sizes: Vec<usize>,
}

/// A Gaussian with the sum of all matrices it comes with.
type Atom = Term;

impl Structure {
    pub(super) fn new(kernel: &Kernel, vertices: &[Vertex], kept_bytes: usize) -> Result<Self> {
        let atoms = atoms(kernel);
        let matrices: Vec<Matrix3> = atoms.iter().map(|a| a.matrix).collect();
        let directions = joint_eigenvectors(&matrices).ok_or_else(|| {
            Error::new(format_args!(
                "kernel {kernel}: its 3x3 matrices are not symmetric or share no eigenvectors; \
                 combine kernels whose matrices commute"
            ))
        })?;

        let mirror = only_mirror(&atoms);
        let colored = atoms.iter().any(|a| a.space == Space::Color);
        let mirrored =
            mirror.and_then(|phi| Some((phi, Orbits::mirrored(vertices, phi, colored)?)));
        let (orbits, atoms, sectors): (_, _, &[Sector]) = match mirrored {
            Some((phi, orbits)) => (orbits, both_sides(&atoms, phi), &[Sector::Even, Sector::Odd]),
            None if atoms.iter().all(|a| a.space == Space::Color) => {
                (Orbits::colored(vertices), atoms, &[Sector::Whole])
            }
            None => (Orbits::new(0..vertices.len()), atoms, &[Sector::Whole]),
        };

        let (metrics, order) = metrics(&atoms, vertices, &orbits);
        let mut scalars: Vec<Scalar> = Vec::new();
        for &sector in sectors {
            for direction in directions {
                let weights = order.iter().map(|&a| sector.weight(&atoms, &atoms[a], direction));
                add(&mut scalars, sector, direction, weights.collect());
            }
        }
        let problems = scalars.iter().map(|scalar| Weights {
            gaussians: scalar.weights.clone(),
            scales: orbits.sizes.iter().map(|size| scalar.sector.scale(*size)).collect(),
        });
        let operator = Operator::new(metrics, problems.collect(), kept_bytes);
        let (sectors, uses) = scalars.into_iter().map(|s| (s.sector, s.uses)).unzip();
        Ok(Self { operator, uses, sectors, orbits })
    }

    /// The field over all vertices that `values`, one per point of the operator, stand for in
    /// `problem`; norms are kept.
    pub(super) fn expand(&self, problem: usize, values: ColRef<'_, f64>) -> Vec<f64> {
        let Orbits { of, first, sizes } = &self.orbits;
        let odd = self.sectors[problem] == Sector::Odd;
        let value = |(vertex, &orbit): (usize, &usize)| {
            let value = (1.0 / sizes[orbit] as f64).sqrt() * values[orbit];
            match odd {
                true if sizes[orbit] == 1 => 0.0,
                true if first[orbit] != vertex => -value,
                _ => value,
            }
        };
        of.iter().enumerate().map(value).collect()
    }
}

impl Sector {
    /// Weight of Gaussian `atom` in the scalar covariance of `direction` on this sector.
    fn weight(self, atoms: &[Atom], atom: &Atom, direction: [f64; 3]) -> f64 {
        let plain = quadratic(&atom.matrix, direction);
        let sign = match self {
            Self::Whole => return plain,
            Self::Even => 1.0,
            Self::Odd => -1.0,
        };
        if atom.space == Space::Color {
            // Both sides have the same colour: g(i, j) ± g(i, j') is 2 g or nothing.
            return (1.0 + sign) * plain;
        }
        // On the sector w G + w' G Φ = (w ± w') G with G = g(i, j) ± g(i, j'): the plain
        // Gaussian weighs w ± w', the mirrored one ±(w ± w') = w' ± w.
        let twin = |b: &&Atom| b.is_twin(atom);
        let other = atoms.iter().find(twin).map_or(0.0, |b| quadratic(&b.matrix, direction));
        plain + sign * other
    }

    /// `c` of an orbit of so many vertices.
    fn scale(self, size: usize) -> f64 {
        match self {
            Self::Whole => (size as f64).sqrt(),
            Self::Odd if size == 1 => 0.0,
            Self::Even | Self::Odd => (0.5 * size as f64).sqrt(),
        }
    }
}

/// Adds the scalar covariance of one direction and sector, to a problem with proportional
/// weights if there is one.
fn add(scalars: &mut Vec<Scalar>, sector: Sector, direction: [f64; 3], mut weights: Vec<f64>) {
    let scale = weights.iter().fold(0.0, |m: f64, w| m.max(w.abs()));
    if scale == 0.0 {
        return;
    }
    for w in &mut weights {
        *w /= scale;
    }
    let role = Use { direction, scale };
    let close = |(a, b): (&f64, &f64)| (a - b).abs() <= ROUNDING;
    let same = |s: &&mut Scalar| s.sector == sector && s.weights.iter().zip(&weights).all(close);
    match scalars.iter_mut().find(same) {
        Some(scalar) => scalar.uses.push(role),
        None => scalars.push(Scalar { sector, weights, uses: vec![role] }),
    }
}

/// The terms of a kernel, those of the same Gaussian summed.
fn atoms(kernel: &Kernel) -> Vec<Atom> {
    let mut atoms: Vec<Atom> = Vec::new();
    for term in kernel.terms() {
        match atoms.iter_mut().find(|a| a.same_metric(&term) && a.same_scale(&term)) {
            Some(atom) => {
                for (sum, m) in
                    atom.matrix.as_flattened_mut().iter_mut().zip(term.matrix.as_flattened())
                {
                    *sum += m;
                }
            }
            None => atoms.push(term),
        }
    }
    atoms
}

impl Atom {
    fn same_metric(&self, other: &Self) -> bool {
        self.space == other.space && self.negates == other.negates
    }

    fn same_scale(&self, other: &Self) -> bool {
        self.sigma.to_bits() == other.sigma.to_bits()
    }

    /// Whether `other` is the same Gaussian of positions on the other side of the mirror.
    fn is_twin(&self, other: &Self) -> bool {
        self.space == other.space && self.same_scale(other) && self.negates != other.negates
    }
}

/// The reflection in the kernel, if there is exactly one.
fn only_mirror(atoms: &[Atom]) -> Option<[bool; 3]> {
    let mut mirrors = atoms.iter().map(|a| a.negates).filter(|phi| *phi != PLAIN);
    let first = mirrors.next()?;
    mirrors.all(|phi| phi == first).then_some(first)
}

/// Adds the missing twins, with no weight, so that every Gaussian of positions has both sides.
fn both_sides(atoms: &[Atom], phi: [bool; 3]) -> Vec<Atom> {
    let mut all = atoms.to_vec();
    for atom in atoms.iter().filter(|a| a.space == Space::Position) {
        if !atoms.iter().any(|b| atom.is_twin(b)) {
            let negates = if atom.negates == phi { PLAIN } else { phi };
            all.push(Atom { matrix: [[0.0; 3]; 3], negates, ..*atom });
        }
    }
    all
}

impl Orbits {
    /// Of each vertex, the first vertex of its orbit.
    fn new(firsts: impl IntoIterator<Item = usize>) -> Self {
        let mut all = Self { of: Vec::new(), first: Vec::new(), sizes: Vec::new() };
        for (vertex, first) in firsts.into_iter().enumerate() {
            if first == vertex {
                all.of.push(all.first.len());
                all.first.push(vertex);
                all.sizes.push(1);
            } else {
                let orbit = all.of[first];
                all.of.push(orbit);
                all.sizes[orbit] += 1;
            }
        }
        all
    }

    /// Pairs every vertex with its mirror image; `None` unless all have exactly one. Positions
    /// (and with `colored` colours) are compared to a nanometre, far below what f32 resolves.
    fn mirrored(vertices: &[Vertex], phi: [bool; 3], colored: bool) -> Option<Self> {
        let key = |v: &Vertex, phi: [bool; 3]| -> [i64; 6] {
            std::array::from_fn(|k| match k {
                0..3 => (reflect(v.position, phi)[k] * 1e6).round() as i64,
                _ if colored => (v.color[k - 3] * 1e6).round() as i64,
                _ => 0,
            })
        };
        let mut index = HashMap::with_capacity(vertices.len());
        for (i, v) in vertices.iter().enumerate() {
            if index.insert(key(v, PLAIN), i).is_some() {
                return None;
            }
        }
        let image = |v: &Vertex| index.get(&key(v, phi)).copied();
        let images: Vec<usize> = vertices.iter().map(image).collect::<Option<_>>()?;
        Some(Self::new(images.into_iter().enumerate().map(|(i, image)| i.min(image))))
    }

    /// Joins the vertices of each colour.
    fn colored(vertices: &[Vertex]) -> Self {
        let mut index = HashMap::new();
        let first = |(i, v): (usize, &Vertex)| *index.entry(v.color.map(f64::to_bits)).or_insert(i);
        Self::new(vertices.iter().enumerate().map(first))
    }
}

/// Lays the points of the orbits out per metric; also the order the Gaussians come to be in,
/// as indices into `atoms`.
fn metrics(atoms: &[Atom], vertices: &[Vertex], orbits: &Orbits) -> (Vec<Metric>, Vec<usize>) {
    let mut metrics = Vec::new();
    let mut order: Vec<usize> = Vec::new();
    for (first, atom) in atoms.iter().enumerate() {
        if order.contains(&first) {
            continue;
        }
        let members: Vec<usize> =
            (first..atoms.len()).filter(|&a| atoms[a].same_metric(atom)).collect();
        let coordinate = |k: usize| -> Vec<f64> {
            let of = |v: &Vertex| if atom.space == Space::Color { v.color } else { v.position };
            orbits.first.iter().map(|&vertex| of(&vertices[vertex])[k]).collect()
        };
        metrics.push(Metric {
            points: std::array::from_fn(coordinate),
            negates: atom.negates,
            rates: members.iter().map(|&a| atoms[a].sigma.powi(-2)).collect(),
        });
        order.extend(members);
    }
    (metrics, order)
}
