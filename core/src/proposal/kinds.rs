//! What an elementary move is, and what of a hypothesis it touches.

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
pub enum Half {
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
        half: Half,
        /// Per coefficient.
        sd: f32,
    },
    /// Adds to one coefficient.
    Single {
        /// Which coefficients.
        half: Half,
        /// Of that coefficient.
        sd: f32,
    },
    /// Multiplies every coefficient by the same factor.
    Caricature {
        /// Which coefficients.
        half: Half,
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
    /// Solves for the light that explains the picture best. It steers, see [`Move::steers`].
    SolveLight {
        /// Visible surface points to use.
        points: u32,
    },
}

impl Move {
    /// Whether the move steers towards good states: it finds them quickly, but it is not reversible and a
    /// chain that uses it is no sampler.
    pub fn steers(&self) -> bool {
        matches!(self, Self::SolveLight { .. })
    }

    /// The coefficients the move changes, if any.
    pub fn half(&self) -> Option<Half> {
        match *self {
            Self::Gaussian { half, .. }
            | Self::Single { half, .. }
            | Self::Caricature { half, .. } => Some(half),
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
            _ => match self.half() {
                Some(Half::Shape) => Touched::SHAPE,
                Some(Half::Albedo) => Touched::ALBEDO,
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
