//! Mixtures of moves as data, and such a tree multiplied out. Widths and weights are those of the paper's
//! released program, unless said otherwise.

use super::kinds::{Axis, Half, Move};
use crate::rng::Rng;

/// A mixture of moves: a tree whose branches carry weights, normalised within each mixture.
#[derive(Clone, Copy, Debug)]
pub enum Tree {
    /// Picks a branch by weight.
    Mixture(&'static [(f32, Self)]),
    /// Compensates the subtree's moves so that landmark number `usize` of [`CENTRES`] stays
    /// where it is in the picture.
    Centred(usize, &'static Self),
    /// A named move.
    Leaf(&'static str, Move),
}

/// Landmarks that pose moves are centred on.
pub const CENTRES: [&str; 4] =
    ["right.eye.corner_outer", "left.eye.corner_outer", "right.lips.corner", "left.lips.corner"];

use Tree::{Centred, Leaf, Mixture};

const fn rotation(name: &'static str, axis: Axis, sd: f32) -> Tree {
    Leaf(name, Move::Rotation { axis, sd })
}

macro_rules! rotations {
    ($name:literal, $axis:expr) => {
        Mixture(&[
            (0.1, rotation($name, $axis, 0.75)),
            (0.4, rotation($name, $axis, 0.10)),
            (0.5, rotation($name, $axis, 0.01)),
        ])
    };
}

/// Rotation, distance and scaling.
const TURN: Tree = Mixture(&[
    (
        1.0,
        Mixture(&[
            (0.5, rotations!("yaw", Axis::Yaw)),
            (0.3, rotations!("pitch", Axis::Pitch)),
            (0.2, rotations!("roll", Axis::Roll)),
        ]),
    ),
    (
        1.0,
        Mixture(&[
            (0.2, Leaf("distance", Move::Distance { sd: 500.0 })),
            (0.6, Leaf("distance", Move::Distance { sd: 50.0 })),
            (0.2, Leaf("distance", Move::Distance { sd: 5.0 })),
        ]),
    ),
    (
        1.0,
        Mixture(&[
            (0.2, Leaf("scaling", Move::Scaling { sd: 0.15 })),
            (0.6, Leaf("scaling", Move::Scaling { sd: 0.05 })),
            (0.2, Leaf("scaling", Move::Scaling { sd: 0.01 })),
        ]),
    ),
]);

const TRANSLATION: Tree = Mixture(&[
    (0.2, Leaf("translation", Move::Translation { sd: 300.0 })),
    (0.2, Leaf("translation", Move::Translation { sd: 50.0 })),
    (0.6, Leaf("translation", Move::Translation { sd: 10.0 })),
]);

/// Pose moves of a face fit.
pub const POSE: Tree = Mixture(&[
    (1.0, Centred(0, &TURN)),
    (1.0, Centred(1, &TURN)),
    (1.0, Centred(2, &TURN)),
    (1.0, Centred(3, &TURN)),
    (0.2, TRANSLATION),
]);

/// Pose moves where none of [`CENTRES`] is seen: of an object that is no face.
pub const OBJECT_POSE: Tree = Mixture(&[(0.8, TURN), (0.2, TRANSLATION)]);

macro_rules! coefficients {
    ($name:literal, $half:expr) => {
        Mixture(&[
            (0.1, Leaf($name, Move::Gaussian { half: $half, sd: 0.2 })),
            (0.5, Leaf($name, Move::Gaussian { half: $half, sd: 0.1 })),
            (0.2, Leaf($name, Move::Gaussian { half: $half, sd: 0.025 })),
            (0.2, Leaf(concat!($name, " caricature"), Move::Caricature { half: $half, sd: 0.2 })),
        ])
    };
}

const fn color(gain_sd: f32) -> Tree {
    Leaf("colour", Move::Color { gain_sd, contrast_sd: gain_sd, offset_sd: 1e-4 })
}

const SHAPE_COEFFICIENTS: Tree = coefficients!("shape", Half::Shape);

const COEFFICIENTS: Tree =
    Mixture(&[(0.5, SHAPE_COEFFICIENTS), (0.5, coefficients!("albedo", Half::Albedo))]);

const COLOR: Tree = Mixture(&[(0.2, color(0.01)), (0.6, color(0.001)), (0.2, color(0.0005))]);

const LIGHT: Tree = Mixture(&[
    (
        5.0,
        Mixture(&[
            (1.0, Leaf("light spatial", Move::LightSpatial { sd: 0.05 })),
            (1.0, Leaf("light bands", Move::LightBands { sd: 0.1 })),
            (1.0, Leaf("light intensity", Move::LightIntensity { sd: 0.1 })),
            (1.0, Leaf("light perturbation", Move::LightPerturbation { sd: 0.001 })),
            (1.0, Leaf("light colour", Move::LightColor { sd: 0.01 })),
        ]),
    ),
    (1.0, Leaf("light solve", Move::SolveLight { points: 100 })),
]);

/// Moves of pose and shape, in the proportion that [`FACE`] has.
pub const POSE_AND_SHAPE: Tree = Mixture(&[(1.0, POSE), (3.0, SHAPE_COEFFICIENTS)]);

/// [`POSE_AND_SHAPE`] of an object.
pub const OBJECT_POSE_AND_SHAPE: Tree = Mixture(&[(1.0, OBJECT_POSE), (3.0, SHAPE_COEFFICIENTS)]);

/// All moves of a face fit.
pub const FACE: Tree = Mixture(&[(1.0, POSE), (1.0, COLOR), (3.0, COEFFICIENTS), (2.0, LIGHT)]);

/// All moves of the fit of an object. (The reference engine does not solve for its light.)
pub const OBJECT: Tree =
    Mixture(&[(1.0, OBJECT_POSE), (1.0, COLOR), (3.0, COEFFICIENTS), (2.0, LIGHT)]);

/// The most leaves a [`Table`] holds; [`FACE`] has 80.
pub const MAX_LEAVES: usize = 88;

/// A leaf of the tree with its probability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Branch {
    /// What reports call it.
    pub name: &'static str,
    /// What it does.
    pub kind: Move,
    /// Landmark held in place, an index into [`CENTRES`].
    pub centre: Option<usize>,
    /// Probability of being picked.
    pub probability: f32,
}

/// A tree multiplied out: the leaves that apply, their probabilities summing to one.
#[derive(Clone, Debug)]
pub struct Table(heapless::Vec<Entry, MAX_LEAVES>);

/// A [`Branch`] in little memory.
#[derive(Clone, Copy, Debug)]
struct Entry {
    leaf: &'static Tree,
    centre: Option<u8>,
    probability: f32,
}

impl Entry {
    /// `None` of a tree that is no leaf.
    fn branch(&self) -> Option<Branch> {
        let Leaf(name, kind) = *self.leaf else { return None };
        let centre = self.centre.map(usize::from);
        Some(Branch { name, kind, centre, probability: self.probability })
    }
}

impl Table {
    /// Flattens a tree, dropping what `applies` rejects and sharing its weight among the others of
    /// its mixture. `None` if there is nothing left, or more than [`MAX_LEAVES`].
    pub fn new(tree: &'static Tree, applies: impl Fn(&Branch) -> bool) -> Option<Self> {
        let mut table = Self(heapless::Vec::new());
        table.add(tree, 1.0, None, &applies)?;
        if table.0.is_empty() { None } else { Some(table) }
    }

    /// The leaves.
    pub fn branches(&self) -> impl Iterator<Item = Branch> {
        self.0.iter().filter_map(Entry::branch)
    }

    /// Number of leaves.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Never: a table has leaves.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// A leaf by its index; `None` past the end.
    pub fn branch(&self, index: usize) -> Option<Branch> {
        self.0.get(index)?.branch()
    }

    /// Index of a leaf picked by its probability.
    pub fn pick(&self, rng: &mut Rng) -> usize {
        let mut u = rng.uniform();
        for (index, entry) in self.0.iter().enumerate() {
            u -= f64::from(entry.probability);
            if u < 0.0 {
                return index;
            }
        }
        self.0.len() - 1
    }

    fn add(
        &mut self,
        tree: &'static Tree,
        probability: f32,
        centre: Option<u8>,
        applies: &dyn Fn(&Branch) -> bool,
    ) -> Option<()> {
        match *tree {
            Leaf(..) => {
                let entry = Entry { leaf: tree, centre, probability };
                if entry.branch().is_some_and(|branch| applies(&branch)) {
                    self.0.push(entry).ok()?;
                }
            }
            Centred(landmark, inner) => {
                self.add(inner, probability, Some(landmark as u8), applies)?;
            }
            Mixture(branches) => {
                let alive = |tree: &'static Tree| any_applies(tree, centre, applies);
                let total: f32 = branches.iter().filter(|b| alive(&b.1)).map(|b| b.0).sum();
                for (weight, inner) in branches.iter().filter(|b| alive(&b.1)) {
                    self.add(inner, probability * weight / total, centre, applies)?;
                }
            }
        }
        Some(())
    }
}

fn any_applies(tree: &'static Tree, centre: Option<u8>, applies: &dyn Fn(&Branch) -> bool) -> bool {
    match *tree {
        Leaf(..) => {
            let entry = Entry { leaf: tree, centre, probability: 0.0 };
            entry.branch().is_some_and(|branch| applies(&branch))
        }
        Centred(landmark, inner) => any_applies(inner, Some(landmark as u8), applies),
        Mixture(branches) => branches.iter().any(|(_, tree)| any_applies(tree, centre, applies)),
    }
}
