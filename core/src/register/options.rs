//! Settings of a registration, and its levels from coarse to fine.

/// One resolution of a registration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Standard deviation of the blur of colours, mm.
    pub blur: f32,
    /// The most shape components that are sought, the leading ones.
    pub components: usize,
    /// Distance to its foot at which a vertex counts a quarter, mm.
    pub trust: f32,
    /// Iterations.
    pub iterations: u32,
}

/// The levels, coarse to fine, as they were found in a prototype (docs/registration.md).
pub const LEVELS: [Level; 4] = [
    Level { blur: 6.0, components: 50, trust: 6.0, iterations: 4 },
    Level { blur: 3.0, components: 100, trust: 4.0, iterations: 4 },
    Level { blur: 1.5, components: usize::MAX, trust: 3.0, iterations: 3 },
    Level { blur: 0.0, components: usize::MAX, trust: 3.0, iterations: 4 },
];

/// The settings. How they were chosen: docs/registration.md.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Whether colours say where a vertex belongs.
    pub albedo: bool,
    /// Standard deviation of coefficients of shape and albedo; the model's is 1.
    pub width: f32,
    /// Standard deviation of the logarithm of the size.
    pub size_sd: f32,
    /// Standard deviation of the distance to the scan, mm.
    pub distance_sd: f32,
    /// Vertices that share one independent error of distance.
    pub patch: f32,
    /// Standard deviation of a colour channel.
    pub color_sd: f32,
    /// Vertices that share one independent error of colour.
    pub color_patch: f32,
    /// Standard deviation of a colour channel about the albedo that is found for the scan.
    pub albedo_sd: f32,
    /// Vertices that share one independent error of albedo.
    pub albedo_patch: f32,
    /// Standard deviation of landmarks, mm.
    pub landmark_sd: f32,
    /// Feet nearer than this to a border of the scan, mm, are no evidence: nobody knows how the surface goes on
    /// there. At most 6.
    pub rim: f32,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            albedo: true,
            width: 0.45,
            // The 60 people of `fixtures/face` differ by 3.6 to 5.8 % along the axes.
            size_sd: 0.04,
            distance_sd: 0.4,
            patch: 30.0,
            color_sd: 0.05,
            color_patch: 8.6,
            albedo_sd: 0.05,
            albedo_patch: 70.0,
            landmark_sd: 1.0,
            rim: 1.5,
        }
    }
}
