//! What is to be fitted to what, and how.

use super::config::Config;
use super::dimensions::Dimensions;
use super::schedule::Schedule;
use crate::engine::Engine;
use crate::image::Image;
use crate::likelihood::landmarks::{MAX_LANDMARKS, ObservedLandmark};
use crate::model::Model;
use crate::scene::MAX_RANK;
use core::fmt;

/// A photo, and what is known of it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Photo<'a> {
    /// The picture.
    pub image: Image<'a>,
    /// Landmarks in the picture, at least one.
    pub landmarks: &'a [ObservedLandmark<'a>],
    /// Where the face may be seen, if that is known: one number per pixel, row by row, from 255 for a pixel
    /// that may show the face to 0 for one that cannot; a pixel in between has a part of its weight. Only a
    /// search looks at it: a chain takes every pixel that the model covers for the face.
    pub open: Option<&'a [u8]>,
}

impl<'a> Photo<'a> {
    /// A photo that may show the face anywhere.
    pub const fn new(image: Image<'a>, landmarks: &'a [ObservedLandmark<'a>]) -> Self {
        Self { image, landmarks, open: None }
    }

    /// The same, with [`open`](Self::open) as given.
    #[must_use]
    pub const fn with_open(self, open: Option<&'a [u8]>) -> Self {
        Self { open, ..self }
    }

    /// How much a pixel may show the face, 0 to 1.
    pub(crate) fn open_at(&self, index: usize) -> f32 {
        self.open.map_or(1.0, |open| f32::from(open.get(index).copied().unwrap_or(0)) / 255.0)
    }

    /// Sizes of a problem, with this photo's in place of the problem's own.
    pub(crate) fn dimensions(&self, of: &Dimensions) -> Dimensions {
        let Image { width, height, .. } = self.image;
        let (width, height) = (width as usize, height as usize);
        Dimensions { landmarks: self.landmarks.len(), width, height, ..*of }
    }

    /// Looks whether everything fits together, and finds the landmarks' vertices.
    pub(crate) fn check(&self, model: &Model<'_>) -> Result<Observed, ChainError> {
        let Self { image, landmarks, open } = *self;
        let pixels = (image.width as usize).checked_mul(image.height as usize);
        let count = image.pixels.len();
        if count == 0 || pixels != Some(count) || open.is_some_and(|open| open.len() != count) {
            return Err(ChainError::Image);
        }
        if landmarks.is_empty() || landmarks.len() > MAX_LANDMARKS {
            return Err(ChainError::LandmarkCount { found: landmarks.len() });
        }
        let mut observed = Observed::new();
        for (index, landmark) in landmarks.iter().enumerate() {
            let vertex =
                model.landmark(landmark.name).ok_or(ChainError::UnknownLandmark { index })?;
            if !landmark.position.iter().all(|x| x.is_finite()) {
                return Err(ChainError::LandmarkPosition { index });
            }
            // The count was checked.
            let _ = observed.push((vertex, landmark.position));
        }
        Ok(observed)
    }
}

/// What is to be fitted to what, and how.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Problem<'a> {
    /// The model.
    pub model: &'a Model<'a>,
    /// The photo.
    pub photo: Photo<'a>,
    /// How it is fitted.
    pub config: &'a Config,
    /// The phases of a chain.
    pub schedule: &'a Schedule,
    /// What computes the expensive stages; [`Engine::PORTABLE`] if in doubt.
    pub engine: &'a Engine,
    /// Whether memory is scarcer than time. The chain then takes less than half the memory: a
    /// rejected proposal's stages are computed again when they are wanted. Same bits.
    pub lean: bool,
}

/// Vertex and observed position of every landmark.
pub(crate) type Observed = heapless::Vec<(u32, [f32; 2]), MAX_LANDMARKS>;

impl<'a> Problem<'a> {
    /// Looks whether the numbers that say how are in range.
    pub(crate) fn check(&self) -> Result<(), ChainError> {
        let config = self.config;
        let found = config.shape_rank.max(config.albedo_rank);
        if found > MAX_RANK {
            return Err(ChainError::Rank { found });
        }
        let prior = &config.prior;
        let sds = [
            config.landmark_sd,
            config.pixel_sd,
            config.pixel_patch,
            prior.distance,
            prior.distance_sd,
            prior.principal_point_sd,
            prior.gain_sd,
            prior.contrast_sd,
            prior.offset_sd,
        ];
        if sds.iter().any(|sd| !(*sd > 0.0 && sd.is_finite())) {
            return Err(ChainError::Config);
        }
        Ok(())
    }

    /// A face in a photo, with [`Schedule::FACE`] and [`Engine::PORTABLE`], and not lean.
    pub const fn new(
        model: &'a Model<'a>,
        image: Image<'a>,
        landmarks: &'a [ObservedLandmark<'a>],
        config: &'a Config,
    ) -> Self {
        let (schedule, engine) = (&Schedule::FACE, Engine::PORTABLE);
        let photo = Photo::new(image, landmarks);
        Self { model, photo, config, schedule, engine, lean: false }
    }

    /// The same with other phases: [`Schedule::of`] chooses them by the landmarks, if it need not be a face.
    #[must_use]
    pub const fn with_schedule(self, schedule: &'a Schedule) -> Self {
        Self { schedule, ..self }
    }

    /// The same, its expensive stages computed by `engine`.
    #[must_use]
    pub const fn with_engine(self, engine: &'a Engine) -> Self {
        Self { engine, ..self }
    }

    /// The same, with the photo's [`open`](Photo::open) as given.
    #[must_use]
    pub const fn with_open(self, open: Option<&'a [u8]>) -> Self {
        Self { photo: self.photo.with_open(open), ..self }
    }

    /// The same, with [`lean`](Self::lean) as given.
    #[must_use]
    pub const fn with_lean(self, lean: bool) -> Self {
        Self { lean, ..self }
    }

    /// The sizes that determine the memory a chain needs.
    pub fn dimensions(&self) -> Dimensions {
        Dimensions {
            vertices: self.model.vertices(),
            shape_rank: self.config.shape_rank.min(self.model.shape.rank()),
            albedo_rank: self.config.albedo_rank.min(self.model.albedo.rank()),
            landmarks: self.photo.landmarks.len(),
            width: self.photo.image.width as usize,
            height: self.photo.image.height as usize,
            lean: self.lean,
        }
    }
}

/// Why a chain cannot start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum ChainError {
    /// The picture is empty or has another number of pixels than its sides or its mask say.
    Image,
    /// More photos than there is room for.
    Photos { found: usize },
    /// No landmarks, or more than [`MAX_LANDMARKS`].
    LandmarkCount { found: usize },
    /// A landmark that the model does not have.
    UnknownLandmark { index: usize },
    /// A landmark position that is not finite.
    LandmarkPosition { index: usize },
    /// More coefficients than [`MAX_RANK`].
    Rank { found: usize },
    /// A standard deviation that is not positive.
    Config,
    /// A schedule without phases, with too many, or with a phase whose moves all need what the
    /// problem does not have.
    Schedule,
    /// The memory is shorter than [`Dimensions::words`].
    Memory { needed: usize, found: usize },
    /// The checkpoint is of another problem: other coefficients or picture size.
    Checkpoint,
}

impl fmt::Display for ChainError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Image => write!(f, "the picture is empty or its size does not match its pixels"),
            Self::Photos { found } => write!(f, "{found} photos, which is too many"),
            Self::LandmarkCount { found } => {
                write!(f, "{found} landmarks; a fit needs 1 to {MAX_LANDMARKS}")
            }
            Self::UnknownLandmark { index } => {
                write!(f, "landmark {index} is not a landmark of the model")
            }
            Self::LandmarkPosition { index } => {
                write!(f, "landmark {index} has a position that is not finite")
            }
            Self::Rank { found } => {
                write!(f, "{found} coefficients; a fit infers at most {MAX_RANK} of each kind")
            }
            Self::Config => write!(f, "a standard deviation in the configuration is not positive"),
            Self::Schedule => {
                write!(f, "the schedule has no phases, too many, or one without moves")
            }
            Self::Memory { needed, found } => {
                write!(f, "{found} words of memory; this fit needs {needed}")
            }
            Self::Checkpoint => write!(f, "the checkpoint belongs to another model or picture"),
        }
    }
}

impl core::error::Error for ChainError {}
