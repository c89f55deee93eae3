//! Proposals: the mixture tree as data, and what each move does to a hypothesis.
//!
//! A move changes the scene in place and returns
//! `log [q(x' → x)·|J| / q(x → x')]`, the factor by which Metropolis–Hastings must correct the
//! ratio of targets; for moves that scale several parameters together it is the Jacobian of the
//! scaling. With these the chain without [search moves](Move::is_search) leaves its target
//! invariant. (The reference engine treats every move as symmetric.)

// Every move has the same signature, also those that cannot fail.
#![allow(clippy::unnecessary_wraps)]

mod coefficients;
mod color;
mod light;
mod pose;

use crate::math;
use crate::rng::Rng;
use crate::scene::Scene;

/// One of the three rotation angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Axis {
    Roll,
    Yaw,
    Pitch,
}

/// One half of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Part {
    Shape,
    Albedo,
}

/// An elementary move. Standard deviations are in the unit of the parameter: radians,
/// millimetres, colour in `[0, 1]`, standard deviations of a coefficient, or logarithms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Move {
    /// Adds to one angle.
    Rotation {
        /// Which angle.
        axis: Axis,
        /// Radians.
        sd: f32,
    },
    /// Moves along the optical axis and scales the focal length so that the size stays.
    Distance {
        /// Millimetres.
        sd: f32,
    },
    /// Scales the focal length.
    Scaling {
        /// Of the logarithm.
        sd: f32,
    },
    /// Shifts in x and y.
    Translation {
        /// Millimetres.
        sd: f32,
    },
    /// Adds to gain, contrast and offset.
    Color {
        /// Per channel.
        gain_sd: f32,
        /// Of the contrast.
        contrast_sd: f32,
        /// Per channel.
        offset_sd: f32,
    },
    /// Adds to every coefficient.
    Gaussian {
        /// Which coefficients.
        part: Part,
        /// Per coefficient.
        sd: f32,
    },
    /// Adds to one coefficient.
    Single {
        /// Which coefficients.
        part: Part,
        /// Of the one.
        sd: f32,
    },
    /// Multiplies every coefficient by the same factor.
    Caricature {
        /// Which coefficients.
        part: Part,
        /// Of the logarithm.
        sd: f32,
    },
    /// Adds the same to the three channels of a light coefficient, for every coefficient.
    LightSpatial {
        /// Per coefficient.
        sd: f32,
    },
    /// Multiplies each band of the light by its own factor.
    LightBands {
        /// Of the logarithm.
        sd: f32,
    },
    /// Multiplies the whole light by one factor.
    LightIntensity {
        /// Twice the standard deviation of the logarithm (the reference engine's convention).
        sd: f32,
    },
    /// Adds to all 27 numbers of the light and keeps their energy.
    LightPerturbation {
        /// Per number.
        sd: f32,
    },
    /// Adds one RGB shift to all nine coefficients and keeps their energy.
    LightColor {
        /// Per channel.
        sd: f32,
    },
    /// Solves for the light that explains the picture best. A search move.
    SolveLight {
        /// Visible surface points to use.
        points: u32,
    },
    /// Goes a random part of a Gauss–Newton step of the coefficients (and with the shape the
    /// pose) towards the picture. A search move.
    Refine {
        /// Which coefficients.
        part: Part,
        /// Visible vertices to use.
        points: u32,
    },
}

impl Move {
    /// Whether the move optimises: it finds good states quickly, but it is not reversible and a
    /// chain that uses it is no sampler.
    pub fn is_search(&self) -> bool {
        matches!(self, Self::SolveLight { .. } | Self::Refine { .. })
    }

    /// The coefficients the move changes, if any.
    pub fn part(&self) -> Option<Part> {
        match *self {
            Self::Gaussian { part, .. }
            | Self::Single { part, .. }
            | Self::Caricature { part, .. }
            | Self::Refine { part, .. } => Some(part),
            _ => None,
        }
    }

    /// What the move changes.
    pub fn touches(&self) -> Touched {
        match *self {
            Self::Rotation { .. }
            | Self::Translation { .. }
            | Self::Distance { .. }
            | Self::Scaling { .. } => Touched::GEOMETRY,
            _ => match self.part() {
                Some(Part::Shape) => Touched::SHAPE,
                Some(Part::Albedo) => Touched::ALBEDO,
                None => Touched::COLOR,
            },
        }
    }
}

/// Which stages of the pipeline a move invalidates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Touched {
    /// The instance's positions and normals.
    pub shape: bool,
    /// What is visible where.
    pub geometry: bool,
    /// The instance's albedo.
    pub albedo: bool,
}

impl Touched {
    /// Light or colour transform only.
    pub const COLOR: Self = Self { shape: false, geometry: false, albedo: false };
    /// Albedo coefficients.
    pub const ALBEDO: Self = Self { albedo: true, ..Self::COLOR };
    /// Pose or camera.
    pub const GEOMETRY: Self = Self { geometry: true, ..Self::COLOR };
    /// Shape coefficients.
    pub const SHAPE: Self = Self { shape: true, geometry: true, albedo: false };
    /// Everything.
    pub const ALL: Self = Self { shape: true, geometry: true, albedo: true };

    /// What either touches.
    #[must_use]
    pub fn with(self, other: Self) -> Self {
        Self {
            shape: self.shape || other.shape,
            geometry: self.geometry || other.geometry,
            albedo: self.albedo || other.albedo,
        }
    }

    /// What this touches and the other does not.
    #[must_use]
    pub fn without(self, other: Self) -> Self {
        Self {
            shape: self.shape && !other.shape,
            geometry: self.geometry && !other.geometry,
            albedo: self.albedo && !other.albedo,
        }
    }
}

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

/// Rotation, distance and scaling (FACTS §6.1 "NT").
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
    ($name:literal, $part:expr) => {
        Mixture(&[
            (0.1, Leaf($name, Move::Gaussian { part: $part, sd: 0.2 })),
            (0.5, Leaf($name, Move::Gaussian { part: $part, sd: 0.1 })),
            (0.2, Leaf($name, Move::Gaussian { part: $part, sd: 0.025 })),
            (0.2, Leaf(concat!($name, " caricature"), Move::Caricature { part: $part, sd: 0.2 })),
            (0.15, Leaf(concat!($name, " refine"), Move::Refine { part: $part, points: 600 })),
        ])
    };
}

const fn color(gain_sd: f32) -> Tree {
    Leaf("colour", Move::Color { gain_sd, contrast_sd: gain_sd, offset_sd: 1e-4 })
}

const SHAPE_COEFFICIENTS: Tree = coefficients!("shape", Part::Shape);

const COEFFICIENTS: Tree =
    Mixture(&[(0.5, SHAPE_COEFFICIENTS), (0.5, coefficients!("albedo", Part::Albedo))]);

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

/// Moves of pose and shape.
pub const POSE_AND_SHAPE: Tree = Mixture(&[(1.0, POSE), (3.0, SHAPE_COEFFICIENTS)]);

/// [`POSE_AND_SHAPE`] of an object.
pub const OBJECT_POSE_AND_SHAPE: Tree = Mixture(&[(1.0, OBJECT_POSE), (3.0, SHAPE_COEFFICIENTS)]);

/// All moves of a face fit (FACTS §6.1).
pub const FACE: Tree = Mixture(&[(1.0, POSE), (1.0, COLOR), (3.0, COEFFICIENTS), (2.0, LIGHT)]);

/// All moves of the fit of an object. (The reference engine does not solve for its light.)
pub const OBJECT: Tree =
    Mixture(&[(1.0, OBJECT_POSE), (1.0, COLOR), (3.0, COEFFICIENTS), (2.0, LIGHT)]);

/// The most leaves a [`Table`] holds.
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

/// What a move needs to know besides the scene.
pub trait Surroundings {
    /// Model-frame position of the landmark a move is centred on.
    fn centre(&self, index: usize) -> Option<[f32; 3]>;

    /// Replaces the light of `scene`, the current state, by the closed-form light from `points`
    /// visible surface points. `None` if there is none.
    fn solve_light(&mut self, scene: &mut Scene, points: u32, rng: &mut Rng) -> Option<()>;

    /// Moves the coefficients (and the pose) of `scene`, the current state, by part of a
    /// Gauss–Newton step from `points` visible vertices. `None` if there is none.
    fn refine(&mut self, scene: &mut Scene, part: Part, points: u32, rng: &mut Rng) -> Option<()>;
}

/// Applies a leaf to the scene. Returns the log ratio described at the top of this module, or
/// `None` if the move fails: it leads out of the space (behind the camera, say) or has nothing to
/// work on. A failed move counts as rejected, its scene is to be discarded.
pub fn propose(
    branch: &Branch,
    scene: &mut Scene,
    rng: &mut Rng,
    surroundings: &mut impl Surroundings,
) -> Option<f64> {
    let Some(centre) = branch.centre else {
        return apply(branch.kind, scene, rng, surroundings);
    };
    // The principal point is additive in the picture, so shifting it by the difference holds the
    // landmark exactly; given everything else the shift is a translation, its Jacobian is one.
    let point = surroundings.centre(centre)?;
    let project = |scene: &Scene| scene.camera.project(scene.pose.to_world(point));
    let (u0, v0, d0) = project(scene);
    let ratio = apply(branch.kind, scene, rng, surroundings)?;
    let (u1, v1, d1) = project(scene);
    let near = scene.camera.near;
    if !(d0 > near && d1 > near) {
        return None;
    }
    let [width, height] = scene.camera.image_size.map(|side| side as f32);
    scene.camera.principal_point[0] += 2.0 * (u0 - u1) / width;
    scene.camera.principal_point[1] -= 2.0 * (v0 - v1) / height;
    Some(ratio)
}

fn apply(
    kind: Move,
    scene: &mut Scene,
    rng: &mut Rng,
    surroundings: &mut impl Surroundings,
) -> Option<f64> {
    match kind {
        Move::Rotation { axis, sd } => pose::rotate(&mut scene.pose, axis, rng.normal_sd(sd)),
        Move::Distance { sd } => {
            pose::change_distance(&mut scene.pose, &mut scene.camera, rng.normal_sd(sd))
        }
        Move::Scaling { sd } => pose::scale(&mut scene.camera, rng.normal_sd(sd)),
        Move::Translation { sd } => {
            let shift = [rng.normal_sd(sd), rng.normal_sd(sd)];
            pose::translate(&mut scene.pose, shift)
        }
        Move::Color { gain_sd, contrast_sd, offset_sd } => {
            color::perturb(&mut scene.color, gain_sd, contrast_sd, offset_sd, rng)
        }
        Move::Gaussian { part, sd } => coefficients::add(coefficients_of(scene, part), sd, rng),
        Move::Single { part, sd } => {
            coefficients::add_to_one(coefficients_of(scene, part), sd, rng)
        }
        Move::Caricature { part, sd } => {
            coefficients::caricature(coefficients_of(scene, part), rng.normal_sd(sd))
        }
        Move::LightSpatial { sd } => light::spatial(&mut scene.light, sd, rng),
        Move::LightBands { sd } => light::bands(&mut scene.light, sd, rng),
        Move::LightIntensity { sd } => light::intensity(&mut scene.light, 0.5 * rng.normal_sd(sd)),
        Move::LightPerturbation { sd } => light::perturb(&mut scene.light, sd, rng),
        Move::LightColor { sd } => light::tint(&mut scene.light, sd, rng),
        Move::SolveLight { points } => {
            surroundings.solve_light(scene, points, rng)?;
            Some(0.0)
        }
        Move::Refine { part, points } => {
            surroundings.refine(scene, part, points, rng)?;
            Some(0.0)
        }
    }
}

fn coefficients_of(scene: &mut Scene, part: Part) -> &mut [f32] {
    match part {
        Part::Shape => &mut scene.shape,
        Part::Albedo => &mut scene.albedo,
    }
}

/// `eˣ` as f32, for factors.
fn factor(x: f32) -> f32 {
    math::exp(f64::from(x)) as f32
}
