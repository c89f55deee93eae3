//! The course of a fit as data: which moves, judged by what, how often, and from where.

use super::config::Config;
use crate::likelihood::landmarks::ObservedLandmark;
use crate::metropolis::Factors;
use crate::proposal::{
    CENTRES, FACE, OBJECT, OBJECT_POSE, OBJECT_POSE_AND_SHAPE, POSE, POSE_AND_SHAPE, Tree,
};
use serde::{Deserialize, Serialize};

/// The phases of a fit, as reports name them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PhaseName {
    /// Pose by landmarks.
    Landmarks,
    /// Pose and shape by landmarks.
    Shape,
    /// Everything by the picture.
    Image,
}

impl PhaseName {
    /// All of them, in order.
    pub const ALL: [Self; 3] = [Self::Landmarks, Self::Shape, Self::Image];
}

/// [`Factors`]: the landmark likelihood.
pub const LANDMARKS: Factors = 1 << 0;
/// [`Factors`]: the prior.
pub const PRIOR: Factors = 1 << 1;
/// [`Factors`]: the image likelihood.
pub const IMAGE: Factors = 1 << 2;

/// Where a phase begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begin {
    /// At the state of highest density of the phase before.
    Best,
    /// At the state the phase before ended with, as one long chain would.
    Last,
}

/// A part of a fit in which nothing changes but the state.
#[derive(Clone, Copy, Debug)]
pub struct Phase {
    /// What reports call it.
    pub name: PhaseName,
    /// What may be done. Moves are left out for which the problem has no coefficients or no landmark, and, if
    /// the phase does not look at the picture, those that need one.
    pub moves: &'static Tree,
    /// Which factors judge a proposal.
    pub factors: Factors,
    /// How many steps it has: 0 skips the phase, unless it is the last.
    pub steps: fn(&Config) -> u32,
    /// Where it begins.
    pub begin: Begin,
}

/// The most phases a [`Schedule`] has.
pub const MAX_PHASES: usize = 3;

/// The phases of a fit, in order.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    /// What it is for, `"face"` or `"object"`.
    pub name: &'static str,
    /// At least one, at most [`MAX_PHASES`]; their names differ.
    pub phases: &'static [Phase],
}

impl Schedule {
    /// The phases of a face, as in the paper: first the pose by the landmarks, at last everything by the
    /// picture. Between the two there may be one that moves pose and shape by the landmarks. Moves of the
    /// pose hold a landmark of [`CENTRES`] in place.
    pub const FACE: Self = Self {
        name: "face",
        phases: &[
            Phase { moves: &POSE, ..LANDMARK_PHASE },
            Phase { moves: &POSE_AND_SHAPE, ..SHAPE_PHASE },
            Phase { moves: &FACE, ..IMAGE_PHASE },
        ],
    };

    /// The same phases for anything else, without landmarks that are held in place. The phase of
    /// the shape is for objects whose template is far from what the picture shows.
    pub const OBJECT: Self = Self {
        name: "object",
        phases: &[
            Phase { moves: &OBJECT_POSE, ..LANDMARK_PHASE },
            Phase { moves: &OBJECT_POSE_AND_SHAPE, ..SHAPE_PHASE },
            Phase { moves: &OBJECT, ..IMAGE_PHASE },
        ],
    };

    /// [`Schedule::FACE`] if any of its centres, [`CENTRES`], is among the observed landmarks,
    /// [`Schedule::OBJECT`] otherwise: nothing else tells a face from other things.
    pub fn of(landmarks: &[ObservedLandmark<'_>]) -> &'static Self {
        let face = landmarks.iter().any(|landmark| CENTRES.contains(&landmark.name));
        if face { &Self::FACE } else { &Self::OBJECT }
    }

    /// Phase number `phase`; past the end, the last. `None` if there are none at all.
    pub(super) fn phase(&self, phase: u8) -> Option<&'static Phase> {
        self.phases.get(usize::from(phase)).or(self.phases.last())
    }

    /// Steps of the phases before number `phase`; of all, if it is past the end.
    pub(super) fn steps_before(&self, phase: usize, config: &Config) -> u32 {
        let steps = self.phases.iter().take(phase).map(|phase| (phase.steps)(config));
        steps.fold(0, u32::saturating_add)
    }

    /// The first phase from number `phase` on that has steps, or the last.
    pub(super) fn next(&self, phase: usize, config: &Config) -> usize {
        let next = self.phases.iter().skip(phase).position(|phase| (phase.steps)(config) > 0);
        next.map_or(self.phases.len().saturating_sub(1), |skipped| phase + skipped)
    }
}

const LANDMARK_PHASE: Phase = Phase {
    name: PhaseName::Landmarks,
    moves: &POSE,
    factors: LANDMARKS | PRIOR,
    steps: |config| config.landmark_steps,
    begin: Begin::Best,
};

const SHAPE_PHASE: Phase = Phase {
    name: PhaseName::Shape,
    moves: &POSE_AND_SHAPE,
    factors: LANDMARKS | PRIOR,
    steps: |config| config.shape_steps,
    begin: Begin::Best,
};

const IMAGE_PHASE: Phase = Phase {
    name: PhaseName::Image,
    moves: &FACE,
    factors: LANDMARKS | PRIOR | IMAGE,
    steps: |config| config.image_steps,
    begin: Begin::Best,
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phases_without_steps_are_skipped_but_for_the_last() {
        let config = |landmark_steps, shape_steps, image_steps| Config {
            landmark_steps,
            shape_steps,
            image_steps,
            ..Config::default()
        };
        assert_eq!(Schedule::FACE.next(0, &config(0, 0, 9)), 2);
        assert_eq!(Schedule::FACE.next(0, &config(0, 5, 9)), 1);
        assert_eq!(Schedule::FACE.next(1, &config(1, 0, 0)), 2);
        assert_eq!(Schedule::FACE.steps_before(3, &config(u32::MAX, 1, 1)), u32::MAX);
        assert_eq!(Schedule::FACE.steps_before(2, &config(1, 2, 4)), 3);
    }

    #[test]
    fn one_centre_makes_a_face() {
        let at = |name| ObservedLandmark { name, position: [0.0; 2] };
        assert_eq!(Schedule::of(&[at("fin"), at(CENTRES[3])]).name, "face");
        assert_eq!(Schedule::of(&[at("fin")]).name, "object");
    }
}
